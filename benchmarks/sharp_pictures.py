"""All-in-focus against sharp truth, beside scikit-image's Wiener and Richardson-Lucy with the same kernels."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from colour_data import markdown, print_row, save
from half_pupil import CROP, REACH, by_kernels, capture, kernel_blur, read
from picture_quality import compare

from chromaperture.color.alignment import align_channels
from chromaperture.color.lens_shift import LensShift
from chromaperture.color.noise import estimate_noise_variance
from chromaperture.effects.all_in_focus import SharpenConfig, all_in_focus
from chromaperture.effects.edge_aware import filter_disparity
from chromaperture.effects.layered_model import layer_radii, layer_weights
from chromaperture.effects.restore import UNFITTED_ERROR, by_tiles, fitted_settings
from chromaperture.effects.transfer_functions import Blur, LensTransfer, ThinLensBlur
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.aperture import centroids
from chromaperture.optics.lens_blur import BlurModel, LensBlur

FULL_WELL, READ_NOISE = 5000.0, 4.0  # electrons
ROUNDS = {"layered Wiener": 0, "all in focus": 3}
KNOWN_ERROR = SharpenConfig().model_error  # of kernels that are true


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
    from chromaperture.optics.simulator.render import render, render_depth, render_sharp
    from chromaperture.optics.simulator.scene import load_scene, plane

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
    """Real half-pupil photographs as a cyan/yellow capture (red right, blue left, green their mean), at half size.

    Optics and noise are real, the colours are put together: a scene without colour of its own. Depth is found with the
    measured kernels, in their layers, and so are the kernels of every layer.
    """
    rows = []
    for scene in ("002", "012"):
        full = capture(folder, scene)
        blur = kernel_blur(folder, full.shape[1], full.shape[0])
        in_focus, per_edge = (part / blur.model.scale_px_mm for part in (blur.model.infinity_px, REACH * blur.edge_px))
        lens = LensShift(blur, near_mm=1 / (in_focus + per_edge), far_mm=1 / (in_focus - per_edge))
        disparity, sigma = by_kernels(full, blur)
        sides = np.array([[1.0, 0], [0, 0], [-1.0, 0]])
        first = align_channels(full, disparity, sides)
        disparity, scatter = filter_disparity(disparity, sigma, first)
        radius = lens.layer_radius_px(disparity).astype(np.float32)
        doubt = (scatter / blur.reach).astype(np.float32)
        aligned = np.maximum(align_channels(full, disparity, sides, displacement_px=lens(radius)), 0)[CROP]
        image, radius, doubt = np.maximum(full, 0)[CROP], radius[CROP], doubt[CROP]
        truth = read(folder / f"{scene}_gt_all_in_focus.png")
        truth = np.repeat((truth * 0.8 / np.percentile(truth, 99.5))[..., None], 3, axis=2).astype(np.float32)
        # The sharp photograph was shaded otherwise: the capture tells how, alike for all methods.
        smooth = [cv2.GaussianBlur(p.mean(axis=2), (0, 0), 40) for p in (image, truth)]
        truth *= (smooth[0] / smooth[1])[..., None]
        noise = estimate_noise_variance(full)[0, 0]
        begin = time.perf_counter()
        transfer = LensTransfer(lens)

        def tile(piece: tuple, middle: tuple, *, config: SharpenConfig, radius=radius, image=image, aligned=aligned,
                 noise=noise, transfer=transfer, doubt=doubt) -> np.ndarray:  # fmt: skip
            frame_position = (0.667 * middle[0], 0.667 * middle[1])  # the crop is the middle of the frame
            there = partial(transfer, frame_position=frame_position)
            return all_in_focus(image[piece], radius[piece], there, noise_variance=noise, aligned=aligned[piece],
                                radius_sigma_px=doubt[piece], config=config)  # fmt: skip

        made = {"capture": image, "aligned": aligned}
        for name, rounds in ROUNDS.items():
            config = SharpenConfig(model_error=UNFITTED_ERROR, reweightings=rounds)
            made[name] = by_tiles((504, 672), partial(tile, config=config), tile_px=224, overlap_px=32)
        made |= peers(image, radius, transfer, 79)
        seconds = time.perf_counter() - begin
        # Channels hold one grey scene: their mean is the picture.
        known = read(folder / f"{scene}_gt_defocus.png") > 0
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
