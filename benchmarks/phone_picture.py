"""Tables and figure of `simulated_phone.py`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

QUALITIES = ("real-time", "accurate")
LIGHTS = (1.0, 1 / 8)  # shares of the light that fills the sensor: full, and three stops less
_COLORS = ("#1f77b4", "#d1495b")


def rms(rows: list[dict[str, Any]], key: str, **which: Any) -> float:
    """Root mean square of a figure over the distances, of the rows with certain values."""
    return float(np.sqrt(np.mean([r[key] ** 2 for r in rows if all(r[k] == v for k, v in which.items())])))


def print_tables(
    results: Mapping[str, Any],
    bound: Mapping[float, float],
    changed: Mapping[str, list[dict[str, float]]],
    show: Callable[[str], None] = print,
) -> None:
    """Print the tables in Markdown."""
    if "everything" in results:
        rows = results["everything"]["rows"]
        show("\n| distance, mm | bound | real-time: bias, spread, stated | accurate: bias, spread, stated |")
        show("| --- | --- | --- | --- |")
        for at, limit in bound.items():
            cells = [next(r for r in rows if r["distance_mm"] == at and r["quality"] == q) for q in QUALITIES]
            texts = [f"{r['middle_bias']:+.1%}, {r['middle_spread']:.1%}, {r['middle_stated']:.1%}" for r in cells]
            show(f"| {at:g} | {limit:.2%} | {texts[0]} | {texts[1]} |")
    columns = ("", *(f"{q}: bias, spread, within 5 %" for q in QUALITIES), "changes in full light: shift, scatter",
               "in an eighth of the light")  # fmt: skip
    show("\n| " + " | ".join(columns) + " |")
    show("| --- | --- | --- | --- | --- |")
    for name, result in results.items():
        texts = []
        for q in QUALITIES:
            inside = np.mean([row["frame_in_5"] for row in result["rows"] if row["quality"] == q])
            bias, spread = (rms(result["rows"], f"frame_{key}", quality=q) for key in ("bias", "spread"))
            texts.append(f"{bias:.2%}, {spread:.2%}, {inside:.0%}")
        for light in LIGHTS if name in changed else ():
            shift, scatter = (rms(changed[name], key, light=light) for key in ("shift", "scatter"))
            texts.append(f"{shift:.2%}, {scatter:.2%}")
        show(f"| {name} | " + " | ".join(texts) + " |")


def draw(
    results: Mapping[str, Any], bound: Mapping[float, float], changed: Mapping[str, list[dict[str, float]]], path: Path
) -> None:
    """Draw bias and spread by distance, and what each loss changes."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.4), width_ratios=(1, 1.15), layout="constrained")
    whole = results["everything"]["rows"]
    for quality, color in zip(QUALITIES, _COLORS, strict=True):
        rows = [r for r in whole if r["quality"] == quality]
        at = [r["distance_mm"] for r in rows]
        left.plot(at, [100 * r["middle_spread"] for r in rows], "o-", color=color, label=f"{quality}: spread")
        left.plot(at, [100 * abs(r["middle_bias"]) for r in rows], "s--", color=color, mfc="white",
                  label=f"{quality}: bias, without its sign")  # fmt: skip
    left.plot(list(bound), [100 * v for v in bound.values()], "k:", label="Cramer-Rao bound of a window")
    left.set(xlabel="distance, mm", ylabel="% of the distance", ylim=(0, None))
    left.set_title("everything on, middle of the frame", fontsize=10)
    left.legend(fontsize=8)
    names = [name for name in changed if name != "nothing"]
    y = np.arange(len(names))[::-1]
    for light, color, shift, label in zip(LIGHTS, ("#e9a23b", "#44546a"), (0.2, -0.2),
                                          ("full light", "an eighth of it"), strict=True):  # fmt: skip
        parts = [[rms(changed[n], key, light=light) for key in ("shift", "scatter")] for n in names]
        right.barh(y + shift, 100 * np.hypot(*np.array(parts).T) if parts else [], 0.38, color=color, label=label)
    right.set_yticks(y, names, fontsize=8)
    right.set(xlabel="% of the distance: shift and scatter against the same picture without any loss")
    right.set_title("what each loss changes, real-time, whole frame", fontsize=10)
    right.legend(fontsize=8, loc="lower right")
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)
    plt.close(figure)
