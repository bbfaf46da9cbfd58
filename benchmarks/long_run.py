"""The live loop and its page for hours, with a camera that misbehaves: python benchmarks/long_run.py [--seconds 1200]

With `--source SPEC` the camera is one that `open_source` opens instead; its pictures must be of 240x160 px, as those of
`'aravis:127.0.0.1?width=480&height=320&fps=30'` beside Debian's `arv-fake-gv-camera-0.8 -i lo -r 2`.

A simulated camera stalls, jumps in time, changes its size, is unplugged and gives damaged frames; browsers come, press
everything, send nonsense and die. Exit code 1: memory, handles, threads, queues, messages or blocks of Python grow
after the first third by more than `LIMITS` and three standard errors of a line, the loop ended, or frames stopped.
"""

from __future__ import annotations

import argparse
import contextlib
import http.client
import importlib.util
import json
import os
import random
import shutil
import socket
import sys
import tempfile
import threading
import time
from collections import Counter
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from chromaperture.app.live.loop import LiveLoop
from chromaperture.app.live.page import LivePage
from chromaperture.app.live.watchdog import Watchdog
from chromaperture.camera.camera import CodedApertureCamera, load_camera
from chromaperture.capture.files import read_image
from chromaperture.capture.open import open_source
from chromaperture.capture.source import Event, Frame
from chromaperture.capture.threaded_source import DeviceLostError, LiveSource
from chromaperture.color.encoding import Encoding
from chromaperture.depth.field import DepthField
from chromaperture.products.samples import sample_camera, sample_image
from chromaperture.system.errors import InputError

NAME, WIDTH, HEIGHT = "still_life_cy_halves", 240, 160
ENCODING = Encoding(16, 1016)
FPS = 30.0  # of the simulated camera; its clock, not that of the run
PAUSE_S = 0.002  # between two frames: the loop drops what it cannot measure
TROUBLE_EVERY = 60  # frames between two troubles on average: one in two seconds of the camera's clock
SILENCE_S, RETRY_S, STALL_S = 0.2, 0.02, 0.3  # so short that hundreds of losses fit into minutes
WATCHDOG_S = 5.0  # no stage takes so long here, unless it hangs
COLUMNS = ("seconds", "memory_mb", "handles", "threads", "queued", "connections", "blocks", "frames")
# Growth in the observed time that counts as flat. Memory: 8 MB or 2 %, since the allocator scatters by 1 % (measured in
# docs/reconstruction.md) and one picture of 115 KB kept at every trouble would exceed it within a hundred troubles.
# Blocks: 5000 or 2 %, caches included. The others are whole things, hundreds of which are made and ended: a leak of one
# each would exceed them at once.
LIMITS = {"memory_mb": 8.0, "handles": 3.0, "threads": 3.0, "queued": 1.0, "connections": 3.0, "blocks": 5000.0}
MEMORY_PART, PARTS = 0.02, 20


def small_camera(device: str, width: int = WIDTH, height: int = HEIGHT) -> CodedApertureCamera:
    """The middle of the sample's sensor, or more than all of it, with one depth curve."""
    whole = load_camera(sample_camera(NAME)).calibration
    sensor, lens = whole.sensor, whole.lens
    matrix = lens.camera_matrix.copy()
    matrix[:2, 2] -= (sensor.width_px - width) / 2, (sensor.height_px - height) / 2
    size = (sensor.width_px, sensor.height_px)
    depth = {name: DepthField.constant(field.on_axis(*size)) for name, field in whole.depth.items()}
    small = replace(sensor, width_px=width, height_px=height)
    return CodedApertureCamera(
        replace(whole, sensor=small, lens=replace(lens, camera_matrix=matrix), depth=depth, blur=None), device=device
    )


class World:
    """A camera on a path over the sample's photograph, and all that can go wrong with it; makes its devices."""

    def __init__(self, seed: int) -> None:
        image = read_image(sample_image(NAME), black_level=16, white_level=1016)
        self._counts = np.clip(image * 1000 + 16, 0, 1023).astype(np.uint16)
        self._random, self._rng = random.Random(seed), np.random.default_rng(seed)
        self._time_s, self._number = 0.0, 0
        self._absent = 0  # attempts to connect that fail
        self._odd, self._odd_frames = "", 0
        self.troubles: Counter[str] = Counter()

    def connect(self) -> World:
        if self._absent > 0:
            self._absent -= 1
            raise InputError("not there") if self._absent % 2 else OSError(19, "No such device")
        return self

    def close(self) -> None:
        pass

    def read(self, index: int) -> Frame | None:
        time.sleep(PAUSE_S)
        self._time_s += 1 / FPS
        self._number += 1
        if self._odd_frames:
            self._odd_frames -= 1
        elif self._random.random() < 1 / TROUBLE_EVERY:
            self._begin_trouble()
            if self._odd == "silence":
                return None
        counts = self._picture()
        if self._odd_frames:
            counts = self._damaged(counts)
        return Frame(counts, ENCODING, self._time_s, index, {"number": self._number})

    @property
    def hours(self) -> float:
        return self._number / FPS / 3600

    def _begin_trouble(self) -> None:
        kinds = ["silence", "stall", "unplugged", "io error", "jump ahead", "jump back", "size", "empty", "grey", "nan"]
        kind = self._random.choice([*kinds, "dark", "noise", "white", "cut"])
        self.troubles[kind] += 1
        self._odd = kind
        if kind == "stall":
            time.sleep(STALL_S)
        elif kind == "silence":
            time.sleep(SILENCE_S)
        elif kind in ("unplugged", "io error"):
            self._absent = self._random.randrange(4)
            raise DeviceLostError("unplugged?") if kind == "unplugged" else OSError(5, "Input/output error")
        elif kind.startswith("jump"):
            self._time_s += self._random.uniform(1, 86400) * (1 if kind == "jump ahead" else -1)
        else:
            self._odd_frames = self._random.randrange(1, 6)

    def _picture(self) -> np.ndarray:
        height, width = self._counts.shape[:2]
        angle = self._number / 100
        y = int((height - HEIGHT) / 2 * (1 + 0.3 * np.sin(angle)))
        x = int((width - WIDTH) / 2 * (1 + 0.3 * np.cos(angle)))
        return np.ascontiguousarray(self._counts[y : y + HEIGHT, x : x + WIDTH])

    def _damaged(self, counts: np.ndarray) -> np.ndarray:
        if self._odd == "size":
            return np.zeros((*self._rng.integers(1, 400, 2), 3), np.uint16)
        if self._odd == "cut":  # the lower half never came
            counts[HEIGHT // 2 :] = 0
            return counts
        return {
            "empty": lambda: counts[:0],
            "grey": lambda: counts[..., 0],
            "nan": lambda: np.full(counts.shape, np.nan, np.float32),
            "dark": lambda: np.full_like(counts, 16),
            "white": lambda: np.full_like(counts, 65535),
            "noise": lambda: self._rng.integers(0, 1024, counts.shape, np.uint16),
        }[self._odd]()


class Visitors:
    """Browsers without a screen, in a thread of their own."""

    def __init__(self, page: LivePage, seed: int) -> None:
        self._page, self._random, self._leave = page, random.Random(seed), threading.Event()
        self.did: Counter[str] = Counter()
        self._thread = threading.Thread(target=self._run, name="visitors", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self._leave.set()
        self._thread.join(timeout=30)  # s: longer than any step below

    def _run(self) -> None:
        while not self._leave.wait(self._random.uniform(0.05, 0.3)):
            try:
                self._step()
            except Exception as error:  # as one whose nonsense the server hung up on
                self.did[f"failed: {type(error).__name__}"] += 1

    def _step(self) -> None:
        kind = self._random.choice(["look", "look", "look", "die", "click", "click", "slide", "nonsense", "stranger"])
        if kind == "die":  # in the middle of an answer
            where = f"/{self._page.access.token}/api/live/frame?after=0"
            self._raw(f"GET {where} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
        elif kind == "nonsense":
            self._raw(os.urandom(30) + b"\r\n\r\n")
        elif kind == "stranger":  # a scan of the port, which leaves in the middle
            self._raw(b"GET / HTTP/1.1\r\nHo", read=False)
        elif kind == "slide":
            value, pupil = (self._random.choice([0, -1, 1e9, "far", "nan", 1500.0, 2.0]) for _ in range(2))
            self._ask("POST", f"focus?distance_mm={value}&pupil={pupil}" if self._random.random() < 0.7 else "focus")
        elif kind == "click":
            buttons = ["record?on=1", "record?on=0", "pause?on=1", "pause?on=0", "snapshot?percent=10"]
            what = self._random.choice(buttons)
            self._ask("POST", what)
            kind = f"click {what}"
        else:
            for what in ("frame?after=0", "state", "mesh"):
                self._ask("GET", what)
        self.did[kind] += 1

    def _ask(self, method: str, what: str) -> None:
        connection = http.client.HTTPConnection("127.0.0.1", self._page.port, timeout=10)
        with contextlib.closing(connection):
            connection.request(method, f"/{self._page.access.token}/api/live/{what}")
            connection.getresponse().read()

    def _raw(self, data: bytes, *, read: bool = True) -> None:
        with socket.create_connection(("127.0.0.1", self._page.port), timeout=5) as connection:
            connection.sendall(data)
            if read:
                connection.recv(100)


def sample(loop: LiveLoop, page: LivePage | None, seconds: float) -> tuple[float, ...]:
    """One row of the curves, in the order of COLUMNS."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    connections = 0 if page is None else len(page._server.server_state.connections)
    return (
        seconds,
        pages * os.sysconf("SC_PAGE_SIZE") / 2**20,
        len(os.listdir("/proc/self/fd")),
        threading.active_count(),
        loop.queued,
        connections,
        sys.getallocatedblocks(),  # gc.get_objects() would break tuples that another thread is making
        loop.meters["depth"].count,
    )


def trend(seconds: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Growth of a straight line over the time, and its standard error, from the means of PARTS parts.

    Samples a second apart are not independent; those of the parts nearly are.
    """
    parts = [part for part in np.array_split(np.arange(len(seconds)), PARTS) if len(part)]
    x = np.array([seconds[part].mean() for part in parts])
    y = np.array([values[part].mean() for part in parts])
    slope, offset = np.polyfit(x, y, 1)
    residual = y - slope * x - offset
    error = np.sqrt((residual**2).sum() / max(len(x) - 2, 1) / ((x - x.mean()) ** 2).sum())
    time_s = seconds[-1] - seconds[0]
    return float(slope * time_s), float(error * time_s)


def judged(rows: np.ndarray) -> dict[str, dict[str, Any]]:
    """Level, growth and verdict of every curve after the warm-up."""
    late = rows[rows[:, 0] >= rows[-1, 0] / 3]
    found = {}
    for name, limit in LIMITS.items():
        values = late[:, COLUMNS.index(name)]
        growth, error = trend(late[:, 0], values)
        if name in ("memory_mb", "blocks"):
            limit = max(limit, MEMORY_PART * float(values.mean()))
        hours = (late[-1, 0] - late[0, 0]) / 3600
        found[name] = {
            "median": round(float(np.median(values)), 1),
            "growth": round(growth, 2),
            "standard_error": round(error, 2),
            "growth_an_hour": round(growth / hours, 2),
            "flat": growth <= max(limit, 3 * error),
        }
    return found


def run(
    seconds: float,
    *,
    page_shown: bool,
    model: bool,
    folder: Path,
    seed: int = 0,
    sample_s: float = 1.0,
    device: str = "cpu",
    spec: str = "",
) -> tuple[np.ndarray, dict[str, Any]]:
    """Run the loop; returns the curves and what happened."""
    said: Counter[str] = Counter()
    world = World(seed)

    def say(line: str) -> None:
        said[" ".join("#" if any(c.isdigit() for c in word) else word for word in line.split())] += 1

    loops: list[LiveLoop] = []

    def report(event: Event) -> None:
        loops[0].say_rarely(event.message)

    troubled = LiveSource("troubled", world.connect, listener=report, silence_s=SILENCE_S, retry_s=RETRY_S)
    source = open_source(spec, listener=report) if spec else troubled
    assert isinstance(source, LiveSource), "not a live camera"
    rows: list[tuple[float, ...]] = []
    with Watchdog(WATCHDOG_S, listener=say) as watchdog:
        loop = LiveLoop(source, small_camera(device), track=model, listener=say, watchdog=watchdog)
        loops.append(loop)
        visitors = drawing = page = None
        with source, loop:
            if page_shown:
                page = LivePage(loop, host="127.0.0.1", port=0, out=folder)
                drawing = threading.Thread(target=page.run, name="draw", daemon=True)
                drawing.start()
                visitors = Visitors(page, seed)
            began = time.monotonic()
            while (now := time.monotonic() - began) < seconds and not loop.over.is_set() and loop.failure is None:
                if not page_shown and len(loop.to_view):
                    loop.to_view.take()
                elif int(now) % 10 == 0:
                    loop.paused.clear()  # a visitor may have pressed "pause"
                rows.append(sample(loop, page, now))
                for old in () if loop.recording else sorted(folder.glob("[!.]*")):
                    shutil.rmtree(old, ignore_errors=True) if old.is_dir() else old.unlink(missing_ok=True)
                loop.over.wait(sample_s)
            ended_early = loop.over.is_set() or loop.failure is not None
            if visitors is not None:
                visitors.stop()
        if page is not None:
            drawing.join(timeout=30)  # s: one frame and its drawing
            page.close()
    counts = source.counts
    facts = {
        "seconds": round(rows[-1][0]),
        "counts": asdict(counts),
        "frames": {"given": counts.sent, "measured": int(rows[-1][-1]), "refused": loop.unused},
        "hours_of_the_camera": round(world.hours, 2),
        "troubles": dict(world.troubles),
        "visitors": dict(visitors.did) if visitors else {},
        "ended_early": ended_early,
        "failure": repr(loop.failure) if loop.failure else None,
        "said": dict(said.most_common(30)),
        "lines_said": said.total(),
        "stages": loop.figures(),
    }
    return np.array(rows), facts


def write_curves(folder: Path, rows: np.ndarray) -> None:
    import matplotlib.pyplot as plt

    folder.mkdir(parents=True, exist_ok=True)
    np.savetxt(folder / "long_run.csv", rows, "%.2f", ",", header=",".join(COLUMNS), comments="")
    figure, axes = plt.subplots(len(LIMITS), 1, figsize=(8, 10), layout="constrained", sharex=True)
    for axis, name in zip(axes, LIMITS, strict=True):
        axis.plot(rows[:, 0] / 60, rows[:, COLUMNS.index(name)])
        axis.axvline(rows[-1, 0] / 180, color="0.6", linestyle="--")
        axis.set(ylabel=name.replace("_", ", "), ylim=(0, None))
    axes[0].set_title("dashed: end of the warm-up")
    axes[-1].set_xlabel("minutes")
    figure.savefig(folder / "long_run.png", dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=1200.0)
    parser.add_argument("--model", action="store_true", help="track and build the model (Open3D)")
    parser.add_argument("--no-page", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="cpu", help="that measures: cpu, auto, gpu or gpu:NAME")
    parser.add_argument("--source", default="", help="for open_source, of 240x160 px; default: the simulated camera")
    parser.add_argument("--out", type=Path, help="folder for long_run.csv and long_run.png")
    args = parser.parse_args()

    page_shown = not args.no_page and importlib.util.find_spec("starlette") is not None
    with tempfile.TemporaryDirectory() as folder:
        shown = {"page_shown": page_shown, "model": args.model, "folder": Path(folder)}
        rows, facts = run(args.seconds, **shown, seed=args.seed, device=args.device, spec=args.source)
    if args.out:
        write_curves(args.out, rows)
    verdict = judged(rows)
    print(json.dumps(facts | {"trends": verdict}, indent=1))
    # No frame measured in the second half; a simulated GenTL producer's are saturated, and only counted.
    stuck = rows[-1, -1] <= rows[len(rows) // 2, -1] and not (args.source and facts["counts"]["delivered"])
    if facts["ended_early"] or stuck or not all(each["flat"] for each in verdict.values()):
        sys.exit(1)


if __name__ == "__main__":
    main()
