"""Train the network that finds depth edges in a photograph, and write ``matching/planes/depth_edges.onnx``.

    python benchmarks/edge_scenes.py --out scenes --first 3 --cameras 87
    python benchmarks/edge_training.py scenes --minutes 28 --aside 10 --write
    python benchmarks/edge_scenes.py --out scenes --first 101 --cameras 39 --rooms
    python benchmarks/edge_training.py scenes --minutes 28 --aside 10 --seed 1 --write --onward

So the network of the package was trained on two cores: a U-Net (Ronneberger et al. 2015) of three levels with residual
blocks (He et al. 2016) that gives the log odds that the distance jumps or bends between neighbouring blocks of 4 px.
Scenes of every ``--aside``-th camera are not learned from, and scored by the area under precision and recall: 0.77
after the first round, 0.70 on the furnished rooms of the second. Needs PyTorch and onnx.
"""

from __future__ import annotations

import argparse
import io
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from sklearn.metrics import average_precision_score
from torch import Tensor, nn
from torch.nn import functional

from chromaperture.matching.planes.depth_edges import MODEL, contrast

CROP = 96  # blocks; smaller frames are taken as high or wide as they are
BATCH = 6
RATE = 2e-3
NEAR_EDGE = 0.3  # what a link beside an edge counts: 4 px are less than the blur
SCENES_OF_CAMERA = 100  # their numbers begin at so many times the camera's

Part = tuple[Tensor, Tensor]  # photograph (3, 2 h, 2 w), edges (2, h, w)


class Residual(nn.Module):
    """Two convolutions beside what they change."""

    def __init__(self, channels: int, spacing: int = 1) -> None:
        super().__init__()
        self.first = nn.Conv2d(channels, channels, 3, padding=spacing, dilation=spacing)
        self.second = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.second(functional.relu(self.first(functional.relu(x))))


class EdgeNetwork(nn.Module):
    """From a photograph (N, 3, 2 h, 2 w) to log odds of edges (N, 2, h, w); h and w are multiples of 4."""

    def __init__(self, fine: int = 32, middle: int = 40, coarse: int = 48) -> None:
        super().__init__()
        self.pixels, self.blocks = nn.Conv2d(3, 12, 5, padding=2), nn.Conv2d(12, fine, 4, stride=2, padding=1)
        self.fine, self.fine_up = Residual(fine), Residual(fine)
        self.to_middle, self.to_coarse = (
            nn.Conv2d(a, b, 4, stride=2, padding=1) for a, b in ((fine, middle), (middle, coarse))
        )
        self.middle, self.middle_up = Residual(middle), Residual(middle)
        self.coarse = nn.Sequential(Residual(coarse), Residual(coarse, 2))
        self.from_coarse, self.from_middle = nn.Conv2d(coarse, middle, 1), nn.Conv2d(middle, fine, 1)
        self.out = nn.Conv2d(fine, 2, 3, padding=1)
        nn.init.constant_(self.out.bias, -4.0)  # one link in fifty is an edge

    def forward(self, photograph: Tensor) -> Tensor:
        def twice(x: Tensor) -> Tensor:
            return functional.interpolate(x, scale_factor=2, mode="bilinear")

        fine = self.fine(self.blocks(functional.relu(self.pixels(photograph))))
        middle = self.middle(self.to_middle(functional.relu(fine)))
        coarse = self.coarse(self.to_coarse(functional.relu(middle)))
        middle = self.middle_up(middle + twice(self.from_coarse(coarse)))
        return self.out(functional.relu(self.fine_up(fine + twice(self.from_middle(middle)))))


def load(path: Path) -> Part:
    """Read a scene of `edge_scenes.py`."""
    with np.load(path) as kept:
        picture = contrast(kept["image"].astype(np.float32))
        return torch.from_numpy(picture.transpose(2, 0, 1).copy()), torch.from_numpy(kept["edges"].astype(np.float32))


def mirrored(part: Part, axis: int) -> Part:
    """Mirror a scene top to bottom (0) or left to right (1); an edge belongs to the block above or left of it."""
    picture, edges = (values.flip(1 + axis).clone() for values in part)
    edges[axis] = torch.roll(edges[axis], -1, axis)
    edges[axis].select(axis, -1).zero_()
    return picture, edges


def drawn(scenes: list[Part], rng: np.random.Generator) -> Iterator[Part]:
    """Draw batches: crops, mirrored, in other light, with colours exchanged, with noise."""

    def one() -> Part:
        picture, edges = scenes[rng.integers(len(scenes))]
        rows, columns = (
            slice(at := int(rng.integers(n - size + 1)), at + size)
            for n, size in zip(edges.shape[1:], size_of_crops, strict=True)
        )
        part = picture[:, 2 * rows.start : 2 * rows.stop, 2 * columns.start : 2 * columns.stop], edges[:, rows, columns]
        for axis in (0, 1):
            if rng.random() < 0.5:
                part = mirrored(part, axis)
        gain = torch.from_numpy(rng.normal(1, 0.15, (3, 1, 1)).astype(np.float32)) * float(np.exp(rng.normal(0, 0.25)))
        picture = part[0] * gain + float(rng.normal(0, 0.1))
        if rng.random() < 0.3:
            picture = picture[rng.permutation(3)]
        return picture + float(rng.choice([0.003, 0.01, 0.03])) * torch.randn_like(picture), part[1]

    size_of_crops = tuple(min([CROP, *(edges.shape[axis] for _, edges in scenes)]) // 4 * 4 for axis in (1, 2))
    while True:
        parts = [one() for _ in range(BATCH)]
        yield torch.stack([picture for picture, _ in parts]), torch.stack([edges for _, edges in parts])


def stored() -> EdgeNetwork:
    """Return the network of the package."""
    network = EdgeNetwork()
    weights = onnx.load_from_string(MODEL.read_bytes()).graph.initializer
    network.load_state_dict({part.name: torch.from_numpy(numpy_helper.to_array(part).copy()) for part in weights})
    return network


def trained(scenes: list[Part], network: EdgeNetwork, *, minutes: float, seed: int) -> EdgeNetwork:
    """Train a network for so long."""
    optimizer = torch.optim.AdamW(network.parameters(), lr=RATE, weight_decay=1e-3)
    start, smooth = time.monotonic(), 0.0
    for step, (picture, edges) in enumerate(drawn(scenes, np.random.default_rng(seed)), start=1):
        share = (time.monotonic() - start) / (60 * minutes)
        if share >= 1:
            break
        for group in optimizer.param_groups:
            group["lr"] = RATE * min(1, step / 100) * (0.5 + 0.5 * np.cos(np.pi * share))
        beside = functional.max_pool2d(edges, 3, 1, 1) > edges
        each = functional.binary_cross_entropy_with_logits(network(picture), edges, reduction="none")
        loss = (each * torch.where(beside, NEAR_EDGE, 1.0)).mean()
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        smooth += max(0.01, 1 / step) * (loss.item() - smooth)
        if step % 500 == 0:
            print(f"{step} batches, {share:.0%}: loss {smooth:.4f}", flush=True)
    return network.eval()


def precision(network: EdgeNetwork, scenes: list[Part]) -> float:
    """Return the area under the curve of precision and recall over all links of scenes."""
    found, true = [], []
    with torch.no_grad():
        for picture, edges in scenes:
            rows, columns = (n // 4 * 4 for n in edges.shape[1:])
            found.append(network(picture[None, :, : 2 * rows, : 2 * columns]).numpy().ravel())
            true.append(edges[:, :rows, :columns].numpy().ravel())
    return float(average_precision_score(np.concatenate(true), np.concatenate(found)))


def written(network: EdgeNetwork) -> bytes:
    """Return a network as ONNX, for pictures of any size."""
    out = io.BytesIO()
    torch.onnx.export(
        network, (torch.zeros(1, 3, 64, 96),), out, input_names=["photograph"], output_names=["log_odds"], dynamo=False,
        dynamic_axes={"photograph": {2: "height", 3: "width"}, "log_odds": {2: "rows", 3: "columns"}},
    )  # fmt: skip
    return out.getvalue()


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("scenes", type=Path)
    arguments.add_argument("--minutes", type=float, default=30)
    arguments.add_argument("--aside", type=int, default=0, help="every so manyth camera is not learned from; 0: none")
    arguments.add_argument("--onward", action="store_true", help="start from the network of the package")
    arguments.add_argument("--seed", type=int, default=0)
    arguments.add_argument("--write", action="store_true", help="write it into the package")
    args = arguments.parse_args()
    paths = sorted(args.scenes.glob("*.npz"), key=lambda path: int(path.stem))
    aside = [path for path in paths if args.aside and int(path.stem) // SCENES_OF_CAMERA % args.aside == 0]
    torch.manual_seed(args.seed)
    network = stored() if args.onward else EdgeNetwork()
    scenes = [load(path) for path in paths if path not in aside]
    network = trained(scenes, network, minutes=args.minutes, seed=args.seed)
    if aside:
        print(
            f"area under precision and recall, {len(aside)} scenes aside: {precision(network, [*map(load, aside)]):.3f}"
        )
    if args.write:
        Path(str(MODEL)).write_bytes(written(network))


if __name__ == "__main__":
    main()
