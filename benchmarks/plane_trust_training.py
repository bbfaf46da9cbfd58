"""Find the weights of `plane_trust.py`, by which `accurate` takes planes or the surface that they explain.

    python benchmarks/error_bar_training.py draw II.asdf --lens achromat_50 --focus-mm 1800 --out pictures
    ...                                                                             # every other camera
    python benchmarks/plane_trust_training.py measure *.asdf --pictures pictures --out measured
    python benchmarks/plane_trust_training.py fit measured [--aside NAME ...]

``measure`` measures the pictures whose names begin with a camera file's, and keeps, of every fourth pixel in both
directions, the signs of `signs_of_trust`, and whether the plane and the surface are within 2 and within 5 % of the true
distance. What is there already is not measured again. ``fit`` finds the weights by logistic regression (Newton's
method) on the pixels where both are more than a label apart: the answer is which of both is within more of the two
limits, a difference of two counts twice, and cameras count alike. It prints the weights, and what they gain for every
camera against `where_they_agree` alone, by weights of the other scenes (four parts), and by weights of the other
cameras; ``--aside`` names cameras that are not learned from.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from chromaperture.camera import CodedApertureCamera, load_camera
from chromaperture.depth.conversion import disparity_to_depth
from chromaperture.disparity import accurate, plane_trust

EVERY_PX = 4
LIMITS = 0.02, 0.05  # of the true distance
PARTS = 4
NEWTON_STEPS = 20
NAMES = tuple(plane_trust.WEIGHTS)

Scene = dict[str, np.ndarray]


def measure(args: argparse.Namespace) -> None:
    """Measure pictures; keep signs, and which of planes and surface is right."""
    args.out.mkdir(parents=True, exist_ok=True)
    for file in args.cameras:
        camera = load_camera(file, quality="accurate", scale=1, device="cpu")
        for path in sorted(args.pictures.glob(f"{file.stem}_*.npz")):
            if not (args.out / path.name).exists():
                with np.load(path) as picture:
                    np.savez(args.out / path.name, **kept(camera, picture["image"], picture["truth_mm"]))
                print(path.name, flush=True)


def kept(camera: CodedApertureCamera, image: np.ndarray, truth_mm: np.ndarray) -> Scene:
    """Return the signs of some pixels, (P,) each, and what is right there, (2, P) bool each."""
    told: dict[str, np.ndarray] = {}

    def asked(planes, surface_px, sigma_px, step_px):
        told.update(plane_trust.signs_of_trust(planes, surface_px, sigma_px, step_px))
        agreed = plane_trust.where_they_agree(planes, surface_px, np.hypot(sigma_px, step_px))
        told.update(plane=planes.label_px, surface=surface_px, before=agreed)
        told["apart"] = np.abs(planes.label_px - surface_px) > step_px
        return real(planes, surface_px, sigma_px, step_px)

    real, accurate.planes_or_surface = accurate.planes_or_surface, asked
    try:
        camera.measure(image)
    finally:
        accurate.planes_or_surface = real
    some = np.s_[EVERY_PX // 2 :: EVERY_PX, EVERY_PX // 2 :: EVERY_PX]
    out = {name: np.asarray(told[name][some].ravel(), np.float32) for name in NAMES}
    out["apart"] = told["apart"][some].ravel()
    for name in ("plane", "surface", "before"):
        disparity = np.asarray(camera.method.label_map.disparity(told[name]), np.float32)
        depth = disparity_to_depth(np.ascontiguousarray(disparity), camera.depth_model)[0]
        error = np.nan_to_num(np.abs(depth - truth_mm) / truth_mm, nan=np.inf)[some].ravel()
        out[f"{name}_right"] = np.stack([error < limit for limit in LIMITS])
    return out


def weights_of(cameras: Sequence[Sequence[Scene]]) -> np.ndarray:
    """Return the weights of `NAMES` and the constant; cameras count alike."""
    signs, answers, counts = [], [], []
    for scenes in cameras:
        for scene in scenes:
            gain = scene["plane_right"].sum(axis=0, dtype=int) - scene["surface_right"].sum(axis=0, dtype=int)
            differ = (gain != 0) & scene["apart"]
            signs.append(np.stack([scene[name][differ] for name in NAMES] + [np.ones(differ.sum())], axis=1))
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
    """Return the shares within `LIMITS` less those of `where_they_agree` alone; (2,)."""
    trusted = sum(w * scene[name] for w, name in zip(weights, NAMES, strict=False)) + weights[-1] > 0
    right = np.where(trusted | ~scene["apart"], scene["plane_right"], scene["surface_right"])
    return np.asarray(right.mean(axis=1) - scene["before_right"].mean(axis=1))


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
