"""Find the weights of the learned error bar of `accurate`, and write ``matching/learned_error_bar.json``.

    python benchmarks/world_scenes.py cameras --out cameras
    python benchmarks/world_scenes.py draw --out pictures
    python benchmarks/error_bar_training.py measure cameras --pictures pictures --out measured
    python benchmarks/error_bar_training.py fit measured [--write]

``measure`` measures the scenes for choosing (even numbers) by their cameras, and those of cameras whose blur is known
again by NAME_views.asdf, calibrated with ``--no-blur``, where there is one. Of every block it keeps the signs of an
error (`learned_error_bar.signs`) and the error in labels. ``fit`` finds the weights for either kind of evidence: the
sum of two quantile losses (Koenker and Bassett 1978), so that as many errors lie within one and two bars as `SHARES`,
whatever the signs. Every scene counts the same. Scores are those of scenes not learned from, in four parts.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from chromaperture.camera.camera import CodedApertureCamera, load_camera
from chromaperture.depth.conversion import depth_to_disparity
from chromaperture.matching import accurate, learned_error_bar
from chromaperture.matching.blocks import BLOCK_PX

SHARES = (0.64, 0.93)  # of the errors, within one and two bars
LEAST_ERROR = 0.02  # labels; smaller ones are as good as none, and their logarithm would count
SOFTNESS = 0.05  # of the quantile loss at 0, so that it has a derivative
RIDGE = 1e-3  # of the weights of signs in units of their standard deviation
PARTS = 4


def measured(camera: CodedApertureCamera, image: np.ndarray, truth_mm: np.ndarray) -> dict[str, np.ndarray]:
    """Return the signs of every block of a photograph whose depth is known and was answered, and its error."""
    kept: dict[str, np.ndarray] = {}
    signs = learned_error_bar.signs

    def keep(*args: object) -> dict[str, np.ndarray]:
        kept.update(signs(*args))
        return {name: part.copy() for name, part in kept.items()}

    accurate.signs = keep  # type: ignore[assignment]
    try:
        frame = camera.measure(image)
    finally:
        accurate.signs = signs
    labels_px, label_map = camera.method.labels_px, camera.method.label_map  # type: ignore[attr-defined]
    label_px = np.broadcast_to(label_map.scale, truth_mm.shape) * (labels_px[1] - labels_px[0])
    error = np.abs(frame.disparity_px - depth_to_disparity(truth_mm, camera.depth_model)) / label_px
    height, width = next(iter(kept.values())).shape
    middles = error[BLOCK_PX // 2 :: BLOCK_PX, BLOCK_PX // 2 :: BLOCK_PX][:height, :width]
    known = np.isfinite(middles)
    return {name: part[known] for name, part in kept.items()} | {"error": middles[known].astype(np.float32)}


def measure(args: argparse.Namespace) -> None:
    """Measure the scenes for choosing, and keep signs and errors."""
    args.out.mkdir(parents=True, exist_ok=True)
    cameras = {path.stem: load_camera(path, quality="accurate", scale=1, device="cpu")
               for path in sorted(args.cameras.glob("*.asdf"))}  # fmt: skip
    for path in sorted(args.pictures.glob("*.npz")):
        with np.load(path) as scene:
            name, part, image, truth_mm = (scene[key] for key in ("camera", "part", "image", "truth_mm"))
        for kind, file in (("blur", str(name)), ("views", f"{name}_views")):
            out = args.out / f"{kind}-{path.stem}.npz"
            if str(part) == "choosing" and file in cameras and not out.exists():
                np.savez_compressed(out, **measured(cameras[file], image, truth_mm.astype(float)))
                print(out.name, flush=True)


def loss(parameters: np.ndarray, signs: np.ndarray, error: np.ndarray, weight: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the weighted quantile losses of both shares, and their derivative."""
    away = error - signs @ parameters
    total, slope = 0.0, np.zeros(len(error))
    for share, bars in zip(SHARES, (1, 2), strict=True):
        left = away - np.log(bars)
        soft = np.hypot(left, SOFTNESS)
        total += float(weight @ (0.5 * soft + (share - 0.5) * left))
        slope += weight * (0.5 * left / soft + share - 0.5)
    ridge = RIDGE * np.append(parameters[:-1], 0)
    return total + float(ridge @ parameters) / 2, -signs.T @ slope + ridge


def fitted(scenes: list[dict[str, np.ndarray]], names: list[str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return weights and constant, and the least and greatest signs that were seen (1st and 99th percentile)."""
    signs = np.concatenate([np.stack([scene[name] for name in names], axis=1) for scene in scenes]).astype(float)
    least, most = np.percentile(signs, (1, 99), axis=0)
    signs = np.clip(signs, least, most)
    mean, spread = signs.mean(axis=0), np.maximum(signs.std(axis=0), 1e-6)
    error = np.log(np.maximum(np.concatenate([scene["error"] for scene in scenes]), LEAST_ERROR))
    weight = np.concatenate([np.full(len(s["error"]), 1 / len(s["error"]) / len(scenes)) for s in scenes])
    units = np.column_stack([(signs - mean) / spread, np.ones(len(signs))])
    found = minimize(loss, np.zeros(len(names) + 1), (units, error, weight), jac=True, method="L-BFGS-B").x
    weights = found[:-1] / spread
    return np.append(weights, found[-1] - weights @ mean), least, most


def within(scene: dict[str, np.ndarray], names: list[str], model: tuple[np.ndarray, np.ndarray, np.ndarray]) -> list:
    """Return the shares of a scene's errors within one and two bars."""
    parameters, least, most = model
    signs = np.clip(np.stack([scene[name] for name in names], axis=1), least, most)
    bar = np.exp(signs @ parameters[:-1] + parameters[-1])
    return [float((scene["error"] < bars * bar).mean()) for bars in (1, 2)]


def fit(args: argparse.Namespace) -> None:
    """Find the weights of either kind, print scores of scenes not learned from, and write them."""
    stored = {}
    for kind in ("blur", "views"):
        scenes = [dict(np.load(path)) for path in sorted(args.measured.glob(f"{kind}-*.npz"))]
        names = [name for name in scenes[0] if name != "error"]
        others = [
            within(scene, names, fitted([s for j, s in enumerate(scenes) if j % PARTS != i % PARTS], names))
            for i, scene in enumerate(scenes)
        ]
        mean, error = np.mean(others, axis=0), np.std(others, axis=0) / np.sqrt(len(others))
        print(f"{kind}: {len(scenes)} scenes, within 1 / 2 bars {mean.round(3)} +- {error.round(3)}")
        parameters, least, most = fitted(scenes, names)
        rows = zip(names, parameters, least, most, strict=False)
        table = {name: [round(float(v), 4) for v in row] for name, *row in rows}
        print(json.dumps({name: row[0] for name, row in table.items()}))
        columns = dict(zip(("weights", "least", "most"), zip(*table.values(), strict=True), strict=True))
        stored[kind] = {"constant": round(float(parameters[-1]), 4)} | {
            key: dict(zip(table, values, strict=True)) for key, values in columns.items()
        }
    if args.write:
        Path(learned_error_bar.__file__).with_suffix(".json").write_text(json.dumps(stored, indent=1) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    measuring = commands.add_parser("measure")
    measuring.add_argument("cameras", type=Path)
    measuring.add_argument("--pictures", type=Path, required=True)
    measuring.add_argument("--out", type=Path, required=True)
    fitting = commands.add_parser("fit")
    fitting.add_argument("measured", type=Path)
    fitting.add_argument("--write", action="store_true")
    args = parser.parse_args()
    (measure if args.command == "measure" else fit)(args)


if __name__ == "__main__":
    main()
