"""White sheets through the designs, photographed or simulated, which Tables 1 and 2 and Figure 11 share."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from chromaperture.calibration.session import read_session
from chromaperture.color.transparency_map import transparency
from chromaperture.evaluation.paper import world
from chromaperture.evaluation.paper.context import Context
from chromaperture.optics.scene import plane


def white_sheets(context: Context, designs: tuple[str, ...]) -> tuple[dict[str, np.ndarray], str]:
    """Photograph or read a sheet through each design, all at one exposure; linear images by name, and the source."""
    if context.data is not None:
        sheets = {}
        session = read_session(context.data / "cy_halves") if (context.data / "cy_halves").is_dir() else None
        for name in designs:
            path = Path(context.data, "white", f"{name}.png")
            if path.is_file():
                sheets[name] = session.read(path) if session else _read(path)
        return sheets, "From the white sheets in --data."
    camera = context.session_camera
    sheet = [plane(np.ones((2, 2, 3), np.float32), center_mm=(0, 0, 500.0), width_mm=4000)]
    out = {}

    def through(name: str) -> np.ndarray:
        table = world.traced_table(camera, world.real_film(name), context.cells)
        seed = world.EIGHT.index(name)
        return world.photograph(table, sheet, camera, seed=seed, exposure=world.WHITE).image

    for name in designs:
        out[name] = context.once(f"white {name}", partial(through, name))
    return out, "Simulated: a white sheet traced through the lens and the package's 'real' film, with noise."


def shares(sheets: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Transparency of each sheet against the open one, Eq. (11); (H, W, 3) by name."""
    return {name: transparency(sheet, sheets["open"]) for name, sheet in sheets.items() if name != "open"}


def _read(path: Path) -> np.ndarray:
    from chromaperture.capture.files import read_image

    return read_image(path)
