"""The colour picture against truth: python benchmarks/colour.py --data DATA [alignment] [simulated] [real]

``alignment``: displacement of the channels before and after restoration, and colour beside the open aperture's capture,
on bench50. ``simulated`` and ``real``: all-in-focus pictures against sharp ones, of a simulated world and of half-pupil
photographs, beside scikit-image with the same kernels. DATA holds bench50/ and real/cmu_dual_pixel/.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from pathlib import Path

import cv2
import numpy as np
from bench50 import truth_mm
from half_pupil import CROP, REACH, by_kernels, capture, kernel_blur, read
from skimage.color import deltaE_ciede2000, rgb2lab
from skimage.metrics import structural_similarity
from skimage.restoration import richardson_lucy, wiener

from chromaperture.calibration.calibrate_session import calibrate_session
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.capture.files import read_image
from chromaperture.color.alignment import align_channels
from chromaperture.color.lens_shift import LensShift
from chromaperture.color.noise import estimate_noise_variance
from chromaperture.color.srgb import linear_to_srgb
from chromaperture.color.transparency_map import compensate_vignetting, flat_field
from chromaperture.depth.conversion import depth_to_disparity
from chromaperture.effects.all_in_focus import SharpenConfig, all_in_focus
from chromaperture.effects.edge_aware import filter_disparity
from chromaperture.effects.layered_model import Blur, LensTransfer, ThinLensBlur, layer_radii, layer_weights
from chromaperture.effects.restore import UNFITTED_ERROR, by_tiles, fitted_settings, restore, white_gains
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.aperture import DESIGNS, centroids, channel_transmission, made_of
from chromaperture.optics.lens_blur import BlurModel, LensBlur
from chromaperture.optics.pinhole import focused_at, pupil_camera
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.ray_table import lens_rays, pinhole_rays
from chromaperture.optics.simulator.render import render, render_depth, render_sharp
from chromaperture.optics.simulator.scene import load_scene, plane

SCENES = ("still_life", "steps", "room", "desk")
PARALLAX = ("cy_halves", "cy_open", "rgb_squares", "cmy_circles")
FOCUS_MM = 2000.0  # of the sessions of bench50
LEVELS = {"black_level": 16, "white_level": 1016}  # counts, of all captures of bench50
RIM_PX = 20  # left out of PSNR, SSIM and CIEDE2000
TEMPLATE, SEARCH, STRIDE = 35, 16, 14  # px, of the windows of `misalignment`; the search covers every displacement
PARTS_OF_WINDOW = 3  # along each side, with independent errors
SURE_PX = 0.1  # largest standard error of the windows that are counted
LEAST_NCC = 0.85
LEAST_GRADIENT = 4e-3  # per px, of the square root of light, in the direction with less texture
FULL_WELL, READ_NOISE = 5000.0, 4.0  # electrons
ROUNDS = {"layered Wiener": 0, "all in focus": 3}
KNOWN_ERROR = SharpenConfig().model_error  # of kernels that are true


def print_row(**row: object) -> None:
    print(json.dumps({k: round(v, 4) if isinstance(v, float) else v for k, v in row.items()}), flush=True)


def matched_exposure(picture: np.ndarray, reference: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Scale each channel to the reference: exposure and white balance are not errors of restoration."""
    gain = (reference * valid[..., None]).sum(axis=(0, 1)) / (picture * valid[..., None]).sum(axis=(0, 1))
    return picture * gain.astype(np.float32)


def compare(picture: np.ndarray, reference: np.ndarray, valid: np.ndarray) -> dict[str, float]:
    """PSNR and SSIM of sRGB values in [0, 1], mean CIEDE2000; both linear, over the valid pixels."""
    a, b = (linear_to_srgb(p) for p in (matched_exposure(picture, reference, valid), reference))
    error = ((a - b) ** 2)[valid].mean()
    _, map_ = structural_similarity(b, a, channel_axis=2, data_range=1.0, gaussian_weights=True, full=True)
    return {
        "psnr": float(-10 * np.log10(error)),
        "ssim": float(map_[valid].mean()),
        "ciede2000": float(deltaE_ciede2000(rgb2lab(b), rgb2lab(a))[valid].mean()),
    }


def misalignment(picture: np.ndarray) -> np.ndarray:
    """Measure the displacement of red and blue from green in windows; (N, 2) float, px.

    Columns are the displacement and its standard error, from the scatter between the parts of the window; NaN where no
    match is found. The windows form a fixed grid, so that pictures of the same size can be compared window by window.
    """
    p = np.maximum(np.asarray(picture, np.float32), 0)
    p = cv2.GaussianBlur(np.sqrt(p), (0, 0), 1.0)  # equal noise in dark and light
    height, width = p.shape[:2]
    half, reach = TEMPLATE // 2, TEMPLATE // 2 + SEARCH
    found = []
    for y in range(reach, height - reach, STRIDE):
        for x in range(reach, width - reach, STRIDE):
            area = p[y - reach : y + reach + 1, x - reach : x + reach + 1, 1]
            for k in (0, 2):
                found.append(_displacement(p[y - half : y + half + 1, x - half : x + half + 1, k], area))
    return np.array(found)


def _displacement(patch: np.ndarray, area: np.ndarray) -> tuple[float, float]:
    gy, gx = np.gradient(patch)
    # Texture in both directions: along a lone edge the displacement is undetermined.
    if np.linalg.eigvalsh(np.cov(gx.ravel(), gy.ravel()))[0] ** 0.5 < LEAST_GRADIENT:
        return np.nan, np.nan
    score = cv2.matchTemplate(area, patch, cv2.TM_CCOEFF_NORMED)
    _, best, _, (i, j) = cv2.minMaxLoc(score)
    if best < LEAST_NCC or not (0 < i < 2 * SEARCH and 0 < j < 2 * SEARCH):
        return np.nan, np.nan
    dx = _peak(score[j, i - 1], score[j, i], score[j, i + 1]) + i - SEARCH
    dy = _peak(score[j - 1, i], score[j, i], score[j + 1, i]) + j - SEARCH
    middle = (area.shape[1] // 2 + dx, area.shape[0] // 2 + dy)
    there = cv2.getRectSubPix(np.ascontiguousarray(area), patch.shape[::-1], middle)
    return float(np.hypot(dx, dy)), _standard_error(patch, there, gx, gy)


def _standard_error(patch: np.ndarray, there: np.ndarray, gx: np.ndarray, gy: np.ndarray) -> float:
    """Of a displacement, from the residual of the patch, taken to be correlated within each part of the window."""
    tone = there - there.mean()
    left = patch - patch.mean()
    left = left - (left * tone).sum() / (tone * tone).sum() * tone
    edges = np.linspace(0, len(patch), PARTS_OF_WINDOW + 1).astype(int)[:-1]
    sums = (np.add.reduceat(np.add.reduceat(g * left, edges, axis=0), edges, axis=1) for g in (gx, gy))
    pull = np.stack([s.ravel() for s in sums])
    pull -= pull.mean(axis=1, keepdims=True)
    normal = np.linalg.inv(np.array([[(a * b).sum() for a in (gx, gy)] for b in (gx, gy)]))
    parts = PARTS_OF_WINDOW**2
    return float(np.sqrt(np.trace(normal @ (pull @ pull.T) @ normal) * parts / (parts - 1)))


def _peak(left: float, middle: float, right: float) -> float:
    curvature = left - 2 * middle + right
    return 0.0 if curvature >= 0 else float(0.5 * (left - right) / curvature)


@dataclass(frozen=True)
class Bench:
    """The set bench50 in ``data``; cameras and disparities are kept in ``work``, and made when missing."""

    data: Path
    work: Path

    @property
    def folder(self) -> Path:
        return self.data / "bench50"

    def calibration(self, design: str) -> Calibration:
        path = self.work / f"{design}.asdf"
        if not path.exists():
            # Only the first design has tilted boards, which determine the lens.
            lens = None if design == PARALLAX[0] else self.calibration(PARALLAX[0])
            calibrate_session(self.folder / design, lens_from=lens).calibration.save(path)
        return Calibration.load(path)

    def camera(self, design: str, quality: str = "accurate") -> CodedApertureCamera:
        calibration = self.calibration(design)
        return CodedApertureCamera(calibration, default_config(calibration, quality))

    def scenes(self, design: str) -> list[str]:
        return [s for s in SCENES if (self.folder / design / "scene" / f"{s}.png").exists()]

    def capture(self, design: str, scene: str) -> np.ndarray:
        return read_image(self.folder / design / "scene" / f"{scene}.png", **LEVELS)

    def white(self, design: str) -> np.ndarray:
        return read_image(self.folder / "white" / f"{design}.png", **LEVELS)

    def bare(self, scene: str) -> np.ndarray:
        """The open aperture's capture, its vignetting compensated."""
        return compensate_vignetting(self.capture("open", scene), self._open_shading)

    @cached_property
    def _open_shading(self) -> np.ndarray:
        return flat_field(self.white("open"))

    def measured(self, design: str, scene: str, quality: str = "accurate") -> dict[str, np.ndarray]:
        """Disparity and its standard deviation, as `restore` takes them."""
        path = self.work / f"{design}_{scene}_{quality}.npz"
        if not path.exists():
            frame = self.camera(design, quality).measure(self.capture(design, scene))
            np.savez(path, disparity_px=frame.disparity_px, sigma_px=frame.disparity_sigma_px)
        with np.load(path) as kept:
            return dict(kept)

    def true_disparity(self, scene: str, camera: CodedApertureCamera) -> np.ndarray:
        """Disparity by the true depth; unknown depths are taken to be in focus."""
        depth = np.nan_to_num(truth_mm(self.folder, scene), nan=FOCUS_MM)
        return depth_to_disparity(depth, camera.depth_model).astype(np.float32)


def alignment(bench: Bench) -> None:
    """All designs with parallax on all scenes, in windows that register in the open aperture's capture."""
    for design in PARALLAX:
        camera = bench.camera(design)
        shading = flat_field(bench.white(design))
        for scene in bench.scenes(design):
            image, bare = bench.capture(design, scene), bench.bare(scene)
            known, true = bench.measured(design, scene), bench.true_disparity(scene, camera)
            made = {
                "before": image * white_gains(camera.calibration),
                "after": restore(image, camera=camera, sharpness="aligned", **known).color,
                "true depth": restore(image, true, camera, sharpness="aligned").color,
                "all in focus": restore(image, camera=camera, **known).color,
            }
            sure = misalignment(bare)[:, 0] < SURE_PX
            inner = np.zeros(image.shape[:2], bool)
            inner[RIM_PX:-RIM_PX, RIM_PX:-RIM_PX] = True
            for name, picture in made.items():
                moved = misalignment(picture)[sure, 0]
                natural = compensate_vignetting(np.maximum(picture, 0), shading)
                off = {"median_px": float(np.nanmedian(moved)), "most_px": float(np.nanpercentile(moved, 90))}
                print_row(design=design, scene=scene, picture=name, **off, **compare(natural, bare, inner))


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


def simulated(calibration: Calibration) -> None:
    """A small world seen by a thin lens (the kernels are true) and by a ray-traced one (they are an approximation).

    The ray-traced lens is the calibrated camera's, so that its fitted blur, scaled to these pixels, serves as well.
    """
    width, height, pitch = 480, 320, 22.3 / 480
    lens = focused_at(load_lens("double_gauss_50"), 2000.0)
    camera = pupil_camera(lens, width_px=width, height_px=height, pixel_pitch_mm=pitch)
    fine = pupil_camera(lens, width_px=3 * width, height_px=3 * height, pixel_pitch_mm=pitch / 3)
    planes = load_scene(Path(__file__).parents[1] / "examples" / "desk.toml")
    sheet = [plane(np.ones((2, 2, 3), np.float32), center_mm=(0, 0, 500.0), width_mm=4000)]
    rng = np.random.default_rng(1)
    valid = np.ones((height, width), bool)
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
                print_row(design=design, optics=optics, picture=name, **compare(picture, truth, valid))
            if optics != "thin lens":
                depth = render_depth(table, planes)
                fitted(image, depth, calibration, noise, truth, camera.sensor_to_pupil_mm)


def fitted(
    image: np.ndarray, depth_mm: np.ndarray, calibration: Calibration, noise: np.ndarray, truth: np.ndarray,
    sensor_to_pupil_mm: float,
) -> None:  # fmt: skip
    """Print rows of the calibrated camera's kernels, at the pixels of this picture."""
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
        figures = compare(picture, truth, valid)
        print_row(design=calibration.design, optics="ray-traced lens, fitted kernels", picture=name, **figures)


def real(folder: Path) -> None:
    """Real half-pupil photographs as a cyan/yellow capture (red right, blue left, green their mean), at half size.

    Optics and noise are real, the colours are put together: a scene without colour of its own. Depth is found with the
    measured kernels, in their layers, and so are the kernels of every layer.
    """
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
        # Channels hold one grey scene: their mean is the picture.
        known = read(folder / f"{scene}_gt_defocus.png") > 0
        valid = known if known.mean() > 0.2 else np.ones((504, 672), bool)
        for name, picture in made.items():
            grey = np.repeat(picture.mean(axis=2, keepdims=True), 3, axis=2)
            print_row(scene=scene, picture=name, **compare(grey, truth, valid))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parts = ("alignment", "simulated", "real")
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(parts)}; all when absent")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--work", type=Path, help="folder of cameras and disparities; a temporary one when absent")
    args = parser.parse_args()
    if unknown := set(args.parts) - set(parts):
        parser.error(f"unknown part {', '.join(sorted(unknown))}: choose from {', '.join(parts)}")
    with tempfile.TemporaryDirectory() as temporary:
        work = args.work or Path(temporary)
        work.mkdir(parents=True, exist_ok=True)
        bench = Bench(args.data, work)
        for name in args.parts or parts:
            print(f"\n# {name}", flush=True)
            if name == "alignment":
                alignment(bench)
            elif name == "simulated":
                simulated(bench.calibration("cy_halves"))
            else:
                real(args.data / "real" / "cmu_dual_pixel")


if __name__ == "__main__":
    main()
