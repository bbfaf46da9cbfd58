"""Misalignment of the channels before and after restoration, and their colour against the open aperture's capture."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from colour_data import PARALLAX, SCENES, Bench, markdown, print_row, save
from no_parallax import sharp_scene, without_parallax
from picture_quality import SURE_PX, compare, matched_exposure, misalignment, phase_misalignment

from chromaperture.camera.alignment import channel_shifts
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.capture.files import read_image
from chromaperture.color.alignment import align_channels
from chromaperture.color.transparency_map import compensate_vignetting, flat_field
from chromaperture.effects.restore import restore, white_gains
from chromaperture.model.camera_file import Calibration

RIM_PX = 20  # left out of PSNR, SSIM and CIEDE2000
LEAST_RESPONSE = 0.3  # of the peak of a phase correlation, to be counted
SURE_RESPONSE = 0.5  # to select windows
REAL_NCC = 0.8  # lower than for simulated captures: real filters overlap in colour, and the photographs are noisy


def bench_rows(bench: Bench, out: Path | None) -> list[dict]:
    """Measure all designs with parallax on all scenes."""
    rows: list[dict] = []

    @cache
    def sharp(scene: str) -> np.ndarray:
        eye = bench.camera(PARALLAX[0])
        radius = eye.alignment.blur_radius_px(bench.true_disparity(scene, eye))
        return sharp_scene(bench.bare(scene), radius, eye.alignment.lens_shift)

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
            nothing = without_parallax(sharp(scene), camera.alignment.blur_radius_px(true), image, camera)
            # Windows with enough texture: those that register in the open capture, whose channels are aligned.
            sure = misalignment(bare)[:, 0] < SURE_PX
            phase = phase_misalignment(bare)
            phase_sure = (phase[:, 0] < SURE_PX) & (phase[:, 1] > SURE_RESPONSE)
            inner = np.zeros(image.shape[:2], bool)
            inner[RIM_PX:-RIM_PX, RIM_PX:-RIM_PX] = True
            row: dict = {"design": design, "scene": scene, "windows": int(sure.sum())}
            for name, picture in {**made, "floor": nothing}.items():
                row[name] = displaced(picture, sure, phase_sure)
                if name != "floor":
                    natural = compensate_vignetting(np.maximum(picture, 0), shading)
                    row[name] |= compare(natural, bare, inner)
                print_row({"design": design, "scene": scene, "picture": name, **row[name]})
            rows.append(row)
            if out:
                pictures = [matched_exposure(np.maximum(p, 0), bare, inner) for p in (*made.values(), bare)]
                save(out / f"aligned_{design}_{scene}.png", pictures)
    print(markdown(rows, COLUMNS), flush=True)
    return rows


def displaced(picture: np.ndarray, sure: np.ndarray, phase_sure: np.ndarray) -> dict[str, float]:
    found = misalignment(picture)
    moved, phase = found[sure, 0], phase_misalignment(picture)[phase_sure]
    return {
        "median_px": float(np.nanmedian(moved)),
        "most_px": float(np.nanpercentile(moved, 90)),
        "sure_px": float(np.median(found[found[:, 1] < SURE_PX, 0])),
        "phase_px": float(np.median(phase[phase[:, 1] > LEAST_RESPONSE, 0])),
    }


COLUMNS = {
    "design": "{design}",
    "scene": "{scene}",
    "registered before": "{before[median_px]:.2f}",
    "after": "{after[median_px]:.2f}, {after[most_px]:.2f}",
    "true depth": "{true depth[median_px]:.2f}",
    "all in focus": "{all in focus[median_px]:.2f}",
    "floor": "{floor[median_px]:.2f}",
    "phase before": "{before[phase_px]:.2f}",
    "after ": "{after[phase_px]:.2f}",
    "floor ": "{floor[phase_px]:.2f}",
    "PSNR before, after": "{before[psnr]:.1f}, {after[psnr]:.1f}",
    "SSIM": "{before[ssim]:.3f}, {after[ssim]:.3f}",
    "CIEDE2000": "{before[ciede2000]:.1f}, {after[ciede2000]:.1f}",
}


def window_rows(bench: Bench) -> list[dict]:
    """Measure aligned channels, those of the open aperture's captures, by the standard error of the windows."""
    found = np.concatenate([misalignment(bench.bare(scene)) for scene in SCENES])
    rows = []
    for low, high in ((0.0, 0.05), (0.05, 0.1), (0.1, 0.15), (0.15, 0.2), (0.2, 0.3), (0.3, 0.5), (0.5, 1.0)):
        read = found[(found[:, 1] >= low) & (found[:, 1] < high), 0]
        rows.append({"error": f"{low:g}-{high:g}", "read_px": float(np.median(read)), "windows": len(read)})
        print_row(rows[-1])
    print(markdown(rows, {"error": "{error}", "median": "{read_px:.2f}", "windows": "{windows}"}), flush=True)
    return rows


def bando_rows(folder: Path, out: Path | None) -> list[dict]:
    """Measure real photographs through RGB squares, by an uncalibrated camera and without truth."""
    rows = []
    for name in ("dog", "sheep"):
        image = read_image(folder / f"{name}.ppm")
        calibration = Calibration.uncalibrated("rgb_squares", width_px=image.shape[1], height_px=image.shape[0])
        config = default_config(calibration, "real-time")
        camera = CodedApertureCamera(calibration, replace(config, matcher=config.matcher.with_range(-3, 9)))
        frame = camera.measure(image)
        restored = restore(image, frame.disparity_px, camera, sigma_px=frame.disparity_sigma_px, sharpness="aligned")
        aligned = align_channels(image, frame.disparity_px, channel_shifts(calibration, "real-time"))
        for label, picture in (("before", image), ("by disparity", aligned), ("after", restored.color)):
            found = misalignment(picture, least_ncc=REAL_NCC)
            sure = found[found[:, 1] < SURE_PX, 0]
            phase = phase_misalignment(picture)
            steady = phase[phase[:, 1] > SURE_RESPONSE, 0]
            row = {"scene": name, "picture": label, "all_px": float(np.nanmedian(found[:, 0])),
                   "error_of_all_px": float(np.nanmedian(found[:, 1])), "windows": int(np.isfinite(found[:, 0]).sum()),
                   "sure_px": float(np.median(sure)), "sure_most_px": float(np.percentile(sure, 90)),
                   "sure_windows": len(sure), "phase_px": float(np.median(steady))}  # fmt: skip
            rows.append(row)
            print_row(row)
        if out:
            save(out / f"bando_{name}.png", [image, aligned, restored.color])
    print(markdown(rows, BANDO_COLUMNS), flush=True)
    return rows


BANDO_COLUMNS = {
    "photograph": "{scene}",
    "picture": "{picture}",
    "windows good to 0.1 px": "{sure_px:.2f}, {sure_most_px:.2f} ({sure_windows})",
    "all windows": "{all_px:.2f} ({windows})",
    "their own error": "{error_of_all_px:.2f}",
    "phase": "{phase_px:.2f}",
}
