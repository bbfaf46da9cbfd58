"""Make ``system/kernels.json``: the kernels of each quality, their arguments and the time to compile them.

``python benchmarks/kernel_list.py`` after a kernel or its arguments changed; a test says when. Everything is compiled
anew, in a folder of its own. The times only order the kernels: those that take longest are compiled first.
"""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

QUALITIES = ("paper", "real-time", "accurate")
TARGET = Path(__file__).parents[1] / "src" / "chromaperture" / "system" / "kernels.json"


def kernels_of(quality: str) -> dict[str, list]:
    """Measure the samples in this process; returns what was compiled for it, in the form of the list."""
    from numba.core import event
    from numba.core.dispatcher import Dispatcher

    from chromaperture.color.alignment import fill_from_nearest
    from chromaperture.products.samples import open_sample, samples
    from chromaperture.system.compile_ahead import text_of

    seconds: dict[str, float] = {}
    begun: list[float] = []

    class Clock(event.Listener):
        def on_start(self, _: event.Event) -> None:
            begun.append(time.process_time())

        def on_end(self, happened: event.Event) -> None:
            function = happened.data["dispatcher"].py_func
            name = f"{function.__module__}:{function.__name__}"
            seconds[name] = seconds.get(name, 0.0) + time.process_time() - begun.pop()

    event.register("numba:compile", Clock())
    for sample in samples():
        camera, image = open_sample(sample, quality=quality, device="cpu")
        frame = camera.measure(image)
        frame.points()
        with tempfile.TemporaryDirectory() as folder:
            frame.save(folder, write="ply")
        frame.depth_mm, frame.sigma_mm, frame.color  # noqa: B018 - some are computed when they are asked for
        # What fills unknown pixels, of which the samples may have none.
        fill_from_nearest(np.where(np.arange(image.shape[1]) < 1, np.nan, image[..., 0]))
    found: dict[str, list] = {}
    for kernel in (it for it in gc.get_objects() if isinstance(it, Dispatcher)):
        if hasattr(kernel._cache, "holds") and kernel.signatures:  # type: ignore[attr-defined]
            name = f"{kernel.py_func.__module__}:{kernel.py_func.__name__}"
            signatures = sorted([text_of(argument) for argument in signature] for signature in kernel.signatures)
            found[name] = [round(seconds.get(name, 0.0), 1), *signatures]
    return dict(sorted(found.items()))


def text_of_list(content: dict[str, dict[str, list]]) -> str:
    """JSON with a line for each kernel."""
    qualities = []
    for quality, kernels in content.items():
        lines = ",\n".join(f"  {json.dumps(name)}: {json.dumps(value)}" for name, value in kernels.items())
        qualities.append(f" {json.dumps(quality)}: {{\n{lines}\n }}")
    return "{\n" + ",\n".join(qualities) + "\n}\n"


def main() -> None:
    if len(sys.argv) > 1:
        print(json.dumps(kernels_of(sys.argv[1])))
        return
    content = {}
    for quality in QUALITIES:
        with tempfile.TemporaryDirectory() as folder:
            done = subprocess.run(
                [sys.executable, __file__, quality], env=os.environ | {"NUMBA_CACHE_DIR": folder}, capture_output=True,
                text=True, check=True,
            )  # fmt: skip
        content[quality] = json.loads(done.stdout.splitlines()[-1])
    TARGET.write_text(text_of_list(content))


if __name__ == "__main__":
    main()
