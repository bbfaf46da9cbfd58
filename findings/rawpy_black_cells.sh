#!/usr/bin/env bash
# The black level of a DNG file whose levels repeat every 4 x 4 photosites (BlackLevelRepeatDim), by rawpy.
#
# Expected: black_level_per_channel holds the mean of the four photosites of each channel in the cell.
# Seen with rawpy 0.28.0 (LibRaw 0.22): of levels from 100 to 400 it holds 100 for every channel, the least of all
# sixteen, where of a 2 x 2 cell it holds each channel's own. postprocess subtracts each photosite's level in both files;
# raw_image, from which the attribute is to be subtracted, keeps up to 300 counts of black. No attribute tells of the cell.
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

WHITE, LIGHT = 4000, 1000
folder = Path(os.environ["FOLDER"])


def write(name, levels):
    """Even light on a mosaic whose photosites have these levels without light."""
    rows, columns = levels.shape
    counts = (LIGHT + np.tile(levels, (128 // rows, 192 // columns))).astype(np.uint16)
    identity = (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1)
    tags = [
        (33421, "H", 2, (2, 2), False), (33422, "B", 4, bytes([0, 1, 1, 2]), False), (274, "H", 1, 1, True),
        (50706, "B", 4, bytes([1, 4, 0, 0]), False), (50707, "B", 4, bytes([1, 1, 0, 0]), False),
        (50708, "s", 0, "Test\0", False), (50713, "H", 2, (rows, columns), False),
        (50714, "H", levels.size, tuple(map(int, levels.ravel())), False), (50717, "I", 1, WHITE, False),
        (50721, "2i", 9, identity, False), (50728, "2I", 3, (1,) * 6, False), (50778, "H", 1, 21, False),
        (271, "s", 0, "test\0", False), (272, "s", 0, "Test\0", False),
    ]
    tifffile.imwrite(folder / name, counts, photometric=32803, extratags=tags, metadata=None, software=False)


def read(name):
    with rawpy.imread(str(folder / name)) as raw:
        black = list(raw.black_level_per_channel)
        left = raw.raw_image_visible.astype(int) - np.array(black)[raw.raw_colors_visible] - LIGHT
        picture = raw.postprocess(
            demosaic_algorithm=rawpy.DemosaicAlgorithm.LINEAR, output_color=rawpy.ColorSpace.raw, gamma=(1, 1),
            output_bps=16, no_auto_bright=True, user_wb=[1, 1, 1, 1], adjust_maximum_thr=0,
        )
    return black, int(left.max()), int(np.ptp(picture))


write("two.dng", np.array([[100, 140], [180, 220]]))
write("four.dng", 100 + 20 * np.arange(16).reshape(4, 4))
for name in ("two.dng", "four.dng"):
    black, left, spread = read(name)
    print(f"{name}: black_level_per_channel {black}, left in raw_image {left}, spread of postprocess {spread}")
assert read("two.dng") == ([100, 140, 220, 180], 0, 0), "levels of a 2 x 2 cell are told otherwise"
assert read("four.dng") == ([100] * 4, 300, 0), "levels of a 4 x 4 cell are told otherwise"
PYTHON
