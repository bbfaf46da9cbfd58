"""Quality accurate against OpenCV's full semi-global matching, on the capture of the demo, stage by stage.

    python benchmarks/accurate_speed.py [--threads N] [--rounds N] [--json]

The peer is `cv2.StereoSGBM` with all eight paths (MODE_HH) and as many disparities as accurate has labels, rounded up
to whole 16s, on the red and blue channels of the same picture. The contestants alternate in one process; the fastest
run of each counts.
"""

from __future__ import annotations

import argparse
import json

import cv2
import numpy as np
from timing import fastest_ms

from chromaperture.matching.accurate import AccurateMethod, explained_surface, path_surface
from chromaperture.matching.planes.block_surface import depth_edges_of
from chromaperture.matching.views import filtered_views
from chromaperture.products.samples import open_sample
from chromaperture.system.threads import thread_count


def contestants(design: str) -> dict:
    """Functions without arguments: the peer, accurate as a whole, its evidence, paths, and surface of blocks."""
    camera, image = open_sample(f"still_life_{design}", quality="accurate", device="cpu")
    method = camera.method
    assert isinstance(method, AccurateMethod)
    layers_px, labels_px = method.config.layers.values_px, method.labels_px
    likelihood = method.evidence.at(image, layers_px, labels_px)
    guide = filtered_views(image, method.space, config=method.config.views).guide
    found = path_surface(likelihood, guide, labels_px, config=method.config, run=method.run)
    red, blue = (np.clip(255 * image[..., k], 0, 255).astype(np.uint8) for k in (0, 2))
    disparities = -(-len(labels_px) // 16) * 16
    peer = cv2.StereoSGBM.create(
        minDisparity=-disparities // 2, numDisparities=disparities, blockSize=7, P1=392, P2=1568,
        mode=cv2.StereoSGBM_MODE_HH,
    )  # fmt: skip
    return {
        "sgbm_eight_paths": lambda: peer.compute(red, blue),
        "accurate": lambda: camera.measure(image),
        "accurate_evidence": lambda: method.evidence.at(image, layers_px, labels_px),
        "accurate_paths": lambda: path_surface(likelihood, guide, labels_px, config=method.config, run=method.run),
        "accurate_blocks": lambda: explained_surface(
            found, depth_edges_of(image), labels_px, config=method.config, run=method.run
        ),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--design", default="cy_halves")
    parser.add_argument("--threads", type=int, default=min(2, thread_count()))
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    times = fastest_ms(contestants(args.design), threads=args.threads, rounds=args.rounds)
    peer = times["sgbm_eight_paths"]
    table = {name: {"ms": round(ms), "over_sgbm": round(ms / peer, 2)} for name, ms in times.items()}
    if args.json:
        print(json.dumps({"threads": args.threads, **table}, indent=2))
        return
    print(f"{args.threads} threads")
    for name, row in table.items():
        print(f"{name:20} {row['ms']:6d} ms {row['over_sgbm']:7.2f} of SGBM")


if __name__ == "__main__":
    main()
