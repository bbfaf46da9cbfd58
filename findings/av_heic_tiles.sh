#!/usr/bin/env bash
# A HEIC picture made of tiles, as phones write them, opened by PyAV (FFmpeg).
#
# Expected: one stream of the picture's size, or an error that says that tiles are not put together.
# Seen with PyAV 18.1.0: a picture of 384x256 px in tiles of 128x128 opens as six streams of 128x128 px, without a word;
# decode(video=0) gives one frame, the upper left tile, and the size of the whole stands nowhere among the streams.
# pillow-heif 1.8.1 (libheif) opens the same file as one picture of 384x256.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q numpy==2.4.6 av==18.1.0 pillow==13.0.0 pillow-heif==1.8.1
"$folder/venv/bin/python" - <<'PYTHON'
import io

import av
import numpy as np
import pillow_heif
from PIL import Image

WIDTH, HEIGHT, TILE = 384, 256, 128
ramp = np.linspace(0, 255, WIDTH).astype(np.uint8)
picture = Image.fromarray(np.repeat(np.tile(ramp, (HEIGHT, 1))[..., None], 3, axis=2))
pillow_heif.options.GRID_TILE_SIZE = TILE
file = io.BytesIO()
pillow_heif.from_pillow(picture).save(file, quality=90)
data = file.getvalue()

whole = np.asarray(pillow_heif.open_heif(io.BytesIO(data)))
with av.open(io.BytesIO(data)) as container:
    sizes = [(stream.width, stream.height) for stream in container.streams.video]
    frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
print(f"libheif: {whole.shape[1]}x{whole.shape[0]}; FFmpeg: {len(sizes)} streams of {sizes[0]}, {len(frames)} frame")
print(f"brightest of the first frame: {frames[0].max()}, of the picture: {whole.max()}")
assert whole.shape[:2] == (HEIGHT, WIDTH), "pillow-heif no longer opens the picture whole"
assert sizes == [(TILE, TILE)] * 6, "the streams are no longer the tiles"
assert len(frames) == 1 and frames[0].shape[:2] == (TILE, TILE), "the first stream is no longer one tile"
assert np.abs(frames[0].astype(int) - whole[:TILE, :TILE]).max() < 8, "it is no longer the upper left one"
PYTHON
