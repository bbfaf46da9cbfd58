"""Show that a change of the code changed no result: python benchmarks/frozen.py [--keep] [--only PART ...].

``--keep`` writes digests of results to frozen.json; without it they are compared with those, what differs is printed,
and the exit code is 1 if anything does. Keep them before a change and compare after it, on the same machine with the
same libraries: other processors and versions round otherwise. Digests begin SHA-256. No part needs a GPU.

samples     Maps of the package's samples at the three qualities.
simulated   The same of rendered captures through six designs; ``blur`` has known blur, ``halved`` is matched at 1/2.
readable    The same of small captures by the readable stages.
chains      What a GPU would be sent for both: code without comments, dispatches, inputs; plans: the same for browsers.
help        The text of every command's --help; names: public names and their signatures.
"""

from __future__ import annotations

import argparse
import hashlib
import inspect
import json
import os
import re
import struct
import sys
import time
import warnings
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any, get_args
from unittest import mock

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy: accurate's windows are rounded by how many there are

import numpy as np
import typer
from typer.testing import CliRunner

import chromaperture
from chromaperture.app.device_plan import make_plan
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.cli.main import app
from chromaperture.depth.conversion import DepthModel
from chromaperture.depth.field import DepthField
from chromaperture.frame.depth_frame import DepthFrame
from chromaperture.matching.device import accurate_chain, gpu_method
from chromaperture.matching.device.device import Device, Exchange, PlannedChain
from chromaperture.model.camera_file import Calibration
from chromaperture.model.camera_parts import CameraSensor, Film, Lens
from chromaperture.optics.aperture import DESIGNS, aperture_figures, channel_transmission, film_unmixing, made_of
from chromaperture.optics.lens_blur import BlurModel, LensBlur, sample_pupil
from chromaperture.optics.pinhole import PupilCamera, centered_pinhole
from chromaperture.optics.ray_table import pinhole_rays
from chromaperture.optics.simulator import textures
from chromaperture.optics.simulator.render import render
from chromaperture.optics.simulator.scene import plane
from chromaperture.products.samples import open_sample, samples
from chromaperture.settings.methods import Config, Quality
from chromaperture.system.errors import CaptureWarning

KEPT = Path(__file__).parent / "frozen.json"
QUALITIES: tuple[Quality, ...] = ("paper", "real-time", "accurate")
VARIANTS: dict[str, tuple[Quality, int]] = {name: (name, 1) for name in QUALITIES}
VARIANTS |= {"blur": ("accurate", 1), "halved": ("real-time", 2)}
NAMES = ("rgb_circles", "rgb_squares", "cmy_squares", "cmy_circles", "cy_halves", "cy_open")
SIZE, SMALL = (192, 128), (75, 50)  # width and height, px
SENSOR_MM, FOCAL_MM, RADIUS_MM, FOCUS_MM, PUPIL_MM = 12.0, 50.0, 12.5, 2000.0, 50.0
FULL_WELL, READ_NOISE = 10_000.0, 4.0  # electrons
MAPS = ("depth_mm", "sigma_mm", "disparity_px", "disparity_sigma_px", "confidence", "color", "image")
Found = Iterator[tuple[str, str]]


def digest(*parts: Any) -> str:
    """Digest arrays, bytes and whatever has a text; every NaN counts as the same."""
    found = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            if part.dtype.kind == "f":
                part = np.where(np.isnan(part), part.dtype.type(np.nan), part)
            found.update(f"{part.dtype} {part.shape}".encode() + np.ascontiguousarray(part).tobytes())
        else:
            found.update(repr(part).encode())
    return found.hexdigest()[:16]


def maps(title: str, frame: DepthFrame) -> Found:
    yield from ((f"{title} {name}", digest(getattr(frame, name))) for name in MAPS)
    yield f"{title} points", digest(*vars(frame.points()).values())


def of_samples() -> Found:
    for name, quality in product(samples(), QUALITIES):
        camera, image = open_sample(name, quality=quality, device="cpu")
        yield from maps(f"{name} {quality}", camera.measure(image))


@cache
def calibration(design: str, size: tuple[int, int]) -> tuple[Calibration, PupilCamera]:
    """The camera as its optics have it, with its blur and noise, and its lens for the renderer."""
    film, pitch = made_of(DESIGNS[design], "real"), SENSOR_MM / size[0]
    lens = PupilCamera(*size, FOCAL_MM / pitch, RADIUS_MM, FOCUS_MM, PUPIL_MM, pitch)
    blur = BlurModel(float(lens.blur_radius_px(np.inf)), lens.focal_px * RADIUS_MM)
    curve = DepthModel(*LensBlur(blur, sample_pupil(film), *size).reference, PUPIL_MM)
    filters = {part.filter.name: np.asarray(part.filter.transmission, float) for part in film.parts}
    made = Calibration(
        design=design,
        sensor=CameraSensor(*size, pitch, 0.0, 65535.0, full_well_electrons=FULL_WELL, read_noise_electrons=READ_NOISE),
        lens=Lens(FOCAL_MM, centered_pinhole(lens.focal_px, size), np.zeros(5), f_number=2.0),
        film=Film(filters, np.ones(3), np.asarray(channel_transmission(film), float)),
        depth=dict.fromkeys(QUALITIES, DepthField.constant(curve)),
        near_mm=1100.0, far_mm=4200.0, blur=blur,
    )  # fmt: skip
    return made, lens


@cache
def capture(design: str, size: tuple[int, int]) -> np.ndarray:
    """A noisy photograph of two cards before a wall, with clipped pixels and unknown ones; (H, W, 3)."""
    planes = []
    for seed, (x, z, width, tilt) in enumerate([(0, 3500, 1600, 0), (-150, 2100, 300, 35), (120, 1400, 150, 0)]):
        color = 0.3 + 0.7 * np.random.default_rng(seed).random(3)
        texture = textures.noise((300, 400), exponent=1.0, seed=seed)[..., None] * color.astype(np.float32)
        planes.append(plane(texture, center_mm=(x, 0, z), width_mm=width, tilt_deg=(tilt, 0, 0)))
    light = render(pinhole_rays(calibration(design, size)[1], made_of(DESIGNS[design], "real"), cells=12), planes)
    light = 0.9 * light / light.max()
    variance = light / FULL_WELL + (READ_NOISE / FULL_WELL) ** 2
    image = light + np.sqrt(variance) * np.random.default_rng(7).normal(size=light.shape)
    image[10:14, 20:26], image[30:32, 60:63] = 1.0, np.nan
    return np.clip(image, 0, 1).astype(np.float32)


def camera_of(design: str, size: tuple[int, int], variant: str) -> tuple[Calibration, Config]:
    made, _ = calibration(design, size)
    quality, scale = VARIANTS[variant]
    if variant != "blur":
        unknown = replace(made.sensor, full_well_electrons=None, read_noise_electrons=None)
        reach = aperture_figures(made.aperture, film_unmixing(made.aperture)).beta
        curve = DepthModel(reach * made.blur.infinity_px, reach * made.blur.scale_px_mm, PUPIL_MM)
        depth = dict.fromkeys(QUALITIES, DepthField.constant(curve))
        made = replace(made, blur=None, sensor=unknown, depth=depth)
    return made, default_config(made, quality, scale=scale)


def of_simulated(size: tuple[int, int] = SIZE, **execution: Any) -> Found:
    for design in NAMES:
        yield f"{design} photograph", digest(capture(design, size))
        for variant in VARIANTS:
            frame = CodedApertureCamera(*camera_of(design, size, variant), **execution).measure(capture(design, size))
            yield from maps(f"{design} {variant}", frame)


def code(source: str) -> str:
    """A shader without its comments and empty lines."""
    bare = re.sub(r"//[^\n]*|/\*.*?\*/", "", source, flags=re.DOTALL)
    return "\n".join(" ".join(line.split()) for line in bare.splitlines() if line.strip())


class RecordedChain(PlannedChain):
    """A chain that keeps digests of what it would have sent; arrays have numbers for names."""

    sent: dict[str, str]

    def __init__(self, device: Device) -> None:
        super().__init__("quad" if device.subgroups else "shared")

    def start(self, inputs: Mapping[str, np.ndarray], outputs: Sequence[str]) -> Any:
        number = {name: i for i, name in enumerate(self.arrays)}
        called = [(d.groups, [number[a.name] for a in d.arrays]) for d in self.dispatches]
        values = {number[name]: value for name, value in (self.values | dict(inputs)).items()}
        RecordedChain.sent = {
            "code": digest([code(d.source) for d in self.dispatches]),
            "dispatches": digest(called, [a[2:4] for a in self.arrays.values()], [number[name] for name in outputs]),
            "inputs": digest(*(part for i in sorted(values) for part in (i, values[i]))),
        }


def of_chains() -> Found:
    """Large pictures for a device with subgroups, small ones for one without."""
    for size, device in ((SIZE, PlannedChain("quad").device), (SMALL, PlannedChain("shared").device)):
        with (
            mock.patch.multiple(gpu_method, open_device=lambda _, d=device: d, Chain=RecordedChain),
            mock.patch.object(accurate_chain, "Chain", RecordedChain),
        ):
            for design, variant in product(NAMES, VARIANTS):
                camera = CodedApertureCamera(*camera_of(design, size, variant), device="gpu")
                camera.submit(capture(design, size))
                name = f"{size[0]}x{size[1]} {design} {variant}"
                yield from ((f"{name} {key}", value) for key, value in RecordedChain.sent.items())


def of_plans() -> Found:
    for design, exchange in product(NAMES, get_args(Exchange)):
        message = make_plan(CodedApertureCamera(*camera_of(design, SIZE, "real-time")), exchange, {})
        start = 4 + struct.unpack("<I", message[:4])[0]
        text = json.loads(zlib.decompress(message[4:start]))
        text |= {"sources": [code(source) for source in text["sources"]], "notes": None, "checks": None}
        text["measure"], text["draw"] = ([s | {"stage": ""} for s in text[key]] for key in ("measure", "draw"))
        yield f"{design} {exchange}", digest(json.dumps(text, sort_keys=True), message[start:])


def of_help() -> Found:
    def below(command: Any, path: list[str]) -> Iterator[list[str]]:
        yield path
        for name, child in getattr(command, "commands", {}).items():
            yield from below(child, [*path, name])

    wide = {"COLUMNS": "120", "TERMINAL_WIDTH": "120", "NO_COLOR": "1", "TERM": "dumb"}
    for path in below(typer.main.get_command(app), []):
        said = CliRunner().invoke(app, [*path, "--help"], env=wide, prog_name="chromaperture")
        yield " ".join(["chromaperture", *path]), digest(said.exit_code, said.output)


def of_names() -> Found:
    def signature(thing: Any) -> str:
        plain = isinstance(thing, type) and issubclass(thing, Exception)  # has no signature of its own
        text = str(inspect.signature(thing)) if callable(thing) and not plain else type(thing).__name__
        return re.sub(r"\bchromaperture\.(?:\w+\.)*| at 0x\w+", "", text)

    for name in chromaperture.__all__:
        thing = getattr(chromaperture, name)
        yield name, ", ".join(thing) if isinstance(thing, Mapping) else signature(thing)
        if inspect.isclass(thing):
            members = sorted(name for name in set(dir(thing)) - set(dir(Exception)) if not name.startswith("_"))
            yield from ((f"{name}.{member}", signature(getattr(thing, member))) for member in members)


PARTS: dict[str, Callable[[], Found]] = {
    "samples": of_samples, "simulated": of_simulated, "readable": partial(of_simulated, SMALL, execution="numpy"),
    "chains": of_chains, "plans": of_plans, "help": of_help, "names": of_names,
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", action="store_true", help="write what is found as what to compare with")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART")
    args = parser.parse_args()
    warnings.simplefilter("ignore", CaptureWarning)
    kept: dict[str, dict[str, str]] = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    differing = 0
    for part in args.only:
        begun = time.perf_counter()
        found, before = dict(PARTS[part]()), kept.get(part, {})
        if args.keep:
            kept[part] = before = found
        for name in (name for name in before | found if found.get(name) != before.get(name)):
            differing += 1
            print(f"{part}: {name}: was {before.get(name, 'not there')}, is {found.get(name, 'not there')}")
        print(f"{part}: {len(found)} in {time.perf_counter() - begun:.0f} s", flush=True)
    if args.keep:
        KEPT.write_text(json.dumps(kept, indent=1) + "\n")
    print(f"{differing} differ" if differing else "nothing differs")
    sys.exit(int(differing > 0))


if __name__ == "__main__":
    main()
