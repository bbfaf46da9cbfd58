#!/usr/bin/env bash
# A DNG file of two mosaics of one size, as of a burst or of the two halves of every pixel, by rawpy's shot_select.
#
# Expected: shot_select=1, "which image to extract from RAW files that contain multiple images", gives the second one.
# Seen with rawpy 0.28.0 (LibRaw 0.22): it gives the first one again, in raw_image and by postprocess, without a word,
# whether the two are pages of the file or sub-pictures of a preview. The number is looked at: shot_select=2 is refused
# as not in the file. tifffile reads both.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q numpy==2.4.6 tifffile==2026.3.3 rawpy==0.28.0
FOLDER="$folder" "$folder/venv/bin/python" - <<'PYTHON'
import os
from pathlib import Path

import numpy as np
import rawpy
import tifffile

WHITE, LIGHTS, SHAPE = 4000, (1000, 2000), (128, 192)
folder = Path(os.environ["FOLDER"])
identity = (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1)
dng = [
    (274, "H", 1, 1, True), (50706, "B", 4, bytes([1, 4, 0, 0]), False), (50707, "B", 4, bytes([1, 1, 0, 0]), False),
    (50708, "s", 0, "Test\0", False), (50721, "2i", 9, identity, False), (50728, "2I", 3, (1,) * 6, False),
    (50778, "H", 1, 21, False), (271, "s", 0, "test\0", False), (272, "s", 0, "Test\0", False),
]
mosaic = [
    (33421, "H", 2, (2, 2), False), (33422, "B", 4, bytes([0, 1, 1, 2]), False), (50714, "H", 1, 0, False),
    (50717, "I", 1, WHITE, False),
]
plain = {"metadata": None, "software": False}


def write(name, with_preview):
    """Two mosaics of even light: pages, or in the sub-directories of a preview."""
    with tifffile.TiffWriter(folder / name) as file:
        if with_preview:
            small = np.zeros((32, 48, 3), np.uint8)
            file.write(small, photometric="rgb", subfiletype=1, subifds=2, extratags=dng, **plain)
        for light in LIGHTS:
            counts = np.full(SHAPE, light, np.uint16)
            file.write(counts, photometric=32803, subfiletype=0, extratags=mosaic + dng, **plain)


def seen(name, number):
    with rawpy.imread(str(folder / name), shot_select=number) as raw:
        picture = raw.postprocess(
            output_color=rawpy.ColorSpace.raw, gamma=(1, 1), output_bps=16, no_auto_bright=True,
            user_wb=[1, 1, 1, 1], adjust_maximum_thr=0,
        )
        return float(np.median(raw.raw_image_visible)), round(float(np.median(picture)) / 65535 * WHITE)


for name, with_preview in (("pages.dng", False), ("preview.dng", True)):
    write(name, with_preview)
    with tifffile.TiffFile(folder / name) as file:
        pages = file.pages[0].pages if with_preview else file.pages
        stored = tuple(int(np.median(page.asarray())) for page in pages)
    found = [seen(name, number) for number in (0, 1)]
    print(f"{name}: tifffile {stored}; raw_image and postprocess of shot_select=0 {found[0]}, of 1 {found[1]}")
    assert stored == LIGHTS, "tifffile reads something else"
    assert found == [(LIGHTS[0], LIGHTS[0])] * 2, "shot_select=1 no longer gives the first picture"
    try:
        seen(name, 2)
    except rawpy.LibRawError as error:
        print(f"  of 2: {type(error).__name__}")
    else:
        raise AssertionError("shot_select=2 is no longer refused")
PYTHON
