"""Log-likelihoods at labels on a device: of fractions or scores of layers, and of windows of all channels."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from chromaperture.matching.device.correlation_stages import add_correlation
from chromaperture.matching.device.device import Array, Chain
from chromaperture.matching.device.evidence_plan import EvidencePlan
from chromaperture.matching.device.spectral_stages import WindowGrid
from chromaperture.matching.device.view_stages import add_views
from chromaperture.matching.device.workgroups import groups_for
from chromaperture.matching.evidence.blur import SPACING_PX
from chromaperture.matching.evidence.correlation import MOST_EXPLAINED, CorrelationEvidence
from chromaperture.matching.labels import LabelMap
from chromaperture.matching.readable.paths import EDGE_LAYERS, LEAST_UNEXPLAINED


class WindowsEarned(NamedTuple):
    """What labels earn in windows of all channels, and where the photograph is usable."""

    earned: Array
    usable: Array
    grid: WindowGrid


def add_labels(
    chain: Chain,
    plan: EvidencePlan,
    unexplained: Array,
    counted: Array,
    likelihood: Array,
    labels_px: np.ndarray,
    *,
    windows: WindowsEarned | None = None,
) -> None:
    """Append `stages.read_at_labels`, at the pixels of the photograph, and add what windows say.

    Parameters
    ----------
    chain : Chain
    plan : EvidencePlan
    unexplained : Array
        (samples, D).
    counted : Array
        (H, W): factor on the evidence of pairs.
    likelihood : Array
        (H, W, N), which is written.
    labels_px : (N,) float, px
    windows : WindowsEarned, optional
    """
    source, samples = plan.source, plan.samples
    height, width = source.blur.height_px, source.blur.width_px
    at_labels = chain.array("at_labels", samples[0] * samples[1] * len(labels_px))
    same: dict[str, Any] = dict(
        width=width, height=height, count=len(labels_px), spacing=SPACING_PX,
        sample_height=samples[0], sample_width=samples[1],
    )  # fmt: skip
    chain.add(
        "labels_of_samples", [unexplained, _label_map(chain, source.label_map, plan.layers_px), at_labels],
        groups=groups_for(samples[0] * samples[1], 1), **same,
        **_polynomial(plan.layers_px, labels_px, source.label_map),
    )  # fmt: skip
    arrays, uses = [at_labels, counted, likelihood], "windows_none"
    more: dict[str, Any] = {}
    if windows is not None:
        grid, uses = windows.grid, "windows_enlarged"
        arrays += [windows.earned, windows.usable]
        more = dict(window_rows=len(grid.rows), window_columns=len(grid.columns), stride=grid.stride)
    chain.add(
        "labels_between", arrays, groups=groups_for(samples[1] * height, 1), uses=(uses,),
        factors=float(plan.factors), **same, **more,
    )  # fmt: skip


def add_views_evidence(
    chain: Chain,
    source: CorrelationEvidence,
    shape: tuple[int, int],
    arrays: tuple[Array, Array, Array],
    layers_px: np.ndarray,
    labels_px: np.ndarray,
) -> None:
    """Append the evidence of shifted views, `CorrelationEvidence.at`.

    Parameters
    ----------
    chain : Chain
    source : CorrelationEvidence
    shape : (int, int)
        Height and width of the photograph.
    arrays : three Array
        Image, where it is usable, likelihood; the last is written.
    layers_px, labels_px : float, px
    """
    image, usable, likelihood = arrays
    for i, (space, label_map) in enumerate(zip(source.spaces, source.label_maps, strict=True)):
        planes = add_views(chain, image, shape, space, source.views)
        score: Array | None = None
        for volume, *_ in add_correlation(
            chain, planes, layers_px, space.directions, source.config.correlation, pitch=len(layers_px)
        ):
            score = volume
        assert score is not None
        chain.add(
            "labels_read", [score, _label_map(chain, label_map, layers_px), usable, likelihood],
            groups=groups_for(shape[0] * shape[1], 1),
            height=shape[0], width=shape[1],
            count=len(labels_px), factors=len(space.rows) - 1.0, views_of_score=len(space.rows), is_first=i == 0,
            most_explained=MOST_EXPLAINED, weight=1 / len(source.spaces),
            **_polynomial(layers_px, labels_px, label_map),
        )  # fmt: skip


def _polynomial(layers_px: np.ndarray, labels_px: np.ndarray, label_map: LabelMap) -> dict[str, Any]:
    """Return the constants of ``label_polynomial.wgsl`` and of the places that it is given."""
    step = float(layers_px[1] - layers_px[0])
    return dict(
        layers=len(layers_px), one_map=label_map.is_identity,
        first_label=float((labels_px[0] - layers_px[0]) / step),
        label_step=float((labels_px[1] - labels_px[0]) / step),
        least_unexplained=LEAST_UNEXPLAINED, edge_layers=EDGE_LAYERS,
    )  # fmt: skip


def _label_map(chain: Chain, label_map: LabelMap, layers_px: np.ndarray) -> Array:
    """Offset and scale of a label at every pixel, in layers from the first."""
    step = float(layers_px[1] - layers_px[0])
    begin = (label_map.offset_px + (label_map.scale - 1) * layers_px[0]) / step
    return chain.constant("label_map", np.stack(np.broadcast_arrays(begin, label_map.scale), axis=-1))
