"""A simulated phone, end to end: what its video costs in depth, and which loss costs how much.

    python benchmarks/simulated_phone.py --out FOLDER [--work FOLDER] [--only everything nothing] [--small]

The package's 4 mm lens (``phone_4``) with the film 0.5 mm before its stop, between front lens and cover glass as in the
paper's prototype. Light is rendered ray by ray at 1280x720; `optics/simulator/video_signal.py` puts noise, tone curve,
4:2:0 colours and 8 bits on it, and the page's halving. The session is filled by the assistant's own checks, calibrated
by its job, and planes at other distances are measured with the camera file it made, as ``api/frames`` measures.

Each loss is taken alone and left out alone; what it changes is also told pixel by pixel. Writes ``phone.json`` and
``phone.png``; light is kept in ``--work``, and with it the results so far, so that a second run goes on. It takes
half an hour of processor time; ``--small`` two minutes.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from phone_picture import LIGHTS, QUALITIES, draw, print_tables

from chromaperture.app.assistant import check_shot, sheets_of
from chromaperture.app.calibration_job import CalibrationJob
from chromaperture.app.session_folder import SessionFolder
from chromaperture.app.workbench import Workbench, heard
from chromaperture.color.srgb import srgb_to_linear
from chromaperture.frame.depth_frame import DepthFrame
from chromaperture.optics.aperture import DESIGNS, Aperture, SubAperture, channel_transmission, made_of
from chromaperture.optics.depth_error_bound import Texture, expected_accuracy
from chromaperture.optics.filters import OPAQUE
from chromaperture.optics.paraxial import focused_at
from chromaperture.optics.pinhole import PupilCamera, pupil_camera
from chromaperture.optics.prescription import load_lens, with_filter_at
from chromaperture.optics.ray_table import RayTable, lens_rays
from chromaperture.optics.shapes import Disc
from chromaperture.optics.simulator import textures
from chromaperture.optics.simulator.render import render, render_depth
from chromaperture.optics.simulator.scene import plane
from chromaperture.optics.simulator.sensor import SensorModel
from chromaperture.optics.simulator.session import wall
from chromaperture.optics.simulator.video_signal import VideoSignal, drawn_smaller, video_frame
from chromaperture.system.robust import MAD_TO_SIGMA

WHITE = 0.9  # of full scale, of the brightest paper
RULER_MM = 0.3  # largest error of a distance: a caliper's, at these distances
TINY = 1e-6  # light is kept in counts of 16 bits of its brightest value
LOSSES = ("stop", "noise", "4:2:0", "tone", "8 bit")


@dataclass(frozen=True)
class Phone:
    """The phone, its session and the planes; figures chosen by hand, mm and px."""

    lens: str = "phone_4"
    design: str = "cy_halves"
    film_offset_mm: float = -0.5  # of the film from the stop, + towards the sensor
    focus_mm: float = 150.0
    sensor_width_mm: float = 3.6
    width_px: int = 1280
    height_px: int = 720
    cells: int = 10  # rays across the pupil
    square_mm: float = 4.5  # of the board, which fills the frame where it is nearest
    boards_mm: tuple[float, ...] = (90.0, 105.0, 125.0, 150.0, 180.0, 225.0, 300.0)
    leans_deg: tuple[tuple[float, float], ...] = ((0, 22), (0, -22), (18, 0), (-18, 0), (13, 15), (-13, -15))
    planes_mm: tuple[float, ...] = (100.0, 115.0, 135.0, 165.0, 200.0, 250.0)
    plane_leans_deg: tuple[float, float] = (12.0, 16.0)  # of every plane: a matcher must follow its slope
    seed: int = 7

    def camera(self, shrink: int = 1) -> PupilCamera:
        """First-order camera of the video, or of one that is so many times smaller."""
        return pupil_camera(
            focused_at(load_lens(self.lens), self.focus_mm), width_px=self.width_px // shrink,
            height_px=self.height_px // shrink, pixel_pitch_mm=self.sensor_width_mm / self.width_px * shrink,
        )  # fmt: skip


SMALL = Phone(width_px=640, height_px=360, cells=6, boards_mm=(90.0, 110.0, 150.0, 205.0, 300.0),
              leans_deg=Phone.leans_deg[:4], planes_mm=(115.0, 250.0))  # fmt: skip


@dataclass(frozen=True)
class Losses:
    """Which losses a variant has."""

    name: str
    stop: bool = False  # the film is away from the stop
    noise: bool = False
    chroma: bool = False
    tone: bool = False  # BT.709 instead of the sRGB curve that the reader assumes
    bits: bool = False
    doubled: bool = True  # captured at twice the size that is measured, and drawn smaller
    options: dict[str, Any] = field(default_factory=dict)  # of the job

    def signal(self, sensor: SensorModel) -> VideoSignal:
        """Video of the variant."""
        return VideoSignal(
            sensor if self.noise else None, "bt709" if self.tone else "srgb", "4:2:0" if self.chroma else "4:4:4",
            8 if self.bits else None,
        )  # fmt: skip


NAMES = dict(zip(LOSSES, ("stop", "noise", "chroma", "tone", "bits"), strict=True))
ALL = Losses("everything", stop=True, noise=True, chroma=True, tone=True, bits=True)
VARIANTS = [
    Losses("nothing"),
    *(Losses(f"{loss} alone", **{key: True}) for loss, key in NAMES.items()),
    ALL,
    *(replace(ALL, name=f"without {loss}", **{key: False}) for loss, key in NAMES.items()),
    Losses("4:2:0 alone, not doubled", chroma=True, doubled=False),
    replace(ALL, name="everything, not doubled", doubled=False),
]


# ---- light


class Light:
    """Rendered light, kept in a folder.

    Parameters
    ----------
    phone : Phone
    folder : Path
    """

    def __init__(self, phone: Phone, folder: Path) -> None:
        self.phone, self.folder = phone, folder
        folder.mkdir(parents=True, exist_ok=True)
        self.aperture = made_of(DESIGNS[phone.design], "real")
        self._tables: dict[tuple[bool, str], RayTable] = {}

    def of(self, name: str, off_stop: bool) -> np.ndarray:
        """Light of a photograph of `photographs`; (H, W, 3) float32."""
        path = self.folder / f"{'off' if off_stop else 'at'}-{name.replace('/', '-')}.npz"
        if not path.is_file():
            picture = self._render(name, off_stop)
            top = max(float(picture.max()), TINY)
            np.savez(path, counts=np.rint(picture / top * 65535).astype(np.uint16), top=top)
        with np.load(path) as stored:
            return stored["counts"].astype(np.float32) * np.float32(stored["top"] / 65535)

    def _render(self, name: str, off_stop: bool) -> np.ndarray:
        kind, _, rest = name.partition("/")
        film = self._film(rest) if kind == "white" else self.aperture
        table = self._table(off_stop, rest if kind == "white" else self.phone.design, film)
        return render(table, self._scene(kind, rest))

    def _table(self, off_stop: bool, name: str, film: Aperture) -> RayTable:
        key = (off_stop, name)
        if key not in self._tables:
            lens = focused_at(load_lens(self.phone.lens), self.phone.focus_mm)
            lens = with_filter_at(lens, self.phone.film_offset_mm) if off_stop else lens
            size = {"width_px": self.phone.width_px, "height_px": self.phone.height_px}
            pitch = self.phone.sensor_width_mm / self.phone.width_px
            self._tables[key] = lens_rays(lens, film, pixel_pitch_mm=pitch, cells=self.phone.cells, **size)
        return self._tables[key]

    def _film(self, sheet: str) -> Aperture:
        if sheet == "open":
            return DESIGNS["open"]
        if sheet == self.phone.design:
            return self.aperture
        color = {"sheet_c": "cyan", "sheet_y": "yellow"}[sheet]
        part = SubAperture(Disc(radius=3.0), self.aperture.filter_named(color))  # wider than the light anywhere
        return Aperture(color, color, (part,), OPAQUE, ())

    def _scene(self, kind: str, rest: str) -> list[Any]:
        phone, camera = self.phone, self.phone.camera()
        if kind == "white":
            return [plane(np.ones((2, 2, 3), np.float32), center_mm=(0, 0, 500.0), width_mm=4000)]
        if kind == "board":
            return wall(camera, (0, 0, true_mm(phone, float(rest))), (0, 0, 0), phone.square_mm, 0.0)
        if kind == "tilt":
            across, up = phone.leans_deg[int(rest)]
            at = phone.focus_mm * (1.1 if int(rest) % 2 else 1.0)
            return wall(camera, (0, 0, at), (across, up, 0), phone.square_mm, 0.0)
        at, footprint = float(rest), (float(rest) - camera.sensor_to_pupil_mm) / camera.focal_px
        # The texture of the bound: 1/f, its contrast over 512 px of what is measured, in texels of a video pixel.
        side = -(-int(1.4 * phone.width_px) // 1024) * 1024  # wider than the frame where the plane leans
        tiles = [textures.noise((1024, 1024), exponent=1.0, seed=int(at) + k) for k in range(side // 1024)]
        grey = np.concatenate(tiles, axis=1)
        picture = np.repeat(grey[..., None], 3, axis=2)
        return [plane(picture, center_mm=(0, 0, at), width_mm=side * footprint, tilt_deg=(*phone.plane_leans_deg, 0))]

    def depth_mm(self, name: str, off_stop: bool) -> np.ndarray:
        """True distances of a plane, of 2 x 2 pixels; (H / 2, W / 2) float."""
        kind, _, rest = name.partition("/")
        depth = render_depth(self._table(off_stop, self.phone.design, self.aperture), self._scene(kind, rest))
        h, w = depth.shape
        return depth.reshape(h // 2, 2, w // 2, 2).mean(axis=(1, 3))


def true_mm(phone: Phone, ruler_mm: float) -> float:
    """Where the board of a ruler's reading stands."""
    rng = np.random.default_rng((phone.seed, int(ruler_mm)))
    return ruler_mm + float(rng.uniform(-RULER_MM, RULER_MM))


# ---- photographs


class Shutter:
    """Photographs of one variant.

    Parameters
    ----------
    light : Light
    losses : Losses
    sensor : SensorModel
        Of a pixel of the video.
    """

    def __init__(self, light: Light, losses: Losses, sensor: SensorModel) -> None:
        self.light, self.losses = light, losses
        # A pixel of a video that is half as large gathers the light of four.
        larger = replace(sensor, full_well_electrons=4 * sensor.full_well_electrons,
                         read_noise_electrons=2 * sensor.read_noise_electrons)  # fmt: skip
        self.sensor = sensor if losses.doubled else larger
        self.sheets = WHITE / float(light.of("white/open", losses.stop).max())
        coded = light.of(f"white/{light.phone.design}", losses.stop)
        self.boards = WHITE / float(coded.max())

    def take(self, name: str, light_share: float = 1.0) -> np.ndarray:
        """Encoded picture as the page sends it; (H, W, 3) float32, 0 to 1."""
        light, signal = self.light.of(name, self.losses.stop), self.losses.signal(self.sensor)
        exposure = light_share * (self.sheets if name.startswith("white/") else self.boards)
        seed = sum(name.encode()) * 1009 + self.light.phone.seed
        if self.losses.doubled:
            return drawn_smaller(video_frame(light, signal, seed=seed, exposure=exposure), signal)
        h, w = (n // 2 for n in light.shape[:2])
        smaller = light.reshape(h, 2, w, 2, 3).mean(axis=(1, 3), dtype=np.float32)
        return video_frame(smaller, signal, seed=seed, exposure=exposure)

    def save(self, path: Path, name: str) -> None:
        """Write a photograph: 8 bits as the page does, or light in 16 bits where nothing is rounded."""
        picture = self.take(name)
        if self.losses.bits:
            counts = np.rint(picture * 255).astype(np.uint8)
        else:
            counts = np.rint(srgb_to_linear(picture) * 65535).astype(np.uint16)
        counts[0, 0, 2] ^= 1  # white paper without noise is exactly grey, which no photograph is: it would be refused
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), counts[..., ::-1])


def fill_session(shutter: Shutter, folder: Path, scratch: Path) -> tuple[SessionFolder, list[str]]:
    """Fill a session by the assistant's checks; returns it and what they warned of."""
    phone, camera = shutter.light.phone, shutter.light.phone.camera()
    facts = {
        "design": phone.design, "focal_length_mm": round(camera.image_distance_mm, 1),
        "f_number": round(camera.f_number, 1), "focus_mm": phone.focus_mm, "sensor_width_mm": phone.sensor_width_mm,
        "nearest_mm": min(phone.boards_mm), "farthest_mm": max(phone.boards_mm), "square_mm": phone.square_mm,
    }  # fmt: skip
    session, warned = SessionFolder.create(folder, facts), []
    path = scratch / "shot.png"

    def put(name: str, kind: Any, **options: Any) -> None:
        shutter.save(path, name)
        found = check_shot(session, path, kind, **options)
        warned.extend(f"{name}: {c.name}: {c.finding}" for c in found.checks if c.verdict == "warn")
        session.keep(path, kind, found.reading, found.checks, sheet=options.get("sheet", ""))

    for at in sorted(phone.boards_mm, key=lambda at: abs(at - phone.focus_mm)):
        put(f"board/{at:g}", "board", ruler_mm=at)
    for i in range(len(phone.leans_deg)):
        put(f"tilt/{i}", "tilt")
    for sheet in sheets_of(session):
        put(f"white/{sheet}", "white", sheet=sheet)
    path.unlink()
    return session, warned


# ---- measuring


def measure(shutter: Shutter, bench: Workbench, at_mm: float, quality: str, light_share: float = 1.0) -> DepthFrame:
    """Measure a plane with a variant's camera file, 8 bits by the function that answers the page."""
    picture = shutter.take(f"plane/{at_mm:g}", light_share)
    if not shutter.losses.bits:
        return bench.eye("phone", quality).measure(srgb_to_linear(picture))
    data, size = np.rint(picture * 255).astype(np.uint8), (picture.shape[1], picture.shape[0])
    return bench.measure_pixels(data.tobytes(), size, camera="phone", quality=quality)[0]


def measure_planes(shutter: Shutter, bench: Workbench) -> Iterator[dict[str, Any]]:
    """Measure the planes with a camera file; one row a distance and quality."""
    for at in shutter.light.phone.planes_mm:
        truth = shutter.light.depth_mm(f"plane/{at:g}", shutter.losses.stop)
        for quality in QUALITIES:
            frame = measure(shutter, bench, at, quality)
            yield {"distance_mm": at, "quality": quality} | errors(frame.depth_mm, frame.sigma_mm, truth)


def changes(phone: Phone, work: Path, names: Sequence[str]) -> dict[str, list[dict[str, float]]]:
    """What a loss changes, pixel by pixel, in the `real-time` depth of the same planes without any, in two lights.

    Median and spread of the difference of the relative errors: what both have in common, the matcher's own, is gone.
    """
    before: dict[tuple[float, float], np.ndarray] = {}
    found: dict[str, list[dict[str, float]]] = {}
    for losses in (v for v in VARIANTS if v.name in names):
        shutter = Shutter(Light(phone, work / "light"), losses, SensorModel())
        bench = Workbench(folder_of(work, losses), reserve_bytes=0)
        for at in phone.planes_mm:
            truth = shutter.light.depth_mm(f"plane/{at:g}", losses.stop)
            for light in LIGHTS:
                with heard():
                    error = (measure(shutter, bench, at, "real-time", light).depth_mm - truth) / truth
                change = error - before.setdefault((at, light), error)
                shift = float(np.nanmedian(change))
                scatter = float(MAD_TO_SIGMA * np.nanmedian(np.abs(change - shift)))
                row = {"distance_mm": at, "light": light, "shift": shift, "scatter": scatter}
                found.setdefault(losses.name, []).append(row)
    return found


def folder_of(work: Path, losses: Losses) -> Path:
    """Folder of a variant."""
    return work / "variants" / "".join(c if c.isalnum() else "-" for c in losses.name)


def errors(depth: np.ndarray, sigma: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Bias and spread of the depth of a plane, relative to its distance, in the middle and over the frame."""
    rows, columns = (slice(n // 3, n - n // 3) for n in depth.shape)
    found = {}
    off, said = (depth - truth) / truth, sigma / depth
    for name, part in (("middle", (rows, columns)), ("frame", (slice(None), slice(None)))):
        known = off[part][np.isfinite(off[part])]
        bias = float(np.median(known)) if known.size else float("nan")
        spread = float(MAD_TO_SIGMA * np.median(np.abs(known - bias))) if known.size else float("nan")
        found |= {f"{name}_bias": bias, f"{name}_spread": spread, f"{name}_known": known.size / off[part].size,
                  f"{name}_in_5": float((np.abs(known) < 0.05).sum() / off[part].size),
                  f"{name}_stated": float(np.nanmedian(said[part])) if np.isfinite(said[part]).any() else float("nan"),
                  f"{name}_honest": float((np.abs(off[part]) < said[part]).sum() / max(known.size, 1))}  # fmt: skip
    return found


def bounds(phone: Phone, sensor: SensorModel) -> dict[float, float]:
    """Cramer-Rao bound of one pixel's matching window by distance, relative to it; of the film in the stop."""
    larger = replace(sensor, full_well_electrons=4 * sensor.full_well_electrons,
                     read_noise_electrons=2 * sensor.read_noise_electrons)  # fmt: skip
    aperture = made_of(DESIGNS[phone.design], "real")
    at = np.array(phone.planes_mm)
    exposure = WHITE / float(channel_transmission(aperture).max())
    found = expected_accuracy(aperture, phone.camera(2), at, sensor=larger, texture=Texture(), exposure=exposure)
    return dict(zip(phone.planes_mm, (found.sigma_mm / at).tolist(), strict=True))


def run_variant(phone: Phone, losses: Losses, work: Path, *, lens_blur: bool) -> dict[str, Any]:
    """Calibrate and measure one variant."""
    sensor = SensorModel()
    shutter = Shutter(Light(phone, work / "light"), losses, sensor)
    folder = folder_of(work, losses)
    bench = Workbench(folder, reserve_bytes=0)
    session_folder = folder / "sessions" / "phone"
    camera = folder / "cameras" / "phone.asdf"
    warned: list[str] = []
    if not camera.is_file():
        if session_folder.exists():
            raise SystemExit(f"{session_folder} is half filled: delete {folder}")
        with heard():
            _, warned = fill_session(shutter, session_folder, folder)
            job = CalibrationJob(session_folder, camera, folder / "report.html", lens_blur=lens_blur)
            job.start()
            job.wait()
        if job.error:
            raise SystemExit(f"{losses.name}: {job.error}")
        (folder / "job.json").write_text(json.dumps({"warned": warned, "result": job.result}))
    job_said = json.loads((folder / "job.json").read_text())
    rows = list(measure_planes(shutter, bench))
    return {"losses": {k: v for k, v in asdict(losses).items() if k != "options"}, "rows": rows, **job_said}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--work", type=Path, help="default: OUT/work")
    parser.add_argument("--only", nargs="+", choices=[v.name for v in VARIANTS])
    parser.add_argument("--small", action="store_true", help="a quarter of the pixels, fewer photographs and rays")
    parser.add_argument("--no-blur", action="store_true", help="calibrate without the lens's blur")
    args = parser.parse_args()
    phone, work = SMALL if args.small else Phone(), args.work or args.out / "work"
    args.out.mkdir(parents=True, exist_ok=True)
    results = {}
    for losses in VARIANTS:
        if args.only and losses.name not in args.only:
            continue
        kept = work / f"{losses.name.replace(' ', '-').replace(':', '')}.json"
        if not kept.is_file():
            kept.parent.mkdir(parents=True, exist_ok=True)
            kept.write_text(json.dumps(run_variant(phone, losses, work, lens_blur=not args.no_blur)))
        results[losses.name] = json.loads(kept.read_text())
        print(losses.name, "done", flush=True)
    bound = bounds(phone, SensorModel())
    changed = changes(phone, work, list(results)) if "nothing" in results else {}
    print_tables(results, bound, changed)
    (args.out / "phone.json").write_text(json.dumps({"bound": bound, "results": results, "changes": changed}, indent=1))
    if "everything" in results:
        draw(results, bound, changed, args.out / "phone.png")


if __name__ == "__main__":
    main()
