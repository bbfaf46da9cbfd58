"""``chromaperture transparency``: Eq. (11), Tables 1 and 2, Figure 11 from photographs of a white sheet."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from chromaperture.cli.console import out as console
from chromaperture.cli.console import print_json, table
from chromaperture.cli.options import BlackLevel, Json, Quiet, WhiteLevel, check_output
from chromaperture.system.errors import InputError

if TYPE_CHECKING:
    import numpy as np


def transparency(
    sheets: Annotated[
        list[Path], typer.Argument(help="White sheet through each coded aperture, one file a design.", metavar="SHEET")
    ],
    bare: Annotated[Path, typer.Option(help="The same sheet through the open pupil, at the same exposure.")],
    black_level: BlackLevel = None,
    white_level: WhiteLevel = None,
    exposure: Annotated[
        float, typer.Option(help="Exposure of the SHEETs over that of the bare one, where they differ.")
    ] = 1.0,
    figure: Annotated[Path | None, typer.Option(help="Write maps and the bar chart of Figure 11 (.png, .svg).")] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure how much light coded apertures pass, and what that costs in noise.

    chromaperture transparency white/cy_halves.png --bare white/open.png --black-level 16 --white-level 1016
    """
    from chromaperture.capture.files import read_image
    from chromaperture.color.transparency_map import transparency as transparency_map
    from chromaperture.system.storage import staged

    if not exposure > 0:
        raise InputError(f"--exposure must be positive, got {exposure:g}")
    if figure is not None:
        check_output(figure, ".png", ".svg", option="--figure")

    def read(path: Path) -> np.ndarray:
        return read_image(path, black_level=black_level, white_level=white_level)

    open_sheet = read(bare)
    maps: dict[str, np.ndarray] = {}
    rows: list[dict[str, Any]] = []
    for path in sheets:
        sheet = read(path)
        maps[path.stem] = transparency_map(sheet / exposure if exposure != 1 else sheet, open_sheet)
        rows.append({"name": path.stem, **figures(sheet, open_sheet, maps[path.stem])})
    if figure is not None:
        with staged(figure.parent) as stage:
            draw(stage.path(figure.name), maps)
    if json:
        print_json(rows)
    elif not quiet:
        _print(rows)
        if figure is not None:
            typer.echo(f"Wrote {figure}")


def figures(coded: np.ndarray, bare: np.ndarray, transmission: np.ndarray) -> dict[str, Any]:
    """Return the figures of Tables 1 and 2 and Figure 11 for one aperture; losses in dB, mean over the channels."""
    import numpy as np

    from chromaperture.color.noise import exposure_to_restore, snr_db
    from chromaperture.color.transparency_map import light_efficiency

    light = light_efficiency(transmission)
    (open_center, _), (center, border) = snr_db(bare), snr_db(coded)
    loss = float(np.mean(open_center - center))
    longer = exposure_to_restore(max(loss, 0.0))
    return {
        "minimum_rgb": light.minimum.round(4).tolist(),
        "maximum_rgb": light.maximum.round(4).tolist(),
        "efficiency": light.efficiency,
        "efficiency_luminance": light.luminance,
        "snr_loss_central_db": loss,
        "snr_loss_border_db": float(np.mean(open_center - border)),
        "exposure_shot_noise": longer.shot,
        "exposure_amplitude": longer.amplitude,
    }


def draw(path: Path, maps: dict[str, np.ndarray]) -> None:
    """Draw the transparency maps as in Table 1 and the efficiencies as in Figure 11, sorted by light."""
    import numpy as np

    from chromaperture.color.color_maps import OTHER
    from chromaperture.evaluation.figures import CHANNEL_COLORS, new_figure, show_image

    names = sorted(maps, key=lambda name: float(maps[name].mean()))
    sheet = new_figure(2.4 * max(len(names), 3), 8.4)
    grid = sheet.add_gridspec(4, len(names), height_ratios=(1, 1, 1, 2))
    for column, name in enumerate(names):
        for k, channel in enumerate("RGB"):
            axes = sheet.add_subplot(grid[k, column])
            values = maps[name][..., k]
            title = f"{name}\n" if k == 0 else ""
            title += f"{channel}: {values.min():.2f} to {values.max():.2f}"
            show_image(axes, values, title, bar="", colors=OTHER)
    bars = sheet.add_subplot(grid[3, :])
    position = np.arange(len(names))
    for k, (channel, color) in enumerate(CHANNEL_COLORS.items()):
        means = [100 * float(maps[name][..., k].mean()) for name in names]
        bars.bar(position + 0.26 * (k - 1), means, 0.25, color=color, label=channel)
    for x, name in zip(position, names, strict=True):
        bars.annotate(f"{100 * float(maps[name].mean()):.1f} %", (x, 101), ha="center", fontsize=9)
    bars.set_xticks(position, names)
    bars.set(ylabel="light that passes, %", ylim=(0, 110))
    bars.legend(fontsize=9, loc="upper left")
    sheet.savefig(path, format=path.suffix[1:])


def _print(rows: list[dict[str, Any]]) -> None:
    light = table("Transparency, Eq. (11), %", "sheet", "R", "G", "B", "mean")
    noise = table("Loss of SNR, dB, and exposure", "sheet", "centre", "border", "exposure, photons", "sensor noise")
    for row in rows:
        ranges = (f"{100 * a:.0f}-{100 * b:.0f}" for a, b in zip(row["minimum_rgb"], row["maximum_rgb"], strict=True))
        light.add_row(escape(row["name"]), *ranges, f"{100 * row['efficiency']:.1f}")
        losses = (f"{row[f'snr_loss_{place}_db']:.1f}" for place in ("central", "border"))
        longer = (f"x {row[f'exposure_{source}']:.2f}" for source in ("shot_noise", "amplitude"))
        noise.add_row(escape(row["name"]), *losses, *longer)
    console.print(light)
    console.print(noise)
    console.print(
        "Loss against the bare centre. Exposure: the factor that restores the centre's SNR where photons make the "
        "noise, and where the sensor's own noise does, the reading behind the paper's 30 % for 2.3 dB."
    )
