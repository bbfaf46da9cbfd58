"""The worlds of the tests: pictures of known depth, and the calibrations of the cameras that took them."""

from __future__ import annotations

import math
import shutil
import struct
import tomllib
import zlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import scipy.fft
import tifffile
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

from chromaperture.calibration.curves import Evidence
from chromaperture.calibration.place_boards import BoardDistances
from chromaperture.color.unmixing import own_film_unmixing, view_directions
from chromaperture.depth.field import DepthField
from chromaperture.matching.estimate import estimate_disparity
from chromaperture.matching.views import ViewSpace, view_spaces
from chromaperture.model.camera_file import Calibration
from chromaperture.model.camera_parts import CameraSensor, Film, Lens
from chromaperture.optics.aperture import DESIGNS, made_of
from chromaperture.optics.lens_blur import BlurModel, LensBlur, sample_pupil
from chromaperture.optics.pinhole import PupilCamera, centered_pinhole
from chromaperture.optics.ray_table import RayTable, pinhole_rays
from chromaperture.optics.simulator.scene import Plane, plane
from chromaperture.optics.simulator.sensor import SensorModel
from chromaperture.optics.simulator.session import SessionPlan, write_session
from chromaperture.optics.simulator.textures import noise
from chromaperture.settings.methods import PaperConfig
from chromaperture.settings.stages import BilateralConfig, CorrelationConfig, LayersConfig
from chromaperture_paper.sweep import Trial

# ---- textured planes, displaced view by view as the aperture would displace them

ALL_DESIGNS = ("rgb_circles", "rgb_squares", "cmy_squares", "cmy_circles", "cy_halves", "cy_open")
SIN60 = np.sqrt(3) / 2
# Which way an object beyond focus moves in the view of each film, x right, y down: towards the film.
LAYOUT = {
    "cy_halves": {"cyan": (-1, 0), "yellow": (1, 0)},
    "rgb_squares": {"red": (1, 0), "green": (0, -1), "blue": (-1, 0)},
    "cmy_circles": {"cyan": (0, -1), "magenta": (-SIN60, 0.5), "yellow": (SIN60, 0.5)},
}
MARGIN_PX = 16  # the Fourier shift wraps round, the matcher replicates
# The paper's method with everything that known noise and pure channels gain; these pictures are ideal.
NARROW = PaperConfig(
    layers=LayersConfig(min_px=-4.0, max_px=4.0),
    space="pure",
    correlation=CorrelationConfig(noise_debiasing=True),
    bilateral=BilateralConfig(texture_weighting=True),
    sigma_scale=1.0,
    edge_share=0.0,
    floor_px=0.0,
    hue_share=0.0,
)


def texture(rng, height=80, width=96, blur_px=1.5):
    """Periodic Gaussian texture around 0.5, band-limited by a Gaussian; (H, W)."""
    fy, fx = np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width)
    spectrum = np.fft.fft2(rng.normal(size=(height, width))) * np.exp(-2 * (np.pi * blur_px) ** 2 * (fx**2 + fy**2))
    field = np.fft.ifft2(spectrum).real
    return 0.5 + 0.09 * field / field.std()


def moved(picture, dx, dy):
    """The picture displaced by (dx, dy) px, exactly, for a periodic band-limited one."""
    fy, fx = np.fft.fftfreq(picture.shape[0])[:, None], np.fft.fftfreq(picture.shape[1])
    return np.fft.ifft2(np.fft.fft2(picture) * np.exp(-2j * np.pi * (fx * dx + fy * dy))).real


def capture(picture, design, disparity_px, film=None):
    """Photograph of a grey plane: every film, ideal unless given, adds its colour times its displaced view."""
    film = film or ideal_film(design)
    image = np.zeros((*picture.shape, 3))
    for name, (ux, uy) in LAYOUT[design].items():
        image += moved(picture, disparity_px * ux, disparity_px * uy)[..., None] * film[name]
    return (0.9 * image / image.max()).astype(np.float32)


def ideal_film(design):
    return {name: np.array(DESIGNS[design].filter_named(name).transmission) for name in LAYOUT[design]}


def measured(image, design, config=NARROW, noise=0.0):
    variance = np.full(image.shape, noise**2, np.float32)
    found = estimate_disparity(image, aperture=design, config=config, noise_variance=variance, execution="numpy")
    inner = (slice(MARGIN_PX, -MARGIN_PX), slice(MARGIN_PX, -MARGIN_PX))
    return found.value_px[inner], found.sigma_px[inner]


def space_of(design: str) -> ViewSpace:
    """The unmixed views of a design in ideal film."""
    return view_spaces(DESIGNS[design], None, "unmixed")[0]


def wavy_capture(
    design: str, *, shape: tuple[int, int] = (61, 83), seed: int = 7, saturated: bool = True
) -> np.ndarray:
    """A noisy capture of a wavy surface with a step, an even area and a saturated one; (H, W, 3) float32."""
    rng = np.random.default_rng(seed)
    height, width = shape
    margin = 16
    big = (height + 2 * margin, width + 2 * margin)
    texture = sum(cv2.GaussianBlur(rng.normal(size=big).astype(np.float32), (0, 0), s) * s for s in (1.2, 4.0))
    texture = 0.5 + 0.12 * texture / texture.std()
    y, x = np.mgrid[:height, :width].astype(np.float32)
    disparity = 2.5 * np.sin(x / 17) * np.cos(y / 13)
    disparity[height // 3 : height // 2, width // 4 : width // 2] -= 1.5
    aperture = DESIGNS[design]
    x, y = x + margin, y + margin
    views = [
        cv2.remap(texture, x - disparity * np.float32(u), y - disparity * np.float32(v), cv2.INTER_CUBIC)
        for u, v in view_directions(aperture)
    ]
    image = np.stack(views, axis=-1) @ np.linalg.pinv(own_film_unmixing(aperture)).T
    image = image * (0.8 / image.max()) + rng.normal(0, 0.006, image.shape)
    image[-20:, -25:] = 0.3  # an even area without even noise
    if saturated:
        image[5:15, 40:50] = 1.0
    return image.astype(np.float32)


@st.composite
def hostile_images(draw):
    """Noise of any size from 1 x 2 px, with unknown and saturated pixels; (H, W, 3) float32."""
    shape = draw(st.tuples(st.integers(1, 40), st.integers(1, 40)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    image = rng.uniform(0, 0.9, (*shape, 3)).astype(np.float32)
    for value in (1.0, np.nan, np.inf):
        image[rng.random(shape) < draw(st.sampled_from([0.0, 0.1]))] = value
    return image


def spectral_example(rng, windows=7, layers=4, frequencies=20):
    """Windows of random channels, and powers that mix three random transfer functions a frequency."""
    h = rng.standard_normal((2, layers, 3, frequencies, 3)) + 1j * rng.standard_normal((2, layers, 3, frequencies, 3))
    g = np.einsum("klafi,klbfi->klfabi", h, h.conj()).mean(axis=-1)
    parts = [g[..., k, k].real for k in range(3)]
    for i, j in ((0, 1), (0, 2), (1, 2)):
        parts += [g[..., i, j].real, g[..., i, j].imag]
    powers = np.stack(parts, axis=2).astype(np.float32)
    mix = rng.standard_normal((3, 3))
    y = rng.standard_normal((windows, 3, frequencies)) + 1j * rng.standard_normal((windows, 3, frequencies))
    spectra = np.einsum("ij,mjf->mif", mix, y).astype(np.complex64)
    return spectra, powers, np.arange(windows) % 2, np.full((windows, 3), 0.1, np.float32)


def at_block_middles(volume, shape, spacing_px):
    """A volume of samples so far apart at the middles of a picture's blocks, linearly; the last sample holds beyond."""
    places = [(4 * np.arange(n // 4) + 1.5) / spacing_px for n in shape]
    grid = np.meshgrid(*places, np.arange(volume.shape[2]), indexing="ij")
    return map_coordinates(np.asarray(volume, float), grid, order=1, mode="nearest")


# ---- cameras of cyan and yellow halves


def halves_camera(depth, width_px, height_px, /, *, focal_px=1000.0, pixel_pitch_mm=0.05, **changes):
    """A calibration of ideal film with one depth curve, a DepthModel or a DepthField, for all qualities."""
    field = depth if isinstance(depth, DepthField) else DepthField.constant(depth)
    camera = Calibration(
        design="cy_halves",
        sensor=CameraSensor(width_px, height_px, pixel_pitch_mm, 0.0, 65535.0),
        lens=Lens(50.0, centered_pinhole(focal_px, (width_px, height_px)), np.zeros(5), f_number=2.0),
        film=Film(ideal_film("cy_halves"), np.ones(3), np.ones(3)),
        depth=dict.fromkeys(("paper", "real-time", "accurate"), field),
        near_mm=900.0,
        far_mm=4200.0,
    )
    return replace(camera, **changes)


# ---- boards blurred by a known lens


def lens_blur(model: BlurModel, width_px: int, height_px: int, design: str = "cy_halves") -> LensBlur:
    return LensBlur(model, sample_pupil(DESIGNS[design]), width_px, height_px)


def blurred(pattern: np.ndarray, blur: LensBlur, inverse_mm: float) -> np.ndarray:
    """A periodic grey pattern with the blur of the frame's middle everywhere, by one convolution; (H, W, 3) float32."""
    transfer = blur.transfer((blur.width_px - 1) / 2, (blur.height_px - 1) / 2, inverse_mm, len(pattern))
    image = scipy.fft.irfft2(scipy.fft.rfft2(pattern) * transfer)
    return image[:, : blur.height_px, : blur.width_px].transpose(1, 2, 0).astype(np.float32)


def plane_behind(
    blur: LensBlur, layer_px: float, rng: np.random.Generator, *, noise=0.002, finest_px=0.0, gains=(1, 1, 1)
) -> np.ndarray:
    """A noisy plane at one depth, grey or of a hue that rises by ``gains`` of R, G, B; (H, W, 3) float32."""
    pattern = rng.normal(0, 0.15, (256, 256))
    if finest_px:
        pattern = cv2.GaussianBlur(pattern, (0, 0), finest_px, borderType=cv2.BORDER_REFLECT_101)
        pattern *= 0.12 / pattern.std()
    at_infinity, scale = blur.reference
    image = 0.5 + np.asarray(gains) * (blurred(0.5 + pattern, blur, (at_infinity - layer_px) / scale) - 0.5)
    return (image + rng.normal(0, noise, image.shape)).astype(np.float32)


class Boards:
    """The part of a session that the fits to its boards use: photographs by their distance from the sensor, mm."""

    def __init__(self, images: Mapping[float, np.ndarray]) -> None:
        self.boards = dict(enumerate(images))
        self.images = list(images.values())

    def read(self, i: int) -> np.ndarray:
        return self.images[i]


def board_evidence(sensor: CameraSensor, z_mm: np.ndarray, *, pupil_mm: float = 50.0, variance=0.1) -> Evidence:
    """Evidence of boards at distances from the pupil that are known to a variance, mm^2; nothing measured on them."""
    count, none = len(z_mm), np.zeros(len(z_mm))
    distances = BoardDistances(z_mm, pupil_mm, 0.5, 1.0, variance * np.eye(count + 1), none, none + 1.0)
    return Evidence(sensor, [], distances, 3.0, np.ones(count, bool))


# ---- scenes for rays


def pinhole_camera(width_px: int, height_px: int, *, focus_mm: float = 1000.0, radius_mm: float = 25.0) -> PupilCamera:
    """A camera of a pupil wide enough to blur small frames by several px."""
    return PupilCamera(width_px, height_px, focal_px=400.0, pupil_radius_mm=radius_mm, focus_mm=focus_mm,
                       sensor_to_pupil_mm=50.0, pixel_pitch_mm=0.05)  # fmt: skip


def card_before_wall(colors, *, texels: tuple[int, int], distances_mm, widths_mm, **spectrum: float) -> list[Plane]:
    """A textured wall and a card before it; colours, distances and widths are of the wall and of the card.

    Their grey texture is `chromaperture.optics.simulator.textures.noise`, to which ``spectrum`` goes.
    """
    made = []
    for seed, (color, z_mm, width_mm) in enumerate(zip(colors, distances_mm, widths_mm, strict=True), start=1):
        picture = noise(texels, seed=seed, **spectrum)[..., None] * np.asarray(color, np.float32)
        made.append(plane(picture, center_mm=(0, 0, z_mm), width_mm=width_mm))
    return made


# ---- a session of boards that are shifted views

INFINITY_PX, SCALE_PX_MM, PUPIL_MM = 4.3, 8200.0, 52.0  # d = A - B / z, z from the pupil
RULERS_MM = (1150, 1400, 1800, 2300, 3000)

SESSION_TOML = """
design = "cy_halves"
[sensor]
width_px = 144
height_px = 108
pixel_pitch_mm = 0.031
black_level = 100
white_level = 60100
[lens]
nominal_focal_length_mm = 50.0
nominal_f_number = 2.0
focused_at_about_mm = 1950
[board]
inner_corners = [9, 6]
square_mm = 30.0
ruler_error_mm = 3.0
"""


def write_board_session(folder: Path) -> None:
    """Photographs of boards and white sheets by a camera of cyan and yellow halves whose curve is known."""
    rng = np.random.default_rng(3)
    (folder / "board").mkdir(parents=True)
    (folder / "session.toml").write_text(SESSION_TOML)
    rows = ["file,ruler_mm"]
    for ruler in RULERS_MM:
        image = capture(texture(rng, 108, 144), "cy_halves", INFINITY_PX - SCALE_PX_MM / (ruler - PUPIL_MM))
        image = image + rng.normal(0, 0.003, image.shape)
        counts = np.clip(image * 60000 + 100, 0, 65535).astype(np.uint16)
        cv2.imwrite(str(folder / "board" / f"{ruler}.png"), counts[..., ::-1])
        rows.append(f"board/{ruler}.png,{ruler}")
    (folder / "distances.csv").write_text("\n".join(rows) + "\n")
    (folder / "white").mkdir()
    for name, colour in (("sheet_c", (0, 1, 1)), ("sheet_y", (1, 1, 0))):  # this world's film is ideal
        sheet = np.broadcast_to(np.array(colour) * 45000 + 100, (108, 144, 3)).astype(np.uint16)
        cv2.imwrite(str(folder / "white" / f"{name}.png"), sheet[..., ::-1])


def session_of(session: Path, folder: Path, suffix: str, write: Callable[[Path, np.ndarray], None]) -> Path:
    """Copy a session with pictures of another kind; ``write`` takes a path and counts (H, W, 3)."""
    shutil.copytree(session, folder)
    for picture in folder.rglob("*.png"):
        write(picture.with_suffix(suffix), cv2.imread(str(picture), cv2.IMREAD_UNCHANGED)[..., ::-1])
        picture.unlink()
    table = folder / "distances.csv"
    table.write_text(table.read_text().replace(".png", suffix))
    return folder


def render_boards(folder: Path, camera: PupilCamera, rulers_mm, *, tilts: int = 0, cells: int = 8, film="real") -> None:
    """A session of boards seen through a thin lens and halves, rendered ray by ray."""
    plan = SessionPlan(distances_mm=rulers_mm, tilts=tilts)
    write_session(folder, aperture=made_of(DESIGNS["cy_halves"], film), camera=camera, scenes={}, plan=plan,
                  rays=lambda aperture: pinhole_rays(camera, aperture, cells=cells))  # fmt: skip


# ---- RAW files


def write_dng(
    path: Path,
    mosaic: np.ndarray,
    *,
    pattern: str = "RGGB",
    black: tuple[int, ...] = (0,),
    black_dim: int = 2,
    white: int = 4095,
    orientation: int = 1,
    active_area: tuple[int, int, int, int] | None = None,
    model: str = "Test",
    noise_profile: tuple[float, ...] = (),
) -> None:
    """Write an uncompressed DNG (Adobe's specification 1.4) of a mosaic (H, W) uint16.

    ``pattern`` is that of a square cell, row by row; ``black`` is one level, or those of a cell of ``black_dim`` rows,
    row by row; ``active_area`` is top, left, bottom, right, where the pattern begins.
    """
    colours = bytes("RGB".index(colour) for colour in pattern)
    side = math.isqrt(len(colours))
    identity = (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1)
    tags: list[tuple] = [
        (33421, "H", 2, (side, side), False), (33422, "B", side * side, colours, False),
        (274, "H", 1, orientation, True), (50706, "B", 4, bytes([1, 4, 0, 0]), False),
        (50707, "B", 4, bytes([1, 1, 0, 0]), False), (50708, "s", 0, model + "\0", False),
        (50717, "I", 1, white, False), (50721, "2i", 9, identity, False),
        (50728, "2I", 3, (1, 1, 1, 1, 1, 1), False), (50778, "H", 1, 21, False),
        (271, "s", 0, "test\0", False), (272, "s", 0, model + "\0", False),
    ]  # fmt: skip
    if len(black) == 1:
        tags.append((50714, "H", 1, black[0], False))
    else:
        tags += [(50713, "H", 2, (black_dim,) * 2, False), (50714, "H", len(black), black, False)]
    if noise_profile:
        tags.append((51041, "d", len(noise_profile), noise_profile, False))
    if active_area is not None:
        tags.append((50829, "I", 4, active_area, False))
    tifffile.imwrite(path, mosaic, photometric=32803, extratags=tags, metadata=None, software=False)


def mosaic_of(counts: np.ndarray) -> np.ndarray:
    """Photosites (2H, 2W), RGGB, of a sensor that sees a picture (H, W, 3)."""
    fine = cv2.resize(counts.astype(np.float32), None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    sites = fine[..., 1].copy()
    sites[::2, ::2], sites[1::2, 1::2] = fine[::2, ::2, 0], fine[1::2, 1::2, 2]
    return np.clip(np.round(sites), 0, 65535).astype(np.uint16)


# ---- trials of the sweeps


def small_trials(seeds=(0, 1)) -> list[Trial]:
    size = {"width_px": 96, "height_px": 64, "cells": 6, "exposure": 0.9}
    names = ("normalised cross-correlation, unmixed", "phase correlation")
    return [Trial(method=name, design="cy_halves", seed=seed, **size) for name in names for seed in seeds]


def stored(folder: Path) -> dict[str, bytes]:
    """The files in which a sweep keeps its results, by name."""
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.json"))}


# ---- files that should be the same

PNG = b"\x89PNG\r\n\x1a\n"


def png_of(width: int, height: int, data: bytes = zlib.compress(bytes(9)), *, bits: int = 8) -> bytes:
    """A colour PNG that declares a size, whatever its data hold."""

    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, bits, 2, 0, 0, 0)
    return PNG + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def content(path: Path) -> bytes:
    """Return the bytes of a file; raises where a PNG is cut off."""
    data = path.read_bytes()
    assert not data.startswith(PNG) or data.endswith(b"IEND\xae\x42\x60\x82")
    return data


# ---- point-spread functions as a bench would photograph them


def kernel_places(width_px, height_px, rows=4, columns=6):
    """Middles (x, y) of equal cells of a frame, row by row."""
    return [
        [((j + 0.5) * width_px / columns - 0.5, (i + 0.5) * height_px / rows - 0.5) for j in range(columns)]
        for i in range(rows)
    ]


def painted_kernels(blur, distance_mm, *, side, finer=1):
    """Paint kernels of a `LensBlur` at `kernel_places`, ``finer`` samples a px; (rows, columns, 3, side, side)."""
    scaled = {name: finer * getattr(blur.model, name) for name in ("infinity_px", "scale_px_mm")}
    fine, size = replace(blur, model=replace(blur.model, **scaled)), 2 * (side + side % 2)
    spectra = [
        [fine.transfer(x, y, 1 / distance_mm, size) for x, y in row]
        for row in kernel_places(blur.width_px, blur.height_px)
    ]
    kernels = scipy.fft.fftshift(scipy.fft.irfft2(spectra, s=(size, size)), axes=(-2, -1))
    middle = slice(size // 2 - side // 2, size // 2 + side // 2 + 1)
    return kernels[..., middle, middle]


# ---- dual-pixel sensors


def write_halves(path: Path, image: np.ndarray, sides: tuple[str, str] = ("right", "left")) -> None:
    """Write red and blue of counts (H, W, 3) as two grey PNG files, NAME_right and NAME_left."""
    for channel, side in zip((0, 2), sides, strict=True):
        cv2.imwrite(str(path.with_name(f"{path.stem}_{side}.png")), image[..., channel])


def write_pair_session(
    folder: Path, halved: RayTable, camera: PupilCamera, rulers_mm, *, lens: str | None = None, tilts: int | None = None
) -> None:
    """A session of pairs by a dual-pixel sensor behind rays of halves: flat boards, or chessboards where ``tilts``."""
    sensor = SensorModel(160_000.0, 20.0, 256, 64256, 16)
    plan = SessionPlan(distances_mm=rulers_mm, tilts=tilts or 0, sensor=sensor, ruler_error_mm=0.0)
    write_session(folder, aperture=DESIGNS["cy_halves"], camera=camera, scenes={}, plan=plan, rays=lambda _: halved)
    shutil.rmtree(folder / "white")
    for picture in [*(folder / "board").iterdir(), *(folder.glob("tilt/*"))]:
        write_halves(picture, cv2.imread(str(picture), cv2.IMREAD_UNCHANGED)[..., ::-1])
        picture.unlink()
    table, settings = folder / "distances.csv", folder / "session.toml"
    table.write_text(table.read_text().replace(".png", "_left.png"))
    known = tomllib.loads(settings.read_text())
    square = "flat = true" if tilts is None else f"square_mm = {known['board']['square_mm']}"
    settings.write_text(
        f"""[sensor]
width_px = {camera.width_px}
height_px = {camera.height_px}
pixel_pitch_mm = {camera.pixel_pitch_mm}
black_level = 256
white_level = 64256
dual_pixel = "left-right"
[lens]
nominal_focal_length_mm = {known["lens"]["nominal_focal_length_mm"]}
nominal_f_number = {known["lens"]["nominal_f_number"]}
focused_at_about_mm = {camera.focus_mm}
{f'prescription = "{lens}"' if lens else ""}
[board]
{square}
"""
    )
