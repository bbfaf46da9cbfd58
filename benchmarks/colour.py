"""Figures of the colour picture: light, alignment, restoration, all-in-focus.

    python benchmarks/colour.py --data DATA [PART...] [--out DIR]

DATA holds bench50/ and real/. Parts: light, alignment, bando, restoration, sharp, cmu. Needs scikit-image; PSNR, SSIM
and CIEDE2000 are of sRGB values after the exposure of each channel is matched.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np
from picture_quality import compare, matched_exposure, misalignment, phase_misalignment

from chromaperture.calibrate import calibrate_session
from chromaperture.calibration import Calibration
from chromaperture.camera import CodedApertureCamera, channel_shifts, default_config
from chromaperture.capture.files import read_image
from chromaperture.color.alignment import align_channels, linear_displacement, shift_back
from chromaperture.color.srgb import linear_to_srgb
from chromaperture.color.transparency import compensate_vignetting, flat_field, transparency
from chromaperture.depth.conversion import depth_to_disparity
from chromaperture.effects.restore import restore, white_gains

SCENES = ("still_life", "steps", "room", "desk")
PARALLAX = ("cy_halves", "cy_open", "rgb_squares", "cmy_circles")
LEVELS = {"black_level": 16, "white_level": 1016}
RIM_PX = 20


def cameras(data: Path) -> dict[str, Calibration]:
    lens, out = None, {}
    for design in PARALLAX:
        out[design] = calibrate_session(data / "bench50" / design, lens_from=lens).calibration
        lens = lens or out[design]
    return out


def light(data: Path, out: Path | None) -> list[dict]:
    """Tables 1 and 2, Figure 11."""
    from chromaperture.cli.transparency import draw, figures

    white = data / "bench50" / "white"
    bare = read_image(white / "open.png", **LEVELS)
    rows, maps = [], {}
    for design in ("rgb_squares", "cmy_circles", "cy_halves", "magenta_annulus", "cy_open"):
        sheet = read_image(white / f"{design}.png", **LEVELS)
        maps[design] = transparency(sheet, bare)
        rows.append({"design": design, **figures(sheet, bare, maps[design])})
    if out:
        draw(out / "transparency.png", maps)
    return rows


def truth_disparity(data: Path, scene: str, camera: CodedApertureCamera) -> np.ndarray:
    stored = cv2.imread(str(data / "bench50" / "truth" / f"{scene}.depth_0.1mm.png"), cv2.IMREAD_UNCHANGED) / 10.0
    return depth_to_disparity(np.where(stored > 0, stored, 2000.0), camera.depth_model).astype(np.float32)


def alignment(data: Path, out: Path | None) -> list[dict]:
    """Misalignment before and after; against the open capture: PSNR, SSIM, CIEDE2000."""
    rows = []
    for design, calibration in cameras(data).items():
        gains = white_gains(calibration)
        flat = flat_field(read_image(data / "bench50" / "white" / f"{design}.png", **LEVELS))
        flat_open = flat_field(read_image(data / "bench50" / "white" / "open.png", **LEVELS))
        for scene in SCENES:
            path = data / "bench50" / design / "scene" / f"{scene}.png"
            if not path.exists():
                continue
            image = read_image(path, **LEVELS)
            bare = compensate_vignetting(read_image(data / "bench50/open/scene" / f"{scene}.png", **LEVELS), flat_open)
            inner = np.zeros(image.shape[:2], bool)
            inner[RIM_PX:-RIM_PX, RIM_PX:-RIM_PX] = True
            pictures = {"before": image}
            for quality in ("real-time", "accurate"):
                camera = CodedApertureCamera(calibration, default_config(calibration, quality))
                frame = camera.measure(image)
                u = channel_shifts(calibration, quality)
                pictures[quality] = align_channels(image, frame.disparity_px, u)
                if quality == "accurate":
                    pictures["steadied"] = (
                        restore(image, frame.disparity_px, camera, sigma_px=frame.disparity_sigma_px,
                                sharpness="aligned").color / gains
                    )  # fmt: skip
                    true = truth_disparity(data, scene, camera)
                    pictures["true depth, no fill"] = shift_back(image, linear_displacement(true, u))
                    pictures["true depth"] = restore(image, true, camera, sharpness="aligned").color / gains
            floor, phase_floor = misalignment(bare), phase_misalignment(bare)
            told = (phase_floor[:, 0] < 0.1) & (phase_floor[:, 1] > 0.5)
            # Texture allows a figure where the open capture, whose channels are one view, registers.
            allowed = floor < 0.1
            for name, picture in pictures.items():
                natural = compensate_vignetting(np.maximum(picture, 0) * gains, flat)
                moved, phase = misalignment(picture)[allowed], phase_misalignment(picture)[told]
                rows.append({"design": design, "scene": scene, "picture": name, **compare(natural, bare, inner),
                             "misaligned_median_px": float(np.nanmedian(moved)),
                             "misaligned_90_percent_px": float(np.nanpercentile(moved, 90)),
                             "phase_median_px": float(np.median(phase[phase[:, 1] > 0.3, 0])),
                             "open_median_px": float(np.nanmedian(floor)),
                             "windows": int(np.isfinite(moved).sum())})  # fmt: skip
                say(rows[-1])
            if out and scene == "still_life":
                save(out / f"{design}_{scene}.png", [matched_exposure(np.maximum(p, 0), bare, inner) for p in
                     (image, pictures["real-time"], pictures["steadied"], bare)])  # fmt: skip
    return rows


def bando(data: Path, out: Path | None) -> list[dict]:
    """Real photographs through RGB squares: misalignment before and after; there is no truth."""
    from dataclasses import replace

    rows = []
    for name in ("dog", "sheep"):
        image = read_image(data / "real" / "bando2008" / f"{name}.ppm")
        calibration = Calibration.uncalibrated("rgb_squares", width_px=image.shape[1], height_px=image.shape[0])
        config = default_config(calibration, "real-time")
        camera = CodedApertureCamera(calibration, replace(config, matcher=config.matcher.with_range(-3, 9)))
        frame = camera.measure(image)
        restored = restore(image, frame.disparity_px, camera, sigma_px=frame.disparity_sigma_px, sharpness="aligned")
        aligned = align_channels(image, frame.disparity_px, channel_shifts(calibration, "real-time"))
        for label, picture in (("before", image), ("after", aligned), ("steadied", restored.color)):
            # Real filters overlap in colour and the photographs are grainy: a lower score must do.
            moved = misalignment(picture, least_ncc=0.8)
            rows.append({"scene": name, "picture": label, "windows": int(np.isfinite(moved).sum()),
                         "misaligned_median_px": float(np.nanmedian(moved)),
                         "misaligned_75_percent_px": float(np.nanpercentile(moved, 75))})  # fmt: skip
            say(rows[-1])
        if out:
            save(out / f"bando_{name}.png", [image, aligned, restored.color])
    return rows


def restoration(data: Path, out: Path | None) -> list[dict]:
    """Pages to look at: captures and their restorations."""
    for design in ("cy_halves", "cy_open"):
        calibration = calibrate_session(data / "bench50" / design).calibration
        for quality in ("real-time", "accurate"):
            camera = CodedApertureCamera(calibration, default_config(calibration, quality))
            for scene in SCENES:
                image = read_image(data / "bench50" / design / "scene" / f"{scene}.png", **LEVELS)
                frame = camera.measure(image)
                modes = ("aligned", "fast", "full")
                made = [restore(image, frame.disparity_px, camera, sigma_px=frame.disparity_sigma_px, sharpness=m).color
                        for m in modes]  # fmt: skip
                if out:
                    gain = 0.9 / np.percentile(made[0], 99.5)
                    save(out / f"restored_{design}_{scene}_{quality}.png", [gain * p for p in (image, *made)])
    return []


def sharp(data: Path, out: Path | None) -> list[dict]:
    from sharp_pictures import simulated_rows

    return simulated_rows(out, say=say, save=save)


def cmu(data: Path, out: Path | None) -> list[dict]:
    from sharp_pictures import cmu_rows

    return cmu_rows(data / "real" / "cmu_dual_pixel", out, say=say, save=save)


def say(row: dict) -> None:
    print(json.dumps({k: round(v, 4) if isinstance(v, float) else v for k, v in row.items()}), flush=True)


def save(path: Path, pictures: list[np.ndarray]) -> None:
    """Write pictures as they are, two beside each other, 8-bit sRGB."""
    path.parent.mkdir(parents=True, exist_ok=True)
    tiles = [np.rint(linear_to_srgb(p) * 255).astype(np.uint8)[..., ::-1] for p in pictures]
    tiles += [np.zeros_like(tiles[0])] * (len(tiles) % 2)
    rows = [np.hstack(tiles[i : i + 2]) for i in range(0, len(tiles), 2)]
    cv2.imwrite(str(path), np.vstack(rows))


PARTS = {"light": light, "alignment": alignment, "bando": bando, "restoration": restoration, "sharp": sharp, "cmu": cmu}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)}; all when absent")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, help="write pictures here")
    args = parser.parse_args()
    unknown = set(args.parts) - set(PARTS)
    if unknown:
        parser.error(f"unknown part {', '.join(sorted(unknown))}: choose from {', '.join(PARTS)}")
    if args.out:
        args.out.mkdir(parents=True, exist_ok=True)
    for name in args.parts or PARTS:
        rows = PARTS[name](args.data, args.out)
        if name == "light":
            for row in rows:
                say(row)


if __name__ == "__main__":
    main()
