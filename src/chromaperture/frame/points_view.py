"""Points that a notebook or a web page turns with the mouse, with their data inside."""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from html import escape

import numpy as np

from chromaperture.depth.pointcloud import PointCloud
from chromaperture.system.errors import InputError, MissingDependencyError

_POINT_MM = 3.0  # side of a point, chosen by hand: neighbours of a 720x480 camera at 2 m lie 1.2 mm apart

_ROOM = 1.15  # about the points, chosen by hand


@dataclass(frozen=True, repr=False)
class PointsView:
    """A page that shows points, and needs nothing else."""

    page: str  # HTML with the data inside; ``Path("points.html").write_text(view.page, encoding="utf-8")`` keeps it
    count: int  # points shown
    height_px: int  # height within a notebook

    def __repr__(self) -> str:
        return f"PointsView({self.count} points)"

    def _repr_html_(self) -> str:
        style = "border: 1px solid #ddd; width: 100%"
        return f'<iframe srcdoc="{escape(self.page)}" height="{self.height_px}" style="{style}"></iframe>'


def points_view(cloud: PointCloud, *, most_points: int, height_px: int) -> PointsView:
    """Make a page of points with viser's client.

    ``most_points``: of more points, evenly chosen ones are shown. Raises InputError: there is no point, or
    ``most_points`` is below 1. Raises MissingDependencyError: the extra ``viewer`` is not installed.
    """
    try:
        import viser
    except ImportError:
        raise MissingDependencyError("turning points needs the extra: pip install 'chromaperture[viewer]'") from None
    if not len(cloud.points_mm) or most_points < 1:
        raise InputError("there is no point to show: raise max_relative_sigma or most_points")
    chosen = slice(None, None, -(-len(cloud.points_mm) // most_points))
    points_m, colors = cloud.points_mm[chosen] / 1000, cloud.colors[chosen]
    middle = np.median(points_m, axis=0)
    reach = np.abs(points_m[:, 1] / points_m[:, 2] - middle[1] / middle[2])
    field_of_view = 2.0 * float(np.arctan(_ROOM * np.percentile(reach, 98))) or 0.1  # of the height, radians
    # Viser can make a page only of a server's scene; this one serves loopback for the time that takes, 0.1 s.
    with _silence():
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        try:
            server.scene.set_up_direction("-y")
            server.initial_camera.position = (0.0, 0.0, 0.0)
            server.initial_camera.look_at = tuple(middle)
            server.initial_camera.fov = field_of_view
            server.scene.add_point_cloud("/points", points_m, colors, point_size=_POINT_MM / 1000)
            page = server.scene.as_html()
        finally:
            server.stop()
    return PointsView(page, len(points_m), height_px)


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Keep viser's banner from the output; in a notebook it is no text but a display."""
    with contextlib.ExitStack() as stack:
        if "IPython" in sys.modules:
            from IPython.utils.capture import capture_output

            stack.enter_context(capture_output())
        else:
            stack.enter_context(contextlib.redirect_stdout(io.StringIO()))
        yield
