"""All-in-focus against sharp truth, beside scikit-image's Wiener and Richardson-Lucy with the same kernels."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from colour_data import markdown, print_row, save
from picture_quality import compare

from chromaperture.camera import CodedApertureCamera
from chromaperture.camera_file import Calibration
from chromaperture.camera_matching import default_config
from chromaperture.color.alignment import align_channels
from chromaperture.color.lens_shift import LensShift, least_fringes
from chromaperture.color.noise import estimate_noise_variance
from chromaperture.effects.all_in_focus import SharpenConfig, all_in_focus
from chromaperture.effects.blur_layers import layer_radii, layer_weights
from chromaperture.effects.edge_aware import filter_disparity
from chromaperture.effects.restoration_tiles import by_tiles
from chromaperture.effects.restore import UNFITTED_ERROR, fitted_settings
from chromaperture.effects.transfer_functions import Blur, LensTransfer, ThinLensBlur, kernel_otf
from chromaperture.optics.aperture import centroids
from chromaperture.optics.lens_blur import BlurModel, LensBlur
from chromaperture.optics.lens_otf import ChannelRays

FULL_WELL, READ_NOISE = 5000.0, 4.0  # electrons
ROUNDS = {"layered Wiener": 0, "all in focus": 3}
KNOWN_ERROR = SharpenConfig().model_error  # of kernels that are true
EDGE_PER_DISPARITY = 3 * np.pi / 4  # the rim of a half disc over its centroid


@dataclass(frozen=True)
class MeasuredBlur:
    """Measured kernels on a grid of frame positions and blur radii.

    Attributes
    ----------
    kernels : (rows, columns, radii, 3, s, s) float
        Centred on the view of the pupil's centre; s is odd.
    radii_px : (radii,) float
        Rising.
    """

    kernels: np.ndarray
    radii_px: np.ndarray

    def __post_init__(self) -> None:
        shape = self.kernels.shape
        if len(shape) != 6 or shape[3] != 3 or shape[4] != shape[5] or shape[4] % 2 == 0:
            raise ValueError(f"kernels must be (rows, columns, radii, 3, odd, odd), got {shape}")
        if shape[2] != len(self.radii_px) or np.any(np.diff(self.radii_px) <= 0):
            raise ValueError("radii_px must rise and number as many as the kernels' third dimension")

    def __call__(
        self, radius_px: float, shape: tuple[int, int], *, frame_position: tuple[float, float] | None = None
    ) -> np.ndarray:
        """See `Blur`; of the nearest frame position, linear between two radii."""
        rows, columns = self.kernels.shape[:2]
        x, y = frame_position or (0.0, 0.0)
        row = int(np.clip(round((y + 1) / 2 * rows - 0.5), 0, rows - 1))
        column = int(np.clip(round((x + 1) / 2 * columns - 0.5), 0, columns - 1))
        position = float(np.interp(radius_px, self.radii_px, np.arange(len(self.radii_px))))
        below = min(int(position), max(len(self.radii_px) - 2, 0))
        fraction = position - below
        stack = self.kernels[row, column]
        kernel = (1 - fraction) * stack[below] + fraction * stack[min(below + 1, len(stack) - 1)]
        return kernel_otf(kernel, shape)


def by_peer(image: np.ndarray, radius: np.ndarray, blur: Blur, deconvolve: Callable, size: int) -> np.ndarray:
    """A peer's deconvolution in each layer, composed by the same weights of the layers."""
    out = np.zeros_like(image)
    radii = layer_radii(radius)
    for r, weight in zip(radii, layer_weights(radius, radii), strict=True):
        if not weight.any():
            continue
        otf = blur(float(r), (size, size))
        kernels = np.fft.fftshift(np.fft.irfft2(otf, s=(size, size)), axes=(1, 2))
        for k in range(3):
            out[..., k] += weight * deconvolve(image[..., k], np.maximum(kernels[k], 0) / kernels[k].sum())
    return np.maximum(out, 0)


def peers(image: np.ndarray, radius: np.ndarray, blur: Blur, size: int) -> dict[str, np.ndarray]:
    from skimage.restoration import richardson_lucy, wiener

    pad = size // 2
    wide = cv2.copyMakeBorder(image, pad, pad, pad, pad, borderType=cv2.BORDER_REFLECT)
    depth = cv2.copyMakeBorder(radius, pad, pad, pad, pad, borderType=cv2.BORDER_REFLECT)
    methods = {
        "skimage Wiener": lambda y, k: wiener(y, k, 0.02, clip=False),
        "skimage Richardson-Lucy, 15": lambda y, k: richardson_lucy(np.maximum(y, 1e-4), k, 15, clip=False),
    }
    return {n: by_peer(wide, depth, blur, m, size)[pad:-pad, pad:-pad] for n, m in methods.items()}


def ours(
    image: np.ndarray, radius: np.ndarray, blur: Blur, noise: np.ndarray, aligned: np.ndarray, error: float
) -> dict[str, np.ndarray]:
    return {
        name: all_in_focus(
            image, radius, blur, noise_variance=noise, aligned=aligned,
            config=SharpenConfig(model_error=error, reweightings=rounds),
        )
        for name, rounds in ROUNDS.items()
    }  # fmt: skip


def simulated_rows(calibration: Calibration, out: Path | None) -> list[dict]:
    """A small world seen by a thin lens (the kernels are true) and by a ray-traced one (they are an approximation).

    The ray-traced lens is the calibrated camera's, so that its fitted blur, scaled to these pixels, serves as well.
    """
    from chromaperture.optics.aperture import DESIGNS, channel_transmission, made_of
    from chromaperture.optics.paraxial import focused_at
    from chromaperture.optics.pinhole import pupil_camera
    from chromaperture.optics.prescription import load_lens
    from chromaperture.optics.ray_table import lens_rays, pinhole_rays
    from chromaperture.optics.render import render, render_depth, render_sharp
    from chromaperture.optics.scene import load_scene, plane

    width, height, pitch = 480, 320, 22.3 / 480
    lens = focused_at(load_lens("double_gauss_50"), 2000.0)
    camera = pupil_camera(lens, width_px=width, height_px=height, pixel_pitch_mm=pitch)
    fine = pupil_camera(lens, width_px=3 * width, height_px=3 * height, pixel_pitch_mm=pitch / 3)
    planes = load_scene(Path(__file__).parents[1] / "examples" / "desk.toml")
    sheet = [plane(np.ones((2, 2, 3), np.float32), center_mm=(0, 0, 500.0), width_mm=4000)]
    rng = np.random.default_rng(1)
    valid = np.ones((height, width), bool)
    rows = []
    for design in ("cy_halves", "cy_open", "rgb_squares", "magenta_annulus"):
        aperture = made_of(DESIGNS[design], "real")
        size = {"width_px": width, "height_px": height, "pixel_pitch_mm": pitch}
        tables = {"thin lens": pinhole_rays(camera, aperture, cells=24)}
        if design == "cy_halves":
            tables["ray-traced lens"] = lens_rays(lens, aperture, cells=16, nodes=25, **size)
        # A pixel of the pinhole reference collects light over its area, as a sensor's does.
        truth = cv2.resize(
            render_sharp(pinhole_rays(fine, aperture, cells=2), planes), (width, height), interpolation=cv2.INTER_AREA
        )
        for optics, table in tables.items():
            white = render(table, sheet)
            white /= white.max(axis=(0, 1))
            clean = render(table, planes)
            clean *= 0.9 / channel_transmission(aperture).max()
            noisy = clean + rng.normal(size=clean.shape) * np.sqrt(clean / FULL_WELL + (READ_NOISE / FULL_WELL) ** 2)
            gains = 1 / channel_transmission(aperture) / 0.9 * channel_transmission(aperture).max()
            image = (noisy * gains / white).astype(np.float32)
            noise = (noisy.mean(axis=(0, 1)) / FULL_WELL) * gains**2
            radius = camera.blur_radius_px(render_depth(table, planes)).astype(np.float32)
            radius = np.nan_to_num(radius)
            aligned = np.maximum(align_channels(image, radius, np.nan_to_num(centroids(aperture))), 0)
            blur = ThinLensBlur(aperture)
            error = KNOWN_ERROR if optics == "thin lens" else UNFITTED_ERROR
            made = {"capture": image, "aligned": aligned, **ours(image, radius, blur, noise, aligned, error)}
            if design in ("cy_halves", "rgb_squares"):
                made |= peers(image, radius, blur, 33)
            for name, picture in made.items():
                rows.append({"design": design, "optics": optics, "picture": name, **compare(picture, truth, valid)})
                print_row(rows[-1])
            if optics != "thin lens":
                depth = render_depth(table, planes)
                made |= fitted(image, depth, calibration, noise, rows, truth, camera.sensor_to_pupil_mm)
            if out:
                save(out / f"sharp_{design}_{optics.split()[0]}.png", [*made.values(), truth])
    print(markdown(by_picture(rows, "design", "optics"), heading(rows, "design", "optics")), flush=True)
    return rows


def fitted(
    image: np.ndarray, depth_mm: np.ndarray, calibration: Calibration, noise: np.ndarray, rows: list[dict],
    truth: np.ndarray, sensor_to_pupil_mm: float,
) -> dict[str, np.ndarray]:  # fmt: skip
    """The calibrated camera's kernels, at the pixels of this picture."""
    height, width = depth_mm.shape
    scale = width / calibration.sensor.width_px
    numbers = {k: v if "rim" in k else scale * v for k, v in asdict(calibration.blur).items()}
    pupil = calibration.field_blur().pupil
    lens = LensShift(LensBlur(BlurModel(**numbers), pupil, width, height), near_mm=600.0, far_mm=6000.0)
    at_infinity = lens.radius_px(0.0)
    inverse_mm = 1 / np.where(np.isfinite(depth_mm), depth_mm - sensor_to_pupil_mm, np.inf)
    radius = np.where(np.isfinite(depth_mm), lens.radius_px(inverse_mm), at_infinity).astype(np.float32)
    u = np.nan_to_num(centroids(calibration.aperture))
    aligned = np.maximum(align_channels(image, radius, u, displacement_px=lens(radius)), 0)
    made = {"aligned": aligned}
    reach = math.ceil(float(np.abs(radius).max())) + 4
    for name, rounds in ROUNDS.items():
        config = fitted_settings(lens.blur.reach, reweightings=rounds)

        def tile(piece: tuple, middle: tuple, *, config: SharpenConfig = config) -> np.ndarray:
            blur = partial(LensTransfer(lens), frame_position=middle)
            return all_in_focus(image[piece], radius[piece], blur, noise_variance=noise,
                                aligned=aligned[piece], config=config)  # fmt: skip

        made[name] = by_tiles(radius.shape, tile, tile_px=96, overlap_px=reach)
    valid = np.ones(radius.shape, bool)
    for name, picture in made.items():
        rows.append({"design": calibration.design, "optics": "ray-traced lens, fitted kernels", "picture": name,
                     **compare(picture, truth, valid)})  # fmt: skip
        print_row(rows[-1])
    return {f"{name}, fitted": picture for name, picture in made.items()}


def by_picture(rows: list[dict], *keys: str) -> list[dict]:
    """One row for what the keys say, with PSNR / SSIM / CIEDE2000 of each picture in a column."""
    table: dict[tuple, dict] = {}
    for row in rows:
        line = table.setdefault(tuple(row[k] for k in keys), {k: row[k] for k in keys} | heading(rows, *keys, blank=""))
        line[row["picture"]] = f"{row['psnr']:.2f} / {row['ssim']:.3f} / {row['ciede2000']:.2f}"
    return list(table.values())


def heading(rows: list[dict], *keys: str, blank: str | None = None) -> dict[str, str]:
    names = dict.fromkeys(row["picture"] for row in rows)
    if blank is not None:
        return dict.fromkeys(names, blank)
    return {name: f"{{{name}}}" for name in (*keys, *names)}


def cmu_rows(folder: Path, out: Path | None) -> list[dict]:
    """Real half-pupil photographs as a cyan/yellow capture (red left, blue right, green their mean), at half size.

    Optics and noise are real, the colours are put together: a scene without colour of its own. Depth is what our
    matcher finds in it; the kernels are the measured ones, scaled with the disparity.
    """
    rows = []
    whites = [_half(_read(folder / "calibration" / f"white_sheet_{s}.png") - 1024) for s in ("left", "right")]
    whites = [cv2.GaussianBlur(w, (0, 0), 12) for w in whites]
    kernels, at_px = _kernels(folder / "calibration")
    apart = np.array([[at_px / _registered_px(stack) for stack in row] for row in kernels], np.float32)
    for scene in ("002", "012"):
        left, right = (
            _half(_read(folder / f"{scene}_{s}.png") - 1024) / w
            for s, w in zip(("left", "right"), whites, strict=True)
        )
        full = np.dstack([left, (left + right) / 2, right]).astype(np.float32)
        full *= 0.8 / np.percentile(full, 99.5)
        calibration = Calibration.uncalibrated("cy_halves", width_px=full.shape[1], height_px=full.shape[0])
        eye = CodedApertureCamera(calibration, default_config(calibration, "real-time"))
        frame = eye.measure(full)
        shifts = np.array([[1.0, 0], [0, 0], [-1.0, 0]])
        crop = np.s_[126:630, 168:840]
        first = align_channels(full, frame.disparity_px, shifts)
        disparity, scatter = filter_disparity(frame.disparity_px, frame.disparity_sigma_px, first)
        aligned = np.maximum(align_channels(full, disparity, shifts), 0)[crop]
        image = np.maximum(full, 0)[crop]
        radius, doubt = EDGE_PER_DISPARITY * disparity[crop], EDGE_PER_DISPARITY * scatter[crop]
        truth = _half(_read(folder / f"{scene}_gt_all_in_focus.png"))
        truth = np.repeat((truth * 0.8 / np.percentile(truth, 99.5))[..., None], 3, axis=2).astype(np.float32)
        # The sharp photograph was shaded otherwise: the capture tells how, alike for all methods.
        smooth = [cv2.GaussianBlur(p.mean(axis=2), (0, 0), 40) for p in (image, truth)]
        truth *= (smooth[0] / smooth[1])[..., None]
        radii = np.sort(np.sign(at_px) * np.array([0.2, *np.arange(1.0, 14.1, 1.0)]))
        blur = MeasuredBlur(*_scaled(kernels, at_px, radii))
        radius = np.clip(radius, radii[0], radii[-1]).astype(np.float32)
        noise = estimate_noise_variance(full)[0, 0]
        begin = time.perf_counter()

        def tile(piece: tuple, middle: tuple, *, config: SharpenConfig, radius: np.ndarray, image=image,
                 aligned=aligned, noise=noise, blur=blur, doubt=doubt) -> np.ndarray:  # fmt: skip
            frame_position = (0.667 * middle[0], 0.667 * middle[1])  # the crop is the middle of the frame
            there = partial(blur, frame_position=frame_position)
            return all_in_focus(image[piece], radius[piece], there, noise_variance=noise, aligned=aligned[piece],
                                radius_sigma_px=doubt[piece], config=config)  # fmt: skip

        made = {"capture": image, "aligned": aligned}
        whole = radius
        # Kernels as far apart as the disparity by their centroids, or by what registration reads between them.
        ratio = cv2.resize(apart, full.shape[1::-1], interpolation=cv2.INTER_LINEAR)[crop]
        for rule, share in (("centroids", np.float32(1)), ("registered", ratio)):
            radius = np.clip(share * whole, radii[0], radii[-1]).astype(np.float32)
            for name, rounds in ROUNDS.items():
                config = SharpenConfig(model_error=UNFITTED_ERROR, reweightings=rounds)
                made[f"{name}, {rule}"] = by_tiles(
                    (504, 672), partial(tile, radius=radius, config=config), tile_px=224, overlap_px=32
                )
            made |= {f"{name}, {rule}": p for name, p in peers(image, radius, blur, 63).items()}
        seconds = time.perf_counter() - begin
        # Channels hold one grey scene: their mean is the picture.
        known = _half(_read(folder / f"{scene}_gt_defocus.png")) > 0
        valid = known if known.mean() > 0.2 else np.ones((504, 672), bool)
        for name, picture in made.items():
            grey = np.repeat(picture.mean(axis=2, keepdims=True), 3, axis=2)
            rows.append({"scene": scene, "picture": name, **compare(grey, truth, valid)})
            print_row(rows[-1])
        print_row({"scene": scene, "seconds": seconds, "radius_5_95": np.percentile(radius, (5, 95)).tolist()})
        if out:
            save(out / f"cmu_{scene}.png", [*made.values(), truth])
    print(markdown(by_picture(rows, "scene"), heading(rows, "scene")), flush=True)
    return rows


def _read(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED).astype(np.float32)


def _half(picture: np.ndarray) -> np.ndarray:
    return cv2.resize(picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)


def _kernels(folder: Path) -> tuple[np.ndarray, float]:
    """Measured half-pupil kernels as R, G, B on the field, centred between the halves, and their half disparity."""
    sides = [np.load(folder / f"blur_kernels_{s}.npy").reshape(6, 8, 61, 61) for s in ("left", "right")]
    stack = np.stack([sides[0], (sides[0] + sides[1]) / 2, sides[1]], axis=2)
    axis = np.arange(61) - 30
    centred = np.empty_like(stack)
    separation = []
    for i in range(6):
        for j in range(8):
            weights = stack[i, j] / stack[i, j].sum(axis=(1, 2), keepdims=True)
            cx = (weights * axis).sum(axis=(1, 2))
            cy = (weights * axis[:, None]).sum(axis=(1, 2))
            separation.append((cx[0] - cx[2]) / 2)
            middle = ((cx[0] + cx[2]) / 2, (cy[0] + cy[2]) / 2)
            shift = np.float32([[1, 0, -middle[0]], [0, 1, -middle[1]]])
            for k in range(3):
                centred[i, j, k] = cv2.warpAffine(stack[i, j, k], shift, (61, 61), flags=cv2.INTER_LINEAR)
    return centred, float(np.mean(separation))


def _registered_px(stack: np.ndarray) -> float:
    """Half the displacement that registration reads between the left and the right kernel of one place."""
    axis = np.arange(stack.shape[-1], dtype=float) - stack.shape[-1] // 2
    places = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    rays = []
    for kernel in np.maximum(stack[[0, 2, 2]], 0):
        lit = kernel.ravel() > 1e-3 * kernel.max()
        rays.append(ChannelRays(places[lit], kernel.ravel()[lit] / kernel.ravel()[lit].sum()))
    shift = least_fringes(rays)
    return float(shift[0, 0] - shift[1, 0]) / 2


def _scaled(kernels: np.ndarray, at_px: float, radii: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Kernels for other blur radii, at half the size of the photographs they were measured in."""
    size = 63
    out = np.zeros((6, 8, len(radii), 3, size, size), np.float32)
    for n, radius in enumerate(radii):
        scale = radius / EDGE_PER_DISPARITY / (0.5 * at_px) * 0.5
        matrix = np.float32([[scale, 0, size // 2 - 30 * scale], [0, scale, size // 2 - 30 * scale]])
        for i in range(6):
            for j in range(8):
                for k in range(3):
                    # Shrunk after a blur of the pixel's size, or a small kernel would miss its samples.
                    soft = cv2.GaussianBlur(kernels[i, j, k], (0, 0), max(0.25 / max(abs(scale), 0.05), 0.3))
                    out[i, j, n, k] = cv2.warpAffine(soft, matrix, (size, size), flags=cv2.INTER_LINEAR)
    out = np.maximum(out, 0)
    return out / np.maximum(out.sum(axis=(4, 5), keepdims=True), 1e-9), radii
