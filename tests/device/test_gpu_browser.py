"""The same shader files in a browser: a frame of quality real-time in headless Chromium, against this process's."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

from chromaperture.effects.refocusing import Focus, refocus
from chromaperture.matching.device.device import Chain, open_device
from chromaperture.matching.device.gpu_method import GpuMethod
from chromaperture.matching.device.refocus_stages import RefocusChain, inputs_of
from chromaperture.matching.device.surface_stages import Grid, add_block_sums, add_path_surface
from chromaperture.matching.estimate import method_for
from chromaperture.matching.result import NO_EXTRAS, Conversion, Extras
from chromaperture.settings.methods import RealTimeConfig
from chromaperture.settings.stages import SurfaceConfig
from devices import EXPECTED, needs_device
from test_gpu_alignment import camera_of, chain_behind_disparity
from test_gpu_surface import volume
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


def recorded(chain: Chain, inputs: dict[str, np.ndarray], output: str) -> bytes:
    """What a chain is made of, and what goes into it, as JSON."""
    known = inputs | chain.run(inputs, [a.name for a in chain.arrays.values() if a.is_constant])
    values = {name: base64.b64encode(np.ascontiguousarray(part).tobytes()).decode() for name, part in known.items()}
    arrays = {a.name: {"size": a.size, "values": values.get(a.name)} for a in chain.arrays.values()}
    dispatches = [
        {"stage": d.stage, "source": d.source, "groups": d.groups, "arrays": [a.name for a in d.arrays]}
        for d in chain.dispatches
    ]
    return json.dumps({"arrays": arrays, "dispatches": dispatches, "output": output}).encode()


def in_browser(chain: bytes, profile: Path) -> np.ndarray:
    """Run a recorded chain in the browser and return its output."""
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


@pytest.mark.parametrize(("design", "moved"), [("cy_halves", False), ("rgb_squares", False), ("rgb_squares", True)])
def test_a_frame_in_a_browser_is_that_of_python(design, moved, tmp_path, rng):
    config = RealTimeConfig().with_range(-4.0, 4.0)
    moves = rng.uniform(-1, 1, (4, 5, 3, 2)) if moved else None
    method = method_for(config, aperture=design, channel_moves_px=moves, execution="numpy")
    image = wavy_capture(design, shape=SHAPE)
    image[3, 4] = np.nan
    on_device = GpuMethod(method, open_device("gpu"))
    expected = on_device.match(image).value_px
    chain = on_device._composed(SHAPE, NO_EXTRAS)
    found = in_browser(recorded(chain, {"image": image}, "disparity"), tmp_path / "profile").reshape(SHAPE)
    assert (np.isnan(found) == np.isnan(expected)).mean() > 0.999
    error = np.abs(found - expected)[np.isfinite(found) & np.isfinite(expected)]
    # Another compiler: exp, log and the order of sums differ in the last bits, and layers that are as good may swap.
    assert np.quantile(error, 0.98) < 1e-3


@pytest.mark.parametrize("scale", [1, 3])
def test_colours_and_depth_of_a_disparity_in_a_browser(scale, tmp_path, rng):
    """Channels moved by the lens, and curves computed from numbers."""
    camera, image = camera_of("still_life_cy_halves", scale)
    disparity, sigma = rng.uniform(-2, 1, (2, *image.shape[:2])).astype(np.float32)
    disparity[rng.uniform(size=disparity.shape) < 0.2] = np.nan
    field = camera.calibration.depth["accurate"]
    numbers = Conversion(*field.in_numbers(image.shape[1], image.shape[0]), 50_000.0)
    chain = chain_behind_disparity(disparity.shape, Extras(numbers, camera.alignment.numbers))
    inputs = {"image": image, "disparity": disparity, "sigma": sigma}
    expected = chain.run(inputs, ["color", "depth_mm"])
    color = in_browser(recorded(chain, inputs, "color"), tmp_path / "one")
    assert (np.abs(color - expected["color"]) < 1e-4).mean() > 0.99  # places between pixels are rounded
    depth = in_browser(recorded(chain, inputs, "depth_mm"), tmp_path / "other")
    np.testing.assert_allclose(depth, expected["depth_mm"], rtol=1e-4)  # A - d in 32 bits


def test_stages_of_accurate_in_a_browser(tmp_path, rng):
    """Paths, posterior and sums of blocks."""
    likelihood, guide = volume(rng, 20, 26, 33)
    chain, grid = Chain(open_device("gpu")), Grid(*likelihood.shape)
    arrays = [chain.array(name, n) for name, n in (("likelihood", grid.size), ("guide", grid.pixels))]
    add_path_surface(chain, *arrays, grid, np.linspace(-4, 4, 33), config=SurfaceConfig())
    add_block_sums(chain, arrays[0], grid, 4)
    given = {"likelihood": likelihood, "guide": guide}
    expected = chain.run(given, ["label", "posterior", "blocks"])
    for name, values in expected.items():
        found = in_browser(recorded(chain, given, name), tmp_path / name)
        # Layers that are as good may swap.
        assert np.isclose(found, values, rtol=1e-3, atol=1e-3).mean() > 0.99


def test_a_refocused_picture_in_a_browser(tmp_path, rng):
    color = rng.uniform(0, 1, (*SHAPE, 3)).astype(np.float32)
    radius = (np.where(np.arange(SHAPE[1]) > 40, 9, -3) + rng.uniform(-0.1, 0.1, SHAPE)).astype(np.float32)
    chain = RefocusChain(open_device("gpu"), SHAPE)
    given: list[tuple] = []

    def composite(*parts):
        given.append(parts)
        return chain.composite(*parts)

    expected = refocus(color, radius, Focus(1.0, 1.0, "hex"), compositor=composite)
    inputs = inputs_of(*given[0][:3])
    found = in_browser(recorded(chain.chain, inputs, "refocused"), tmp_path / "profile").reshape(color.shape)
    np.testing.assert_allclose(found, expected, atol=2e-5)  # sums of 961 products of order 1, in another order
