"""What a figure or table of the paper is made of, and what the page shows of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from chromaperture.evaluation.tables import Table

if TYPE_CHECKING:
    from chromaperture.evaluation.paper.context import Context


@dataclass(frozen=True)
class Compared:
    """A number of the paper beside ours.

    Attributes
    ----------
    what, paper, ours : str
        With their units.
    why : str
        A sentence on the difference.
    """

    what: str
    paper: str
    ours: str
    why: str


@dataclass(frozen=True)
class Drawn:
    """A picture, the stem of its file and the sentence that says what to see."""

    stem: str
    figure: Figure
    caption: str


@dataclass(frozen=True)
class Listed:
    """A table and the stem of its CSV file; one that is too long for the page is in the file alone."""

    stem: str
    table: Table
    on_page: bool = True


@dataclass(frozen=True)
class Made:
    """All of one figure or table.

    Attributes
    ----------
    source : str
        What the input was.
    """

    source: str
    drawn: Sequence[Drawn] = ()
    listed: Sequence[Listed] = ()
    compared: Sequence[Compared] = ()
    lines: Sequence[str] = ()


@dataclass(frozen=True)
class Exhibit:
    """A figure or table of the paper, or a comparison that belongs to it.

    Attributes
    ----------
    name : str
        As given on the command line and as the folder is called.
    title : str
    make : callable
        Makes it from a `Context`.
    files : tuple of str
        What it reads below ``--data`` where such a folder is given.
    only_data : bool
        Whether it has no simulated input.
    reads_all : bool
        Whether it reads more of the data folder than ``files``, and camera files.
    """

    name: str
    title: str
    make: Callable[[Context], Made]
    files: tuple[str, ...] = ()
    only_data: bool = False
    reads_all: bool = False
