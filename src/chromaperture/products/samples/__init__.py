"""Two captures of a ray-traced real 50 mm lens, and their camera files, for the demo and the tests."""

from __future__ import annotations

from pathlib import Path

SAMPLES = ("still_life_cy_halves", "still_life_cy_open")
_HERE = Path(__file__).parent


def sample_image(name: str) -> Path:
    """Return the path of a bundled capture: 16-bit PNG, linear counts, black 16, white 1016."""
    return _HERE / f"{name}.png"


def sample_camera(name: str) -> Path:
    """Return the path of the camera file of a bundled capture."""
    return _HERE / f"{name.removeprefix('still_life_')}.asdf"
