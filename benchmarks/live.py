"""Rate and memory of the live loop: python benchmarks/live.py SOURCE --camera CAMERA.asdf [--seconds 60].

SOURCE is a live one, as "replay:FOLDER?speed=1&loop=1" or "simulate:FOLDER?speed=1&loop=1". Without a browser; --page
draws the page as for a viewer. CPU time is comparable between busy and free machines, rates are those of a free one
only, see the load; stages hand parts of their work to the threads called chromaperture. The first third is
warm-up: compilation, and growth of the model. Memory growth is of a straight line fitted to the remaining time, for all
memory and without the voxels in use, which new places need. --out FOLDER stores the curves, memory.csv and memory.png.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from chromaperture.app.live.loop import LiveLoop
from chromaperture.app.live.page import LivePage
from chromaperture.camera.camera import CodedApertureCamera, load_camera
from chromaperture.capture.open import open_source
from chromaperture.reconstruction.volume import BLOCK_BYTES


def resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 2**20


def with_page(loop: LiveLoop, folder: str) -> tuple[LivePage, threading.Thread]:
    """Draw the page as for a browser, without one."""
    page = LivePage(loop, host="127.0.0.1", port=8990, out=Path(folder))
    page.view._asked = math.inf  # somebody looks, always
    thread = threading.Thread(target=page.run, name="page", daemon=True)
    thread.start()
    return page, thread


@contextlib.contextmanager
def running(
    args: argparse.Namespace, camera: CodedApertureCamera, listener: Callable[[str], None]
) -> Iterator[LiveLoop]:
    with (
        open_source(args.source, camera_encoding=camera.calibration.sensor.encoding) as source,
        LiveLoop(source, camera, track=not args.no_model, listener=listener) as loop,
    ):
        yield loop


def cpu_seconds() -> dict[str, float]:
    """CPU time of all threads so far; those of libraries, which Python does not know, together."""
    names = {thread.native_id: thread.name for thread in threading.enumerate()}
    spent: defaultdict[str, float] = defaultdict(float)
    for task in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):  # it has ended
            fields = (task / "stat").read_text().rpartition(")")[2].split()
            name = names.get(int(task.name), "libraries").split("_")[0]
            spent[name] += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return dict(spent)


def sample(loop: LiveLoop, now: float) -> tuple[float, ...]:
    """One row of the curve: seconds, resident MB, frames, blocks, keyframes, vertices."""
    model = loop.model.current if loop.model else None
    grown = (model.volume.blocks, len(model.keyframes)) if model and model.volume else (0, 0)
    vertices = len(loop.mesh.vertices_mm) if loop.mesh else 0
    return (now, resident_mb(), loop.meters["depth"].count, *grown, vertices)


def voxels_mb(rows: np.ndarray) -> np.ndarray:
    return rows[:, 3] * BLOCK_BYTES / 2**20


def growth_percent(minutes: np.ndarray, mb: np.ndarray) -> float:
    """Growth from the first to the last minute along the straight line through the curve."""
    line = np.polynomial.Polynomial.fit(minutes, mb, 1)
    return float(100 * (line(minutes[-1]) / line(minutes[0]) - 1))


def write_curve(folder: Path, rows: np.ndarray, warm_s: float) -> None:
    import matplotlib.pyplot as plt

    folder.mkdir(parents=True, exist_ok=True)
    names = "seconds,resident_mb,frames,blocks,keyframes,vertices"
    np.savetxt(folder / "memory.csv", rows, "%.2f", ",", header=names, comments="")
    figure, axes = plt.subplots(figsize=(8, 3.5), layout="constrained")
    axes.plot(rows[:, 0] / 60, rows[:, 1], label="all")
    axes.plot(rows[:, 0] / 60, rows[:, 1] - voxels_mb(rows), label="without the voxels in use")
    axes.axvline(warm_s / 60, color="0.6", linestyle="--", label="end of warm-up")
    axes.set(xlabel="minutes", ylabel="resident memory, MB", ylim=(0, None))
    axes.legend()
    figure.savefig(folder / "memory.png", dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source")
    parser.add_argument("--camera", type=Path, required=True)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--no-model", action="store_true")
    parser.add_argument("--page", action="store_true")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()

    camera = load_camera(args.camera)
    rows, messages = [], []
    warm_s = args.seconds / 3
    with tempfile.TemporaryDirectory() as folder, running(args, camera, messages.append) as loop:
        page, thread = with_page(loop, folder) if args.page else (None, None)
        start, warm = time.monotonic(), None
        while (now := time.monotonic() - start) < args.seconds and not loop.over.is_set():
            rows.append(sample(loop, now))
            if warm is None and now >= warm_s:
                warm = (now, time.process_time(), loop.meters["depth"].count, loop.meters["tracking"].count)
                spent_before = cpu_seconds()
            loop.over.wait(1.0)
        seconds, frames = now - warm[0], loop.meters["depth"].count - warm[2]
        spent, figures = time.process_time() - warm[1], loop.figures()
        tracked = loop.meters["tracking"].count - warm[3]
        spent_by = {name: s - spent_before.get(name, 0.0) for name, s in cpu_seconds().items()}
        loop.stop()
        if page is not None:
            thread.join()
            page.close()
    curve = np.array(rows)
    if args.out:
        write_curve(args.out, curve, warm_s)
    late = curve[curve[:, 0] >= warm_s]
    print(
        json.dumps(
            {
                "frames_per_second": frames / seconds,
                "tracked_frames_per_second": tracked / seconds,
                "cpu_seconds_per_frame": spent / max(frames, 1),
                "cpu_ms_by_thread_a_tracked_frame": {
                    name: round(1000 * s / max(tracked, 1), 1) for name, s in sorted(spent_by.items()) if s > 0
                },
                "load": os.getloadavg(),
                "memory_growth_percent": growth_percent(late[:, 0], late[:, 1]),
                "memory_growth_without_voxels_percent": growth_percent(late[:, 0], late[:, 1] - voxels_mb(late)),
                "blocks": [int(late[0, 3]), int(late[-1, 3])],
                "vertices": [int(late[0, 5]), int(late[-1, 5])],
                "memory_mb": curve[-1, 1],
                "frames": int(curve[-1, 2]),
                "said": sorted(set(messages))[:20],
                "lines_said": len(messages),
                "stages": figures,
            },
            indent=1,
        )
    )


if __name__ == "__main__":
    main()
