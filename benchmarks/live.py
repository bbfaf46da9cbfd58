"""Rate and memory of the live loop: python benchmarks/live.py SOURCE --camera CAMERA.asdf [--seconds 60].

SOURCE is a live one, as "replay:FOLDER?speed=1&loop=1". Without a browser; CPU seconds a frame say what two free cores
could do where the machine is busy with other things.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

from chromaperture.camera import load_camera
from chromaperture.capture.open import open_source
from chromaperture.viewer.loop import LiveLoop


def resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 2**20


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source")
    parser.add_argument("--camera", type=Path, required=True)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--no-model", action="store_true")
    args = parser.parse_args()

    camera = load_camera(args.camera)
    memory: list[float] = []
    levels = (camera.calibration.sensor.black_level, camera.calibration.sensor.white_level)
    with (
        open_source(args.source, camera_levels=levels) as source,
        LiveLoop(source, camera, track=not args.no_model, listener=lambda line: None) as loop,
    ):
        loop.over.wait(args.seconds / 4)  # compilation, and the model of the place grow in this time
        began, cpu, done = time.monotonic(), time.process_time(), loop.meters["depth"].count
        while time.monotonic() - began < args.seconds * 0.75 and not loop.over.is_set():
            memory.append(resident_mb())
            loop.over.wait(1.0)
        frames, spent = loop.meters["depth"].count - done, time.process_time() - cpu
        seconds, figures = time.monotonic() - began, loop.figures()
    early, late = memory[: len(memory) // 4 + 1], memory[-len(memory) // 4 - 1 :]
    growth = sum(late) / len(late) / (sum(early) / len(early)) - 1
    rates = {"frames_per_second": frames / seconds, "cpu_seconds_per_frame": spent / max(frames, 1)}
    print(
        json.dumps(
            rates | {"memory_growth_percent": 100 * growth, "memory_mb": memory[-1], "stages": figures}, indent=1
        )
    )


if __name__ == "__main__":
    main()
