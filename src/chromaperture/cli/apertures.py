"""``chromaperture apertures``: compare designs for a lens, and write a template of one."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from chromaperture.cli.console import out as console
from chromaperture.cli.console import print_json, table
from chromaperture.cli.options import CAMERA_PANEL, Film, FocusMm, Json, Lens, Quiet, SensorWidthMm, Width, check_output
from chromaperture.system.errors import InputError

if TYPE_CHECKING:
    from chromaperture.optics.aperture import Aperture
    from chromaperture.optics.pinhole import PupilCamera

_LENS = "double_gauss_50"
# Error bar of real-time on textured planes at 1.2 to 3.5 m, 50 mm at f/2, 720x480 px: 0.060 to 0.071 px.
SIGMA_PX = 0.07


def apertures(
    design: Annotated[
        list[str] | None, typer.Argument(help="Designs or files to compare; all when absent.", metavar="DESIGN")
    ] = None,
    lens: Lens = _LENS,
    focal_length_mm: Annotated[
        float | None, typer.Option(help="Of a thin lens in place of --lens.", rich_help_panel=CAMERA_PANEL)
    ] = None,
    f_number: Annotated[float | None, typer.Option(help="Of that thin lens.", rich_help_panel=CAMERA_PANEL)] = None,
    pixel_um: Annotated[
        float | None,
        typer.Option(
            help="Pixel of the pictures: two photosites where a Bayer cell is one pixel.", rich_help_panel=CAMERA_PANEL
        ),
    ] = None,
    focus_mm: FocusMm = 2000.0,
    at_mm: Annotated[
        list[float] | None, typer.Option(help="Distance to judge at, mm; repeatable, the working range.")
    ] = None,
    sigma_px: Annotated[
        float, typer.Option(help="Error of the half disparity, px of the picture that is matched.")
    ] = SIGMA_PX,
    film: Film = "lee",
    width: Width = 720,
    sensor_width_mm: SensorWidthMm = 22.3,
    figure: Annotated[Path | None, typer.Option(help="Write a figure of masks and depth errors (.png, .svg).")] = None,
    template: Annotated[Path | None, typer.Option(help="Write a 1:1 template of the one design (.svg, .pdf).")] = None,
    pupil_mm: Annotated[
        float | None, typer.Option(help="Diameter of the iris for the template, mm; default that of --lens.")
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compare aperture designs: light, baseline, range, disparity, blur, depth error, and the least that noise allows.

    chromaperture apertures cy_halves --template cy.pdf --pupil-mm 17.1

    chromaperture apertures cy_halves --focal-length-mm 25 --f-number 1.4 --pixel-um 6.9 --focus-mm 800
    """
    from chromaperture.optics.aperture import DESIGNS, FILMS, film_names
    from chromaperture.optics.pinhole import thin_lens_camera
    from chromaperture.optics.printing.aperture_file import load_made
    from chromaperture.optics.printing.template import write_template
    from chromaperture.system.storage import staged

    fitting = [n for n, known in DESIGNS.items() if film in FILMS or len(film_names(known)) == film.count(",") + 1]
    names = design or fitting or list(DESIGNS)
    if template and len(names) != 1:
        raise InputError("--template needs exactly one design")
    if figure:
        check_output(figure, ".png", ".svg", option="--figure")
    chosen = [load_made(name, film) for name in names]
    if not 0 < sigma_px < math.inf:
        raise InputError(f"--sigma-px must be positive, got {sigma_px:g}")
    size = {"width_px": width, "height_px": round(width * 2 / 3)}
    if (focal_length_mm, f_number, pixel_um) == (None, None, None):
        camera, iris_mm = _camera_of(lens, focus_mm, pixel_pitch_mm=sensor_width_mm / width, **size)
    elif focal_length_mm is None or f_number is None or pixel_um is None or lens != _LENS:
        raise InputError("give --focal-length-mm, --f-number and --pixel-um together, and no --lens")
    else:
        camera = thin_lens_camera(focal_length_mm, f_number, focus_mm, pixel_pitch_mm=pixel_um / 1000, **size)
        iris_mm, lens = 2 * camera.pupil_radius_mm, f"of {focal_length_mm:g} mm at f/{f_number:g}"
    rows = design_table(chosen, camera, at_mm or [1000.0, 1500.0, 2000.0, 3000.0, 4000.0], sigma_px=sigma_px)
    if template:
        diameter_mm = pupil_mm or iris_mm
        with staged(template.parent) as stage:
            page = stage.path(template.name)
            write_template(page, chosen[0], pupil_diameter_mm=diameter_mm)
    if figure:
        with staged(figure.parent) as stage:
            draw_designs(stage.path(figure.name), chosen, camera)
    if json:
        print_json(rows)
    elif not quiet:
        _print_table(rows, camera, sigma_px)
    if not quiet and not json:
        if template:
            whose = "" if pupil_mm else f" of the lens {lens}; --pupil-mm is for yours"
            typer.echo(f"Wrote {template}: for an iris of {diameter_mm:.1f} mm{whose}")
        if figure:
            typer.echo(f"Wrote {figure}")


def _camera_of(lens: str, focus_mm: float, **sensor: Any) -> tuple[PupilCamera, float]:
    """Return the camera of a lens's prescription, and the diameter of its iris."""
    from chromaperture.optics.pinhole import focused_at, pupil_camera
    from chromaperture.optics.prescription import load_lens

    optics = focused_at(load_lens(lens), focus_mm)
    stop = next(surface for surface in optics.surfaces if surface.role == "stop")
    return pupil_camera(optics, **sensor), 2 * stop.semi_diameter_mm


def design_table(
    chosen: list[Aperture], camera: PupilCamera, distances_mm: list[float], *, sigma_px: float = SIGMA_PX
) -> list[dict[str, Any]]:
    """Return the figures of designs in one lens, at equal exposure; lists run over distances, None without views."""
    import numpy as np

    from chromaperture.model.scale import MOST_RADIUS_PX
    from chromaperture.optics.aperture import aperture_figures, film_unmixing
    from chromaperture.optics.depth_error_bound import expected_accuracy

    rows = []
    for aperture in chosen:
        light = aperture_figures(aperture)
        views = aperture_figures(aperture, film_unmixing(aperture))
        curve = expected_accuracy(aperture, camera, np.array(distances_mm))
        scale = max(1.0, float(np.abs(curve.blur_px).max()) / MOST_RADIUS_PX)  # as `accurate_scale`
        error_px = np.maximum(scale * sigma_px, curve.sigma_px)
        error_mm = error_px / curve.disparity_per_mm if aperture.views else np.empty(0)
        near_mm, far_mm = _searched_mm(camera, views.beta) if aperture.views else (None, None)
        rows.append({
            "name": aperture.name,
            "title": aperture.title,
            "transmission_rgb": light.channel_transmission.round(6).tolist(),
            "efficiency_mean": round(light.efficiency_mean, 6),
            "efficiency_luminance": round(light.efficiency_luminance, 6),
            "baseline_mm": round(2 * views.beta * camera.pupil_radius_mm, 3) if aperture.views else None,
            "near_mm": near_mm,
            "far_mm": far_mm,
            "working_scale": round(scale, 3),
            "distances_mm": [float(z) for z in distances_mm],
            "disparity_px": curve.disparity_px.round(3).tolist() if aperture.views else None,
            "disparity_px_per_mm": curve.disparity_per_mm.round(6).tolist() if aperture.views else None,
            "blur_radius_px": curve.blur_px.round(3).tolist(),
            "depth_error_mm": error_mm.round(3).tolist() if aperture.views else None,
            "depth_error_percent": (100 * error_mm / distances_mm).round(3).tolist() if aperture.views else None,
            "depth_sigma_mm": [round(float(s), 3) if math.isfinite(s) else None for s in curve.sigma_mm]
            if aperture.views else None,
        })  # fmt: skip
    return rows


def _searched_mm(camera: PupilCamera, beta: float) -> tuple[float | None, float | None]:
    """Return the distances between which half disparities are in the default search range; None for infinity."""
    from chromaperture.settings.stages import LayersConfig

    layers = LayersConfig()
    scale = beta * camera.focal_px * camera.pupil_radius_mm
    infinity_px = scale / (camera.focus_mm - camera.sensor_to_pupil_mm)
    ends = layers.min_px + layers.step_px, layers.max_px - layers.step_px  # the best layer at an end is unknown
    left = [infinity_px - end for end in ends]
    near, far = (round(scale / px + camera.sensor_to_pupil_mm, 1) if px > 0 else None for px in left)
    return near, far


def _print_table(rows: list[dict[str, Any]], camera: PupilCamera, sigma_px: float) -> None:
    lens = (
        f"image distance {camera.image_distance_mm:.1f} mm, pupil {2 * camera.pupil_radius_mm:.1f} mm, "
        f"focus {camera.focus_mm:.0f} mm"
    )
    heads = ("design", "R", "G", "B", "mean", "luminance", "baseline, mm")
    light = table(f"Light, %, and baseline: {lens}", *heads)
    for row in rows:
        passed = [*row["transmission_rgb"], row["efficiency_mean"], row["efficiency_luminance"]]
        baseline = f"{row['baseline_mm']:.2f}" if row["baseline_mm"] else "-"
        light.add_row(row["name"], *(f"{100 * x:.1f}" for x in passed), baseline)
    console.print(light)
    ranges = table("Range searched at full size, mm", "design", "from", "to")
    for row in rows:
        if row["near_mm"]:
            ranges.add_row(row["name"], f"{row['near_mm']:.0f}", f"{row['far_mm'] or math.inf:.0f}")
    if ranges.row_count:
        console.print(ranges)
    columns = [f"{z:.0f}" for z in rows[0]["distances_mm"]]
    for title, key, style in (
        ("Depth error, mm, at a distance in mm", "depth_error_mm", ".1f"),
        ("Depth error, %, at a distance in mm", "depth_error_percent", ".2f"),
        ("Least depth error, mm, at a distance in mm", "depth_sigma_mm", ".1f"),
        ("Disparity, px, at a distance in mm", "disparity_px", "+.2f"),
        ("Disparity, px per mm, at a distance in mm", "disparity_px_per_mm", ".5f"),
    ):
        figures = table(title, "design", *columns)
        for row in rows:
            if row["baseline_mm"]:
                figures.add_row(row["name"], *("-" if v is None else format(v, style) for v in row[key]))
        if figures.row_count:
            console.print(figures)
    blur = ", ".join(f"{r:+.1f} px at {z} mm" for r, z in zip(rows[0]["blur_radius_px"], columns, strict=True))
    scale = rows[0]["working_scale"]
    console.print(
        f"Depth error: {sigma_px:g} px of half disparity in pixels {scale:.1f} times as wide (blur), or the least"
    )
    console.print(f"Blur radius of the whole pupil (- nearer than the focus): {blur}")
    if (best := recommended(rows)) and len(rows) > 1:
        console.print(
            f"Recommended of these: {best}, whose least depth error, mean over the distances, is the smallest. "
            "Its pieces to print, for an iris of your size:"
        )
        typer.echo(f"chromaperture apertures {best} --template {best}.pdf --pupil-mm MM")


def recommended(rows: list[dict[str, Any]]) -> str:
    """Return the name of the design with the smallest bound on the depth error, as geometric mean over distances."""
    errors_mm = {row["name"]: row["depth_sigma_mm"] for row in rows if row["depth_sigma_mm"]}
    bounded = {name: math.prod(each) for name, each in errors_mm.items() if None not in each}
    return min(bounded, key=bounded.__getitem__, default="")


def draw_designs(path: Path, chosen: list[Aperture], camera: PupilCamera) -> None:
    """Draw the masks in their colours and the depth error over distance."""
    import numpy as np
    from matplotlib.patches import Circle

    from chromaperture.evaluation.figures import new_figure, plain_log_scale
    from chromaperture.optics.aperture import aperture_figures, pupil_grid
    from chromaperture.optics.depth_error_bound import expected_accuracy

    columns = max(len(chosen), 4)
    drawing = new_figure(1.7 * columns, 6.2)
    grid = drawing.add_gridspec(2, columns, height_ratios=(1, 2.2))
    below = drawing.add_subplot(grid[1, :])
    x, y = pupil_grid(200)
    last = 4000.0 if math.isinf(camera.focus_mm) else 2 * camera.focus_mm
    distances = np.linspace(max(0.25 * last, 1.5 * camera.sensor_to_pupil_mm + camera.image_distance_mm), last, 40)
    for i, aperture in enumerate(chosen):
        axes = drawing.add_subplot(grid[0, i])
        picture = np.where((np.hypot(x, y) < 1)[..., None], aperture.transmission_map(x, y), 1.0)
        axes.imshow(picture)
        axes.add_patch(Circle((99.5, 99.5), 99.5, fill=False, color="0.4", linewidth=0.8))
        axes.axis("off")
        percent = 100 * aperture_figures(aperture).efficiency_mean
        axes.set_title(f"{aperture.title.replace(': ', chr(10))}\nlight {percent:.1f} %", fontsize=8)
        if aperture.views:
            sigma_mm = expected_accuracy(aperture, camera, distances).sigma_mm
            below.plot(distances, sigma_mm, label=aperture.title)
    plain_log_scale(below)
    below.set(xlabel="distance from the sensor, mm", ylabel="bound on the depth error σ, mm")
    below.grid(alpha=0.3)
    if below.lines:
        below.legend(fontsize=8)
    drawing.savefig(path)
