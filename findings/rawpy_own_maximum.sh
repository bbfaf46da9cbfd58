#!/usr/bin/env bash
# rawpy's postprocess on two photographs of the same exposure, all that is automatic switched off but one setting.
#
# Expected: with no_auto_bright, a user white balance of 1 and linear output, a count gives the same value in every file.
# Seen with rawpy 0.28.0 (LibRaw 0.22): a patch at a quarter of the white level gives .25 of full scale, and .3125 beside
# a spot at 80 % of the white level: a file's brightest count becomes the white level, where it is above .75 of that
# (LibRaw's adjust_maximum_thr; 0 switches it off). dcraw with the same options has nothing of the kind.
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

WHITE, PATCH = 4000, 1000
folder = Path(os.environ["FOLDER"])


def write(name, spot):
    counts = np.full((128, 192), PATCH, np.uint16)
    counts[40:60, 40:60] = spot
    identity = (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1)
    tags = [
        (33421, "H", 2, (2, 2), False), (33422, "B", 4, bytes([0, 1, 1, 2]), False), (274, "H", 1, 1, True),
        (50706, "B", 4, bytes([1, 4, 0, 0]), False), (50707, "B", 4, bytes([1, 1, 0, 0]), False),
        (50708, "s", 0, "Test\0", False), (50714, "H", 1, 0, False), (50717, "I", 1, WHITE, False),
        (50721, "2i", 9, identity, False), (50728, "2I", 3, (1,) * 6, False), (50778, "H", 1, 21, False),
        (271, "s", 0, "test\0", False), (272, "s", 0, "Test\0", False),
    ]
    tifffile.imwrite(folder / name, counts, photometric=32803, extratags=tags, metadata=None, software=False)


def patch(name, **more):
    with rawpy.imread(str(folder / name)) as raw:
        picture = raw.postprocess(
            demosaic_algorithm=rawpy.DemosaicAlgorithm.LINEAR, output_color=rawpy.ColorSpace.raw, gamma=(1, 1),
            output_bps=16, no_auto_bright=True, user_wb=[1, 1, 1, 1], **more,
        )
    return float(np.median(picture)) / 65535


write("dim.dng", PATCH)
write("spot.dng", round(0.8 * WHITE))
dim, spot = patch("dim.dng"), patch("spot.dng")
fixed = [patch(name, adjust_maximum_thr=0) for name in ("dim.dng", "spot.dng")]
print(f"patch of .25: {dim:.4f} alone, {spot:.4f} beside a spot; adjust_maximum_thr=0: {fixed[0]:.4f} and {fixed[1]:.4f}")
assert max(abs(value - PATCH / WHITE) for value in fixed) < 1e-3, "adjust_maximum_thr=0 no longer scales by the level"
assert abs(spot / dim - 1.25) < 0.01, "a spot no longer changes the brightness of the rest"
PYTHON
