"""Figure 4(a): the filters' colours in RGB, and the axes C, Y, X of Eq. (1)."""

from __future__ import annotations

import numpy as np

from chromaperture.color.unmixing import mixing_matrix
from chromaperture.evaluation.figures import new_figure
from chromaperture_paper import world
from chromaperture_paper.context import Context
from chromaperture_paper.exhibit import Chart, Comparison, Content, CsvTable


def make(context: Context) -> Content:
    """Draw the colour space of the real film, and greys seen through both halves, which lie in its plane."""
    film = world.real_film("cy_halves")
    mixing = mixing_matrix(np.array([film.filter_named(name).transmission for name in film.views]))
    rng = np.random.default_rng(0)
    cloud = rng.uniform(0, 1, (300, 2)) @ mixing[:, :2].T  # light through the two halves
    inverse = np.linalg.inv(mixing)
    figure = new_figure(width=5.2, height=4.4)
    axes = figure.add_subplot(projection="3d")
    axes.scatter(*cloud.T, c=np.clip(cloud / max(float(cloud.max()), 1e-9), 0, 1), s=8, depthshade=False)
    for k, (name, color) in enumerate((("C", "#12a5b8"), ("Y", "#c8a200"), ("X", "#8040a0"))):
        tip = mixing[:, k] * (0.6 if name == "X" else 1.0)
        axes.plot(*np.stack([np.zeros(3), tip], axis=1), color=color, linewidth=2.5)
        axes.text(*(1.08 * tip), name, color=color, fontsize=12, fontweight="bold")
    axes.set(xlabel="R", ylabel="G", zlabel="B", xlim=(-0.4, 1), ylim=(-0.4, 1.4), zlim=(-0.4, 1))
    axes.view_init(elev=22, azim=150)
    axes.set_box_aspect(None, zoom=0.88)  # leaves room for the label of B
    rows = [
        (name, *(f"{v:+.3f}" for v in mixing[:, k]), *(f"{v:+.3f}" for v in inverse[k])) for k, name in enumerate("CYX")
    ]
    off = float(np.abs((inverse @ cloud.T)[2]).max())
    angle = np.degrees(np.arccos(np.dot(*[mixing[:, k] / np.linalg.norm(mixing[:, k]) for k in (0, 1)])))
    return Content(
        source="The film of the package ('real'), no photograph needed.",
        charts=[Chart("cyx", figure, "Grey things seen through the two halves lie in the plane of C and Y.")],
        tables=[
            CsvTable("matrix", "Columns of M and rows of its inverse, Eq. (1)",
                     ("axis", "R", "G", "B", "R of row", "G of row", "B of row"), rows)
        ],
        comparisons=[
            Comparison("X", "orthogonal to the CY plane", f"orthogonal; greys leave the plane by {off:.0e}",
                       "No difference: the third column of M is built as the plane's normal.")
        ],
        lines=[f"Cyan and yellow are {angle:.0f} degrees apart in colour; at 0 the views could not be separated."],
    )  # fmt: skip
