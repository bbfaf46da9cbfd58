#!/usr/bin/env bash
# OpenCV's bitwise_not of a mask of NumPy's type bool, which OpenCV 5 takes and gives back as bool.
#
# Expected: an error as in OpenCV 4, or the mask turned round, as ~mask.
# Seen with OpenCV 5.0.0: an array of type bool that is true everywhere: its bytes are 254 where the mask was true, 255
# where not. NumPy counts, prints and indexes all of it as true, and ~ of it is false everywhere. bitwise_and,
# bitwise_or, bitwise_xor and flip of bool masks are right. OpenCV 4.13.0 refuses the mask.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
for version in 5.0.0.93 4.13.0.92; do
    python3 -m venv "$folder/$version"
    "$folder/$version/bin/pip" install -q numpy==2.4.6 "opencv-python-headless==$version"
    "$folder/$version/bin/python" - <<'PYTHON'
import cv2
import numpy as np

known = np.tile([[True, False, True]], (2, 1))
other = np.tile([[True, True, False]], (2, 1))
try:
    unknown = cv2.bitwise_not(known)
except cv2.error:
    print(f"OpenCV {cv2.__version__}: refused")
    assert cv2.__version__.startswith("4."), "bitwise_not refuses a mask of type bool"
    raise SystemExit from None
print(f"OpenCV {cv2.__version__}: of {known[0].tolist()} bitwise_not gives {unknown.dtype} {unknown[0].tolist()}, "
      f"bytes {unknown[0].view(np.uint8).tolist()}, count {np.count_nonzero(unknown)}")
assert cv2.__version__.startswith("5."), "OpenCV 4 takes masks of type bool"
assert unknown.dtype == bool and unknown[0].view(np.uint8).tolist() == [254, 255, 254], "other bytes"
assert unknown.all() and not (~unknown).any() and np.count_nonzero(unknown) == known.size, "no longer true everywhere"
assert np.arange(3)[unknown[0]].tolist() == [0, 1, 2], "as an index it no longer takes everything"
for mine, theirs in (
    (cv2.bitwise_and(known, other), known & other), (cv2.bitwise_or(known, other), known | other),
    (cv2.bitwise_xor(known, other), known ^ other), (cv2.flip(known, 1), known[:, ::-1]),
):
    assert mine.dtype == bool and np.array_equal(mine.view(np.uint8), theirs.astype(np.uint8)), "another one differs"
PYTHON
done
