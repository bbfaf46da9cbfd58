"""``chromaperture compare``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from chromaperture.cli.console import out as console
from chromaperture.cli.console import print_json
from chromaperture.cli.options import Json, Quality, Quiet, check_output
from chromaperture.system.errors import InputError

if TYPE_CHECKING:
    from chromaperture.files.map_page import Page


def compare(
    a: Annotated[Path, typer.Argument(help="Depth map in mm (TIFF, 16-bit PNG, .npy), or camera file.", metavar="A")],
    b: Annotated[Path, typer.Argument(help="The same of another measurement or camera.", metavar="B")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="The page; default comparison.html, none with --json.")
    ] = None,
    quality: Quality = "real-time",
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compare two depth maps, or two cameras: difference, shares, and whether the error bars are honest.

    chromaperture compare truth.depth.tiff photo.depth.tiff --out comparison.html

    chromaperture compare before.asdf after.asdf --json
    """
    from chromaperture.files.map_page import render
    from chromaperture.system.storage import staged

    cameras = [path.suffix == ".asdf" for path in (a, b)]
    if any(cameras) and not all(cameras):
        raise InputError("a camera and a depth map cannot be compared; give two of a kind")
    target = out or (None if json else Path("comparison.html"))
    if target is not None:
        check_output(target, ".html", inputs=[a, b])
    figures, page = _cameras(a, b, quality) if all(cameras) else _maps(a, b)
    if target is not None:
        with staged(target.parent) as stage:
            stage.path(target.name).write_text(render(page), encoding="utf-8")
    if json:
        print_json(figures)
    elif not quiet:
        for sentence in page.sentences:
            console.print(sentence, markup=False, highlight=False)
        console.print(f"Wrote {target}", markup=False)


def _maps(a: Path, b: Path) -> tuple[dict[str, Any], Page]:
    from chromaperture.evaluation.compare import compare_depth, depth_page
    from chromaperture.products.result_files import picture_beside, read_depth, stem_and_output

    for path in (a, b):
        if stem_and_output(path)[1] in ("sigma", "disparity"):  # maps themselves; others stand for their depth
            raise InputError(f"{path.name} is no depth map; give STEM.depth.tiff beside it")
    first, second = read_depth(a), read_depth(b)
    if first.name == second.name:  # of two folders: say which
        first, second = (read_depth(path, name=_with_folder(path)) for path in (a, b))
    found = compare_depth(first, second)
    beside = picture_beside(b)
    return found.figures, depth_page(found, picture=picture_beside(a) if beside is None else beside)


def _cameras(a: Path, b: Path, quality: str) -> tuple[dict[str, Any], Page]:
    from chromaperture.evaluation.compare import camera_page, compare_cameras
    from chromaperture.model.camera_file import Calibration

    names = (a.name, b.name) if a.name != b.name else (_with_folder(a), _with_folder(b))
    found = compare_cameras(Calibration.load(a), Calibration.load(b), names=names, quality=quality)
    return found.figures, camera_page(found)


def _with_folder(path: Path) -> str:
    """Return a file's name with its folder's, to tell it from one of the same name."""
    return f"{path.resolve().parent.name}/{path.name}"
