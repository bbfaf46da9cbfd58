"""A figure or table of the paper, and what its part of the page contains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from chromaperture_paper.context import Context


@dataclass(frozen=True)
class Comparison:
    """A quantity, the paper's value and ours with their units, and a sentence on the difference."""

    what: str
    paper: str
    ours: str
    why: str


@dataclass(frozen=True)
class Chart:
    """A figure, the stem of its file, and its caption."""

    stem: str
    figure: Figure
    caption: str


@dataclass(frozen=True)
class CsvTable:
    """A table of text and the stem of its CSV file; ``on_page`` is false for tables too long for the page."""

    stem: str
    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    on_page: bool = True


@dataclass(frozen=True)
class Content:
    """Content of one exhibit; ``source`` states what the input was."""

    source: str
    charts: Sequence[Chart] = ()
    tables: Sequence[CsvTable] = ()
    comparisons: Sequence[Comparison] = ()
    lines: Sequence[str] = ()


@dataclass(frozen=True)
class Exhibit:
    """A figure or table of the paper, or a comparison that belongs to it."""

    name: str  # on the command line, and of its folder
    title: str
    make: Callable[[Context], Content]
    files: tuple[str, ...] = ()  # that it reads below --data where such a folder is given
    only_data: bool = False  # whether it has no simulated input
    reads_all: bool = False  # whether it reads more of the data folder than these files, and camera files
