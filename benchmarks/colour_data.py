"""What the figures of the colour picture are measured on: cameras, their disparities, captures; kept between runs."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from chromaperture.calibration.calibrate_session import calibrate_session
from chromaperture.camera import CodedApertureCamera, default_config
from chromaperture.camera_file import Calibration
from chromaperture.capture.files import read_image
from chromaperture.color.srgb import linear_to_srgb
from chromaperture.color.transparency_map import compensate_vignetting, flat_field
from chromaperture.config import Quality
from chromaperture.depth.conversion import depth_to_disparity

SCENES = ("still_life", "steps", "room", "desk")
PARALLAX = ("cy_halves", "cy_open", "rgb_squares", "cmy_circles")
LEVELS = {"black_level": 16, "white_level": 1016}


@dataclass(frozen=True)
class Bench:
    """bench50, with what was made of it.

    Attributes
    ----------
    data : Path
        Holds bench50/ and real/.
    work : Path
        Calibrated cameras, DESIGN.asdf, and disparities, DESIGN_SCENE_QUALITY.npz; what is missing is made.
    """

    data: Path
    work: Path

    @property
    def folder(self) -> Path:
        return self.data / "bench50"

    def calibration(self, design: str) -> Calibration:
        path = self.work / f"{design}.asdf"
        if not path.exists():
            # A lens is measured once, with the tilted boards of the first design.
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
        stored = cv2.imread(str(self.folder / "truth" / f"{scene}.depth_0.1mm.png"), cv2.IMREAD_UNCHANGED) / 10.0
        return depth_to_disparity(np.where(stored > 0, stored, 2000.0), camera.depth_model).astype(np.float32)


def say(row: dict) -> None:
    print(json.dumps({k: round(v, 4) if isinstance(v, float) else v for k, v in row.items()}), flush=True)


def save(path: Path, pictures: list[np.ndarray]) -> None:
    """Write pictures as they are, two beside each other, 8-bit sRGB."""
    path.parent.mkdir(parents=True, exist_ok=True)
    tiles = [np.rint(linear_to_srgb(p) * 255).astype(np.uint8)[..., ::-1] for p in pictures]
    tiles += [np.zeros_like(tiles[0])] * (len(tiles) % 2)
    rows = [np.hstack(tiles[i : i + 2]) for i in range(0, len(tiles), 2)]
    cv2.imwrite(str(path), np.vstack(rows))


def markdown(rows: list[dict], columns: dict[str, str]) -> str:
    """Table of rows: heading -> what to put there, a format string over the row's keys."""
    lines = ["| " + " | ".join(columns) + " |", "| " + " | ".join("---" for _ in columns) + " |"]
    lines += ["| " + " | ".join(f.format(**row) for f in columns.values()) + " |" for row in rows]
    return "\n".join(lines)
