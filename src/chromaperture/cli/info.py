"""``chromaperture info``: of a camera file, or of the devices that can measure."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from chromaperture.cli.console import out as console
from chromaperture.cli.console import print_json, table
from chromaperture.cli.options import Json, Quiet
from chromaperture.system.errors import InputError

_LEFT_OUT = ("boards", "files")  # of the provenance: long lists, which --json prints


def info(
    camera: Annotated[Path | None, typer.Argument(help="Camera file.", metavar="CAMERA.asdf")] = None,
    devices: Annotated[
        bool, typer.Option("--devices", help="List what --device of the commands that measure can name.")
    ] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Show the content of a camera file: lens, focus, baseline, aperture, how it was calibrated.

    chromaperture info camera.asdf

    chromaperture info --devices
    """
    if devices:
        _show_devices(json=json, quiet=quiet)
        return
    if camera is None:
        raise InputError("give a camera file, or --devices")
    from chromaperture.model.camera_file import Calibration

    summary = Calibration.load(camera).summary()
    if json:
        print_json(summary)
    elif not quiet:
        figures = {**summary, **summary.pop("provenance")}
        rows = table(str(camera), "figure", "value", left=2)
        for name, value in figures.items():
            if name not in _LEFT_OUT and name != "provenance":
                rows.add_row(name, escape(as_text(value)))
        console.print(rows)
        console.print("Boards and hashes of all files: --json", markup=False)


def _show_devices(*, json: bool, quiet: bool) -> None:
    """List the CPU and the adapters, and which of them --device auto takes."""
    from chromaperture.matching.device.device import adapters, has_extra
    from chromaperture.matching.device.gpu_method import chosen_device
    from chromaperture.system.threads import thread_count

    found = adapters()
    chosen = chosen_device("auto")
    taken = "cpu" if chosen is None else f"gpu:{chosen.info.name}"
    if json:
        print_json({"auto": taken, "threads": thread_count(), "adapters": [a._asdict() for a in found]})
        return
    if quiet:
        return
    rows = table("Devices", "--device", "kind", "driver", "largest array", left=3)
    rows.add_row("cpu", f"{thread_count()} threads", "Numba", "-")
    for adapter in found:
        kind = "software, for tests" if adapter.is_software else adapter.kind
        driver = f"{adapter.backend}, {adapter.driver}" if adapter.driver else adapter.backend
        rows.add_row(escape(f"gpu:{adapter.name}"), kind, escape(driver), f"{adapter.largest_array_mb} MB")
    console.print(rows)
    if not has_extra():
        console.print("GPUs need the extra: pip install 'chromaperture[gpu]'", markup=False)
    elif not found:
        console.print("No GPU: no driver for Vulkan, Metal or Direct3D 12 was found", markup=False)
    console.print(f"auto takes {taken}", markup=False)


def as_text(value: Any) -> str:
    """Format a value for people: one line an entry of a list or a mapping, "-" for what is unknown or empty."""
    if isinstance(value, dict):
        return "\n".join(f"{name}: {' '.join(as_text(v).splitlines())}" for name, v in value.items()) or "-"
    if isinstance(value, list | tuple):
        entries = [as_text(v) for v in value]
        return ("\n" if any(isinstance(v, str | dict | list | tuple) for v in value) else ", ").join(entries) or "-"
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
