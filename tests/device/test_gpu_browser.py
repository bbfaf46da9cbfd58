"""The same shader files in a browser: a frame of quality real-time in headless Chromium, against this process's."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import threading
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from chromaperture.effects.refocusing import Focus, refocus
from chromaperture.matching.device.device import Chain, open_device
from chromaperture.matching.device.gpu_method import GpuMethod
from chromaperture.matching.device.refocus_stages import RefocusChain, inputs_of
from chromaperture.matching.device.surface_stages import Grid, add_path_surface
from chromaperture.matching.estimate import method_for
from chromaperture.matching.result import NO_EXTRAS, Conversion, Extras
from chromaperture.settings.methods import RealTimeConfig
from chromaperture.settings.stages import SurfaceConfig
from devices import EXPECTED, needs_device
from executions import slanted_volume
from test_gpu_alignment import chain_behind_disparity, sample_on_device
from worlds import wavy_capture

SHAPE = (60, 84)
PAGE = Path(__file__).parents[1] / "data" / "gpu_chain.html"
BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")
# WebGPU by the rasteriser that Chromium brings; nothing is asked of the network.
FLAGS = (
    "--headless", "--no-sandbox", "--no-first-run", "--disable-sync", "--disable-background-networking",
    "--disable-component-update", "--disable-dev-shm-usage", "--enable-unsafe-webgpu",
    "--use-webgpu-adapter=swiftshader",
)  # fmt: skip
TIMEOUT_S = 240  # of a browser that starts, and compiles thirty shaders, on a busy machine


def recorded(chain: Chain, inputs: dict[str, np.ndarray], outputs: list[str]) -> bytes:
    """What a chain is made of, and what goes into it, as JSON."""
    known = inputs | chain.run(inputs, [a.name for a in chain.arrays.values() if a.is_constant])
    values = {name: base64.b64encode(np.ascontiguousarray(part).tobytes()).decode() for name, part in known.items()}
    arrays = {a.name: {"size": a.size, "values": values.get(a.name)} for a in chain.arrays.values()}
    dispatches = [
        {"stage": d.stage, "source": d.source, "groups": d.groups, "arrays": [a.name for a in d.arrays]}
        for d in chain.dispatches
    ]
    return json.dumps({"arrays": arrays, "dispatches": dispatches, "outputs": outputs}).encode()


def in_browser(chain: bytes, profile: Path) -> np.ndarray:
    """Run a recorded chain in the browser and return its outputs, one after the other."""
    answers: list[tuple[str, bytes]] = []
    answered = threading.Event()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            body = chain if self.path == "/chain.json" else PAGE.read_bytes()
            self.send_response(200)
            self.send_header("Content-Type", "application/json" if self.path == "/chain.json" else "text/html")
            self.end_headers()
            self.wfile.write(body)

        def do_POST(self):
            answers.append((self.path, self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(204)
            self.end_headers()
            answered.set()

        def log_message(self, *arguments):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    url = f"http://127.0.0.1:{server.server_port}/"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    browser = subprocess.Popen([BROWSER, *FLAGS, f"--user-data-dir={profile}", url], **quiet)
    try:
        assert answered.wait(TIMEOUT_S), "the page did not answer"
    finally:
        browser.terminate()
        browser.wait(30)
        server.shutdown()
        server.server_close()
    path, body = answers[0]
    assert path == "/result", body.decode()
    return np.frombuffer(body, np.float32)


pytestmark = [
    pytest.mark.extra("gpu", "wgpu"),
    needs_device,
    pytest.mark.skipif(
        BROWSER is None and not os.environ.get(EXPECTED), reason="no Chromium here: shaders in a browser are NOT tested"
    ),
    pytest.mark.slow,
]


class Recorded(NamedTuple):
    """A chain, what goes into it, and of what comes out ``rtol``, ``atol`` and the least share within them."""

    chain: Chain
    inputs: dict[str, np.ndarray]
    outputs: dict[str, tuple[float, float, float]]


def frame(rng: np.random.Generator) -> Recorded:
    """Of three views that a lens moves; tests/app/test_app_device.py has two views, in the page itself."""
    config, moves = RealTimeConfig().with_range(-4.0, 4.0), rng.uniform(-1, 1, (4, 5, 3, 2))
    method = method_for(config, aperture="rgb_squares", channel_moves_px=moves, execution="numpy")
    image = wavy_capture("rgb_squares", shape=SHAPE)
    image[3, 4] = np.nan
    chain = GpuMethod(method, open_device("gpu"))._composed(SHAPE, NO_EXTRAS)
    # Another compiler: exp, log and the order of sums differ in the last bits, and layers that are as good may swap.
    return Recorded(chain, {"image": image}, {"disparity": (0.0, 1e-3, 0.98)})


def colours_and_depth(rng: np.random.Generator, *, scale: int) -> Recorded:
    """Channels moved by the lens, and curves computed from numbers."""
    camera, image = sample_on_device(scale, "still_life_cy_halves")
    disparity, sigma = rng.uniform(-2, 1, (2, *image.shape[:2])).astype(np.float32)
    disparity[rng.uniform(size=disparity.shape) < 0.2] = np.nan
    field = camera.calibration.depth["accurate"]
    numbers = Conversion(*field.in_numbers(image.shape[1], image.shape[0]), 50_000.0)
    chain = chain_behind_disparity(disparity.shape, Extras(numbers, camera.alignment.numbers))
    # Places between pixels are rounded; A - d is in 32 bits.
    limits = {"color": (0.0, 1e-4, 0.99), "depth_mm": (1e-4, 0.0, 1.0)}
    return Recorded(chain, {"image": image, "disparity": disparity, "sigma": sigma}, limits)


def stages_of_accurate(rng: np.random.Generator) -> Recorded:
    """Paths and posterior."""
    likelihood, guide = slanted_volume(rng, 20, 26, 33)
    chain, grid = Chain(open_device("gpu")), Grid(*likelihood.shape)
    arrays = [chain.array(name, n) for name, n in (("likelihood", grid.size), ("guide", grid.pixels))]
    add_path_surface(chain, *arrays, grid, np.linspace(-4, 4, 33), config=SurfaceConfig())
    limits = dict.fromkeys(("label", "posterior"), (1e-3, 1e-3, 0.99))  # layers that are as good may swap
    return Recorded(chain, {"likelihood": likelihood, "guide": guide}, limits)


def refocused(rng: np.random.Generator) -> Recorded:
    color = rng.uniform(0, 1, (*SHAPE, 3)).astype(np.float32)
    radius = (np.where(np.arange(SHAPE[1]) > 40, 9, -3) + rng.uniform(-0.1, 0.1, SHAPE)).astype(np.float32)
    chain = RefocusChain(open_device("gpu"), SHAPE)
    given: list[tuple] = []

    def composite(*parts):
        given.append(parts)
        return chain.composite(*parts)

    refocus(color, radius, Focus(1.0, 1.0, "hex"), compositor=composite)
    # Sums of 961 products of order 1, in another order.
    return Recorded(chain.chain, inputs_of(*given[0][:3]), {"refocused": (0.0, 2e-5, 1.0)})


CHAINS = {
    "frame": frame,
    "colours": partial(colours_and_depth, scale=1),
    "colours of a working scale": partial(colours_and_depth, scale=3),
    "accurate": stages_of_accurate,
    "refocused": refocused,
}


@pytest.mark.parametrize("name", CHAINS)
def test_a_chain_in_a_browser_is_that_of_python(name, tmp_path, rng):
    chain, inputs, outputs = CHAINS[name](rng)
    expected = chain.run(inputs, list(outputs))
    found = in_browser(recorded(chain, inputs, list(outputs)), tmp_path / "profile")
    ends = np.cumsum([expected[output].size for output in outputs])
    for one, (output, (rtol, atol, least)) in zip(np.split(found, ends[:-1]), outputs.items(), strict=True):
        same = np.isclose(one, expected[output].ravel(), rtol=rtol, atol=atol, equal_nan=True)
        assert same.mean() >= least, output
