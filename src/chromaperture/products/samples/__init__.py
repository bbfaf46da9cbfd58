"""Two captures of a ray-traced real 50 mm lens, and their camera files, for the demo and the tests."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from chromaperture.system.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from chromaperture.camera.camera import CodedApertureCamera
    from chromaperture.settings.methods import Quality

SAMPLES = ("still_life_cy_halves", "still_life_cy_open")
_HERE = Path(__file__).parent


def samples() -> tuple[str, ...]:
    """List the captures that come with the package, for `open_sample`."""
    return SAMPLES


def open_sample(
    name: str = SAMPLES[0], *, quality: Quality | None = None, device: str = "auto"
) -> tuple[CodedApertureCamera, np.ndarray]:
    """Open a bundled capture: its camera, and the photograph as linear RGB, (H, W, 3) float32.

    Parameters
    ----------
    name : str
        One of `SAMPLES`.
    quality : {"paper", "real-time", "accurate"}, optional
        As `load_camera`, and so ``device``.
    device : str

    Raises
    ------
    InputError
        There is no such capture.
    """
    from chromaperture.camera.camera import load_camera

    if name not in SAMPLES:
        raise InputError(f"no sample {name!r}: choose {', '.join(SAMPLES)}")
    camera = load_camera(sample_camera(name), quality=quality, device=device)
    return camera, camera.read(sample_image(name))


def sample_image(name: str) -> Path:
    """Return the path of a bundled capture: 16-bit PNG, linear counts, black 16, white 1016."""
    return _HERE / f"{name}.png"


def sample_camera(name: str) -> Path:
    """Return the path of the camera file of a bundled capture."""
    return _HERE / f"{name.removeprefix('still_life_')}.asdf"
