"""Tables and figure of `simulated_phone.py`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

QUALITIES = ("real-time", "accurate")


def rms(rows: list[dict[str, Any]], quality: str, key: str) -> float:
    """Root mean square of a figure over the distances."""
    values = np.array([row[key] for row in rows if row["quality"] == quality])
    return float(np.sqrt(np.mean(values**2)))


def print_tables(results: dict[str, Any], bound: dict[float, float], show: Callable[[str], None] = print) -> None:
    """Print both tables in Markdown."""
    whole = results.get("everything")
    if whole:
        show("\n| distance, mm | bound | real-time: bias, spread, stated | accurate: bias, spread, stated |")
        show("| --- | --- | --- | --- |")
        for at, limit in bound.items():
            cells = [next(r for r in whole["rows"] if r["distance_mm"] == at and r["quality"] == q) for q in QUALITIES]
            texts = [f"{r['middle_bias']:+.1%}, {r['middle_spread']:.1%}, {r['middle_stated']:.1%}" for r in cells]
            show(f"| {at:g} | {limit:.2%} | {texts[0]} | {texts[1]} |")
    show("\n| | real-time: bias, spread, within 5 % | accurate: bias, spread, within 5 % |")
    show("| --- | --- | --- |")
    for name, result in results.items():
        texts = []
        for q in QUALITIES:
            inside = np.mean([row["frame_in_5"] for row in result["rows"] if row["quality"] == q])
            bias, spread = (rms(result["rows"], q, f"frame_{k}") for k in ("bias", "spread"))
            texts.append(f"{bias:.2%}, {spread:.2%}, {inside:.0%}")
        show(f"| {name} | {texts[0]} | {texts[1]} |")


def draw(results: dict[str, Any], bound: dict[float, float], path: Path) -> None:
    """Draw bias and spread by distance, and what each loss costs."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), width_ratios=(1, 1.15), layout="constrained")
    whole = results["everything"]["rows"]
    for quality, color in zip(QUALITIES, ("#1f77b4", "#d1495b"), strict=True):
        rows = [r for r in whole if r["quality"] == quality]
        at = [r["distance_mm"] for r in rows]
        left.plot(at, [100 * r["middle_spread"] for r in rows], "o-", color=color, label=f"{quality}: spread")
        left.plot(at, [100 * abs(r["middle_bias"]) for r in rows], "s--", color=color, mfc="white",
                  label=f"{quality}: bias, without its sign")  # fmt: skip
    left.plot(list(bound), [100 * v for v in bound.values()], "k:", label="Cramer-Rao bound of a window")
    left.set(xlabel="distance, mm", ylabel="% of the distance", ylim=(0, None))
    left.set_title("Everything on, middle of the frame", fontsize=10)
    left.legend(fontsize=8)
    names = list(results)
    y = np.arange(len(names))[::-1]
    for quality, color, shift in zip(QUALITIES, ("#1f77b4", "#d1495b"), (0.2, -0.2), strict=True):
        parts = [[rms(results[n]["rows"], quality, f"frame_{key}") for key in ("bias", "spread")] for n in names]
        both = 100 * np.hypot(*np.array(parts).T)
        right.barh(y + shift, both, 0.38, color=color, label=quality)
    right.set_yticks(y, names, fontsize=8)
    right.set(xlabel="bias and spread together, % of the distance (whole frame, all distances)")
    right.legend(fontsize=8)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)
