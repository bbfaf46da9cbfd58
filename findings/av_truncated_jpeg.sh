#!/usr/bin/env bash
# Half of a JPEG file, given to FFmpeg's decoder mjpeg through PyAV, as with a webcam whose frame lost its end.
#
# Expected: an error, or a frame with is_corrupt set.
# Seen with PyAV 18.1.0: one frame of full size, is_corrupt False, its lower part of one colour (0, 135, 0): green. With
# the option err_detect=explode decoding ends with InvalidDataError, of the whole file with a frame. Pillow refuses half a
# file.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q numpy==2.4.6 av==18.1.0 pillow==13.0.0
"$folder/venv/bin/python" - <<'PYTHON'
import io

import av
import numpy as np
from PIL import Image

av.logging.set_level(None)
picture = np.random.default_rng(0).integers(0, 255, (256, 384, 3), np.uint8)
file = io.BytesIO()
Image.fromarray(picture).save(file, "JPEG", quality=90)
whole = file.getvalue()
half = whole[: len(whole) // 2]


def decode(data, **options):
    context = av.CodecContext.create("mjpeg", "r")
    context.options = options
    return [*context.decode(av.Packet(data)), *context.decode(None)]


(frame,) = decode(half)
rgb = frame.to_ndarray(format="rgb24")
end = rgb[-64:].reshape(-1, 3)
print(f"half a file: {frame.width}x{frame.height}, is_corrupt {frame.is_corrupt}, lowest rows all {end[0].tolist()}")
assert rgb.shape == picture.shape and not frame.is_corrupt, "half a file is no longer a whole frame"
assert np.ptp(end, axis=0).max() == 0, "what is missing is no longer of one colour"
assert len(decode(whole, err_detect="explode")) == 1, "with err_detect=explode the whole file is no longer decoded"
try:
    decode(half, err_detect="explode")
except av.FFmpegError as error:
    print(f"with err_detect=explode: {type(error).__name__}")
else:
    raise AssertionError("with err_detect=explode half a file is no longer refused")
try:
    Image.open(io.BytesIO(half)).load()
except OSError as error:
    print(f"Pillow: {error}")
else:
    raise AssertionError("Pillow no longer refuses half a file")
PYTHON
