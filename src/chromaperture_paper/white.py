"""White sheets through the designs, photographed or simulated, for Tables 1 and 2 and Figure 11."""

from __future__ import annotations

from functools import partial

import numpy as np

from chromaperture.calibration.session import read_session
from chromaperture.capture.files import read_image
from chromaperture.color.transparency_map import transparency
from chromaperture.optics.simulator.scene import plane
from chromaperture_paper import world
from chromaperture_paper.context import Context


def white_sheets(context: Context, designs: tuple[str, ...]) -> tuple[dict[str, np.ndarray], str]:
    """Photograph or read a sheet through each design, all at one exposure; linear images by name, and the source."""
    if context.data is not None:
        folder = context.data / "cy_halves"
        read = read_session(folder).read if folder.is_dir() else read_image
        paths = {name: context.data / "white" / f"{name}.png" for name in designs}
        return {name: read(path) for name, path in paths.items() if path.is_file()}, "From the white sheets in --data."
    sheet = [plane(np.ones((2, 2, 3), np.float32), center_mm=(0, 0, 500.0), width_mm=4000)]

    def capture(design: str) -> np.ndarray:
        return context.traced(design, sheet, seed=world.EIGHT.index(design), exposure=world.WHITE).image

    sheets = {name: context.once(f"white {name}", partial(capture, name)) for name in designs}
    return sheets, "Simulated: a white sheet traced through the lens and the package's 'real' film, with noise."


def transparencies(sheets: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Transparency of each sheet against the open one, Eq. (11); (H, W, 3) by name."""
    return {name: transparency(sheet, sheets["open"]) for name, sheet in sheets.items() if name != "open"}
