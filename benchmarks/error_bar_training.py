"""Find the weights of the learned error bar of `accurate`, and write ``disparity/learned_error_bar.json``.

    chromaperture simulate II --design rgb_squares --lens achromat_50 --focus-mm 1800 --width 360 --height 240 \
        --sensor-width-mm 11.15 --nearest-mm 900 --farthest-mm 3600 --step-mm 300 --tilts 8 --cells 12
    chromaperture calibrate II --out II.asdf
    python benchmarks/error_bar_training.py draw II.asdf --lens achromat_50 --focus-mm 1800 --out pictures
    ...                                                                             # every other camera
    python benchmarks/error_bar_training.py measure *.asdf --pictures pictures --out measured
    python benchmarks/error_bar_training.py fit measured [--level OTHERS] [--aside NAME ...] [--keep SHARE] [--write]

``draw`` renders random scenes (``error_bar_scenes.py``, ``furnished_rooms.py``) through the camera's lens and design,
with several exposures, into NAME_SEED.npz. ``measure`` measures the pictures whose names begin with a camera file's,
and keeps, of every sixth pixel in both directions, the signs of an error (``signs`` of
``disparity/learned_error_bar.py``) and the error in steps between labels; what is there already is not measured again.
``fit`` finds the weights: the sum of two quantile losses (Koenker and Bassett 1978), so that as many errors lie within
one and two bars as `SHARES`, whatever the signs. Scenes whose file's name begins with one of the names of ``--aside``
are not learned from; all are scored, those that are learned from by weights of the other scenes (four parts). With
``--level`` other scenes set the constant: how long bars are follows from them, what makes them longer from all. With
``--keep`` the written weights are the mean of those found and those stored, which count that share: what was learned
from scenes that are gone is not forgotten. Bars are as long as those found alone, in the geometric mean of all scenes.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from chromaperture.camera import load_camera
from chromaperture.camera_file import Calibration
from chromaperture.depth.conversion import depth_to_disparity
from chromaperture.disparity import accurate, learned_error_bar
from chromaperture.optics.aperture import DESIGNS, made_of
from chromaperture.optics.paraxial import focused_at
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.ray_table import lens_rays

EVERY_PX = 6
# Of the errors, within one and two bars. Of Gaussian errors they are .68 and .95. Errors here have a heavy tail: both
# losses together leave .75 and .89 of 128 rooms, .77 and .89 of 168 other scenes, with a quarter of the weights of
# before kept .74 and .88, .78 and .89; .93 and .97 of steps, room and desk.
SHARES = (0.72, 0.92)
LEAST_ERROR = 0.01  # steps; smaller ones are as good as none, and their logarithm would count
SOFTNESS = 0.05  # of the quantile loss at 0, so that it has a derivative
RIDGE = 1e-3  # of the weights of signs in units of their standard deviation
TRUTH = ("error", "relative", "share_of_step")  # what is kept beside the signs
EXPOSURES = (0.2, 0.5, 0.9, 0.9, 0.9)  # of the white level


def draw(args: argparse.Namespace) -> None:
    """Render scenes and keep them with their truth."""
    from error_bar_scenes import (  # their photographs are scikit-image's, not needed to fit
        few_surfaces,
        photographed,
        random_scene,
    )
    from furnished_rooms import bent_things, furnished_room

    calibration = Calibration.load(args.camera)
    sensor = calibration.sensor
    size = {"width_px": sensor.width_px, "height_px": sensor.height_px, "pixel_pitch_mm": sensor.pixel_pitch_mm}
    design = made_of(DESIGNS[args.design or calibration.aperture.name], args.film)
    table = lens_rays(focused_at(load_lens(args.lens), args.focus_mm), design, cells=12, **size)
    half_field = sensor.pixel_pitch_mm * np.array([sensor.width_px, sensor.height_px]) / 2 / table.z_mm
    args.out.mkdir(parents=True, exist_ok=True)
    for seed in range(args.first, args.first + args.scenes):
        fields = half_field[0], half_field[1]
        if args.rooms:
            planes = furnished_room(seed, fields) + bent_things(seed, fields)
        else:
            planes = (few_surfaces if seed % 2 else random_scene)(seed, fields)
        image, truth = photographed(table, planes, seed=seed, exposures=EXPOSURES)
        maps = {"image": image.astype(np.float32), "truth_mm": truth.astype(np.float32)}
        np.savez(args.out / f"{args.camera.stem}_{seed}.npz", **maps)


def measure(args: argparse.Namespace) -> None:
    """Measure pictures and keep signs and errors."""
    args.out.mkdir(parents=True, exist_ok=True)
    for file in args.cameras:
        camera = load_camera(file, quality="accurate", scale=1, device="cpu")  # errors are those of the matched pixels
        for path in sorted(args.pictures.glob(f"{file.stem}_*.npz")):
            if not (args.out / path.name).exists():
                with np.load(path) as picture:
                    np.savez(args.out / path.name, **kept(camera, picture["image"], picture["truth_mm"]))


def kept(camera, image: np.ndarray, truth_mm: np.ndarray) -> dict[str, np.ndarray]:
    """Measure an image; signs and errors of some pixels."""
    told = {}

    def judged(surface, extent_px, labels_px, **options):
        step = float(labels_px[1] - labels_px[0])
        found = learned_error_bar.signs(
            surface, step, first_px=options["first_px"], explained_by=options["explained_by"]
        )
        told.update(found=found, step=step)
        return real(surface, extent_px, labels_px, **options)

    real, accurate.judged = accurate.judged, judged
    try:
        frame = camera.measure(image)
    finally:
        accurate.judged = real
    truth_px = depth_to_disparity(truth_mm, camera.depth_model)
    error = np.abs(frame.disparity_px - truth_px) / (camera.method.label_map.scale * told["step"])
    some = np.s_[EVERY_PX // 2 :: EVERY_PX, EVERY_PX // 2 :: EVERY_PX]
    known = np.isfinite(error[some])
    relative = np.abs(frame.depth_mm - truth_mm) / truth_mm
    mm_of_step = frame.sigma_mm / frame.disparity_sigma_px * camera.method.label_map.scale * told["step"]
    maps = {"error": error, "relative": relative, "share_of_step": mm_of_step / frame.depth_mm} | told["found"]
    return {name: np.asarray(values[some][known], np.float32) for name, values in maps.items()}


Scene = dict[str, np.ndarray]


def matrix(scene: Scene, names: Sequence[str]) -> np.ndarray:
    return np.stack([scene[name] for name in names], axis=1).astype(float)


def fitted(
    scenes: Sequence[Scene], names: Sequence[str], shares: tuple[float, float] = SHARES
) -> learned_error_bar.Weights:
    """Find weights; every scene counts alike."""
    found = np.concatenate([matrix(scene, names) for scene in scenes])
    least, most = np.percentile(found, (0.5, 99.5), axis=0)
    found = np.clip(found, least, most)
    mean, spread = found.mean(axis=0), found.std(axis=0) + 1e-6
    terms = np.concatenate([(found - mean) / spread, np.ones((len(found), 1))], axis=1)
    error = np.concatenate([np.log(np.maximum(scene["error"], LEAST_ERROR)) for scene in scenes])
    count = np.concatenate([np.full(len(scene["error"]), 1 / len(scene["error"])) for scene in scenes]) / len(scenes)

    def loss(w: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = RIDGE * float(w[:-1] @ w[:-1]), np.append(2 * RIDGE * w[:-1], 0)
        for bars, share in enumerate(shares, start=1):
            beyond = (error - terms @ w - np.log(bars)) / SOFTNESS
            value += float(count @ (SOFTNESS * np.logaddexp(0, beyond) - (1 - share) * SOFTNESS * beyond))
            slope -= terms.T @ (count * (1 / (1 + np.exp(-np.clip(beyond, -50, 50))) - (1 - share)))
        return value, slope

    start = np.append(np.zeros(len(names)), np.log(np.median(np.exp(error))))
    w = minimize(loss, start, jac=True, method="L-BFGS-B").x
    weights = w[:-1] / spread
    return learned_error_bar.Weights(tuple(names), weights, float(w[-1] - weights @ mean), least, most)


def leveled(model: learned_error_bar.Weights, scenes: Sequence[Scene]) -> learned_error_bar.Weights:
    """Find the constant anew, by the same losses over other scenes."""
    ratios = [np.log(np.maximum(scene["error"], LEAST_ERROR) / bars_of(model, scene)) for scene in scenes]

    def loss(more: float) -> float:
        found = 0.0
        for bars, share in enumerate(SHARES, start=1):
            beyond = [ratio - more - np.log(bars) for ratio in ratios]
            found += float(np.mean([np.mean(np.maximum(share * part, (share - 1) * part)) for part in beyond]))
        return found

    return model._replace(constant=model.constant + float(minimize_scalar(loss, bounds=(-3, 3), method="bounded").x))


def bars_of(model: learned_error_bar.Weights, scene: Scene) -> np.ndarray:
    return np.exp(model.constant + np.clip(matrix(scene, model.names), model.least, model.most) @ model.weights)


def scores(scene: Scene, bar: np.ndarray) -> np.ndarray:
    """Share within 1 and 2 bars by tenth, (20,), then the area under the risk-coverage curve, at 2 %."""
    order = np.argsort(bar * scene["share_of_step"])
    in_bars = np.array_split((scene["error"] / bar)[order], 10)
    wrong = (scene["relative"] > 0.02)[order]
    area = (np.cumsum(wrong) / np.arange(1, len(wrong) + 1)).mean()
    return np.array([(part < bars).mean() for bars in (1, 2) for part in in_bars] + [area])


def fit(args: argparse.Namespace) -> None:
    """Learn, score, and write the weights."""
    scenes = {path.stem: dict(np.load(path)) for path in sorted(args.measured.glob("*.npz"))}
    path = Path(learned_error_bar.__file__).with_suffix(".json")
    stored = json.loads(path.read_text(encoding="utf-8"))
    for kind in args.only:
        these = {name: scene for name, scene in scenes.items() if ("rejected" in scene) == (kind == "planes")}
        learned = [name for name in these if not name.startswith(tuple(args.aside or ("\0",)))]
        names = [n for n in next(iter(these.values())) if n not in (*TRUTH, *args.without)]
        everything = fitted([these[name] for name in learned], names, args.shares)
        parts = [
            fitted([these[n] for i, n in enumerate(learned) if i % 4 != part], names, args.shares) for part in range(4)
        ]
        rows: dict[str, list[np.ndarray]] = {}
        for name, scene in these.items():
            model = parts[learned.index(name) % 4] if name in learned else everything
            aside = " (aside)" if name not in learned else ""
            rows.setdefault(name.rsplit("_", 1)[0] + aside, []).append(scores(scene, bars_of(model, scene)))
        print(f"{kind}: camera, scenes, within 1 bar (least, mean, greatest tenth), within 2, area under the curve")
        for camera, found in rows.items():
            *shares, area = np.mean(found, axis=0)
            one, two = shares[:10], shares[10:]
            words = ["  ".join(f"{f(part):.2f}" for f in (min, np.mean, max)) for part in (one, two)]
            print(f"  {camera:20} {len(found):3}   {words[0]}   {words[1]}   {area:.3f}")
        if args.level:
            others = [dict(np.load(path)) for path in sorted(args.level.glob("*.npz"))]
            everything = leveled(everything, [scene for scene in others if ("rejected" in scene) == (kind == "planes")])
        if args.keep:
            everything = mixed(
                everything, learned_error_bar.weights()[kind], args.keep, [these[name] for name in learned]
            )
        kept_weights = replace_rounded(everything)
        columns = np.stack(kept_weights[1:2] + kept_weights[3:], axis=1).tolist()
        stored[kind] = {
            "signs": dict(zip(everything.names, columns, strict=True)),
            "constant": kept_weights.constant,
        }
    if args.write:
        path.write_text(json.dumps(stored, indent=1) + "\n", encoding="utf-8")


def mixed(
    found: learned_error_bar.Weights, before: learned_error_bar.Weights, keep: float, scenes: Sequence[Scene]
) -> learned_error_bar.Weights:
    """Return the mean of two models within the limits of the one before; bars are as long as the found model's."""
    place = [found.names.index(name) for name in before.names]
    model = before._replace(weights=keep * before.weights + (1 - keep) * found.weights[place])
    longer = [np.log(bars_of(found, scene) / bars_of(model, scene)).mean() for scene in scenes]
    return model._replace(constant=model.constant + float(np.mean(longer)))


def replace_rounded(model: learned_error_bar.Weights) -> learned_error_bar.Weights:
    """Round to what a reader can compare."""
    rounded = (np.round(part, 4) for part in (model.weights, model.least, model.most))
    weights, least, most = rounded
    return model._replace(weights=weights, constant=round(model.constant, 4), least=least, most=most)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    one = commands.add_parser("draw")
    one.add_argument("camera", type=Path)
    one.add_argument("--lens", required=True)
    one.add_argument("--focus-mm", type=float, required=True)
    one.add_argument("--film", default="real")
    one.add_argument("--design", help="that of the camera file when absent")
    one.add_argument("--first", type=int, default=0, help="seed of the first scene; odd ones have few surfaces")
    one.add_argument("--scenes", type=int, default=12)
    one.add_argument("--rooms", action="store_true", help="those of furnished_rooms.py, two in three with bent things")
    one.add_argument("--out", type=Path, required=True)
    one.set_defaults(run=draw)
    one = commands.add_parser("measure")
    one.add_argument("cameras", type=Path, nargs="+")
    one.add_argument("--pictures", type=Path, required=True)
    one.add_argument("--out", type=Path, required=True)
    one.set_defaults(run=measure)
    two = commands.add_parser("fit")
    two.add_argument("measured", type=Path)
    two.add_argument("--aside", nargs="+", help="names of cameras that are not learned from")
    two.add_argument("--without", nargs="+", default=[], help="signs to leave out")
    two.add_argument("--level", type=Path, help="measured scenes by which the constant is set")
    two.add_argument("--shares", type=float, nargs=2, default=SHARES, help="of the errors within one and two bars")
    two.add_argument("--keep", type=float, default=0.0, help="share of the weights that are stored")
    two.add_argument("--only", nargs="+", choices=["planes", "surface"], default=["planes", "surface"])
    two.add_argument("--write", action="store_true")
    two.set_defaults(run=fit)
    args = parser.parse_args()
    args.run(args)


if __name__ == "__main__":
    main()
