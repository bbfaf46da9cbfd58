"""``chromaperture serve``."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Annotated

import typer

from chromaperture.app.free_space import RESERVE_BYTES
from chromaperture.cli.console import compile_kernels
from chromaperture.cli.options import CameraOrDesign, Quiet

PORT = 8733  # of no service that is registered; the same every time, because an installed app keeps its address


def serve(
    camera: CameraOrDesign = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of camera files, sessions and photographs.")] = Path(
        "chromaperture-app"
    ),
    source: Annotated[
        list[str] | None,
        typer.Option(
            "--source",
            help="Camera of this computer for the assistant, repeatable: webcam:0, pylon:SERIAL, gphoto2, "
            "replay:FOLDER, a video. Pages can use only these.",
        ),
    ] = None,
    lan: Annotated[
        bool,
        typer.Option(
            "--lan",
            help="Open it to this network, for a phone: https with a certificate made at the first start. Whoever has "
            "the whole address that is printed can use it.",
        ),
    ] = False,
    port: Annotated[int, typer.Option(min=1, max=65535, help="Port.")] = PORT,
    new_address: Annotated[
        bool, typer.Option("--new-address", help="Draw another token: who has the old address is locked out.")
    ] = False,
    keep_free_gb: Annotated[
        float, typer.Option(min=0, help="GiB of the disk that sessions and photographs leave free.")
    ] = RESERVE_BYTES / 2**30,
    quiet: Quiet = False,
) -> None:
    """Serve the app: measure in the browser, and be led through a calibration, until Ctrl-C.

    Example: chromaperture serve --camera camera.asdf
    """
    from chromaperture.app.camera_feed import CameraFeed
    from chromaperture.app.certificate import kept_certificate, kept_token, own_names, qr_code, state_folder
    from chromaperture.app.gate import Access
    from chromaperture.app.listening import make_server
    from chromaperture.app.server import make_app
    from chromaperture.app.state import AppState

    state = state_folder()
    host, names = ("0.0.0.0", own_names()) if lan else ("127.0.0.1", [])
    token = kept_token(state, anew=new_address)
    access = Access(host, token, scheme="https" if lan else "http", command="serve")
    trusted = kept_certificate(state, names) if lan else None
    bench = AppState(out, camera, reserve_bytes=int(keep_free_gb * 2**30))
    files = None if trusted is None else trusted.certificate
    feeds = [CameraFeed(spec) for spec in source or []]
    application = make_app(bench, access, certificate=files, feeds=feeds)
    compile_kernels("real-time", quiet=quiet)
    here = access.url(port, host="localhost" if lan else None)

    def ready() -> None:  # with --quiet too: without its token nobody can open the page
        typer.echo(f"Open this address; Ctrl-C ends it:\n\n    {here}\n", err=quiet)
        if trusted is not None:
            there = access.url(port, host=names[0])
            typer.echo(f"From a phone in this network:\n\n    {there}\n", err=quiet)
            if not quiet:
                typer.echo(qr_code(there))
            typer.echo(
                "The browser will ask whether to trust this computer. The certificate's SHA-256 fingerprint is "
                f"{trusted.fingerprint}",
                err=quiet,
            )

    pair = None if trusted is None else (trusted.certificate, trusted.key)
    try:
        with contextlib.suppress(KeyboardInterrupt):  # the usual way to stop
            make_server(application, host=host, port=port, certificate=pair, ready=ready).run()
    finally:
        for feed in feeds:
            feed.close()
