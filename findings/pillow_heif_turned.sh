#!/usr/bin/env bash
# A HEIC picture that a phone's tag turns by 90 degrees (box irot, and EXIF orientation 6), opened in both ways of
# pillow-heif.
#
# Expected: open_heif and Image.open agree, and info tells by how much the pixels were turned.
# Seen with pillow-heif 1.8.1: both turn the pixels. Image.open sets EXIF's orientation to 1 and keeps original_orientation;
# open_heif leaves orientation 6 in info["exif"] beside pixels that are turned already, so that who follows it turns twice.
# Where EXIF says 1 and irot alone turns, neither tells that anything was turned; no option hands out pixels as stored.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q numpy==2.4.6 pillow==13.0.0 pillow-heif==1.8.1
"$folder/venv/bin/python" - <<'PYTHON'
import io

import numpy as np
import pillow_heif
from PIL import Image

pillow_heif.register_heif_opener()
ORIENTATION, STORED, TURNED = 0x0112, (384, 256), (256, 384)


def exif_of(orientation):
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    return exif.tobytes()


picture = Image.fromarray(np.random.default_rng(0).integers(0, 255, (*STORED[::-1], 3), np.uint8))
file = io.BytesIO()
pillow_heif.from_pillow(picture).save(file, quality=90, exif=exif_of(6))
both = file.getvalue()
alone = both.replace(exif_of(6)[6:], exif_of(1)[6:])  # irot stays
assert b"irot" in both and alone != both


def seen(data):
    heif, opened = pillow_heif.open_heif(io.BytesIO(data)), Image.open(io.BytesIO(data))
    exif = Image.Exif()
    exif.load(heif.info["exif"])
    ways = {"open_heif": (heif.size, exif.get(ORIENTATION), heif.info), "Image.open":
            (opened.size, opened.getexif().get(ORIENTATION), opened.info)}
    return {way: (size, orientation, info.get("original_orientation")) for way, (size, orientation, info) in ways.items()}


for what, data in (("irot and EXIF 6", both), ("irot, EXIF 1", alone)):
    for way, (size, orientation, original) in seen(data).items():
        print(f"{what}: {way} {size}, orientation {orientation}, original_orientation {original}")
assert seen(both)["open_heif"] == (TURNED, 6, None), "open_heif no longer leaves orientation 6 beside turned pixels"
assert seen(both)["Image.open"] == (TURNED, 1, 6), "Image.open no longer sets orientation 1 and keeps 6"
assert {size for size, *_ in seen(alone).values()} == {TURNED}, "irot alone no longer turns"
assert all(told in (None, 1) for _, *two in seen(alone).values() for told in two), "info tells of irot now"
PYTHON
