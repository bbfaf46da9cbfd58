"""Speed as a ratio to a named peer in the same process: python benchmarks/speed.py [PART...] [--json]

Parts: matcher (real-time beside OpenCV's stereo matchers, and its share of right pixels), accurate (beside eight-path
SGBM, stage by stage), variation (beside denoise_TVL1), colour (beside the matcher), reading (beside Pillow and OpenCV).
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable
from pathlib import Path

import av
import cv2
import numpy as np
from PIL import Image
from timing import fastest_ms

import chromaperture as cap
from chromaperture.color.alignment import align_channels, channel_directions
from chromaperture.color.lens_shift import LensShift
from chromaperture.effects.refocusing import Focus, bokeh_kernel, bokeh_mask, refocus
from chromaperture.matching.accurate import AccurateMethod, explained_surface, path_surface
from chromaperture.matching.blocks import block_means
from chromaperture.matching.execution import execution_named
from chromaperture.matching.labels import IDENTITY, Surface
from chromaperture.matching.planes.depth_edges import edge_log_odds
from chromaperture.matching.real_time import RealTimeMethod
from chromaperture.matching.views import filtered_views, halved, view_spaces
from chromaperture.optics.aperture import Aperture, design_named
from chromaperture.optics.lens_blur import BlurModel, LensBlur, sample_pupil
from chromaperture.products.samples import open_sample
from chromaperture.settings.methods import RealTimeConfig
from chromaperture.system.threads import thread_count
from chromaperture_paper.variation import smooth_disparity

HEIGHT, WIDTH = 720, 1280
NOISE = 0.004
CONFIG = RealTimeConfig()
DESIGNS = {"hd32_two_filters": "cy_halves", "hd32_three_filters": "cmy_squares", "hd32_three_circles": "cmy_circles"}
RESTORED = {
    "hd_two_filters": ("cy_halves", (720, 1280)),
    "hd_three_filters": ("rgb_squares", (720, 1280)),
    "full_hd_two_filters": ("cy_halves", (1080, 1920)),
}
THIN = BlurModel(10.0, 20000.0)  # in focus at 2 m
VARIATION_SHAPE, ITERATIONS = (1280, 1920), 100
FRAMES = 60  # of the clip


def each_thread_count(work: dict[str, Callable[[], object]], *, rounds: int = 8) -> dict[str, dict[str, float]]:
    """Fastest runs on one and on two threads, ms."""
    counts = [count for count in (1, 2) if count <= thread_count()]
    return {f"threads_{count}": fastest_ms(work, threads=count, rounds=rounds) for count in counts}


def over(times: dict[str, float], name: str, peers: tuple[str, ...]) -> dict[str, float]:
    """Time of one contestant, and as a ratio to each of its peers."""
    return {"ms": round(times[name], 1)} | {f"over_{peer}": round(times[name] / times[peer], 3) for peer in peers}


def scene(
    directions: np.ndarray, *, seed: int = 5, shape: tuple[int, int] = (HEIGHT, WIDTH)
) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Views (H, W) and guide of a wavy surface with steps, as float32 planes, and the true half disparity, px."""
    height, width = shape
    rng = np.random.default_rng(seed)
    margin = 24
    big = (height + 2 * margin, width + 2 * margin)
    texture = sum(s * cv2.GaussianBlur(rng.normal(size=big).astype(np.float32), (0, 0), s) for s in (1.5, 5.0))
    texture = 0.5 + 0.1 * texture / texture.std()
    y, x = np.mgrid[:height, :width].astype(np.float32)
    truth = 4 * np.sin(x / 190) * np.cos(y / 150)
    truth[150:400, 300:700] -= 2
    truth = truth.astype(np.float32)
    planes = []
    for u, v in (*directions, (0, 0)):
        at_x, at_y = x + margin - truth * np.float32(u), y + margin - truth * np.float32(v)
        view = cv2.remap(texture, at_x, at_y, cv2.INTER_CUBIC)
        planes.append((view + rng.normal(0, NOISE, view.shape)).astype(np.float32))
    return planes[:-1], planes[-1], truth


def directions_of(aperture: Aperture) -> np.ndarray:
    """Directions of the views that the matcher compares."""
    return view_spaces(aperture, None, CONFIG.space)[0].directions


def matching(
    aperture: Aperture, views: list[np.ndarray], guide: np.ndarray, config: RealTimeConfig = CONFIG
) -> Callable[[], Surface]:
    """From float planes (H, W) to the surface by the real-time method, as a function without arguments."""
    space = view_spaces(aperture, None, config.space)[0]
    config = config.for_views(space.directions)
    method = RealTimeMethod(config, space, IDENTITY, execution_named("numba"))
    mask = np.ones(guide.shape, bool)
    return lambda: method.surface(*halved(views, guide, mask, directions=space.directions, config=config.views))


def stereo_peers(views: list[np.ndarray]) -> dict[str, Callable[[], object]]:
    """OpenCV's matchers on the first and last view in 8 bits; 32 disparities of whole px, block 7."""
    left, right = (np.clip(255 * view, 0, 255).astype(np.uint8) for view in (views[0], views[-1]))
    block, disparities = 7, 32
    steps = {"P1": 8 * block**2, "P2": 32 * block**2}

    def semi_global(mode: int) -> cv2.StereoSGBM:
        return cv2.StereoSGBM.create(-16, disparities, block, mode=mode, **steps)

    three_way, full = semi_global(cv2.STEREO_SGBM_MODE_SGBM_3WAY), semi_global(cv2.STEREO_SGBM_MODE_SGBM)
    block_matcher = cv2.StereoBM.create(disparities, block)
    return {
        "sgbm_3way": lambda: three_way.compute(left, right),
        "sgbm": lambda: full.compute(left, right),
        "bm": lambda: block_matcher.compute(left, right),
    }


def matcher() -> dict:
    """HD, 32 layers of half a px, from float planes to disparity."""
    results: dict = {}
    for case, design in DESIGNS.items():
        aperture = design_named(design)
        views, guide, truth = scene(directions_of(aperture))
        match = matching(aperture, views, guide)
        error = np.abs(match().disparity_px - truth)
        peers = stereo_peers(views)
        results[case] = {
            "accuracy": {
                "median_error_px": round(float(np.nanmedian(error)), 4),
                "share_within_half_px": round(float((error < 0.5).mean()), 4),
            },
            **{name: over(t, "match", (*peers,)) for name, t in each_thread_count({"match": match, **peers}).items()},
        }
    return results


def accurate() -> dict:
    """The capture of the demo against SGBM with eight paths and as many disparities as there are labels."""
    camera, image = open_sample("still_life_cy_halves", quality="accurate", device="cpu")
    method = camera.method
    assert isinstance(method, AccurateMethod)
    layers_px, labels_px = method.config.layers.values_px, method.labels_px
    likelihood = method.evidence.at(image, layers_px, labels_px)
    guide = block_means(filtered_views(image, method.space, config=method.config.views).guide)
    settings = {"config": method.config, "run": method.run}
    found = path_surface(likelihood, guide, labels_px, **settings)
    red, blue = (np.clip(255 * image[..., k], 0, 255).astype(np.uint8) for k in (0, 2))
    disparities = -(-len(labels_px) // 16) * 16
    peer = cv2.StereoSGBM.create(
        minDisparity=-disparities // 2, numDisparities=disparities, blockSize=7, P1=392, P2=1568,
        mode=cv2.StereoSGBM_MODE_HH,
    )  # fmt: skip
    ours: dict[str, Callable[[], object]] = {
        "whole": lambda: camera.measure(image),
        "evidence": lambda: method.evidence.at(image, layers_px, labels_px),
        "paths": lambda: path_surface(likelihood, guide, labels_px, **settings),
        "blocks": lambda: explained_surface(found, edge_log_odds(image), labels_px, image.shape[:2], **settings),
    }
    times = fastest_ms(
        {"sgbm_eight_paths": lambda: peer.compute(red, blue), **ours}, threads=min(2, thread_count()), rounds=4
    )
    return {name: over(times, name, ("sgbm_eight_paths",)) for name in ours}


def variation() -> dict:
    """Total variation of a 1280 x 1920 map: as many iterations of the same algorithm, not the same convergence."""
    rng = np.random.default_rng(0)
    surface = cv2.GaussianBlur(rng.random(VARIATION_SHAPE, np.float32), (0, 0), 30)
    surface = cv2.normalize(surface, None, 0, 8, cv2.NORM_MINMAX) + rng.normal(0, 0.3, VARIATION_SHAPE)
    outliers = rng.random(VARIATION_SHAPE) < 0.1
    disparity = np.where(outliers, rng.uniform(0, 8, VARIATION_SHAPE), surface).astype(np.float32)
    picture = cv2.normalize(disparity, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    smoothed = np.empty_like(picture)
    work: dict[str, Callable[[], object]] = {
        "smooth": lambda: smooth_disparity(disparity, iterations=ITERATIONS),
        "cv2_tvl1": lambda: cv2.denoise_TVL1([picture], smoothed, 1.0, ITERATIONS),
    }
    return {name: over(t, "smooth", ("cv2_tvl1",)) for name, t in each_thread_count(work, rounds=3).items()}


def colour_work(design: str, height: int, width: int) -> dict[str, Callable[[], object]]:
    """The matcher, restoration, refocusing and one blur of the whole picture, as functions without arguments."""
    aperture = design_named(design)
    views, guide, truth = scene(directions_of(aperture), shape=(height, width))
    image = np.ascontiguousarray(np.dstack([views[0], guide, views[-1]]), np.float32)
    shifts = channel_directions(aperture, {})
    # With steps, so that there are strips to fill, and a blur as wide as the photographs of the demo have.
    radius = (2.4 * truth).astype(np.float32)
    color = cv2.cvtColor(guide, cv2.COLOR_GRAY2RGB)
    lens = LensShift(LensBlur(THIN, sample_pupil(aperture), width, height), near_mm=900.0, far_mm=6000.0)
    focus = Focus(float(radius.min()), 1.0)
    spot = bokeh_kernel(bokeh_mask("disc"), float(np.ptp(radius)))
    return {
        "matcher": matching(aperture, views, guide),
        "align": lambda: align_channels(image, truth, shifts),
        "align_by_lens": lambda: align_channels(image, truth, shifts, displacement_px=lens(radius)),
        "refocus": lambda: refocus(color, radius, focus),
        "plain_blur": lambda: cv2.filter2D(color, -1, spot),
    }


def colour() -> dict:
    """Restoration and refocusing beside the matcher, and refocusing beside one blur by the largest of its spots."""
    results: dict = {}
    for case, (design, (height, width)) in RESTORED.items():
        times = each_thread_count(colour_work(design, height, width), rounds=4)
        results[case] = {
            name: {
                "align": over(t, "align", ("matcher",)), "align_by_lens": over(t, "align_by_lens", ("matcher",)),
                "refocus": over(t, "refocus", ("matcher", "plain_blur")),
            }
            for name, t in times.items()
        }  # fmt: skip
    return results


def textured(width: int, height: int) -> np.ndarray:
    """A picture of even detail; (H, W, 3) uint8."""
    noise = np.random.default_rng(0).normal(128, 240, (height, width, 3)).astype(np.float32)
    return cv2.GaussianBlur(noise, (0, 0), 2).clip(0, 255).astype(np.uint8)


def write_clip(path: Path) -> None:
    """Write a clip of 1080p, H.264 4:2:0, of a moving texture."""
    picture = textured(1920, 1080)
    with av.open(str(path), "w") as clip:
        stream = clip.add_stream("libx264", rate=30, options={"crf": "15"})
        stream.width, stream.height, stream.pix_fmt = 1920, 1080, "yuv420p"
        for i in range(FRAMES):
            clip.mux(stream.encode(av.VideoFrame.from_ndarray(np.roll(picture, 2 * i, axis=1), format="rgb24")))
        clip.mux(stream.encode())


def read_by_opencv(path: Path) -> None:
    clip = cv2.VideoCapture(str(path))
    while clip.read()[0]:
        pass


def read_by_us(path: Path, *, as_light: bool) -> None:
    with cap.open_source(str(path)) as frames:
        for frame in frames:
            _ = frame.image if as_light else frame.counts


def reading() -> dict:
    """A JPEG of 24 megapixels, 4:2:0, and a clip: ours at the size of their chroma to light, peers' to 8 bits."""
    with tempfile.TemporaryDirectory() as folder:
        photo, clip = Path(folder, "photo.jpg"), Path(folder, "clip.mp4")
        Image.fromarray(textured(6000, 4000)).save(photo, quality=95, subsampling=2)
        write_clip(clip)
        work: dict[str, Callable[[], object]] = {
            "photograph": lambda: cap.read_image(photo),
            "pillow": lambda: np.asarray(Image.open(photo).convert("RGB")),
            "clip_to_counts": lambda: read_by_us(clip, as_light=False),
            "clip_to_light": lambda: read_by_us(clip, as_light=True),
            "opencv": lambda: read_by_opencv(clip),
        }
        times = fastest_ms(work, threads=thread_count(), rounds=5)
    clips = {name: over(times, name, ("opencv",)) for name in ("clip_to_counts", "clip_to_light")}
    return {"photograph": over(times, "photograph", ("pillow",))} | clips


PARTS: dict[str, Callable[[], dict]] = {
    "matcher": matcher, "accurate": accurate, "variation": variation, "colour": colour, "reading": reading,
}  # fmt: skip


def printed(name: str, value: dict, indent: str = "") -> None:
    """Print nested figures, one innermost dict a line."""
    if any(isinstance(part, dict) for part in value.values()):
        print(f"{indent}{name}")
        for key, part in value.items():
            printed(key, part, indent + "  ")
    else:
        print(f"{indent}{name:20}", *(f"{key} {part}" for key, part in value.items()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help="all when absent")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    args = parser.parse_args()
    if unknown := set(args.parts) - set(PARTS):
        parser.error(f"unknown part {', '.join(sorted(unknown))}: choose from {', '.join(PARTS)}")
    results = {}
    for name in args.parts or PARTS:
        results[name] = PARTS[name]()
        if not args.json:
            printed(name, results[name])
    if args.json:
        print(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
