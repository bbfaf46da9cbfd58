"""``chromaperture films``: which lighting gels to buy for a camera."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from chromaperture.cli.console import out as console
from chromaperture.cli.console import print_json, table
from chromaperture.cli.options import Json, Quiet, check_output
from chromaperture.system.errors import CaptureWarning, InputError

if TYPE_CHECKING:
    from chromaperture.optics.gels import Gel, Seen

_COUNT = 5  # pairs a list
_COMMON = (("118", "101"), ("115", "101"))  # what is bought by the names of the colours; shown beside the best
_ALIKE = 1e-9  # information, where the best pairs have 0.1 and more: two of one colour; chosen by hand
# Of a lamp's power, within 5 nm, from where it is a line: CIE's white LEDs have at most 0.1, its fluorescent lamps of
# three bands 0.18 and more.
_LINE = 0.12


def films(
    gels: Annotated[
        list[str] | None, typer.Argument(help="Two gels to judge: numbers, names or .csv files.", metavar="GEL GEL")
    ] = None,
    camera_model: Annotated[
        str | None, typer.Option(help="A measured camera, such as 'Canon EOS R5'; default the mean of all.")
    ] = None,
    sensitivities: Annotated[
        Path | None,
        typer.Option(help="The camera's own, for files of gels and light: a .csv of wavelength_nm,red,green,blue."),
    ] = None,
    light: Annotated[
        str | None, typer.Option(help="daylight, led, tungsten, or a .csv file of wavelength_nm,power.")
    ] = None,
    list_gels: Annotated[bool, typer.Option("--list", help="List all gels and what the camera sees of them.")] = False,
    figure: Annotated[Path | None, typer.Option(help="Write a figure of what the pairs pass (.png, .svg).")] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Choose two lighting gels for a camera: what they pass, the light they cost, the depth error they allow.

    Example: chromaperture films 141 768 --camera-model "Canon EOS R5" --light led
    """
    from chromaperture.optics.gels import LIGHTS, OF_SPECTRA, cameras, gel_named

    if gels and len(gels) != 2:
        raise InputError(f"give two gels to judge, or none to see the best pairs; got {len(gels)}")
    if camera_model and sensitivities:
        raise InputError("give either --camera-model or --sensitivities, not both")
    if light and light.lower().endswith(".csv") and not sensitivities:
        raise InputError(
            f"--light of a file needs --sensitivities of the camera; what measured cameras see is known for "
            f"{', '.join(LIGHTS)} alone"
        )
    if figure:
        check_output(figure, ".png", ".svg", inputs=[sensitivities], option="--figure")
    chosen = [(gel_named(gels[0]), gel_named(gels[1]))] if gels else None
    own = [gel for pair in chosen or [] for gel in pair if gel.file]
    if own and not sensitivities:
        raise InputError(f"{own[0].file}: {OF_SPECTRA}")
    look = _look(camera_model, sensitivities, own)
    whose = camera_model or (sensitivities.name if sensitivities else f"mean of {len(cameras())} cameras")
    if list_gels:
        _list_gels(look(light or LIGHTS[0]), light or LIGHTS[0], whose, json=json)
        return
    lights = [light] if light else LIGHTS if chosen else LIGHTS[:1]
    rows = [row for name in lights for row in judged(chosen, look, name)]
    if figure:
        _draw(figure, rows)
    if json:
        print_json([{"camera": whose} | row for row in rows])
    elif not quiet:
        _print(rows, whose)
        if figure:
            typer.echo(f"Wrote {figure}")


def _look(camera_model: str | None, sensitivities: Path | None, own: list[Gel]) -> Callable[[str], Seen]:
    """Return how to find what a camera sees under a light: computed from spectra, or by the table."""
    if sensitivities:
        from chromaperture.optics.gel_spectra import seen_by

        return cache(lambda light: seen_by(sensitivities, light, own))
    from chromaperture.optics.gels import seen

    return cache(lambda light: seen(light, camera_model))


def judged(chosen: Sequence[tuple[Gel, Gel]] | None, look: Callable[[str], Seen], light: str) -> list[dict[str, Any]]:
    """Judge chosen pairs under a light, or its best ones and the common ones."""
    from chromaperture.optics.gels import all_information, best_pairs, gel_named, pair_of

    what = look(light)
    told = all_information(what)
    lists = {f"chosen, {light}": chosen} if chosen else {
        f"best at the exposure without film, {light}": best_pairs(what, told[0], _COUNT),
        f"best where exposed longer, {light}": best_pairs(what, told[1], _COUNT),
        f"common, {light}": [(gel_named(first), gel_named(second)) for first, second in _COMMON],
    }  # fmt: skip
    pairs = [(title, *pair) for title, group in lists.items() for pair in group]
    rows = []
    for title, first, second in pairs:
        pair = pair_of(first, second, what)
        if min(pair.information) < _ALIKE:
            raise InputError(f"{first.title} and {second.title} move all channels alike: give two of other colours")
        same, full = (math.sqrt(best.max() / tells) for best, tells in zip(told, pair.information, strict=True))
        rows.append({
            "list": title,
            "first": first.title,
            "second": second.title,
            "first_rgb": pair.first.round(3),
            "second_rgb": pair.second.round(3),
            "exposure_factor": round(pair.exposure, 2),
            "relative_error": round(same, 2),
            "relative_error_exposed_longer": round(full, 2),
        })  # fmt: skip
    if light.lower().endswith(".csv"):
        _warn_of_lines(light, [gel for _, *pair in pairs for gel in pair], what, look("daylight"))
    return rows


def _warn_of_lines(light: str, gels: list[Gel], what: Seen, by_day: Seen) -> None:
    """Warn of a lamp with a narrow line, and how far what film passes differs from daylight."""
    from chromaperture.optics.gel_spectra import strongest_line

    at_nm, share = strongest_line(light)
    if share > _LINE:
        changes = max(float(abs(what.passed[gel] - by_day.passed[gel]).max()) for gel in gels)
        warnings.warn(
            f"{Path(light).name} has a line at {at_nm:.0f} nm, {share:.0%} of its light within 5 nm of it: what film "
            f"passes depends on it, by up to {changes:.2f} against daylight. Photograph white sheets in this light",
            CaptureWarning, stacklevel=2,
        )  # fmt: skip


def _print(rows: list[dict[str, Any]], whose: str) -> None:
    for title in dict.fromkeys(row["list"] for row in rows):
        shown = table(f"{title}; {whose}".capitalize(), "film", "R, %", "G, %", "B, %", "exposure", "error", "longer")
        for row in rows:
            if row["list"] == title:
                passed = [[f"{100 * t:.0f}" for t in row[f"{which}_rgb"]] for which in ("first", "second")]
                figures = [f"x {row['exposure_factor']:.1f}", f"{row['relative_error']:.2f}",
                           f"{row['relative_error_exposed_longer']:.2f}"]  # fmt: skip
                shown.add_row(row["first"], *passed[0], *figures)
                shown.add_row(row["second"], *passed[1], end_section=True)
        console.print(shown)
    console.print(
        "R, G, B: what each film passes. exposure: factor that makes the brightest channel as bright as without film. "
        "error: of depth, by photon noise, over that of the best pair, at the exposure without film, as where light is "
        "scarce; longer: exposed longer by that factor. For halves of the pupil and a grey texture. Sheets differ: "
        "photograph white sheets all the same."
    )


def _list_gels(what: Seen, light: str, whose: str, *, json: bool) -> None:
    known = {gel.title: passed.mean(axis=0) for gel, passed in what.passed.items()}
    if json:
        print_json([{"gel": title, "rgb": rgb.round(3)} for title, rgb in known.items()])
        return
    shown = table(f"Lee's gels, {light}; {whose}", "film", "R, %", "G, %", "B, %")
    for title, rgb in known.items():
        shown.add_row(title, *(f"{100 * t:.0f}" for t in rgb))
    console.print(shown)


def _draw(path: Path, rows: list[dict[str, Any]]) -> None:
    """Draw what each pair passes in red, green and blue; light by light where a pair has several."""
    import numpy as np

    from chromaperture.evaluation.figures import new_figure, style_axes
    from chromaperture.system.storage import staged

    lists = {(row["first"], row["second"], row["list"].rpartition(", ")[2]): row for row in rows}
    columns = min(len(lists), 3)
    drawing = new_figure(4.0 * columns, 2.6 * math.ceil(len(lists) / columns))
    for i, ((first, second, light), row) in enumerate(lists.items(), start=1):
        axes = drawing.add_subplot(math.ceil(len(lists) / columns), columns, i)
        for place, which, alpha in ((-0.2, "first", 0.5), (0.2, "second", 0.9)):
            colours = ("tab:red", "tab:green", "tab:blue")
            axes.bar(np.arange(3) + place, row[f"{which}_rgb"], 0.36, color=colours, alpha=alpha)
        axes.set_xticks(range(3), ("R", "G", "B"))
        axes.set_ylim(0, 1)
        axes.set_title(f"{first}, {second}\n{light}", fontsize=7)
        style_axes(axes, xlabel="left the first film, right the second", ylabel="passes")
    with staged(path.parent) as stage:
        drawing.savefig(stage.path(path.name))
