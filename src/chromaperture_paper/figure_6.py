"""Figure 6: measured against true distance on the axis, for designs and colour spaces."""

from __future__ import annotations

import numpy as np

from chromaperture.calibration.fit_fields import DepthFit, fit_depth_model
from chromaperture.evaluation.figures import BLUE, GREY, new_figure, style_axes
from chromaperture.matching.estimate import estimate_disparity
from chromaperture.optics.aperture import DESIGNS
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.settings.methods import preset
from chromaperture.system.robust import robust_sigma
from chromaperture_paper import methods, world
from chromaperture_paper.context import Context
from chromaperture_paper.exhibit import Chart, Comparison, Content, CsvTable

_RGB_ROWS = np.eye(3)[[2, 0]]  # blue in place of cyan, red of yellow
PANELS = (
    ("a", "rgb_circles", "RGB circles in RGB", np.eye(3)),
    ("b", "cy_halves", "cyan and yellow halves in CYX", None),
    ("c", "cy_open", "cyan and yellow, open centre, in CYX", None),
    ("d", "cy_open", "cyan and yellow, open centre, in RGB", _RGB_ROWS),
)
_SEED = 6  # of the first board
_RULER_MM = 3.0  # largest error of the boards' distances, which the paper sets by hand; chosen by hand
_PUPIL_SIGMA_MM = 10.0  # of the pupil's position in the lens's data; chosen by hand
_LEAST_SIGMA_PX = 0.01  # of a board's median; keeps weights finite; chosen by hand


def make(context: Context) -> Content:
    """Read boards from 1 to 4 m in a small window about the axis; fit; draw."""
    camera = world.camera_of(200, 140, pitch_mm=world.FINE_PITCH_MM)
    step = 500 if context.quick else 100
    rulers = np.arange(1000.0, 4001.0, step)
    figure = new_figure(height=5.0)
    rows, spans, in_focus_mm = [], {}, {}
    for axes, (letter, design, title, unmixing) in zip(figure.subplots(2, 2).ravel(), PANELS, strict=True):
        disparity, sigma = read_boards(design, unmixing, camera, rulers, cells=context.cells)
        fit = fit_boards(rulers, disparity, sigma, camera)
        in_focus_mm[letter] = float(fit.model.in_focus_mm)
        spans[letter] = span = float(np.nanmax(disparity) - np.nanmin(disparity))
        median_sigma = float(np.nanmedian(sigma))
        axes.plot(rulers, rulers, color=GREY, linewidth=0.8)
        axes.plot(rulers, rulers + fit.residual_mm, "o", color=BLUE, markersize=3.5)
        style_axes(axes, xlabel="true, mm", ylabel="measured, mm")
        axes.set_title(f"({letter}) {title}: rms {fit.rms_mm:.0f} mm", fontsize=8, loc="left")
        rows.append((
            f"({letter}) {title}", f"{fit.rms_mm:.1f}", f"{span:.2f}", f"{median_sigma:.3f}",
            f"{span / median_sigma:.0f}", f"{in_focus_mm[letter]:.0f}", f"{np.isfinite(disparity).sum()}",
        ))  # fmt: skip
    return Content(
        source=f"Simulated: {len(rulers)} boards, ideal lens, off their ruler distance by up to {_RULER_MM:g} mm.",
        charts=[Chart("calibration", figure, "Points on the line are right.")],
        tables=[CsvTable(
            "calibration", "Fits on the axis: range is the half disparity from the nearest to the farthest board; "
            "layers, the range in standard deviations of a pixel",
            ("panel", "rms, mm", "range, px", "sigma of a pixel, px", "layers", "in focus, mm", "boards read"), rows)],
        comparisons=[
            Comparison("CYX instead of RGB, open centre", "more depth layers (no figure given)",
                       f"{spans['c'] / spans['d']:.2f} times the disparity range",
                       "Agrees in direction: unmixing removes the light of the open centre from both views, which "
                       "moves their centroids outwards."),
            Comparison("boards, range, focus", "31, 1000 to 4000 mm, about 2000 mm",
                       f"{len(rulers)}, {rulers[0]:.0f} to {rulers[-1]:.0f} mm, {world.FOCUS_MM:.0f} mm",
                       "Fewer boards with --quick only." if context.quick else "The same."),
            Comparison("focus set by hand", "off by up to 20 mm, so it is fitted",
                       f"set to {world.FOCUS_MM:.0f} mm, fitted {in_focus_mm['b']:.0f} mm with design V",
                       "The simulated focus is exact; the rest is the error of boards and matcher."),
            Comparison("distance of pinhole and sensor", "focal length 51.62 mm (opticians: 51.6)",
                       f"{camera.image_distance_mm:.2f} mm",
                       "Another lens: a patented 50 mm f/2 double Gauss stands for the EF 50 mm f/1.8."),
        ],
    )  # fmt: skip


def read_boards(
    design: str, unmixing: np.ndarray | None, camera: PupilCamera, rulers_mm: np.ndarray, *, cells: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the median and the robust standard deviation of each board's half disparity; two (N,) float64, px."""
    rng = np.random.default_rng(_SEED)
    rows = methods.film_rows(design) if unmixing is None else unmixing
    config = preset("paper").with_range(*methods.disparity_range(design, camera))
    medians, sigmas = [], []
    for i, ruler in enumerate(rulers_mm, _SEED):
        planes = world.board(camera, float(ruler + rng.uniform(-_RULER_MM, _RULER_MM)), seed=i)
        image = world.pinhole_capture(design, planes, camera, cells=cells, seed=i).image
        found = estimate_disparity(
            image, aperture=DESIGNS[design], unmixing=rows, config=config, noise_variance=methods.noise_variance(image)
        ).value_px[30:-30, 30:-30]
        known = found[np.isfinite(found)]
        medians.append(float(np.median(known)) if known.size > found.size / 2 else np.nan)
        sigmas.append(robust_sigma(known - medians[-1]))
    return np.array(medians), np.array(sigmas)


def fit_boards(rulers_mm: np.ndarray, disparity_px: np.ndarray, sigma_px: np.ndarray, camera: PupilCamera) -> DepthFit:
    """Fit the depth curve as the calibration does, with the pupil's position from the lens's data."""
    return fit_depth_model(
        rulers_mm,
        disparity_px,
        disparity_sigma_px=np.hypot(sigma_px, _LEAST_SIGMA_PX),
        distance_sigma_mm=_RULER_MM / np.sqrt(3),  # uniform
        sensor_to_pupil_mm=camera.sensor_to_pupil_mm,
        sensor_to_pupil_sigma_mm=_PUPIL_SIGMA_MM,
    )
