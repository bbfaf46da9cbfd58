"""Age of the frames of a camera when their measurement begins: python benchmarks/frame_age.py SOURCE [--seconds 30]

For example `'aravis:127.0.0.1?width=1280&height=720&fps=20'` beside Debian's `arv-fake-gv-camera-0.8 -i lo`. A frame's
age is the host's clock less `frame.time_s`, so without exposure and readout. The reader measures frame by frame, as
`live` does on a CPU.
"""

from __future__ import annotations

import argparse
import json
import threading
import time
from dataclasses import asdict
from typing import Any

import numpy as np
from long_run import small_camera

from chromaperture.capture.open import open_source
from chromaperture.capture.threaded_source import LiveSource

WARM_UP = 5  # frames: the first measurement compiles


def ages(spec: str, seconds: float, device: str) -> dict[str, Any]:
    """Ages at `measure` and its times, ms, and what became of the frames."""
    events: list[str] = []
    age_ms, measure_ms = [], []
    with open_source(spec, listener=lambda event: events.append(event.message)) as source:
        assert isinstance(source, LiveSource), "not a live camera"
        camera = None
        for number, frame in enumerate(source):
            height, width = frame.counts.shape[:2]
            camera = camera or small_camera(device, width, height)
            age_s, began = time.time() - frame.time_s, time.perf_counter()
            camera.measure(frame.image)
            if number == WARM_UP:
                threading.Timer(seconds, source.stop).start()
            if number > WARM_UP:
                age_ms.append(1e3 * age_s)
                measure_ms.append(1e3 * (time.perf_counter() - began))
        counts = asdict(source.counts)
    return {
        "picture": [width, height],
        "frames": len(age_ms),
        "age_ms": {"median": round(float(np.median(age_ms)), 1), "worst": round(max(age_ms), 1)},
        "measure_ms": {"median": round(float(np.median(measure_ms)), 1), "worst": round(max(measure_ms), 1)},
        "counts": counts,
        "events": events,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", help="of a live camera, for open_source")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--device", default="cpu", help="that measures: cpu, auto, gpu or gpu:NAME")
    args = parser.parse_args()
    print(json.dumps(ages(args.source, args.seconds, args.device), indent=1))


if __name__ == "__main__":
    main()
