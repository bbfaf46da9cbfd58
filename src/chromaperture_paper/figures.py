"""Figures 4 to 14 of the paper."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from chromaperture.calibration.calibrate_session import CalibrationResult
from chromaperture.calibration.fit_fields import DepthFit, fit_depth_model
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.color.color_maps import DIFFERENCE, DISTANCE, color_map
from chromaperture.color.srgb import linear_to_srgb
from chromaperture.color.transparency_map import light_efficiency
from chromaperture.color.unmixing import mixing_matrix
from chromaperture.depth.conversion import disparity_to_inverse_depth
from chromaperture.effects.refocusing import Focus, refocus
from chromaperture.effects.restore import restore
from chromaperture.evaluation.figures import (
    BLUE,
    CHANNEL_COLORS,
    GREY,
    baseline_map,
    draw_flat_board,
    draw_layers,
    draw_surfaces,
    flat_board,
    layer_errors,
    new_figure,
    plane_residual,
    ruler_distances,
    show_image,
    style_axes,
)
from chromaperture.matching.estimate import estimate_disparity
from chromaperture.optics.aperture import DESIGNS, channel_transmission
from chromaperture.optics.pinhole import PupilCamera, focused_at, pupil_camera
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.simulator import textures
from chromaperture.optics.simulator.scene import Plane, plane
from chromaperture.optics.simulator.textures import noise
from chromaperture.settings.methods import preset
from chromaperture.system.robust import robust_sigma
from chromaperture_paper import methods, world
from chromaperture_paper.context import Context
from chromaperture_paper.registry import Chart, Comparison, Content, CsvTable
from chromaperture_paper.tables import transparencies, white_sheets
from chromaperture_paper.variation import smooth_disparity
from chromaperture_paper.world import EIGHT, NUMERALS, full_name


def figure_4a(context: Context) -> Content:
    """Draw the colour space of the real film, and greys seen through both halves, which lie in its plane."""
    film = world.real_film("cy_halves")
    mixing = mixing_matrix(np.array([film.filter_named(name).transmission for name in film.views]))
    rng = np.random.default_rng(0)
    cloud = rng.uniform(0, 1, (300, 2)) @ mixing[:, :2].T  # light through the two halves
    inverse = np.linalg.inv(mixing)
    figure = new_figure(width=5.2, height=4.4)
    axes = figure.add_subplot(projection="3d")
    axes.scatter(*cloud.T, c=np.clip(cloud / max(float(cloud.max()), 1e-9), 0, 1), s=8, depthshade=False)
    for k, (name, color) in enumerate((("C", "#12a5b8"), ("Y", "#c8a200"), ("X", "#8040a0"))):
        tip = mixing[:, k] * (0.6 if name == "X" else 1.0)
        axes.plot(*np.stack([np.zeros(3), tip], axis=1), color=color, linewidth=2.5)
        axes.text(*(1.08 * tip), name, color=color, fontsize=12, fontweight="bold")
    axes.set(xlabel="R", ylabel="G", zlabel="B", xlim=(-0.4, 1), ylim=(-0.4, 1.4), zlim=(-0.4, 1))
    axes.view_init(elev=22, azim=150)
    axes.set_box_aspect(None, zoom=0.88)  # leaves room for the label of B
    rows = [
        (name, *(f"{v:+.3f}" for v in mixing[:, k]), *(f"{v:+.3f}" for v in inverse[k])) for k, name in enumerate("CYX")
    ]
    off = float(np.abs((inverse @ cloud.T)[2]).max())
    angle = np.degrees(np.arccos(np.dot(*[mixing[:, k] / np.linalg.norm(mixing[:, k]) for k in (0, 1)])))
    return Content(
        source="The film of the package ('real'), no photograph needed.",
        charts=[Chart("cyx", figure, "Grey things seen through the two halves lie in the plane of C and Y.")],
        tables=[
            CsvTable("matrix", "Columns of M and rows of its inverse, Eq. (1)",
                     ("axis", "R", "G", "B", "R of row", "G of row", "B of row"), rows)
        ],
        comparisons=[
            Comparison("X", "orthogonal to the CY plane", f"orthogonal; greys leave the plane by {off:.0e}",
                       "No difference: the third column of M is built as the plane's normal.")
        ],
        lines=[f"Cyan and yellow are {angle:.0f} degrees apart in colour; at 0 the views could not be separated."],
    )  # fmt: skip


_RGB_ROWS = np.eye(3)[[2, 0]]  # blue in place of cyan, red of yellow
PANELS = (
    ("a", "rgb_circles", "RGB circles in RGB", np.eye(3)),
    ("b", "cy_halves", "cyan and yellow halves in CYX", None),
    ("c", "cy_open", "cyan and yellow, open centre, in CYX", None),
    ("d", "cy_open", "cyan and yellow, open centre, in RGB", _RGB_ROWS),
)
_BOARDS_SEED = 6  # of the first board
_RULER_MM = 3.0  # largest error of the boards' distances, which the paper sets by hand; chosen by hand
_PUPIL_SIGMA_MM = 10.0  # of the pupil's position in the lens's data; chosen by hand
_LEAST_SIGMA_PX = 0.01  # of a board's median; keeps weights finite; chosen by hand


def figure_6(context: Context) -> Content:
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
    rng = np.random.default_rng(_BOARDS_SEED)
    rows = methods.film_rows(design) if unmixing is None else unmixing
    config = preset("paper").with_range(*methods.disparity_range(design, camera))
    medians, sigmas = [], []
    for i, ruler in enumerate(rulers_mm, _BOARDS_SEED):
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


def figure_7(context: Context) -> Content:
    """Draw the fields of the calibrated camera."""
    result, source = context.calibrated()
    focus, baseline = result.calibration.depth_model("paper").in_focus_mm, baseline_map(result)
    return Content(
        source=source,
        charts=[Chart("surfaces", draw_surfaces(result),
                      "A flat focus surface and an even baseline would have one colour; the lens curves the focus, its "
                      "rims cut the baseline.")],
        comparisons=[
            Comparison("in-focus surface", "curved (a picture, no figure)",
                       f"{np.percentile(focus, 1):.0f} to {np.percentile(focus, 99):.0f} mm",
                       "Another lens, so another curvature; like the paper's it is curved."),
            Comparison("baseline b", "uneven (a picture, no figure)",
                       f"{np.percentile(baseline, 1):.2f} to {np.percentile(baseline, 99):.2f} mm",
                       "Vignetting cuts the pupil towards the corners, which takes area from the outer side."),
        ],
    )  # fmt: skip


_BEND_CELLS = 10  # along each side of the grid of `bend`; chosen by hand
_WHY_FLAT = "The paper shows pictures only; here as there one curve for all pixels bends what is flat."


def figure_8(context: Context) -> Content:
    """Photograph a floor with an object on it; with real photographs, use the wall of a board."""
    result, source = context.calibrated()
    if context.data is not None:
        _, before, after = flat_board(result)
        ours = f"{before:.0f} and {after:.0f} mm"
        compared = Comparison("rms from a plane", "concave before, planar after", ours, _WHY_FLAT)
        chart = Chart("flat", draw_flat_board(result), "A flat wall by one curve and by the fields.")
        return Content(source, [chart], (), [compared])
    shot = context.session_capture(floor_scene(), seed=8)
    maps = [depth_by(result, shot.image, fields=fields) for fields in (False, True)]
    bends = [bend(depth, shot.depth_mm) for depth in maps]
    figure = new_figure(height=4.4)
    panels = figure.subplots(2, 2)
    show_image(panels[0, 0], linear_to_srgb(np.clip(shot.image / 0.9, 0, 1)), "(a) capture")
    low, high = np.nanpercentile(shot.depth_mm, (1, 99))
    show_image(panels[0, 1], maps[1], "depth by the fields", bar="mm", colors=DISTANCE, vmin=low, vmax=high)
    for axes, depth, name, value in zip(panels[1], maps, ("(b) one curve", "(c) fields"), bends, strict=True):
        title = f"{name}: error, bend {value:.1%} of the depth"
        shown = show_image(axes, 100 * (depth / shot.depth_mm - 1), title, colors=DIFFERENCE, vmin=-15, vmax=15)
    figure.colorbar(shown, ax=list(panels[1]), fraction=0.02, label="error, %", extend="both")
    return Content(
        source=f"{source} The floor is photographed by the same simulated lens.",
        charts=[Chart("floor", figure, "A flat floor is white below; a curved one is red or blue at the rim.")],
        comparisons=[Comparison("the floor", "concave before, planar after",
                                f"bend of {bends[0]:.1%} before and {bends[1]:.1%} after, of the depth", _WHY_FLAT)],
        lines=["Bend is the rms over the frame of the smoothed error, from which noise is averaged out."],
    )  # fmt: skip


def floor_scene() -> list[Plane]:
    """Build a floor that fills the picture, and a small upright object instead of the paper's rabbit."""
    grey = textures.noise((900, 1000), exponent=0.9, seed=80)
    floor = np.repeat(grey[..., None], 3, axis=2) * np.float32(1.1)
    upright = np.repeat(textures.noise((160, 120), exponent=0.8, seed=81)[..., None], 3, axis=2)
    return [
        plane(np.clip(floor, 0, 1), center_mm=(0, 0, 2100.0), width_mm=2200, tilt_deg=(-50.0, 0, 0)),
        plane(upright, center_mm=(60, -10, 1750.0), width_mm=180),
    ]


def depth_by(result: CalibrationResult, image: np.ndarray, *, fields: bool) -> np.ndarray:
    """Measure depth by the fields, or by the curve of the axis for all pixels; (H, W) float64, mm."""
    calibration = result.calibration
    frame = CodedApertureCamera(calibration, default_config(calibration, "real-time")).measure(image)
    if fields:
        return np.asarray(frame.depth_mm, float)
    axis = calibration.on_axis("real-time")
    inverse = disparity_to_inverse_depth(np.asarray(frame.disparity_px, float), axis)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(inverse > 0, 1 / inverse, np.nan)
    return np.asarray(depth + float(np.asarray(axis.sensor_to_pupil_mm)))


def bend(depth_mm: np.ndarray, truth_mm: np.ndarray) -> float:
    """Return the rms over a grid of cells of the median relative error less its best plane: curvature, not tilt."""
    error = depth_mm / truth_mm - 1
    parts = [part for rows in np.array_split(error, _BEND_CELLS) for part in np.array_split(rows, _BEND_CELLS, axis=1)]
    medians = [np.nanmedian(part) if np.isfinite(part).mean() > 0.3 else np.nan for part in parts]
    return plane_residual(np.reshape(medians, (_BEND_CELLS, _BEND_CELLS)))[1]


def figure_9(context: Context) -> Content:
    """Compare the median error of a pixel on the boards."""
    result, source = context.calibrated()
    whole, half, fine = layer_errors(result)
    rows = [
        (f"{ruler:.0f}", *(f"{v:.1f}" for v in values))
        for ruler, *values in zip(ruler_distances(result), whole, half, fine, strict=True)
    ]
    ratio = float(np.nanmedian(whole / fine))
    return Content(
        source=source,
        charts=[Chart("layers", draw_layers(result), "Median error of single pixels in the middle of the frame.")],
        tables=[CsvTable("layers", "Median error of a pixel, mm",
                         ("ruler, mm", "layers of 1 px", "the matcher's layers", "sub-pixel"), rows)],
        comparisons=[
            Comparison("sub-pixel against layers", "significantly better (a picture)",
                       f"{ratio:.1f} times smaller error than whole-px layers, in the median over the boards",
                       "Agrees. Near the focus blur is small and both are good; layers are worst where depth "
                       "changes most per px. A board whose disparity happens to be a layer favours them.")
        ],
    )  # fmt: skip


_STILL_SEED = 0
_TV_FIDELITY = 0.2  # per px of blur radius, a unit common to all designs; chosen by hand


def figure_10(context: Context) -> Content:
    """Photograph the same still life through every design and match as the paper does."""
    camera = world.camera_of(*context.scene_size)
    planes = world.still_life(seed=_STILL_SEED)
    figure = new_figure(width=8.0, height=8 * 8.0 / 4 * camera.height_px / camera.width_px + 0.6)
    panels = figure.subplots(len(EIGHT), 4)
    rows: list[tuple[str, ...]] = []
    good: dict[str, float] = {}
    low, high = (float(r) for r in camera.blur_radius_px(np.array([1100.0, 3400.0])))
    for line, design in zip(panels, EIGHT, strict=True):
        shot = world.pinhole_capture(design, planes, camera, cells=context.cells, seed=_STILL_SEED)
        line[0].imshow(linear_to_srgb(np.clip(shot.image / 0.9, 0, 1)))
        line[0].set_ylabel(NUMERALS[design], rotation=0, labelpad=14, va="center", fontsize=11)
        line[3].imshow(shot.radius_px, cmap=color_map(DISTANCE), vmin=low, vmax=high)
        relative_exposure = world.level_exposure(design) / world.level_exposure("open")
        light = float(channel_transmission(world.real_film(design)).mean())
        first = (full_name(design), f"{light:.0%}", f"{relative_exposure:.2f}")
        if design == "open":
            for axes in line[1:3]:
                axes.text(0.5, 0.5, "no disparity", ha="center", va="center", transform=axes.transAxes, fontsize=9)
            rows.append((*first, *"-----"))
            continue
        both = _raw_and_regularised(design, shot.image, camera, context.cells, (low - 1, high + 1))
        for axes, radius in zip(line[1:3], both, strict=True):
            axes.imshow(radius, cmap=color_map(DISTANCE), vmin=low, vmax=high)
        found = [methods.scores(methods.depth_of(np.asarray(r, float), camera), shot.depth_mm) for r in both]
        good[design] = found[1]["within_5"]
        within = (f"{s[key]:.1%}" for s in found for key in ("within_2", "within_5"))
        rows.append((*first, *within, f"{found[1]['median_error']:.1%}"))
    for axes, title in zip(panels[0], ("capture", "raw disparity", "regularised", "truth"), strict=True):
        axes.set_title(title, fontsize=9)
    for axes in panels.ravel():
        axes.set_xticks([])
        axes.set_yticks([])
    head = ("design", "light", "exposure", "raw: within 2 %", "within 5 %", "regularised: within 2 %", "within 5 %",
            "median error")  # fmt: skip
    order = [NUMERALS[n] for n in sorted(good, key=lambda n: good[n], reverse=True)]
    return Content(
        source=f"Simulated: a still life at {camera.width_px}x{camera.height_px} px through an ideal 50 mm f/2 lens, "
        "exposed until white paper reaches the same level in every design, as the paper does.",
        charts=[Chart("designs", figure, "Rows I to VIII. Blue is near, yellow far; the last column is the truth.")],
        tables=[CsvTable("designs", "Fractions of ALL pixels whose depth is right; exposure relative to the open pupil",
                         head, rows)],
        comparisons=[
            Comparison("V against VI", "V seems better at almost the same light",
                       f"within 5 %: V {good['cy_halves']:.0%}, VI {good['magenta_annulus']:.0%}",
                       "Agrees: VI cannot distinguish near from far; everything before the focus is placed behind it."),
            Comparison("VII", "for when depth quality is no issue",
                       f"within 5 %: VII {good['cy_open']:.0%}, V {good['cy_halves']:.0%}",
                       "Agrees: its views lie a third as far apart."
                       if good["cy_open"] < good["cy_halves"] else "Does not agree on this scene."),
            Comparison("depth at equal image level, best first", "not ranked", ", ".join(order),
                       "At equal level the noise is the same; distance and blur of the views decide."),
        ],
        lines=["All designs but VI go through the same matcher (quality paper); VI has its own likelihood [5]. The "
               "same total variation [6] regularises all."],
    )  # fmt: skip


def _raw_and_regularised(
    design: str, image: np.ndarray, camera: PupilCamera, cells: int, bounds_px: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Measure the blur radius as the paper does, before and after total variation; two (H, W) arrays, px."""
    method = methods.method_of(design)
    reading = methods.METHODS[method](image, methods.setting_of(design, camera))
    raw = methods.calibrate(method, design, camera, cells).radius_of(reading)
    return raw, smooth_disparity(raw, fidelity=_TV_FIDELITY, bounds_px=bounds_px)


def figure_11(context: Context) -> Content:
    """Measure the transmitted light of every design that has a sheet."""
    sheets, source = white_sheets(context, EIGHT)
    light = {name: light_efficiency(values) for name, values in transparencies(sheets).items()}
    names = [name for name in EIGHT if name in light]
    figure = new_figure()
    axes = figure.subplots()
    for k, (channel, color) in enumerate(CHANNEL_COLORS.items()):
        values = [100 * light[name].mean[k] for name in names] + [100.0]
        axes.bar(np.arange(len(values)) + 0.26 * (k - 1), values, 0.25, color=color, label=channel)
    axes.set_xticks(range(len(names) + 1), [f"{NUMERALS[n]}\n{n}" for n in names] + ["VIII\nopen"], fontsize=8)
    style_axes(axes, ylabel="light that passes, %")
    axes.legend(frameon=False, ncols=3)
    rows = [
        (full_name(n), *(f"{v:.1%}" for v in light[n].mean), f"{light[n].efficiency:.1%}",
         f"{light[n].luminance:.1%}", f"{channel_transmission(DESIGNS[n]).mean():.1%}")
        for n in names
    ]  # fmt: skip
    order = [NUMERALS[n] for n in sorted(names, key=lambda n: light[n].efficiency)]
    paper = [NUMERALS[n] for n in names]
    halves = channel_transmission(DESIGNS["cy_halves"]).mean()
    return Content(
        source=source,
        charts=[Chart("light", figure, "Transmitted light, relative to an open pupil, by channel.")],
        tables=[CsvTable("light", "Light efficiency; the last column with ideal film",
                         ("design", "R", "G", "B", "mean", "luminance", "ideal film"), rows)],
        comparisons=[
            Comparison("order by light", ", ".join(paper), ", ".join(order), _order_difference(paper, order)),
            Comparison("V with ideal filters", "over 65 %", f"{halves:.1%}",
                       "Geometry: each half passes two of three channels."),
            Comparison("light of the prior art [4, 11] (II, I)", "less than 20 %",
                       " and ".join(f"{NUMERALS[n]} {light[n].efficiency:.0%}"
                                    for n in ("rgb_squares", "rgb_circles") if n in light) or "not measured",
                       "Agrees: every filter passes one channel of three, and three of them do not fill the pupil."),
            Comparison("V against VI", "almost the same light",
                       f"{light['cy_halves'].efficiency:.0%} and {light['magenta_annulus'].efficiency:.0%}"
                       if "magenta_annulus" in light and "cy_halves" in light else "not both measured",
                       "The annulus of the publication (inner radius 0.59) has an open centre that alone "
                       "passes a third of the light."),
        ],
    )  # fmt: skip


def _order_difference(paper: list[str], ours: list[str]) -> str:
    if paper == ours:
        return "The same order."
    moved = [n for n, m in zip(paper, ours, strict=True) if n != m]
    return f"{', '.join(moved)} change positions: their light differs by less than one film from another."


_HALVES = "cy_halves"
_PHONE_FOCUS_MM, _PHONE_SENSOR_MM = 60.0, 4.6  # close, as the paper's models; width of a telephone's sensor


@dataclass(frozen=True)
class Scene:
    """A scene with measured and true depth in mm, or half disparity in px."""

    name: str
    image: np.ndarray
    found: np.ndarray
    truth: np.ndarray
    unit: str
    blur_span_px: float

    @property
    def fill(self) -> float:
        """Fraction of the pixels with a measurement."""
        return float(np.isfinite(self.found).mean())

    @property
    def error(self) -> float:
        """Median error: relative for depth, px for disparity."""
        error = np.abs(self.found - self.truth)
        return float(np.nanmedian(error / self.truth if self.unit == "mm" else error))


def figure_12(context: Context) -> Content:
    """Photograph two still lifes with one camera and two tables of small cards with the other."""
    reflex = [_by_reflex(context, seed) for seed in (12, 13)]
    phone = [_by_phone(context, seed) for seed in (20, 30)]
    figure = new_figure(height=7.6)
    panels = figure.subplots(4, 4, width_ratios=(0.5, 1, 1, 1))
    for line, one, letters, aperture in zip(panels, reflex + phone, ("bc", "de", "gh", "ij"), "a f ", strict=True):
        line[0].set_axis_off()
        if aperture != " ":
            show_image(line[0], linear_to_srgb(aperture_picture()), f"({aperture}) aperture")
        low, high = (float(v) for v in np.nanpercentile(one.truth, (1, 99)))
        show_image(line[1], linear_to_srgb(np.clip(one.image / 0.9, 0, 1)), f"({letters[0]}) {one.name}")
        kind = "depth" if one.unit == "mm" else "disparity"
        shown = show_image(line[2], one.found, f"({letters[1]}) {kind}", vmin=low, vmax=high)
        show_image(line[3], one.truth, "truth", vmin=low, vmax=high)
        figure.colorbar(shown, ax=list(line[2:]), fraction=0.02, label=one.unit)

    def listed(form: str, values: Iterable[float]) -> str:
        return " and ".join(format(value, form) for value in values)

    return Content(
        source="Simulated, cyan and yellow halves of real film; the telephone's lens is the package's 4 mm one, set "
        f"at {_PHONE_FOCUS_MM:.0f} mm.",
        charts=[Chart("cameras", figure, "Above the reflex camera, below the telephone before small cards.")],
        comparisons=[
            Comparison("reflex camera", "depth maps (pictures)",
                       f"median error {listed('.1%', (s.error for s in reflex))} of the depth, "
                       f"{listed('.0%', (s.fill for s in reflex))} answered",
                       "Other scenes; ours have a truth to compare with."),
            Comparison("telephone", "disparity maps of tiny models (pictures)",
                       f"median error {listed('.2f', (s.error for s in phone))} px, "
                       f"{listed('.0%', (s.fill for s in phone))} answered, "
                       f"{listed('.1f', (s.blur_span_px for s in phone))} px of blur radius between nearest and "
                       "farthest",
                       "The simulated filter lies in the pupil; the paper's was before the lens, at a distance that it "
                       "does not state."),
        ],
    )  # fmt: skip


def _by_reflex(context: Context, seed: int) -> Scene:
    camera = world.camera_of(*context.scene_size)
    planes = world.still_life(seed=seed, saturation=0.6)
    shot = world.pinhole_capture(_HALVES, planes, camera, cells=context.cells, seed=seed)
    curve = methods.calibrate("ours, real-time", _HALVES, camera, context.cells)
    found = methods.our_disparity(shot.image, methods.setting_of(_HALVES, camera), quality="real-time")
    depth = methods.depth_of(curve.radius_of(found.value_px), camera)
    return Scene("50 mm f/2", shot.image, depth, shot.depth_mm, "mm", float(np.ptp(shot.radius_px)))


def _by_phone(context: Context, seed: int) -> Scene:
    camera = phone_camera(*context.scene_size)
    shot = world.pinhole_capture(_HALVES, cards(camera, seed), camera, cells=context.cells, seed=seed)
    known = np.isfinite(shot.radius_px)
    setting = replace(methods.setting_of(_HALVES, camera), span_px=searched_span(shot.radius_px))
    disparity = np.asarray(methods.our_disparity(shot.image, setting, quality="real-time").value_px, float)
    # Leaks of the film scale the geometric disparity: one factor, fitted to the truth.
    both = known & np.isfinite(disparity)
    gain = float(np.median(disparity[both] * shot.radius_px[both]) / np.median(shot.radius_px[both] ** 2))
    blur_span_px = float(np.ptp(shot.radius_px[known]))
    return Scene("telephone", shot.image, disparity, gain * shot.radius_px, "half disparity, px", blur_span_px)


def aperture_picture() -> np.ndarray:
    """Draw the transmitted light of the aperture, seen from behind the camera; (160, 160, 3), white around."""
    y, x = np.mgrid[-1.08:1.08:160j, -1.08:1.08:160j]
    light = world.real_film(_HALVES).transmission_map(x, y)
    return np.where((np.hypot(x, y) <= 1)[..., None], light, 1.0)


def phone_camera(width_px: int, height_px: int) -> PupilCamera:
    """Return the first-order model of the telephone's lens, focused close."""
    optics = focused_at(load_lens("phone_4"), _PHONE_FOCUS_MM)
    return pupil_camera(optics, width_px=width_px, height_px=height_px, pixel_pitch_mm=_PHONE_SENSOR_MM / width_px)


def cards(camera: PupilCamera, seed: int = 20) -> list[Plane]:
    """Build a wall and three cards before it, at 45 to 110 mm."""
    side = -1 if seed % 20 else 1  # the other table is the mirror image, with other textures
    made = []
    for i, (z, x, size) in enumerate(((110.0, 0.0, 1.6), (80.0, -0.25, 0.3), (60.0, 0.02, 0.26), (47.0, 0.29, 0.24))):
        seen_mm = z * camera.width_px / camera.focal_px  # width of the picture at this distance
        grey = np.repeat(noise((500, 600), exponent=0.9, seed=seed + i)[..., None], 3, axis=2)
        tint = np.array([(1, 1, 1), (1, 0.7, 0.6), (0.7, 1, 0.7), (0.8, 0.85, 1)][i], np.float32)
        made.append(plane(grey * tint, center_mm=(side * x * seen_mm, 0.02 * seen_mm * i, z), width_mm=size * seen_mm))
    return made


def searched_span(radius_px: np.ndarray) -> tuple[float, float]:
    """Return the range of half disparities of a scene with a margin of 1 px."""
    beta = methods.HALVES_BETA
    return beta * float(np.nanmin(radius_px)) - 1.0, beta * float(np.nanmax(radius_px)) + 1.0


def figure_14(context: Context) -> Content:
    """Measure a scene with the calibrated camera, restore it, focus on the front and on the back."""
    simulated = context.simulated
    result, source = simulated.calibrated()
    shot = simulated.session_capture(world.still_life(seed=14, saturation=0.6), seed=14)
    camera = CodedApertureCamera(result.calibration, default_config(result.calibration, "real-time"))
    frame = camera.measure(shot.image)
    sharp = restore(shot.image, frame.disparity_px, camera, sigma_px=frame.disparity_sigma_px, sharpness="fast")
    near, far = (float(v) for v in np.percentile(sharp.radius_px, (3, 90)))
    pictures = {"(a) restored": sharp.color}
    for title, at in (("(c) focus on the foreground", near), ("(d) focus on the background", far)):
        pictures[title] = refocus(sharp.color, sharp.radius_px, Focus(at, strength=1.5))
    figure = new_figure(height=4.6)
    first, disparity, *rest = figure.subplots(2, 2).ravel()
    show_image(disparity, frame.disparity_px, "(b) disparity, px", bar="", colors=DISTANCE)
    white = float(np.percentile(sharp.color, 99.5))
    for axes, (title, picture) in zip((first, *rest), pictures.items(), strict=True):
        show_image(axes, linear_to_srgb(np.clip(picture / white, 0, 1)), title)
    return Content(
        source=f"{source} The scene is photographed by the same simulated lens.",
        charts=[Chart("effects", figure, "One capture; the focus is set afterwards.")],
        comparisons=[
            Comparison("effects", "pictures of a telephone", "pictures of a simulated reflex camera",
                       "The same chain: disparity, restored colour, blur by depth.")
        ],
    )  # fmt: skip
