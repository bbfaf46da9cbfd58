"""Photographs that are not linear light: what a tone curve costs, and what the chessboards tell of it.

    python benchmarks/tone_curves.py boards SESSION [SESSION ...]
    python benchmarks/tone_curves.py depth SESSION --work FOLDER --pictures NAME_1.npz [NAME_2.npz ...]

``boards`` fits the response to the chessboards of sessions. ``depth`` writes a linear session anew through several
curves, as deep PNG or JPEG files, calibrates from each with and without `with_response`, and measures pictures of
``world_scenes.py draw`` that went through the same curve: shares within 2 and 5 % of the true depth, and of
errors within one and two error bars.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from chromaperture.calibration import calibrate_session as steps
from chromaperture.calibration import fit_response
from chromaperture.calibration.options import Cache, silent
from chromaperture.calibration.place_boards import measure_pinhole
from chromaperture.calibration.session import read_session
from chromaperture.camera.camera import load_camera
from chromaperture.color.srgb import linear_to_srgb

QUALITIES = ("accurate", "real-time")


def s_curve(light: np.ndarray) -> np.ndarray:
    code = linear_to_srgb(light).astype(float)
    return code - 0.06 * np.sin(2 * np.pi * code)


def bt_709(light: np.ndarray) -> np.ndarray:
    return np.where(light < 0.018, 4.5 * light, 1.099 * np.maximum(light, 0.018) ** 0.45 - 0.099)


CURVES: dict[str, tuple[str, Callable[[np.ndarray], np.ndarray]]] = {
    "16 bit, sRGB": (".png", linear_to_srgb),
    "JPEG, sRGB": (".jpg", linear_to_srgb),
    "JPEG, S-curve": (".jpg", s_curve),
    "JPEG, BT.709": (".jpg", bt_709),
}


def write(light: np.ndarray, path: Path, curve: Callable[[np.ndarray], np.ndarray]) -> None:
    code = np.clip(curve(np.clip(light, 0, 1)), 0, 1)
    if path.suffix == ".png":
        cv2.imwrite(str(path), np.rint(65535 * code).astype(np.uint16)[..., ::-1])
    else:
        Image.fromarray(np.rint(255 * code).astype(np.uint8)).save(path, quality=95, subsampling=0)


def through(folder: Path, target: Path, name: str) -> None:
    session, (suffix, curve) = read_session(folder), CURVES[name]
    for path in [*session.boards, *session.tilts, *session.sheets.values()]:
        to = target / path.parent.name / path.with_suffix(suffix).name
        to.parent.mkdir(parents=True, exist_ok=True)
        write(session.read(path), to, curve)
    rows = (f"board/{path.with_suffix(suffix).name},{mm}" for path, mm in session.boards.items())
    (target / "distances.csv").write_text("\n".join(["file,ruler_mm", *rows]) + "\n")
    left_out = ("black_level", "white_level", "full_well", "read_noise")
    lines = (folder / "session.toml").read_text().splitlines()
    (target / "session.toml").write_text("\n".join(line for line in lines if not line.startswith(left_out)))


def boards(folders: list[Path]) -> None:
    print(f"{'session':<20}{'boards':>7}{'rms q - 1':>11}{'q':>15}{'misfit':>9}  decoded as")
    for folder in folders:
        session = read_session(folder)
        corners = measure_pinhole(session, None, cache=Cache(None), progress=silent).corners
        folded = fit_response.folded_boards(session, corners)
        if len(folded) < 2:
            print(f"{folder.name:<20}{len(folded):>7}")
            continue
        found = fit_response.fit_response(folded)
        sensor = fit_response.with_response(session, corners)[0].sensor
        low, high = found.exponents
        decoded = sensor.curve + ("" if sensor.response is None else ", tone curve")
        print(f"{folder.name:<20}{len(folded):>7}{found.deviation:>11.3f}{f'{low:.2f} to {high:.2f}':>15}"
              f"{found.misfit:>9.4f}  {decoded}", flush=True)  # fmt: skip


def depth(args: argparse.Namespace) -> None:
    found = fit_response.with_response
    print(
        f"{'files':<16}{'tone curve':<12}{'quality':<11}"
        + "".join(f"{n:>8}" for n in ("2 %", "5 %", "1 bar", "2 bars"))
    )
    for name, (suffix, curve) in CURVES.items():
        bent = args.work / name.replace(", ", "-").replace(" ", "-").lower()
        shutil.rmtree(bent, ignore_errors=True)
        through(args.session, bent, name)
        for fitted in (False, True):
            steps.with_response = found if fitted else lambda session, corners: (session, ())
            result = steps.calibrate_session(bent)
            with tempfile.TemporaryDirectory() as folder:
                camera_file = Path(folder) / "camera.asdf"
                result.camera.save(camera_file)
                for quality in QUALITIES:
                    camera = load_camera(camera_file, quality=quality, scale=1, device="cpu")
                    rows = []
                    for path in args.pictures:
                        with np.load(path) as z:
                            image, truth_mm = z["image"], z["truth_mm"]
                        photograph = Path(folder) / f"photo{suffix}"
                        write(image, photograph, curve)
                        frame = camera.measure(photograph)
                        error = np.abs(frame.depth_mm - truth_mm)
                        known = np.isfinite(error)
                        relative, bars = np.where(known, error / truth_mm, np.inf), (error / frame.sigma_mm)[known]
                        rows.append(((relative < 0.02).mean(), (relative < 0.05).mean(),
                                     (bars < 1).mean(), (bars < 2).mean()))  # fmt: skip
                    print(f"{name:<16}{'undone' if fitted else 'unknown':<12}{quality:<11}"
                          + "".join(f"{v:8.3f}" for v in np.mean(rows, axis=0)), flush=True)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    of_boards = commands.add_parser("boards")
    of_boards.add_argument("sessions", type=Path, nargs="+")
    of_depth = commands.add_parser("depth")
    of_depth.add_argument("session", type=Path)
    of_depth.add_argument("--work", type=Path, required=True)
    of_depth.add_argument("--pictures", type=Path, nargs="+", required=True)
    args = parser.parse_args()
    boards(args.sessions) if args.command == "boards" else depth(args)


if __name__ == "__main__":
    main()
