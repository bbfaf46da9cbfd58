"""``chromaperture simulate``: photograph a calibration session and scenes in the simulator."""

from __future__ import annotations

import shlex
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from chromaperture.cli.console import progress
from chromaperture.cli.options import (
    BOARDS_PANEL,
    CAMERA_PANEL,
    RAYS_PANEL,
    FarthestMm,
    Film,
    FocusMm,
    Lens,
    NearestMm,
    Quiet,
    Seed,
    SensorWidthMm,
    SimulatedDesign,
    Width,
    check_output,
)
from chromaperture.system.errors import InputError

if TYPE_CHECKING:
    from chromaperture.optics import aperture as optics_aperture

_camera, _boards, _rays = (partial(typer.Option, rich_help_panel=p) for p in (CAMERA_PANEL, BOARDS_PANEL, RAYS_PANEL))


def simulate(
    out: Annotated[
        Path, typer.Argument(help="Folder of the session; everything is written into it.", metavar="FOLDER")
    ],
    design: SimulatedDesign = "cy_halves",
    film: Film = "lee",
    lens: Lens = "double_gauss_50",
    focus_mm: FocusMm = 2000.0,
    filter_offset_mm: Annotated[float, _camera(help="Film off the stop, mm, + towards the sensor.")] = 0.0,
    thin: Annotated[
        bool, _camera("--thin", help="First order of the lens only: no aberrations, no vignetting.")
    ] = False,
    width: Width = 720,
    height: Annotated[int, _camera(help="Image height, px.")] = 480,
    sensor_width_mm: SensorWidthMm = 22.3,
    nearest_mm: NearestMm = 1000.0,
    farthest_mm: FarthestMm = 4000.0,
    step_mm: Annotated[float, _boards(help="Distance from board to board, mm.")] = 100.0,
    tilts: Annotated[int, _boards(help="Tilted board views.")] = 12,
    square_mm: Annotated[
        float | None, _boards(help="Side of the squares, mm; default 30, less where the frame is too small.")
    ] = None,
    scene: Annotated[
        list[Path] | None, _rays(help="Scene file of textured planes, photographed too; repeatable.")
    ] = None,
    cells: Annotated[int, _rays(help="Rays across the pupil, even; noise and time grow with its square.")] = 16,
    seed: Seed = 0,
    quiet: Quiet = False,
) -> None:
    """Write a calibration session with known truth.

    Example: chromaperture simulate session/cy_halves --step-mm 500 --width 360 --height 240
    """
    from chromaperture.optics.pinhole import focused_at, pupil_camera
    from chromaperture.optics.prescription import load_lens, with_filter_at
    from chromaperture.optics.printing.aperture_file import load_made
    from chromaperture.optics.ray_table import RayTable, lens_rays, pinhole_rays
    from chromaperture.optics.simulator.scene import load_scene
    from chromaperture.optics.simulator.session import SessionPlan, write_session
    from chromaperture.system.storage import staged

    if (out / "session.toml").exists():
        raise InputError(f"{out} holds a session; give a new folder, so that photographs of two cameras do not mix")
    if cells < 4 or cells % 2:
        raise InputError(f"--cells must be even and at least 4, got {cells}")
    if step_mm <= 0 or farthest_mm < nearest_mm:
        raise InputError("--step-mm must be positive and --farthest-mm at least --nearest-mm")
    aperture = load_made(design, film)
    optics = focused_at(load_lens(lens), focus_mm)
    size: dict[str, Any] = {"width_px": width, "height_px": height, "pixel_pitch_mm": sensor_width_mm / width}
    camera = pupil_camera(optics, **size)
    traced = with_filter_at(optics, filter_offset_mm) if filter_offset_mm else optics

    def rays(coded: optics_aperture.Aperture) -> RayTable:
        return pinhole_rays(camera, coded, cells=cells) if thin else lens_rays(traced, coded, **size, cells=cells)

    count = int((farthest_mm - nearest_mm) / step_mm + 1e-6) + 1
    distances_mm = tuple(nearest_mm + i * step_mm for i in range(count))
    began = time.monotonic()
    with progress(quiet=quiet) as update, staged(out) as stage:
        is_whole = write_session(
            stage.private,
            aperture=aperture,
            camera=camera,
            rays=rays,
            scenes={path.stem: load_scene(path) for path in scene or []},
            plan=SessionPlan(distances_mm=distances_mm, tilts=tilts, seed=seed, square_mm=square_mm),
            report=(lambda note: None) if quiet else typer.echo,
            progress=update,
        )
        stage.take_all()
    took = f"in {time.monotonic() - began:.0f} s"
    if not is_whole:
        typer.echo(f"{out} holds what was finished {took}, a session of fewer photographs", err=True)
        raise KeyboardInterrupt
    if not quiet:
        command = f"chromaperture calibrate {shlex.quote(str(out))} --out camera.asdf"
        typer.echo(f"Wrote {out} {took}; calibrate it with: {command}")


def simulate_rgbd(
    color: Annotated[Path, typer.Argument(help="Colour picture, sharp.", metavar="COLOR")],
    depth: Annotated[Path, typer.Argument(help="16-bit depth of the same size; 0 and 65535 unknown.", metavar="DEPTH")],
    out: Annotated[Path, typer.Argument(help="Coded capture to write, 16-bit PNG of linear counts.", metavar="OUT")],
    focal_px: Annotated[float, typer.Option(help="fx of the RGB-D camera.")],
    design: SimulatedDesign = "cy_halves",
    film: Film = "lee",
    pupil_radius_mm: Annotated[float, typer.Option(help="Radius of the entrance pupil, mm.")] = 12.5,
    focus_mm: FocusMm = 2000.0,
    sensor_to_pupil_mm: Annotated[float, typer.Option(help="Sensor plane to entrance pupil, mm.")] = 50.0,
    depth_unit_mm: Annotated[float, typer.Option(help="Millimetres a count of the depth map.")] = 1.0,
    pitch_px: Annotated[float, typer.Option(help="Distance of two layers in blur radius.")] = 0.5,
    exposure: Annotated[float, typer.Option(help="Factor on the light; white paper at 1 fills the sensor.")] = 0.9,
    seed: Seed = 0,
    quiet: Quiet = False,
) -> None:
    """Photograph an RGB-D picture through a coded aperture.

    Example: chromaperture simulate-rgbd color.png depth.png coded.png --focal-px 585
    """
    import cv2

    from chromaperture.optics.pinhole import PupilCamera
    from chromaperture.optics.printing.aperture_file import load_made
    from chromaperture.optics.simulator.layer_renderer import read_rgbd, render_layers
    from chromaperture.optics.simulator.sensor import SensorModel, expose
    from chromaperture.system.storage import staged

    check_output(out, ".png", inputs=[color, depth], option="OUT")
    aperture = load_made(design, film)
    picture, depth_mm = read_rgbd(color, depth, depth_unit_mm=depth_unit_mm, sensor_to_pupil_mm=sensor_to_pupil_mm)
    height, width = depth_mm.shape
    # The pixel pitch, 0.02 mm, only serves to check that the focus lies beyond the image distance.
    camera = PupilCamera(width, height, focal_px, pupil_radius_mm, focus_mm, sensor_to_pupil_mm, 0.02)
    rendered = render_layers(picture, depth_mm, camera=camera, aperture=aperture, pitch_px=pitch_px)
    counts = expose(rendered.image, SensorModel(), seed=seed, exposure=exposure)
    with staged(out.parent) as stage:
        stage.path(out.name).write_bytes(cv2.imencode(".png", counts[..., ::-1])[1].tobytes())
    if not quiet:
        typer.echo(f"Wrote {out} ({rendered.layer_count} layers)")
