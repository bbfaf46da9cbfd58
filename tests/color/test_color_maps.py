"""Maps of one quantity look alike everywhere: near is warm, and unknown is one grey."""

from __future__ import annotations

import ast
from pathlib import Path
from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

from chromaperture.app.device_plan import color_tables
from chromaperture.color.color_maps import DIFFERENCE, DISTANCE, ERROR, OTHER, UNKNOWN, color_map, draw_levels
from chromaperture.evaluation.figures import plain_log_scale, show_image
from chromaperture.frame.preview import write_preview

ROOT = Path(__file__).parents[2]
CHOICE = "src/chromaperture/color/color_maps.py"


def strings(path: Path) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)}


def test_colour_maps_are_chosen_in_one_place():
    chosen = {}
    for folder in ("src", "benchmarks", "examples"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            where = path.relative_to(ROOT).as_posix()
            # Grey is a colour of lines too, and of a photographed board.
            names = strings(path) & set(mpl.colormaps) - {"gray", "grey"}
            if names or "COLORMAP_" in path.read_text(encoding="utf-8"):
                chosen[where] = names
    assert chosen == {CHOICE: {DISTANCE, ERROR, DIFFERENCE, OTHER}}


def is_warm(color: np.ndarray) -> bool:
    return bool(color[0] > 2 * color[2])  # red against blue


def test_near_is_warm_and_unknown_is_grey_in_pages_and_in_figures():
    depth = np.full((40, 60), np.nan, np.float32)
    depth[:, :20], depth[:, 20:40] = 1100, 3000
    levels = np.where(np.isnan(depth), 256, np.nan_to_num(depth - 1000) * 256 / 3000).astype(int)
    page = color_tables()[0][levels].astype(int)
    figure = Figure()
    axes = figure.subplots()
    shown = show_image(axes, depth, colors=DISTANCE, vmin=1000, vmax=4000)
    in_figure = np.rint(255 * shown.cmap(shown.norm(np.ma.masked_invalid(depth)))[..., :3]).astype(int)
    for picture in (page, in_figure):
        near, far, unknown = picture[20, 10], picture[20, 30], picture[20, 50]
        assert is_warm(near)
        assert is_warm(far[::-1])
        np.testing.assert_array_equal(unknown, np.rint(255 * np.array(to_rgb(UNKNOWN))))


@pytest.mark.parametrize("name", [DISTANCE, ERROR, DIFFERENCE, OTHER])
def test_the_fast_way_draws_what_matplotlib_draws(name, rng):
    levels = rng.uniform(-0.2, 1.2, (30, 40))
    levels[0] = np.nan
    slow = np.rint(255 * color_map(name)(np.ma.masked_invalid(np.clip(levels, 0, 1)))[..., :3])
    assert np.abs(draw_levels(levels, name) - slow).max() == 0
    np.testing.assert_array_equal(draw_levels(levels, name)[0], slow[0])


@pytest.mark.parametrize("values", [(3.8, 4.4), (0.02, 900), (0.5, 7), (12, 3000)])
def test_logarithmic_axes_are_labelled_with_plain_numbers(values):
    figure = Figure()
    axes = figure.subplots()
    axes.plot([1, 2], values)
    plain_log_scale(axes)
    FigureCanvasAgg(figure).draw()
    low, high = axes.get_ylim()
    labels = [tick.get_text() for tick in axes.get_yticklabels(which="both") if low <= tick.get_position()[1] <= high]
    assert len(labels) >= 2
    for label, place in zip(labels, [t for t in axes.get_yticks() if low <= t <= high], strict=True):
        assert float(label) == pytest.approx(place)  # "$\\mathdefault{4 \\times 10^0}$" is no number


@pytest.mark.parametrize(("ends", "is_same"), [((1000.0, 4000.0), True), (None, False)])
def test_previews_of_one_range_give_a_distance_one_colour(tmp_path, ends, is_same):
    depth = np.linspace(1900, 2600, 60 * 80).reshape(60, 80)
    depth[10:50, 10:70] = 2000
    color = np.full((60, 80, 3), 0.5)
    frame = SimpleNamespace(depth_mm=depth, sigma_mm=depth / 50, valid=np.isfinite(depth), color=color)
    write_preview(tmp_path / "preview.png", color, frame, title="", caption="a caption", depth_range_mm=ends)
    picture = np.asarray(Image.open(tmp_path / "preview.png").convert("RGB")).reshape(-1, 3)
    expected = 255 * np.array(color_map(DISTANCE)(1 / 3)[:3])  # 2000 mm between 1000 and 4000
    # The inner part, half of the map, is a quarter of a quarter of the page at least.
    assert ((np.abs(picture - expected) < 1).all(axis=1).mean() > 1 / 16) == is_same
