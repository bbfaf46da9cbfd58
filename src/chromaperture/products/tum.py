"""Write RGB-D folders in the format of the TUM benchmark: rgb/, depth/, rgb.txt, depth.txt, associations.txt.

Beside them, in the same manner, sigma/ and confidence/, which readers of the format ignore.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA, within_error
from chromaperture.products.rectified import View
from chromaperture.system.errors import InputError
from chromaperture.system.storage import staged

_COUNTS_PER_MM = 5.0  # 5000 a metre, fixed by the TUM format


def write_tum(
    folder: str | Path,
    frames: Iterable[View],
    *,
    camera_matrix: np.ndarray,
    max_relative_sigma: float = MAX_RELATIVE_SIGMA,
) -> int:
    """Write a sequence; the folder appears when it is complete.

    Parameters
    ----------
    folder : str or Path
        Must not exist.
    frames : iterable of View
    camera_matrix : (3, 3) float, px
    max_relative_sigma : float
        Largest sigma / depth in depth/, see `within_error`; sigma/ is whole.

    Returns
    -------
    int
        Frames written.

    Raises
    ------
    InputError
        The folder exists or cannot be written, or the disk is full.
    """
    folder = Path(folder)
    if folder.exists():
        raise InputError(f"{folder} exists already; choose another name")
    rows: dict[str, list[str]] = {"rgb": [], "depth": [], "sigma": [], "confidence": []}
    with staged(folder.parent) as stage:
        private = stage.path(folder.name)
        for part in rows:
            (private / part).mkdir(parents=True)
        for frame in frames:
            stamp = f"{frame.time_s:.6f}"
            z_mm = within_error(frame.z_mm, frame.sigma_mm, max_relative_sigma)
            pictures = {"rgb": frame.color[..., ::-1], "depth": tum_depth(z_mm), "sigma": tum_sigma(frame.sigma_mm)}
            if frame.confidence is not None:
                pictures["confidence"] = np.rint(255 * np.nan_to_num(frame.confidence)).astype(np.uint8)
            for part, picture in pictures.items():
                name = f"{part}/{stamp}.png"
                if (private / name).exists():
                    raise InputError(f"two frames have the same time, {stamp} s; record the sequence again")
                (private / name).write_bytes(cv2.imencode(".png", picture)[1].tobytes())
                rows[part].append(f"{stamp} {name}")
        for part, lines in rows.items():
            text = f"# {part} images\n# timestamp filename\n" + "".join(f"{line}\n" for line in lines)
            (private / f"{part}.txt").write_text(text, encoding="ascii")
        pairs = zip(rows["rgb"], rows["depth"], strict=True)
        (private / "associations.txt").write_text("".join(f"{a} {b}\n" for a, b in pairs), encoding="ascii")
        m = camera_matrix
        intrinsics = f"{m[0, 0]:.4f} {m[1, 1]:.4f} {m[0, 2]:.4f} {m[1, 2]:.4f}\n"
        (private / "calibration.txt").write_text("# fx fy cx cy (px), no distortion\n" + intrinsics, encoding="ascii")
        if not rows["rgb"]:
            raise InputError("the source held no frame; nothing was written")
    return len(rows["rgb"])


def tum_depth(z_mm: np.ndarray) -> np.ndarray:
    """Encode depth, 5000 counts a metre; (H, W) uint16, 0 unknown or beyond 13.1 m."""
    counts = np.rint(np.nan_to_num(z_mm, nan=0.0, posinf=0.0, neginf=0.0).astype(np.float64) * _COUNTS_PER_MM)
    return np.where((counts > 0) & (counts <= 65535), counts, 0).astype(np.uint16)


def tum_sigma(sigma_mm: np.ndarray) -> np.ndarray:
    """Encode standard deviations like depth; (H, W) uint16, 0 unknown, 65535 for 13.1 m and more, never 0 if known."""
    known = ~np.isnan(sigma_mm)
    counts = np.clip(np.rint(np.where(known, sigma_mm, 1).astype(np.float64) * _COUNTS_PER_MM), 1, 65535)
    return np.where(known, counts, 0).astype(np.uint16)
