"""Find depth edges in a photograph: where the distance jumps or bends, told by the photograph alone.

Two surfaces differ in colour and in texture, in how blurred they are, and in the colours that the aperture gives to
their blur. A small convolutional network weighs all of that together. ``benchmarks/edge_training.py`` trained it on
ray-traced captures of random scenes through random lenses, designs and films; OpenCV runs it.
"""

from __future__ import annotations

from importlib import resources

import cv2
import numpy as np

from chromaperture.matching.blocks import BLOCK_PX

STRIDE = 4  # of the network's coarsest level, blocks
LEAST_BLOCKS = 32  # along either side: of fewer than 8 OpenCV 5.0 reads memory that nothing was written to
MODEL = resources.files("chromaperture.matching.planes") / "depth_edges.onnx"
LEAST_RANGE = 1e-3  # of roots of light: an even photograph is not divided by zero


def edge_log_odds(image: np.ndarray) -> np.ndarray:
    """Return the log odds that the distance jumps or bends between neighbouring blocks.

    ``image`` (H, W, 3) float: linear light. H and W are at least `BLOCK_PX`. Returns (2, H // 4, W // 4) float32:
    between a block and the one below it, then the one right of it; the last row, or column, means nothing.
    """
    height, width = (n // BLOCK_PX for n in image.shape[:2])
    whole = np.ascontiguousarray(image[: height * BLOCK_PX, : width * BLOCK_PX], np.float32)
    half = cv2.resize(whole, (2 * width, 2 * height), interpolation=cv2.INTER_AREA)
    below, right = (2 * (max(LEAST_BLOCKS, n + -n % STRIDE) - n) for n in (height, width))
    picture = cv2.copyMakeBorder(contrast(half), 0, below, 0, right, cv2.BORDER_REPLICATE)
    network = cv2.dnn.readNetFromONNX(np.frombuffer(MODEL.read_bytes(), np.uint8))  # a network holds its last picture
    network.setInput(np.ascontiguousarray(picture.transpose(2, 0, 1)[None]))
    return np.asarray(network.forward()[0, :, :height, :width])


def contrast(image: np.ndarray) -> np.ndarray:
    """Return the roots of light about their mean, in units of their range from the 1st to the 99th percentile."""
    root = np.sqrt(np.maximum(image, 0))
    least, most = np.percentile(root.mean(axis=2), (1, 99))
    return np.asarray((root - root.mean()) / max(most - least, LEAST_RANGE), np.float32)


def strongest_links(log_odds: np.ndarray) -> np.ndarray:
    """Return the largest log odds of the links of every block; (h, w) float32."""
    out = np.full(log_odds.shape[1:], -np.inf, np.float32)
    rows, columns = log_odds[0, :-1], log_odds[1, :, :-1]
    for part, values in ((np.s_[:-1], rows), (np.s_[1:], rows), (np.s_[:, :-1], columns), (np.s_[:, 1:], columns)):
        out[part] = np.maximum(out[part], values)
    return out
