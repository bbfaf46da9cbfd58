"""Find `plane_voting.OF_GUIDED`, by which fits of planes whose areas the guide bounds vote against their surface.

    python benchmarks/error_bar_training.py draw II.asdf --lens achromat_50 --focus-mm 1800 --rooms --out pictures
    ...                                                                             # every other camera
    python benchmarks/plane_voting_training.py measure *.asdf --pictures pictures --out measured
    python benchmarks/plane_voting_training.py fit measured [--aside NAME ...]

``measure`` measures the pictures whose names begin with a camera file's, and keeps, of every block, the labels and the
signs of `signs_of_trust` of every fit, and whether each plane and the surface are within 2 and within 5 % of the true
distance. What is there already is not measured again. ``fit`` finds the weights by logistic regression (Newton's
method) on the blocks where both are more than a label apart: the answer is which of both is within more of the two
limits, a difference of two counts twice, and cameras count alike. It prints the weights, and what votes gain for every
camera against the first fit where `where_they_agree` takes it, by weights of the other scenes (four parts), and by
weights of the other cameras; ``--aside`` names cameras that are not learned from.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from chromaperture.camera import CodedApertureCamera, load_camera
from chromaperture.config import AccurateConfig
from chromaperture.depth.conversion import disparity_to_depth
from chromaperture.disparity import planar, plane_voting
from chromaperture.disparity.accurate import AccurateMethod
from chromaperture.disparity.plane_agreement import where_they_agree

LIMITS = 0.02, 0.05  # of the true distance
PARTS = 4
NEWTON_STEPS = 20
NAMES = tuple(plane_voting.OF_GUIDED.weights)

Scene = dict[str, np.ndarray]


def measure(args: argparse.Namespace) -> None:
    """Measure pictures; keep signs, and which of planes and surface is right."""
    args.out.mkdir(parents=True, exist_ok=True)
    for file in args.cameras:
        camera = guided(load_camera(file, quality="accurate", scale=1, device="cpu"))
        for path in sorted(args.pictures.glob(f"{file.stem}_*.npz")):
            if not (args.out / path.name).exists():
                with np.load(path) as picture:
                    np.savez(args.out / path.name, **kept(camera, picture["image"], picture["truth_mm"]))
                print(path.name, flush=True)


def guided(camera: CodedApertureCamera) -> CodedApertureCamera:
    """Return a camera whose planes end where the guide has edges."""
    matcher = camera.config.matcher
    assert isinstance(matcher, AccurateConfig)
    return CodedApertureCamera(camera.calibration, replace(camera.config, matcher=matcher.with_guided_borders()))


def kept(camera: CodedApertureCamera, image: np.ndarray, truth_mm: np.ndarray) -> Scene:
    """Return signs and labels of blocks, (K, h, w) or (h, w), and what is right there, (2, K, h, w) or (2, h, w)."""
    method = camera.method
    assert isinstance(method, AccurateMethod)
    told: dict[str, np.ndarray] = {}
    labels: dict[str, np.ndarray] = {}

    def asked(fits, surface_px, sigma_px, step_px, block_px, *, trust=None):
        told.update(plane_voting.signs_of_trust(fits, surface_px, sigma_px, step_px, block_px))
        labels["plane"] = np.stack([fit.label_px for fit in fits])
        labels["surface"] = surface_px
        labels["before"] = where_they_agree(fits[0], surface_px, np.hypot(sigma_px, step_px))
        some = middles(block_px)
        told["plane"], told["surface"] = labels["plane"][some] / step_px, labels["surface"][some] / step_px
        told["block_px"] = np.array(block_px)
        return real(fits, surface_px, sigma_px, step_px, block_px, trust=trust)

    real, planar.voted_planes = planar.voted_planes, asked
    try:
        camera.measure(image)
    finally:
        planar.voted_planes = real
    for name, label in labels.items():
        maps = [
            np.asarray(method.label_map.disparity(one), np.float32) for one in label.reshape(-1, *image.shape[:2])
        ]
        depth = np.stack([disparity_to_depth(np.ascontiguousarray(one), camera.depth_model)[0] for one in maps])
        error = np.nan_to_num(np.abs(depth - truth_mm) / truth_mm, nan=np.inf).reshape(label.shape)
        told[f"{name}_right"] = np.stack([error[middles(int(told["block_px"]))] < limit for limit in LIMITS])
    height, width = told["rough"].shape
    return {name: values[..., :height, :width] if values.ndim else values for name, values in told.items()}


def middles(block_px: int) -> tuple:
    """Return the places of blocks' middle pixels."""
    return np.s_[..., block_px // 2 :: block_px, block_px // 2 :: block_px]


def columns_of(scene: Scene) -> np.ndarray:
    """Return the signs of every fit's blocks and a 1 each, (K, h, w, signs + 1)."""
    shape = scene["plane"].shape
    return np.stack([np.broadcast_to(scene[name], shape) for name in NAMES] + [np.ones(shape)], axis=-1)


def weights_of(cameras: Sequence[Sequence[Scene]]) -> np.ndarray:
    """Return the weights of `NAMES` and the constant; cameras count alike."""
    signs, answers, counts = [], [], []
    for scenes in cameras:
        for scene in scenes:
            gain = scene["plane_right"].sum(axis=0, dtype=int) - scene["surface_right"].sum(axis=0, dtype=int)
            differ = (gain != 0) & (np.abs(scene["plane"] - scene["surface"]) > 1)
            signs.append(columns_of(scene)[differ])
            answers.append(gain[differ] > 0)
            counts.append(np.abs(gain[differ]) / len(scenes))
    x, y, count = np.concatenate(signs).astype(float), np.concatenate(answers), np.concatenate(counts)
    found = np.zeros(x.shape[1])
    for _ in range(NEWTON_STEPS):
        likely = 1 / (1 + np.exp(-x @ found))
        bend = (x * (count * likely * (1 - likely))[:, None]).T @ x
        found -= np.linalg.solve(bend, x.T @ (count * (likely - y)))
    return found


def gained(scene: Scene, weights: np.ndarray) -> np.ndarray:
    """Return the shares within `LIMITS` less those of the first fit where `where_they_agree` takes it; (2,)."""
    of_planes, of_surface = plane_voting.votes(scene["plane"], scene["surface"], columns_of(scene) @ weights)
    best = plane_voting.chosen_fit(of_planes)[None]
    label = np.take_along_axis(scene["plane"], best, axis=0)[0]
    taken = (of_planes.max(axis=0) >= of_surface) | (np.abs(label - scene["surface"]) <= 1)
    plane = np.stack([np.take_along_axis(right, best, axis=0)[0] for right in scene["plane_right"]])
    right = np.where(taken, plane, scene["surface_right"])
    return np.asarray(right.mean(axis=(1, 2)) - scene["before_right"].mean(axis=(1, 2)))


def fit(args: argparse.Namespace) -> None:
    """Learn, score, and print the weights."""
    cameras: dict[str, list[Scene]] = {}
    for path in sorted(args.measured.glob("*.npz")):
        with np.load(path) as scene:
            cameras.setdefault(path.stem.rsplit("_", 1)[0], []).append(dict(scene))
    learned = {name: scenes for name, scenes in cameras.items() if name not in args.aside}
    everything = weights_of(list(learned.values()))
    parts = [
        weights_of([[scene for i, scene in enumerate(scenes) if i % PARTS != part] for scenes in learned.values()])
        for part in range(PARTS)
    ]
    print("camera, scenes, gain within 2 and 5 % by other scenes (+- standard error), by other cameras")
    for name, scenes in cameras.items():
        others = [part for other, part in learned.items() if other != name]
        models = [parts[i % PARTS] if name in learned else everything for i in range(len(scenes))]
        gains = np.array([gained(scene, model) for scene, model in zip(scenes, models, strict=True)])
        error = gains.std(axis=0) / np.sqrt(len(gains))
        line = "  ".join(f"{g:+.3f} +- {e:.3f}" for g, e in zip(gains.mean(axis=0), error, strict=True))
        if others:
            model = weights_of(others)
            by_others = np.mean([gained(scene, model) for scene in scenes], axis=0)
            line += "   " + "  ".join(f"{gain:+.3f}" for gain in by_others)
        print(f"  {name:16} {len(scenes):3}   {line}")
    print({name: round(float(w), 2) for name, w in zip((*NAMES, "constant"), everything, strict=True)})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    one = commands.add_parser("measure")
    one.add_argument("cameras", type=Path, nargs="+")
    one.add_argument("--pictures", type=Path, required=True)
    one.add_argument("--out", type=Path, required=True)
    one.set_defaults(run=measure)
    two = commands.add_parser("fit")
    two.add_argument("measured", type=Path)
    two.add_argument("--aside", nargs="+", default=[], help="names of cameras that are not learned from")
    two.set_defaults(run=fit)
    args = parser.parse_args()
    args.run(args)


if __name__ == "__main__":
    main()
