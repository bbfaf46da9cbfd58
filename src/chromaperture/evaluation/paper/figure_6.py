"""Figure 6: distance by disparity against distance by ruler on the axis, for designs and colour spaces."""

from __future__ import annotations

import numpy as np

from chromaperture.calibration.fit_curve import DepthFit, fit_depth_model
from chromaperture.color.noise import photon_noise_variance
from chromaperture.config import preset
from chromaperture.disparity.estimate import estimate_disparity
from chromaperture.evaluation.figures import BLUE, GREY, new_figure, tidy
from chromaperture.evaluation.paper import methods, world
from chromaperture.evaluation.paper.context import Context
from chromaperture.evaluation.paper.exhibit import Compared, Drawn, Listed, Made
from chromaperture.evaluation.tables import Table
from chromaperture.optics.aperture import DESIGNS
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.sensor import SensorModel

_RGB_ROWS = np.eye(3)[[2, 0]]  # blue stands for cyan, red for yellow
PANELS = (
    ("a", "rgb_circles", "RGB circles in RGB", np.eye(3)),
    ("b", "cy_halves", "cyan and yellow halves in CYX", None),
    ("c", "cy_open", "cyan and yellow, open centre, in CYX", None),
    ("d", "cy_open", "cyan and yellow, open centre, in RGB", _RGB_ROWS),
)
_RULER_MM = 3.0  # the paper's boards stand by hand


def make(context: Context) -> Made:
    """Read boards from 1 to 4 m in a small window about the axis; fit; draw."""
    camera = world.camera_of(200, 140, pitch_mm=world.SENSOR_WIDTH_MM / 480)
    step = 500 if context.quick else 100
    rulers = np.arange(1000.0, 4001.0, step)
    figure = new_figure(height=5.0)
    rows = []
    spans = {}
    in_focus_mm = float("nan")
    for axes, (letter, design, title, unmixing) in zip(figure.subplots(2, 2).ravel(), PANELS, strict=True):
        disparity, spread = read_boards(design, unmixing, camera, rulers, cells=context.cells)
        fit = fit_boards(rulers, disparity, spread, camera)
        in_focus_mm = float(fit.model.in_focus_mm) if design == "cy_halves" else in_focus_mm
        span = float(np.nanmax(disparity) - np.nanmin(disparity))
        spans[letter] = span, float(np.nanmedian(spread))
        axes.plot(rulers, rulers, color=GREY, linewidth=0.8)
        axes.plot(rulers, rulers + fit.residual_mm, "o", color=BLUE, markersize=3.5)
        tidy(axes, xlabel="true, mm", ylabel="measured, mm")
        axes.set_title(f"({letter}) {title}: rms {fit.rms_mm:.0f} mm", fontsize=8, loc="left")
        rows.append((
            f"({letter}) {title}", f"{fit.rms_mm:.1f}", f"{span:.2f}", f"{spans[letter][1]:.3f}",
            f"{span / spans[letter][1]:.0f}", f"{fit.model.in_focus_mm:.0f}", f"{np.isfinite(disparity).sum()}",
        ))  # fmt: skip
    gain = spans["c"][0] / spans["d"][0]
    focal_mm = camera.image_distance_mm
    return Made(
        source=f"Simulated: {len(rulers)} boards, ideal lens, off their ruler distance by up to {_RULER_MM:g} mm.",
        drawn=[Drawn("calibration", figure, "Points on the line are right.")],
        listed=[Listed("calibration", Table(
            "Fits on the axis: range is the half disparity from the nearest to the farthest board; layers, how many "
            "standard deviations of a pixel fit in",
            ("panel", "rms, mm", "range, px", "sigma of a pixel, px", "layers", "in focus, mm", "boards read"), rows))],
        compared=[
            Compared("CYX instead of RGB, open centre", "more depth layers (no figure given)",
                     f"{gain:.2f} times the disparity range",
                     "Agrees in direction: unmixing takes the light of the open centre out of both views, which moves "
                     "their centroids outwards."),
            Compared("boards, range, focus", "31, 1000 to 4000 mm, about 2000 mm",
                     f"{len(rulers)}, {rulers[0]:.0f} to {rulers[-1]:.0f} mm, {world.FOCUS_MM:.0f} mm",
                     "Fewer boards with --quick only." if context.quick else "The same."),
            Compared("focus set by hand", "off by up to 20 mm, so it is fitted",
                     f"set to {world.FOCUS_MM:.0f} mm, fitted {in_focus_mm:.0f} mm with design V",
                     "The simulated hand does not err; what is left is the boards' and the matcher's."),
            Compared("distance of pinhole and sensor", "focal length 51.62 mm (opticians: 51.6)", f"{focal_mm:.2f} mm",
                     "Another lens: a patented 50 mm f/2 double Gauss stands for the EF 50 mm f/1.8."),
        ],
    )  # fmt: skip


def read_boards(
    design: str, unmixing: np.ndarray | None, camera: PupilCamera, rulers_mm: np.ndarray, *, cells: int, seed: int = 6
) -> tuple[np.ndarray, np.ndarray]:
    """Half disparity of every board, median and robust standard deviation over the window; two (N,) float64, px."""
    rng = np.random.default_rng(seed)
    rows = methods.film_rows(design) if unmixing is None else unmixing
    config = preset("paper").with_range(*methods.disparity_range(design, camera))
    sensor, exposure = SensorModel(), world.level_exposure(design)
    table = world.pinhole_table(camera, design, cells)
    medians, spreads = [], []
    for i, ruler in enumerate(rulers_mm):
        stood = float(ruler + rng.uniform(-_RULER_MM, _RULER_MM))
        planes = world.board(camera, stood, seed=seed + i)
        image = world.photograph(table, planes, camera, seed=seed + i, exposure=exposure).image
        noise = photon_noise_variance(
            image, full_well_electrons=sensor.full_well_electrons, read_noise_electrons=sensor.read_noise_electrons
        )
        found = estimate_disparity(
            image, aperture=DESIGNS[design], unmixing=rows, config=config, noise_variance=noise
        ).value_px[30:-30, 30:-30]
        known = found[np.isfinite(found)]
        medians.append(float(np.median(known)) if known.size > found.size / 2 else np.nan)
        spreads.append(1.4826 * float(np.median(np.abs(known - medians[-1]))) if known.size else np.nan)
    return np.array(medians), np.array(spreads)


def fit_boards(rulers_mm: np.ndarray, disparity_px: np.ndarray, spread_px: np.ndarray, camera: PupilCamera) -> DepthFit:
    """Fit the depth curve as the calibration does, with the pupil where the lens's data say."""
    return fit_depth_model(
        rulers_mm,
        disparity_px,
        disparity_sigma_px=np.hypot(spread_px, 0.01),
        distance_sigma_mm=_RULER_MM / np.sqrt(3),
        sensor_to_pupil_mm=camera.sensor_to_pupil_mm,
        sensor_to_pupil_sigma_mm=10.0,
    )
