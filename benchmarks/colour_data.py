"""Input of the colour benchmarks: cameras, their disparities, captures; stored between runs."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from chromaperture.calibration.calibrate_session import calibrate_session
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.capture.files import read_image
from chromaperture.color.srgb import linear_to_srgb
from chromaperture.color.transparency_map import compensate_vignetting, flat_field
from chromaperture.depth.conversion import depth_to_disparity
from chromaperture.model.camera_file import Calibration
from chromaperture.settings.methods import Quality
from chromaperture_paper.bench import truth_mm

SCENES = ("still_life", "steps", "room", "desk")
PARALLAX = ("cy_halves", "cy_open", "rgb_squares", "cmy_circles")
FOCUS_MM = 2000.0  # of the sessions of bench50
LEVELS = {"black_level": 16, "white_level": 1016}  # counts, of all captures of bench50


@dataclass(frozen=True)
class Bench:
    """The data set bench50, with stored results.

    Attributes
    ----------
    data : Path
        Holds bench50/ and real/.
    work : Path
        Calibrated cameras, DESIGN.asdf, and disparities, DESIGN_SCENE_QUALITY.npz; made when missing.
    """

    data: Path
    work: Path

    @property
    def folder(self) -> Path:
        return self.data / "bench50"

    def calibration(self, design: str) -> Calibration:
        path = self.work / f"{design}.asdf"
        if not path.exists():
            # Only the first design has tilted boards, which determine the lens.
            lens = None if design == PARALLAX[0] else self.calibration(PARALLAX[0])
            calibrate_session(self.folder / design, lens_from=lens).calibration.save(path)
        return Calibration.load(path)

    def camera(self, design: str, quality: Quality = "accurate") -> CodedApertureCamera:
        calibration = self.calibration(design)
        return CodedApertureCamera(calibration, default_config(calibration, quality))

    def scenes(self, design: str) -> list[str]:
        return [s for s in SCENES if (self.folder / design / "scene" / f"{s}.png").exists()]

    def capture(self, design: str, scene: str) -> np.ndarray:
        return read_image(self.folder / design / "scene" / f"{scene}.png", **LEVELS)

    def white(self, design: str) -> np.ndarray:
        return read_image(self.folder / "white" / f"{design}.png", **LEVELS)

    def bare(self, scene: str) -> np.ndarray:
        """The open aperture's capture, its vignetting compensated."""
        return compensate_vignetting(self.capture("open", scene), self._open_shading)

    @cached_property
    def _open_shading(self) -> np.ndarray:
        return flat_field(self.white("open"))

    def measured(self, design: str, scene: str, quality: Quality = "accurate") -> dict[str, np.ndarray]:
        """Disparity and its standard deviation, as `restore` takes them."""
        path = self.work / f"{design}_{scene}_{quality}.npz"
        if not path.exists():
            frame = self.camera(design, quality).measure(self.capture(design, scene))
            np.savez(path, disparity_px=frame.disparity_px, sigma_px=frame.disparity_sigma_px)
        with np.load(path) as kept:
            return dict(kept)

    def true_disparity(self, scene: str, camera: CodedApertureCamera) -> np.ndarray:
        """Disparity by the true depth; unknown depths are taken to be in focus."""
        depth = np.nan_to_num(truth_mm(self.folder, scene), nan=FOCUS_MM)
        return depth_to_disparity(depth, camera.depth_model).astype(np.float32)


def print_row(row: dict) -> None:
    print(json.dumps({k: round(v, 4) if isinstance(v, float) else v for k, v in row.items()}), flush=True)


def save(path: Path, pictures: list[np.ndarray]) -> None:
    """Write linear pictures as 8-bit sRGB, two side by side."""
    path.parent.mkdir(parents=True, exist_ok=True)
    tiles = [np.rint(linear_to_srgb(p) * 255).astype(np.uint8)[..., ::-1] for p in pictures]
    tiles += [np.zeros_like(tiles[0])] * (len(tiles) % 2)
    rows = [np.hstack(tiles[i : i + 2]) for i in range(0, len(tiles), 2)]
    cv2.imwrite(str(path), np.vstack(rows))


def markdown(rows: list[dict], columns: dict[str, str]) -> str:
    """Table of rows; columns map a heading to a format string over the row's keys."""
    lines = ["| " + " | ".join(columns) + " |", "| " + " | ".join("---" for _ in columns) + " |"]
    lines += ["| " + " | ".join(f.format(**row) for f in columns.values()) + " |" for row in rows]
    return "\n".join(lines)
