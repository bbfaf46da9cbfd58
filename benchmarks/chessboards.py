"""Our intrinsics of OpenCV's chessboards against the published ones: python benchmarks/chessboards.py --data DIR.

DIR holds left01.jpg ... left14.jpg, 9 x 6 inner corners. Published: focal length 535.916 px, centre (342.283, 235.571),
0.3926 px rms, with all distortions free and corners of another detector.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2

from chromaperture.calibration.chessboard import find_corners, fit_intrinsics

PUBLISHED = {"focal_px": 535.916, "center_x_px": 342.283, "center_y_px": 235.571, "rms_px": 0.3926}
INNER_CORNERS, GAMMA = (9, 6), 2.2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    pictures = [cv2.imread(str(p), cv2.IMREAD_GRAYSCALE) for p in sorted(parser.parse_args().data.glob("*.jpg"))]
    corners = [find_corners((picture / 255.0) ** GAMMA, INNER_CORNERS) for picture in pictures]
    height, width = pictures[0].shape
    found = fit_intrinsics([c for c in corners if c is not None], (width, height), INNER_CORNERS, square_mm=1.0)
    ours = {
        "focal_px": found.camera_matrix[0, 0],
        "center_x_px": found.camera_matrix[0, 2],
        "center_y_px": found.camera_matrix[1, 2],
        "rms_px": found.rms_px,
    }
    rows = {name: {"ours": round(float(ours[name]), 3), "published": PUBLISHED[name]} for name in ours}
    print(json.dumps({"boards": sum(c is not None for c in corners), **rows}, indent=1))


if __name__ == "__main__":
    main()
