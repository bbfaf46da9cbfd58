"""Fit the error bar of `real-time` to random captures of known depth, and show how it does on them.

    python benchmarks/real_time_error_bar.py *.asdf --pictures FOLDER

Cameras and pictures are those of ``error_bar_training.py draw``: NAME_SEED.npz belongs to the camera NAME.asdf. Of
every cell, 4 x 4 px, the logarithms of the four signs of `disparity.stages.place.error_bar` are kept, and the error in
steps between labels. The weights of the logarithms are found as ``error_bar_training.py`` finds those of `accurate`.
Printed are the constants of `stages.place` that follow, and of every camera the errors within one and two of the bars
that the package has now.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from error_bar_training import Scene, fitted, scores

from chromaperture.camera import CodedApertureCamera, load_camera
from chromaperture.depth.conversion import depth_to_disparity
from chromaperture.disparity import cpu
from chromaperture.disparity.error_bar import local_range
from chromaperture.disparity.stages.place import EDGE_REACH_PX, LEAST_SIGNS

SIGNS = ("information", "posterior", "extent", "likelihood")  # as `error_bar` takes them


def kept(camera: CodedApertureCamera, image: np.ndarray, truth_mm: np.ndarray) -> Scene:
    """Measure an image; signs, errors and bars of all cells that have a depth, (N,) each; lengths in steps."""
    told = {}

    def watched(winner, place, information, layers_px, label_map, mask, *, cell_px=1):
        step = float(layers_px[1] - layers_px[0])
        surface = label_map.disparity(layers_px[0] + step * place)
        extent = local_range(surface, -(-EDGE_REACH_PX // cell_px)) / (label_map.scale * step)
        signs = information, winner.sigma_px / step, extent, winner.at
        found = {n: np.log(np.maximum(s, least)) for n, s, least in zip(SIGNS, signs, LEAST_SIGNS, strict=True)}
        told.update(found=found, step=2 * step, spacing=2 * cell_px)  # of the photograph, not of the halved picture
        return real(winner, place, information, layers_px, label_map, mask, cell_px=cell_px)

    real, cpu.halved_surface = cpu.halved_surface, watched
    try:
        frame = camera.measure(image)
    finally:
        cpu.halved_surface = real
    step = camera.method.label_map.scale * told["step"]
    error = np.abs(frame.disparity_px - depth_to_disparity(truth_mm, camera.depth_model)) / step
    maps = {
        "error": error,
        "relative": np.abs(frame.depth_mm - truth_mm) / truth_mm,
        "share_of_step": frame.sigma_mm / frame.disparity_sigma_px * step / frame.depth_mm,
        "bar": frame.disparity_sigma_px / step,
    }
    cells = {name: values[:: told["spacing"], :: told["spacing"]] for name, values in maps.items()} | told["found"]
    known = np.isfinite(cells["error"])
    return {name: np.asarray(values[known], np.float32) for name, values in cells.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cameras", type=Path, nargs="+")
    parser.add_argument("--pictures", type=Path, required=True)
    args = parser.parse_args()
    everything: list[Scene] = []
    print("camera, scenes, within 1 bar (least, mean, greatest tenth), within 2, area under the curve at 2 %")
    for file in args.cameras:
        camera, scenes = load_camera(file, quality="real-time", device="cpu"), []
        for path in sorted(args.pictures.glob(f"{file.stem}_*.npz")):
            with np.load(path) as picture:
                scenes.append(kept(camera, picture["image"], picture["truth_mm"]))
        together = {name: np.concatenate([scene[name] for scene in scenes]) for name in scenes[0]}
        *shares, area = scores(together, together["bar"])
        parts = ["  ".join(f"{f(part):.2f}" for f in (min, np.mean, max)) for part in (shares[:10], shares[10:])]
        print(f"{file.stem:10} {len(scenes):3}   {parts[0]}   {parts[1]}   {area:.3f}", flush=True)
        everything += scenes
    model = fitted(everything, SIGNS)
    powers = ", ".join(f"{weight:.2f}" for weight in model.weights)
    print(f"BAR_LEVEL = {np.exp(model.constant):.2f}; BAR_POWERS = ({powers})")


if __name__ == "__main__":
    main()
