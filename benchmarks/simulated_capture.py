"""The simulator against captures of the same lens by an independent ray tracer: shift, blur, vignetting.

    python benchmarks/simulated_capture.py --data DATA/bench50 [--out DIR]
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np

from chromaperture.optics.aperture import DESIGNS, made_of
from chromaperture.optics.pinhole import pupil_camera
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.ray_table import lens_rays
from chromaperture.optics.simulator import textures
from chromaperture.optics.simulator.render import render
from chromaperture.optics.simulator.scene import plane

WIDTH, HEIGHT, PITCH_MM = 720, 480, 0.0309722  # of the captures of bench50: 22.3 mm over 720 px
CORNERS, SQUARE_MM = (9, 6), 30.0
BLACK, SPAN = 16, 1000  # counts: black level, and white level above it


def read(path):
    counts = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    return (counts[..., ::-1].astype(np.float32) - BLACK) / SPAN


def corners_of(image):
    """Chessboard corners in green; (54, 2) px."""
    green = np.clip(image[..., 1] / np.percentile(image[..., 1], 99.5) * 255, 0, 255).astype(np.uint8)
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    found, points = cv2.findChessboardCornersSB(green, CORNERS, flags=flags)
    if not found:
        raise SystemExit("no chessboard found")
    points = points.reshape(-1, 2)
    return points if points[0, 1] < points[-1, 1] else points[::-1]


def board(rotation, center, texel_mm):
    picture = np.repeat(textures.chessboard(CORNERS, SQUARE_MM, texel_mm)[..., None], 3, axis=2)
    made = plane(picture, center_mm=(0, 0, 1000), width_mm=picture.shape[1] * texel_mm)
    return type(made)(made.texture, np.asarray(center, float), rotation[:, 0], rotation[:, 1], made.texel_mm)


def compare_board(capture, table, camera, distance_mm, texel_mm):
    """Fit the board's pose in the simulator, then regress the capture on the simulation."""
    matrix = np.array(
        [[camera.focal_px, 0, camera.center_px[0]], [0, camera.focal_px, camera.center_px[1]], [0, 0, 1]]
    )
    grid = np.zeros((54, 3), np.float32)
    grid[:, :2] = np.mgrid[:9, :6].T.reshape(-1, 2) * SQUARE_MM - np.array([4.0, 2.5]) * SQUARE_MM
    seen = corners_of(capture)
    rotation, center = np.eye(3), np.array([0, 0, float(distance_mm)])
    for _ in range(2):
        simulated = render(table, [board(rotation, center, texel_mm)], seed=1)
        _, r0, t0 = cv2.solvePnP(grid, corners_of(simulated), matrix, None)
        _, r1, t1 = cv2.solvePnP(grid, seen, matrix, None)
        rotation = cv2.Rodrigues(r1)[0] @ cv2.Rodrigues(r0)[0].T @ rotation
        center = center + (t1 - t0).ravel()
    simulated = render(table, [board(rotation, center, texel_mm)], seed=1)
    margin = camera.focal_px / distance_mm * 20  # 20 mm around the corners
    low, high = seen.min(axis=0) - margin, seen.max(axis=0) + margin
    (x0, y0), (x1, y1) = np.maximum(low, 4).astype(int), np.minimum(high, (WIDTH - 4, HEIGHT - 4)).astype(int)
    window = np.s_[y0:y1, x0:x1]
    rows = []
    for k in range(3):
        s = cv2.GaussianBlur(simulated[..., k], (0, 0), 0.7)
        c = cv2.GaussianBlur(capture[..., k], (0, 0), 0.7)
        gy, gx = np.gradient(s)
        second = np.gradient(gx, axis=1), np.gradient(gy, axis=0)
        basis = np.stack([s, np.ones_like(s), gx, gy, *second], -1)[window].reshape(-1, 6)
        gain, _, a, b, lx, ly = np.linalg.lstsq(basis, c[window].ravel(), rcond=None)[0]
        rows.append([-a / gain, -b / gain, 2 * lx / gain, 2 * ly / gain, gain])
    return np.array(rows), center, simulated


def spot_moments(table, camera, distance_mm):
    """Centroid and variance (x, y) of each channel's blur in the middle of the image, px and px^2."""
    row, column = table.origin.shape[1] // 2, table.origin.shape[2] // 2
    scale = camera.focal_px / (distance_mm - table.z_mm)
    out = []
    for k in range(3):
        hit = table.origin[k, row, column] + (distance_mm - table.z_mm) * table.slope[k, row, column]
        w = table.weight[k, row, column][:, None]
        w = np.where(np.isfinite(hit), w, 0)
        hit = np.nan_to_num(hit)
        mean = (w * hit).sum(0) / w.sum(0)
        out.append([*(-mean * scale), *((w * (hit - mean) ** 2).sum(0) / w.sum(0) * scale**2)])
    return np.array(out)


def vignetting(data, design, table):
    """Relative difference of the simulated and the photographed white sheet, gain apart, per channel."""
    white = cv2.GaussianBlur(read(data / "white" / f"{design}.png"), (0, 0), 6)
    sheet = plane(np.ones((4, 4, 3), np.float32), center_mm=(0, 0, 600), width_mm=4000)
    ratio = cv2.GaussianBlur(render(table, [sheet], seed=2), (0, 0), 6) / white
    ratio /= ratio[HEIGHT // 2 - 20 : HEIGHT // 2 + 20, WIDTH // 2 - 20 : WIDTH // 2 + 20].mean(axis=(0, 1))
    error = np.abs(ratio[12:-12, 12:-12] - 1)
    return {
        "rms": np.sqrt((error**2).mean(axis=(0, 1))).round(4).tolist(),
        "95_percent_below": np.percentile(error, 95, axis=(0, 1)).round(4).tolist(),
        "99_percent_below": np.percentile(error, 99, axis=(0, 1)).round(4).tolist(),
        "max": error.max(axis=(0, 1)).round(4).tolist(),
        # Lens and film are symmetric up and down; a photograph that is not shows its own error.
        "photograph_upside_down_max": np.abs(white[::-1] / white - 1).max(axis=(0, 1)).round(4).tolist(),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--distances", type=int, nargs="+", default=[1000, 2000, 4000])
    parser.add_argument(
        "--board-texel-mm",
        type=float,
        default=0.5,
        help="sharpness of the drawn board, a divisor of 30 mm; the sharpness of the photographed one is unknown",
    )
    parser.add_argument("--out", type=Path)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    lens = load_lens("double_gauss_50")
    aperture = made_of(DESIGNS["cy_halves"], "real")
    size = {"width_px": WIDTH, "height_px": HEIGHT, "pixel_pitch_mm": PITCH_MM}
    camera = pupil_camera(lens, **size)
    table = lens_rays(lens, aperture, cells=16, nodes=25, **size)
    report = {}
    for distance in args.distances:
        capture = read(args.data / "cy_halves" / "board" / f"{distance}.png")
        rows, center, simulated = compare_board(capture, table, camera, distance, args.board_texel_mm)
        moments = spot_moments(table, camera, center[2])
        shift = rows[:, :2] - rows[1, :2]
        # The regression compares variances; both pictures include the pixel's 1/12 and the same pre-smoothing.
        base = moments[:, 2:] + 1 / 12
        blur = np.sqrt((base + rows[:, 2:4]) / base)
        report[distance] = {
            "board_z_mm": round(float(center[2]), 2),
            "simulated_shift_of_red_and_blue_px": np.round(moments[[0, 2], 0] - moments[1, 0], 3).tolist(),
            "shift_difference_to_green_px": np.round(shift[[0, 2]], 4).tolist(),
            "blur_rms_difference_x_y_px": np.round(np.sqrt(base + rows[:, 2:4]) - np.sqrt(base), 3).tolist(),
            "blur_radius_ratio_x_y": np.round(blur, 4).tolist(),
        }
        if args.out:
            args.out.mkdir(parents=True, exist_ok=True)
            pair = np.hstack([simulated * rows[1, 4], capture])[..., ::-1]
            cv2.imwrite(str(args.out / f"board_{distance}.png"), np.clip(pair * 255, 0, 255).astype(np.uint8))
    report["vignetting_difference_cy_halves"] = vignetting(args.data, "cy_halves", table)
    bare = lens_rays(lens, DESIGNS["open"], cells=16, **size)
    report["vignetting_difference_open"] = vignetting(args.data, "open", bare)
    print(json.dumps(report, indent=None if args.json else 1))


if __name__ == "__main__":
    main()
