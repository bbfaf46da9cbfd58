"""Restored colour pictures on one page: python examples/colour_page.py --out colour.jpg."""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

import chromaperture as cap
from chromaperture.color.srgb import linear_to_srgb
from chromaperture.effects.refocusing import Focus, desaturate_background, refocus
from chromaperture.effects.restore import focus_radius, restore
from chromaperture.products.samples import sample_camera, sample_image


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("colour.jpg"))
    parser.add_argument("--sample", default="still_life_cy_halves")
    args = parser.parse_args()
    camera = cap.load_camera(sample_camera(args.sample), quality="accurate")
    image = cap.read_image(sample_image(args.sample), black_level=16, white_level=1016)
    frame = camera.measure(image)
    known = {"disparity_px": frame.disparity_px, "sigma_px": frame.disparity_sigma_px}
    aligned = restore(image, camera=camera, sharpness="aligned", **known)
    sharp = restore(image, camera=camera, **known)
    near, far = (focus_radius(camera, z) for z in (1450.0, 3600.0))
    pictures = {
        "capture through cyan and yellow halves": image,
        "channels aligned, film's tint removed": aligned.color,
        "all in focus": sharp.color,
        "focused at 1.45 m, pupil 1.5 times as wide": refocus(sharp.color, sharp.radius_px, Focus(near, 1.5)),
        "focused at 3.6 m": refocus(sharp.color, sharp.radius_px, Focus(far, 1.5, "hex")),
        "background desaturated": desaturate_background(sharp.color, sharp.radius_px, near),
    }
    gain = 0.9 / np.percentile(aligned.color, 99.5)
    tiles = []
    for title, picture in pictures.items():
        tile = np.rint(linear_to_srgb(np.maximum(picture, 0) * gain) * 255).astype(np.uint8)[..., ::-1].copy()
        tile[-22:] = tile[-22:] // 4
        cv2.putText(tile, title, (8, tile.shape[0] - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (240, 240, 240), 1, cv2.LINE_AA)
        tiles.append(tile)
    page = np.vstack([np.hstack(tiles[i : i + 2]) for i in range(0, len(tiles), 2)])
    ok, encoded = cv2.imencode(args.out.suffix, page, [cv2.IMWRITE_JPEG_QUALITY, 82])
    if not ok:
        raise SystemExit(f"cannot write {args.out}")
    args.out.write_bytes(encoded.tobytes())


if __name__ == "__main__":
    main()
