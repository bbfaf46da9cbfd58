"""A simulated phone, from light to depth, against known distances: python benchmarks/simulated_phone.py --out FOLDER

The 4 mm lens, film 0.5 mm before its stop, light ray by ray, then noise, the curve of BT.709, 4:2:0 and 8 bits. The
session passes the assistant's checks and its job; leaning planes are measured as the page does, beside the Cramer-Rao
bound. Half an hour of processor time, ``--small`` two minutes.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from video_signal import VideoSignal, drawn_smaller, video_frame

from chromaperture.app.assistant import check_shot, sheets_of
from chromaperture.app.assistant_routes import CalibrationJob
from chromaperture.app.messages import collect_warnings
from chromaperture.app.session_folder import SessionFolder
from chromaperture.app.state import AppState
from chromaperture.optics.aperture import DESIGNS, OPAQUE, Aperture, Disc, SubAperture, channel_transmission, made_of
from chromaperture.optics.depth_error_bound import Texture, expected_accuracy
from chromaperture.optics.pinhole import PupilCamera, focused_at, pupil_camera
from chromaperture.optics.prescription import load_lens, with_filter_at
from chromaperture.optics.ray_table import RayTable, lens_rays
from chromaperture.optics.simulator import textures
from chromaperture.optics.simulator.render import render, render_depth
from chromaperture.optics.simulator.scene import plane
from chromaperture.optics.simulator.sensor import SensorModel
from chromaperture.optics.simulator.session import wall
from chromaperture.system.robust import MAD_TO_SIGMA

QUALITIES = ("real-time", "accurate")
WHITE = 0.9  # of full scale, of the brightest paper
RULER_MM = 0.3  # largest error of a distance: a caliper's, at these distances
SENSOR = SensorModel()
SIGNAL = VideoSignal(SENSOR, "bt709", "4:2:0", 8)


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


def true_mm(phone: Phone, ruler_mm: float) -> float:
    """Where the board of a ruler's reading stands."""
    rng = np.random.default_rng((phone.seed, int(ruler_mm)))
    return ruler_mm + float(rng.uniform(-RULER_MM, RULER_MM))


class Shutter:
    """Photographs of the phone and the true depth of its planes."""

    def __init__(self, phone: Phone) -> None:
        self.phone = phone
        self.aperture = made_of(DESIGNS[phone.design], "real")
        self.table = cache(self._table)
        self.exposures = [WHITE / float(self.light(f"white/{name}").max()) for name in ("open", phone.design)]

    def take(self, name: str) -> np.ndarray:
        """Picture as the page sends it, drawn at half the size of the video; (H / 2, W / 2, 3) uint8."""
        exposure = self.exposures[0 if name.startswith("white/") else 1]
        seed = sum(name.encode()) * 1009 + self.phone.seed
        video = video_frame(self.light(name), SIGNAL, seed=seed, exposure=exposure)
        return np.rint(255 * drawn_smaller(video, SIGNAL)).astype(np.uint8)

    def depth_mm(self, name: str) -> np.ndarray:
        """True distances of 2 x 2 pixels; (H / 2, W / 2) float."""
        depth = render_depth(self.table(self.phone.design), self._scene(*name.split("/")))
        h, w = depth.shape
        return depth.reshape(h // 2, 2, w // 2, 2).mean(axis=(1, 3))

    def light(self, name: str) -> np.ndarray:
        """Light of a photograph, "white/SHEET", "board/MM", "tilt/N" or "plane/MM"; (H, W, 3) float32."""
        kind, rest = name.split("/")
        return render(self.table(rest if kind == "white" else self.phone.design), self._scene(kind, rest))

    def _table(self, film: str) -> RayTable:
        phone = self.phone
        lens = with_filter_at(focused_at(load_lens(phone.lens), phone.focus_mm), phone.film_offset_mm)
        size = {"width_px": phone.width_px, "height_px": phone.height_px}
        pitch = phone.sensor_width_mm / phone.width_px
        return lens_rays(lens, self._film(film), pixel_pitch_mm=pitch, cells=phone.cells, **size)

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


def fill_session(shutter: Shutter, folder: Path, scratch: Path) -> tuple[SessionFolder, list[str]]:
    """Fill a session by the assistant's checks; returns it and what they warned of."""
    phone, camera = shutter.phone, shutter.phone.camera()
    facts = {
        "design": phone.design, "focal_length_mm": round(camera.image_distance_mm, 1),
        "f_number": round(camera.f_number, 1), "focus_mm": phone.focus_mm, "sensor_width_mm": phone.sensor_width_mm,
        "nearest_mm": min(phone.boards_mm), "farthest_mm": max(phone.boards_mm), "square_mm": phone.square_mm,
    }  # fmt: skip
    session, warned = SessionFolder.create(folder, facts), []
    path = scratch / "shot.png"

    def put(name: str, kind: Any, **options: Any) -> None:
        cv2.imwrite(str(path), shutter.take(name)[..., ::-1])
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


def run_phone(phone: Phone, folder: Path, *, lens_blur: bool = True) -> dict[str, Any]:
    """Calibrate in a new folder by the assistant, and measure the planes; one row a distance and quality."""
    shutter = Shutter(phone)
    bench = AppState(folder, reserve_bytes=0)
    session_folder, camera = folder / "sessions" / "phone", folder / "cameras" / "phone.asdf"
    with collect_warnings():
        _, warned = fill_session(shutter, session_folder, folder)
        job = CalibrationJob(session_folder, camera, folder / "report.html", lens_blur=lens_blur)
        job.start()
        job.wait()
    if job.error:
        raise SystemExit(job.error)
    return {"warned": warned, "result": job.result, "rows": list(measured(shutter, bench))}


def measured(shutter: Shutter, bench: AppState) -> Iterator[dict[str, Any]]:
    """Measure the planes by the function that answers the page."""
    for at in shutter.phone.planes_mm:
        picture, truth = shutter.take(f"plane/{at:g}"), shutter.depth_mm(f"plane/{at:g}")
        for quality in QUALITIES:
            size = picture.shape[1], picture.shape[0]
            frame = bench.measure_pixels(picture.tobytes(), size, camera="phone", quality=quality)[0]
            yield {"distance_mm": at, "quality": quality} | errors(frame.depth_mm, frame.sigma_mm, truth)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="a folder that does not exist")
    parser.add_argument("--small", action="store_true", help="a quarter of the pixels, fewer photographs and rays")
    parser.add_argument("--no-blur", action="store_true", help="calibrate without the lens's blur")
    args = parser.parse_args()
    args.out.mkdir(parents=True)
    phone = SMALL if args.small else Phone()
    found = run_phone(phone, args.out, lens_blur=not args.no_blur)
    (args.out / "phone.json").write_text(json.dumps(found, indent=1))
    limits = bounds(phone, SENSOR)
    print("warned:", *found["warned"])
    for row in found["rows"]:
        figures = "  ".join(f"{k} {v:.4f}" for k, v in row.items() if k not in ("distance_mm", "quality"))
        print(f"{row['distance_mm']:6g} mm  {row['quality']:9}  bound {limits[row['distance_mm']]:.4f}  {figures}")


if __name__ == "__main__":
    main()
