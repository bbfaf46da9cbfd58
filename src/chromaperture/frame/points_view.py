"""Points that a notebook or a web page turns with the mouse, with their data inside."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape

from chromaperture.depth.pointcloud import PointCloud
from chromaperture.files.map_page import Page, render
from chromaperture.system.errors import InputError


@dataclass(frozen=True, repr=False)
class PointsView:
    """A page that shows points, and needs nothing else.

    Attributes
    ----------
    page : str
        HTML with the data inside; ``Path("points.html").write_text(view.page, encoding="utf-8")`` keeps it.
    count : int
        Points shown.
    height_px : int
        Height within a notebook.
    """

    page: str
    count: int
    height_px: int

    def __repr__(self) -> str:
        return f"PointsView({self.count} points)"

    def _repr_html_(self) -> str:
        style = "border: 1px solid #ddd; width: 100%"
        return f'<iframe srcdoc="{escape(self.page)}" height="{self.height_px}" style="{style}"></iframe>'


def points_view(cloud: PointCloud, *, most_points: int, height_px: int) -> PointsView:
    """Make the page; of more than ``most_points`` points, evenly chosen ones. Raises InputError for no point."""
    if not len(cloud.points_mm) or most_points < 1:
        raise InputError("there is no point to show: raise max_relative_sigma or most_points")
    chosen = slice(None, None, -(-len(cloud.points_mm) // most_points))
    shown = PointCloud(cloud.points_mm[chosen], cloud.colors[chosen])
    return PointsView(render(Page(title="Points", cloud=shown)), len(shown.points_mm), height_px)
