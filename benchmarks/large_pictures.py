"""Photographs of 24 megapixels beside the same scenes in 720 x 480, and sessions of them.

    python benchmarks/large_pictures.py scenes --out DIR [--scenes 0 1 2] [--scales auto 1/4]
    python benchmarks/large_pictures.py calibration SESSION --out DIR

``scenes``: accuracy against the truth of six textured surfaces at 1169 to 3690 mm behind a simulated 50 mm f/2 lens
(`layer_renderer.py`); smaller sensors see the same light. ``calibration``: a session, enlarged by cubics. Both
give peak memory and processor time of the program in a process of its own.
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import tifffile
from bench50 import score
from numpy.polynomial import chebyshev
from timing import used_by_program

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.depth.conversion import DepthModel
from chromaperture.depth.field import DepthField
from chromaperture.depth.nonlinearity import Nonlinearity
from chromaperture.model.camera_file import Calibration
from chromaperture.model.camera_parts import CameraSensor, Film, Lens
from chromaperture.model.scale import reduced_size, resized, working_scale
from chromaperture.optics.aperture import DESIGNS, channel_transmission, made_of
from chromaperture.optics.lens_blur import BlurModel, LensBlur, sample_pupil
from chromaperture.optics.pinhole import PupilCamera, centered_pinhole
from chromaperture.optics.simulator.layer_renderer import render_layers
from chromaperture.optics.simulator.textures import noise
from chromaperture.system.threads import parallel_map

SMALL, LARGE = (720, 480), (6000, 4000)
SENSOR_MM, FOCAL_MM, PUPIL_MM, FOCUS_MM = 22.3, 52.0, 51.0, 2000.0  # the bench50 camera's, rounded
NEAR_MM, FAR_MM = 950.0, 4200.0
FULL_WELL, READ_NOISE = 20_000.0, 3.0  # electrons, of a pixel of the large sensor
DESIGN = "cy_halves"
WALLS_MM = tuple(1 / np.linspace(1 / 980, 1 / 4000, 14))
LAYER_PX = 1.0  # of blur in 720 x 480 pixels, the distance of the renderer's layers
# Surfaces, far to near, at 3690, 2753, 2200, 1695, 1382 and 1169 mm: blur in whole layers, because a surface between
# two would be rendered as a mixture of both; left, top, right, bottom as fractions of the frame; colour.
SURFACES = (
    (5, (0.0, 0.0, 1.0, 1.0), (0.80, 0.85, 0.90)),
    (3, (0.55, 0.08, 0.97, 0.55), (0.90, 0.80, 0.65)),
    (1, (0.05, 0.10, 0.35, 0.75), (0.75, 0.90, 0.75)),
    (-2, (0.30, 0.45, 0.62, 0.95), (0.90, 0.75, 0.80)),
    (-5, (0.66, 0.50, 0.90, 1.0), (0.85, 0.85, 0.70)),
    (-8, (0.10, 0.65, 0.27, 1.0), (0.80, 0.80, 0.90)),
)


def pupil_camera(size: tuple[int, int]) -> PupilCamera:
    pitch = SENSOR_MM / size[0]
    return PupilCamera(*size, FOCAL_MM / pitch, 12.5, FOCUS_MM, PUPIL_MM, pitch)


def depth_of_blur(blur_px: float) -> float:
    """Distance from the sensor, mm, whose blur has a radius of so many of the 720 x 480 pixels, + beyond focus."""
    camera = pupil_camera(SMALL)
    at_infinity = float(camera.blur_radius_px(np.inf))
    return PUPIL_MM + camera.focal_px * camera.pupil_radius_mm / (at_infinity - blur_px)


def aperture():
    return made_of(DESIGNS[DESIGN], "real")


def calibration(size: tuple[int, int]) -> Calibration:
    """The camera as its optics have it: no bias of a matcher."""
    camera, film = pupil_camera(size), aperture()
    at_infinity = float(camera.blur_radius_px(np.inf))
    blur = BlurModel(at_infinity, camera.focal_px * camera.pupil_radius_mm)
    a, b = LensBlur(blur, sample_pupil(film), *size).reference
    white = channel_transmission(film)
    wells = (LARGE[0] / size[0]) ** 2
    filters = {part.filter.name: np.asarray(part.filter.transmission, float) for part in film.parts}
    curve = DepthField.constant(DepthModel(a, b, PUPIL_MM))
    return Calibration(
        design=DESIGN,
        sensor=CameraSensor(*size, camera.pixel_pitch_mm, 0.0, 65535.0, FULL_WELL * wells, READ_NOISE * wells**0.5),
        lens=Lens(50.0, centered_pinhole(camera.focal_px, size), np.zeros(5), f_number=2.0),
        film=Film(filters, np.ones(3), np.asarray(white, float)),
        depth=dict.fromkeys(("paper", "real-time", "accurate"), curve),
        near_mm=NEAR_MM,
        far_mm=FAR_MM,
        provenance={"note": "simulated"},
        blur=blur,
    )


def exposed(light: np.ndarray, sensor: CameraSensor, seed: int) -> np.ndarray:
    """Photon and read noise, in float32: the counts are many."""
    variance = light / sensor.full_well_electrons + (sensor.read_noise_electrons / sensor.full_well_electrons) ** 2
    draw = np.random.default_rng(seed).standard_normal(light.shape, dtype=np.float32)
    draw *= np.sqrt(variance, dtype=np.float32)
    draw += light
    return np.clip(draw, 0, 1, out=draw)


def with_curves(camera: Calibration) -> Calibration:
    """Fit the curves of the shift matchers, in a camera's pixels, to flat walls in the frame's middle."""
    size = (camera.sensor.width_px, camera.sensor.height_px)
    axis = camera.on_axis("accurate")
    linear = axis.infinity_disparity_px - axis.scale_px_mm / (np.array(WALLS_MM) - PUPIL_MM)
    texture = noise(size[::-1], exponent=1.0, seed=9)
    found = []
    config = default_config(camera, "real-time", scale=1)
    wide = replace(config, matcher=config.matcher.with_range(1.5 * linear.min(), 1.5 * linear.max()))
    method = CodedApertureCamera(camera, wide).method
    for i, z in enumerate(WALLS_MM):
        color = np.repeat(texture[..., None], 3, axis=2)
        wall = render_layers(color, np.full(texture.shape, z), camera=pupil_camera(size), aperture=aperture())
        found.append(float(np.nanmedian(method.match(exposed(wall.image, camera.sensor, i)).value_px)))
    low, high = linear.min() - 0.5, linear.max() + 0.5
    u = (2 * linear - low - high) / (high - low)
    # Measured disparities of channels are those of the centroids times a factor, for film leaks; then T2 to T5.
    terms = np.stack([np.ones_like(linear), linear, *chebyshev.chebvander(u, 5).T[2:]], axis=1)
    shift, factor, *bend = np.linalg.lstsq(terms, np.array(found), rcond=None)[0]
    off = np.abs(terms @ [shift, factor, *bend] - found).max()
    print(f"real-time on flat walls: {factor:.3f} of the centroids' disparity, residual <= {off:.3f} px", flush=True)
    low_px, high_px = sorted((shift + factor * low, shift + factor * high))
    model = DepthModel(
        shift + factor * axis.infinity_disparity_px, factor * axis.scale_px_mm, PUPIL_MM,
        nonlinearity=Nonlinearity(low_px, high_px, np.array(bend)),
    )  # fmt: skip
    return replace(camera, depth=dict(camera.depth) | {"real-time": DepthField.constant(model)})


def surfaces(number: int) -> tuple:
    """Return the surfaces of a scene, far to near: `SURFACES`, for others than scene 0 moved, at other distances."""
    if number == 0:
        return SURFACES
    rng = np.random.default_rng(number)
    wall, *others = SURFACES
    layers = sorted(rng.choice(np.arange(-8, 5), len(others), replace=False), reverse=True)
    moved = []
    for layer, (_, (left, top, right, bottom), tint) in zip(layers, others, strict=True):
        x, y = rng.uniform(-0.05, 0.05, 2)
        moved.append((int(layer), (left + x, max(top + y, 0.0), right + x, min(bottom + y, 1.0)), tint))
    return (wall, *moved)


def scene(size: tuple[int, int], number: int) -> tuple[np.ndarray, np.ndarray]:
    """Colours and depth of a scene, (h, w, 3) and (h, w)."""
    width, height = size
    grey = noise((height, width), exponent=1.0, seed=4 + 100 * number, mean=0.42, contrast=0.16)
    color, depth = np.empty((height, width, 3), np.float32), np.empty((height, width), np.float32)
    for i, (layer, (left, top, right, bottom), tint) in enumerate(surfaces(number)):
        place = np.s_[round(top * height) : round(bottom * height), round(left * width) : round(right * width)]
        turned = np.roll(grey, (i * height // 7, i * width // 5), axis=(0, 1))[place]
        color[place] = turned[..., None] * np.asarray(tint, np.float32)
        depth[place] = depth_of_blur(LAYER_PX * layer)
    return color, depth


def light_and_truth(folder: Path, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Render a scene once: a minute on two cores, 8 GB."""
    folder.mkdir(parents=True, exist_ok=True)
    stored = folder / "light.npy"
    if not stored.exists():
        color, depth = scene(LARGE, number)
        pitch = LAYER_PX * LARGE[0] / SMALL[0]
        image = render_layers(color, depth, camera=pupil_camera(LARGE), aperture=aperture(), pitch_px=pitch).image
        np.save(stored, 0.85 * image / np.percentile(image[::8, ::8], 99.9))
        np.save(folder / "truth.npy", depth)
    return np.load(stored), np.load(folder / "truth.npy")


def photograph(folder: Path, light: np.ndarray, size: tuple[int, int], camera: Calibration) -> tuple[Path, Path]:
    """Write the photograph of a sensor and its camera file."""
    name = f"{size[0]}x{size[1]}"
    picture, file = folder / f"{name}.png", folder / f"{name}.asdf"
    resized(camera, *size).save(file)
    seen = light if size == LARGE else cv2.resize(light, size, interpolation=cv2.INTER_AREA)
    counts = np.rint(exposed(seen, resized(camera, *size).sensor, 1) * 65535).astype(np.uint16)
    cv2.imwrite(str(picture), counts[..., ::-1])
    return picture, file


def measure(picture: Path, camera: Path, quality: str, scale: str, out: Path) -> dict:
    """Run ``chromaperture depth`` in a process of its own."""
    options = "--camera", camera, "--quality", quality, "--scale", scale, "--out", out, "-q"
    used = used_by_program("depth", picture, *options)
    summary = json.loads((out / f"{picture.stem}.json").read_text())
    return used | {"stages_s": summary["seconds"], "scale": summary["config"]["scale"]}


def scenes(args: argparse.Namespace) -> None:
    """Measure scenes by all sizes; others than scene 0 have other textures, places and distances."""
    rows = []
    sizes = [tuple(int(part) for part in text.split("x")) for text in args.sizes]
    cameras = [with_curves(calibration(reduced_size(size, working_scale(calibration(size))))) for size in sizes]
    for number in args.scenes:
        folder = args.out / f"scene{number}"
        light, truth = light_and_truth(folder, number)
        for size, camera in zip(sizes, cameras, strict=True):
            files = photograph(folder, light, size, camera)
            for quality in args.quality:
                for scale in args.scales if size == LARGE else ["auto"]:
                    stem = files[0].stem
                    results = folder / f"{stem}.{quality}"
                    row = {"scene": number, "size": stem, "quality": quality} | measure(*files, quality, scale, results)
                    depth, sigma = (tifffile.imread(results / f"{stem}.{name}.tiff") for name in ("depth", "sigma"))
                    there = cv2.resize(truth, depth.shape[::-1], interpolation=cv2.INTER_NEAREST)
                    rows.append(row | score(depth, sigma, there))
                    print(json.dumps(rows[-1]), flush=True)
    compare(rows)
    (args.out / "rows.json").write_text(json.dumps(rows, indent=1))


def compare(rows: list[dict]) -> None:
    """Print the mean shares of each size, and of the last less the first with its standard error over scenes."""
    sizes = list(dict.fromkeys(row["size"] for row in rows))
    for quality in dict.fromkeys(row["quality"] for row in rows):
        for share in ("within_1_percent", "within_2_percent", "within_5_percent"):
            of = {size: [r[share] for r in rows if (r["size"], r["quality"]) == (size, quality)] for size in sizes}
            text = ", ".join(f"{size} {np.mean(values):.3f}" for size, values in of.items())
            more = np.subtract(of[sizes[-1]], of[sizes[0]]) if len({len(v) for v in of.values()}) == 1 else np.empty(0)
            if len(more) > 1:
                text += f"; difference {more.mean():+.4f} +- {more.std(ddof=1) / len(more) ** 0.5:.4f}"
            print(f"{quality}, {share}, mean of {len(of[sizes[0]])}: {text}", flush=True)


def enlarged(session: Path, out: Path, size_px: tuple[int, int]) -> Path:
    """Write the session with photographs of another size, without more noise; those that are there are kept."""
    target = out / session.name
    photographs = [path for folder in (session, session.parent / "white") for path in sorted(folder.rglob("*.png"))]
    photographs = [path for path in photographs if "scene" not in path.parts and "walk" not in path.parts]
    old = cv2.imread(str(photographs[0]), cv2.IMREAD_UNCHANGED).shape[1]

    def enlarge(path: Path) -> None:
        written = out / path.relative_to(session.parent)
        if written.exists():
            return
        written.parent.mkdir(parents=True, exist_ok=True)
        counts = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(written), cv2.resize(counts, size_px, interpolation=cv2.INTER_CUBIC))

    parallel_map(enlarge, photographs)
    for file in session.glob("*.csv"):
        shutil.copy(file, target)
    lines = (session / "session.toml").read_text().splitlines()
    numbers = {"width_px": size_px[0], "height_px": size_px[1]}
    for i, line in enumerate(lines):
        name, _, value = line.partition("=")
        if name.strip() in numbers:
            lines[i] = f"{name}= {numbers[name.strip()]}"
        if name.strip() == "pixel_pitch_mm":
            lines[i] = f"{name}= {float(value.split('#')[0]) * old / size_px[0]:.8f}"
    (target / "session.toml").write_text("\n".join(lines) + "\n")
    return target


def calibrate(args: argparse.Namespace) -> None:
    """Calibrate from a session whose photographs are enlarged."""
    session = enlarged(args.session, args.out, tuple(int(side) for side in args.size.split("x")))
    began = time.perf_counter()
    options = ["--out", args.out / "camera.asdf", "--json"] + ["--no-blur"] * args.no_blur
    used = used_by_program("calibrate", session, *options)
    boards = len(list((session / "board").glob("*.png")))
    print(json.dumps({"boards": boards, "minutes": (time.perf_counter() - began) / 60} | used, indent=2))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    one = commands.add_parser("scenes")
    one.add_argument("--quality", nargs="+", default=["real-time", "accurate"])
    one.add_argument("--scales", nargs="+", default=["auto"], help="of the large picture, such as auto 1/4 1/12")
    one.add_argument("--sizes", nargs="+", default=["720x480", "6000x4000"])
    one.add_argument("--scenes", nargs="+", type=int, default=[0])
    one.set_defaults(run=scenes)
    other = commands.add_parser("calibration")
    other.add_argument("session", type=Path)
    other.add_argument("--size", default="6000x4000")
    other.add_argument("--no-blur", action="store_true")
    other.set_defaults(run=calibrate)
    for each in (one, other):
        each.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    args.run(args)


if __name__ == "__main__":
    main()
