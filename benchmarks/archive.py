"""Photographs a second on a Dask cluster of this machine, by workers, against an even division of the work.

    python benchmarks/archive.py                     # copies of the sample, real-time, one thread a worker
    python benchmarks/archive.py --sleep-s 0.5       # a stand-in that only waits, so that the cores limit nothing

The last column of the table is what a photograph costs beyond the even division.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import chromaperture as cap
from chromaperture.products.archive import Outcome, Recipe, measure_photograph, recipe_for
from chromaperture.system.cluster import connected, run_tasks

SAMPLE = "still_life_cy_halves"
PORT = 18786  # chosen by hand, beside Dask's own


def wait(image: str, recipe: Recipe, seconds: float) -> Outcome:
    """Take the place of a measurement, with the same arguments and the same result."""
    time.sleep(seconds)
    return Outcome(image, version=dict(recipe.made_from)["version"])


def start(module: str, *arguments: str) -> subprocess.Popen:
    environment = {"CHROMAPERTURE_THREADS": "1", "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    command = [sys.executable, "-m", f"distributed.cli.{module}", *arguments, "--no-dashboard"]
    return subprocess.Popen(command, env=os.environ | environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def seconds_for(workers: int, count: int, sleep_s: float | None, folder: Path) -> float:
    address = f"tcp://127.0.0.1:{PORT}"
    camera = cap.sample_camera(SAMPLE)
    recipe = recipe_for(camera, cap.load_camera(camera, quality="real-time"), out=str(folder / "out"), again=True)
    images = []
    for i in range(count):
        images.append(str(folder / f"p{i}.png"))
        if sleep_s is None:
            shutil.copy(cap.sample_image(SAMPLE), images[-1])
    common = ["--nthreads", "1", "--no-nanny", "--local-directory", str(folder)]
    started = [start("dask_scheduler", "--host", "127.0.0.1", "--port", str(PORT))]
    started += [start("dask_worker", address, *common) for _ in range(workers)]
    try:
        time.sleep(2)
        with connected(address) as client:
            client.wait_for_workers(workers, timeout=60)
            image = str(cap.sample_image(SAMPLE))
            for result in client.run(measure_photograph, image, recipe).values():  # load the compiled matcher
                assert not result.error, result.error
            function, more = (measure_photograph, ()) if sleep_s is None else (wait, (sleep_s,))
            began = time.perf_counter()
            found = list(run_tasks(client, function, images, recipe, *more))
            taken = time.perf_counter() - began
            assert not [f for f in found if f.error is not None or f.value.error]
            return taken
    finally:
        for process in started:
            process.kill()
            process.wait()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--workers", default="1,2,4,8")
    parser.add_argument("--count", type=int, default=40, help="photographs a worker")
    parser.add_argument("--sleep-s", type=float, help="wait so long for each photograph and measure none")
    options = parser.parse_args()
    print("| workers | photographs/s | ms a photograph beyond even division |\n| --- | --- | --- |")
    alone_s = options.sleep_s
    for workers in map(int, options.workers.split(",")):
        count = options.count * workers
        with tempfile.TemporaryDirectory() as folder:
            taken = seconds_for(workers, count, options.sleep_s, Path(folder))
        if alone_s is None:
            alone_s = taken / count * workers
        print(f"| {workers} | {count / taken:.2f} | {1000 * (taken / count - alone_s / workers):.1f} |", flush=True)


if __name__ == "__main__":
    main()
