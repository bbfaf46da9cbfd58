"""Tables 1 to 3 of the paper, and the white sheets that two of them and Figure 11 are made from."""

from __future__ import annotations

import platform
from collections.abc import Callable
from functools import partial

import cv2
import numpy as np

from chromaperture.calibration.session import read_session
from chromaperture.capture.files import read_image
from chromaperture.color.color_maps import OTHER
from chromaperture.color.noise import exposure_to_restore, snr_db
from chromaperture.color.transparency_map import light_efficiency, transparency
from chromaperture.evaluation.figures import new_figure, show_image
from chromaperture.matching.estimate import estimate_disparity
from chromaperture.optics.aperture import DESIGNS
from chromaperture.optics.psf import geometric_otf
from chromaperture.optics.simulator.scene import plane
from chromaperture.optics.simulator.textures import noise
from chromaperture.settings.methods import Quality, preset
from chromaperture.system.threads import limited_opencv_threads, limited_threads, thread_count
from chromaperture_paper import methods, world
from chromaperture_paper.context import Context
from chromaperture_paper.prior_methods import annulus_radius
from chromaperture_paper.registry import Chart, Comparison, Content, CsvTable
from chromaperture_paper.variation import smooth_disparity
from chromaperture_paper.world import NUMERALS, full_name


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


# Read off the paper: minimum and maximum for R, G, B, and the integral efficiency.
_TABLE_1 = {
    "cy_open": (((0.84, 0.97), (0.90, 0.98), (0.78, 0.89)), 0.86),
    "cy_halves": (((0.46, 0.54), (0.72, 0.76), (0.34, 0.41)), 0.55),
    "rgb_squares": (((0.04, 0.06), (0.05, 0.07), (0.06, 0.08)), 0.055),
}
_WHY_1 = {
    "cy_open": "The paper's film and the width of its open part are not given; ours are chosen to be close.",
    "cy_halves": "The film is chosen after this row; the variation over the frame is the lens's vignetting.",
    "rgb_squares": "Squares of this size pass 16 % with ideal film and 13 % with ours: the paper's film is darker, or "
    "its squares are smaller.",
}


def table_1(context: Context) -> Content:
    """Divide white sheets, Eq. (11)."""
    sheets, source = white_sheets(context, ("open", *_TABLE_1))
    maps = transparencies(sheets)
    figure = new_figure(height=6.0)
    panels = figure.subplots(3, len(maps), squeeze=False)
    rows, comparisons = [], []
    for column, (name, shown) in enumerate(maps.items()):
        light = light_efficiency(shown)
        limits = list(zip("RGB", light.minimum, light.maximum, strict=True))
        for k, (channel, low, high) in enumerate(limits):
            title = f"{NUMERALS[name]} {channel}: {low:.2f} to {high:.2f}"
            show_image(panels[k, column], shown[..., k], title, bar="", colors=OTHER)
        rows.append((full_name(name), *(f"{a:.3f} to {b:.3f}" for _, a, b in limits), f"{light.efficiency:.1%}"))
        ranges, efficiency = _TABLE_1[name]
        theirs = ", ".join(f"{c} {a:.2f} to {b:.2f}" for c, (a, b) in zip("RGB", ranges, strict=True))
        ours = ", ".join(f"{c} {a:.2f} to {b:.2f}" for c, a, b in limits)
        title, why = NUMERALS[name], _WHY_1[name]
        comparisons += [
            Comparison(f"{title}, transparency", theirs, ours, why),
            Comparison(f"{title}, light efficiency", f"{efficiency:.1%}", f"{light.efficiency:.1%}", why),
        ]
    caption = "Transparency, smallest to largest over the frame"
    table = CsvTable("transparency", caption, ("design", "R", "G", "B", "mean"), rows)
    return Content(source, [Chart("maps", figure, "Eq. (11), as in Table 1.")], [table], comparisons)


# Loss in the middle and at the border, dB. The paper's columns are named by pictures; by their light they are the
# open pupil, VII, V and II.
_TABLE_2 = {"open": (0.0, 1.5), "cy_open": (0.9, 2.3), "cy_halves": (2.3, 3.2), "rgb_squares": (14.3, 15.0)}
_WHY_2 = (
    "The paper measures photographs of a chart with software of its own scale; ours is 20 log10(mean / noise) of a "
    "white sheet, which photon noise predicts as 10 log10 of the light."
)


def table_2(context: Context) -> Content:
    """Measure the noise of white sheets."""
    sheets, source = white_sheets(context, tuple(_TABLE_2))
    maps = transparencies(sheets)
    open_middle, _ = snr_db(sheets["open"])
    rows, comparisons = [], []
    for name, sheet in sheets.items():
        middle, border = snr_db(sheet)
        losses = [float(np.mean(open_middle - area)) for area in (middle, border)]
        light = 1.0 if name == "open" else light_efficiency(maps[name]).efficiency
        predicted = 10 * np.log10(1 / light)
        longer = exposure_to_restore(max(losses[0], 0.0))
        rows.append((
            full_name(name), f"{light:.1%}", f"{losses[0]:.1f}", f"{losses[1]:.1f}", f"{predicted:.1f}",
            f"{longer.shot:.2f}", f"{longer.amplitude:.2f}",
        ))  # fmt: skip
        theirs = _TABLE_2[name]
        comparisons.append(
            Comparison(f"{NUMERALS[name]}, loss in the middle / at the border", f"{theirs[0]:.1f} / {theirs[1]:.1f} dB",
                       f"{losses[0]:.1f} / {losses[1]:.1f} dB", _WHY_2)
        )  # fmt: skip
    shot, amplitude = exposure_to_restore(2.3).shot, exposure_to_restore(2.3).amplitude
    comparisons.append(
        Comparison("exposure that wins back 2.3 dB", "30 % longer", f"{amplitude - 1:.0%} or {shot - 1:.0%} longer",
                   "The paper's figure holds where the sensor's own noise dominates; with photon noise, SNR grows with "
                   "the root of the time only.")
    )  # fmt: skip
    head = ("design", "light", "middle, dB", "border, dB", "photon noise predicts, dB",
            "exposure, photon noise", "exposure, sensor noise")  # fmt: skip
    table = CsvTable("snr", "Loss relative to the middle of the open pupil", head, rows)
    return Content(source, (), [table], comparisons)


_HD, _PAPER = (720, 1280), (1280, 1920)  # rows, columns, of the paper's pictures
_ANNULUS_PARTS = 64  # the annulus is timed on this part of the paper's picture


def table_3(context: Context) -> Content:
    """Time single images from linear RGB to disparity and error bar, 32 layers, after one run to compile."""
    repeats = 1 if context.quick else 5
    most = thread_count()
    threads = sorted({1, most})
    hd, large = picture(_HD), picture(_PAPER)
    disparity = np.asarray(5 * large[..., 0], np.float32)
    cases: dict[str, Callable[[], object]] = {
        "HD, two filters, real-time": lambda: _match(hd, "cy_halves", "real-time"),
        "HD, two filters, paper": lambda: _match(hd, "cy_halves", "paper"),
        "1280x1920, two filters, paper": lambda: _match(large, "cy_halves", "paper"),
        "1280x1920, three filters, paper": lambda: _match(large, "rgb_squares", "paper"),
        "1280x1920, total variation, 100 rounds": lambda: smooth_disparity(disparity, iterations=100),
    }
    seconds: dict[tuple[str, int], float] = {}
    for count in threads:
        with limited_threads(count), limited_opencv_threads(count):
            for name, run in cases.items():
                run()
                seconds[name, count] = min(methods.timed(run)[1] for _ in range(repeats))
    annulus_s = _ANNULUS_PARTS * _annulus_s()
    rows = [(name, *(f"{1000 * seconds[name, count]:.0f}" for count in threads)) for name in cases]

    def ours(name: str, count: int = 1) -> str:
        return f"{1000 * seconds[name, count]:.0f} ms on {count} thread{'s' if count > 1 else ''}"

    other = "Another machine and ten years: the order of size only."
    return Content(
        source=f"Timed on this machine ({platform.machine()}, {most} threads), the best of {repeats} runs.",
        tables=[CsvTable("times", "Milliseconds for one image",
                         ("what", *(f"{c} thread{'s' if c > 1 else ''}" for c in threads)), rows)],
        comparisons=[
            Comparison("HD, Galaxy S3 / Note 3", "30 s / 5 s", "not measured", "No telephone at hand."),
            Comparison("HD, Core i7-2600, Matlab", "2 s", ours("HD, two filters, paper"), other),
            Comparison("HD, GeForce 780 Ti", "19 ms (53 frames a second)", ours("HD, two filters, real-time", most),
                       "Ours runs on the processor alone."),
            Comparison("1280x1920, two filters, one thread", "3.5 s", ours("1280x1920, two filters, paper"), other),
            Comparison("1280x1920, three filters, one thread", "6 s", ours("1280x1920, three filters, paper"), other),
            Comparison("1280x1920, magenta annulus [5]", "28 s", f"{annulus_s:.0f} s",
                       "Its likelihood written anew in NumPy: 13 sizes of blur on a picture of 240x160, times 64."),
            Comparison("1280x1920, total variation", "3 s", ours("1280x1920, total variation, 100 rounds"),
                       "The paper gives no number of rounds."),
        ],
    )  # fmt: skip


def picture(shape: tuple[int, int]) -> np.ndarray:
    """Return a texture whose red and blue are shifted by +-3 px; (H, W, 3) float32."""
    grey = noise(shape, exponent=1.0, seed=1)
    return np.ascontiguousarray(np.stack([np.roll(grey, 3, 1), grey, np.roll(grey, -3, 1)], axis=-1))


def _annulus_s() -> float:
    """Time the annulus's likelihood on a 64th of the paper's picture, with the 13 levels of its publication; s."""
    small = cv2.resize(picture(_HD), (240, 160), interpolation=cv2.INTER_AREA)
    radii, padded = np.arange(13) / 2, (200, 288)
    transfer = [geometric_otf(DESIGNS["magenta_annulus"], float(r), padded) for r in radii]
    return methods.timed(annulus_radius, small, transfer, radii, padded)[1]


def _match(image: np.ndarray, design: str, quality: Quality) -> object:
    return estimate_disparity(image, aperture=design, config=preset(quality))
