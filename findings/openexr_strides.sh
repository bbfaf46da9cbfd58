#!/usr/bin/env bash
# OpenEXR's Python module: an array whose elements do not follow each other in memory, as cropping and transposing in
# NumPy give it.
#
# Expected: File(header, channels).write stores the array's values, or refuses it.
# Seen with OpenEXR 3.5.3: it stores what follows the array's first element in memory, as if there were no strides: a
# transposed map, every second column and a cropped map come back as other pictures of the right size, without a word.
# np.ascontiguousarray before is the way out.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q numpy==2.4.6 OpenEXR==3.5.3
FOLDER="$folder" "$folder/venv/bin/python" - <<'PYTHON'
import os

import numpy as np
import OpenEXR

path = os.path.join(os.environ["FOLDER"], "depth.exr")
depth_mm = 1000 + np.arange(48 * 64, dtype=np.float32).reshape(48, 64)


def again(values):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Z": values}).write(path)
    return OpenEXR.File(path).channels()["Z"].pixels


def in_memory(values):
    """What lies there from the array's first element on."""
    first = (values.__array_interface__["data"][0] - depth_mm.__array_interface__["data"][0]) // depth_mm.itemsize
    return depth_mm.ravel()[first : first + values.size].reshape(values.shape)


assert np.array_equal(again(depth_mm), depth_mm), "an array in C order is not stored as it is"
for name, values in (
    ("transposed", depth_mm.T), ("every second column", depth_mm[:, ::2]), ("cropped", depth_mm[8:40, 16:48]),
):
    seen = again(values)
    print(f"{name}: {np.mean(seen == values):.0%} of {seen.shape[1]}x{seen.shape[0]} px are right")
    assert np.array_equal(seen, in_memory(values)) and not np.array_equal(seen, values), f"{name}: stored otherwise"
    assert np.array_equal(again(np.ascontiguousarray(values)), values), f"{name}: a copy in C order is not stored"
PYTHON
