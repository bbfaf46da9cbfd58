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

from chromaperture.config import RealTimeConfig
from chromaperture.disparity.estimate import method_for
from chromaperture.disparity.gpu.device import Chain, open_device
from chromaperture.disparity.gpu.gpu_method import Further, GpuMethod
from chromaperture.disparity.labels import IDENTITY
from devices import EXPECTED, needs_device
from worlds import wavy_capture

SHAPE = (60, 84)
PAGE = Path(__file__).parent / "data" / "gpu_chain.html"
BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")
# WebGPU by the rasteriser that Chromium brings; nothing is asked of the network.
FLAGS = (
    "--headless", "--no-sandbox", "--no-first-run", "--disable-sync", "--disable-background-networking",
    "--disable-component-update", "--disable-dev-shm-usage", "--enable-unsafe-webgpu",
    "--use-webgpu-adapter=swiftshader",
)  # fmt: skip
TIMEOUT_S = 240  # of a browser that starts, and compiles thirty shaders, on a busy machine


def recorded(chain: Chain, image: np.ndarray, output: str) -> bytes:
    """What a chain is made of, and one picture, as JSON."""
    constants = chain.run({"image": image}, [a.name for a in chain.arrays.values() if a.is_constant])
    values = {name: base64.b64encode(part.tobytes()).decode() for name, part in (constants | {"image": image}).items()}
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


@pytest.mark.extra("gpu", "wgpu")
@needs_device
@pytest.mark.skipif(
    BROWSER is None and not os.environ.get(EXPECTED), reason="no Chromium here: shaders in a browser are NOT tested"
)
@pytest.mark.slow
@pytest.mark.parametrize("design", ["cy_halves", "rgb_squares"])
def test_a_frame_in_a_browser_is_that_of_python(design, tmp_path):
    config = RealTimeConfig().with_range(-4.0, 4.0)
    method = method_for(config, aperture=design, execution="numpy")
    image = wavy_capture(design, shape=SHAPE)
    image[3, 4] = np.nan
    on_device = GpuMethod(config, method.space, IDENTITY, open_device("gpu"))
    expected = on_device.match(image).value_px
    chain = on_device._composed(SHAPE, Further())
    found = in_browser(recorded(chain, image, "disparity"), tmp_path / "profile").reshape(SHAPE)
    assert (np.isnan(found) == np.isnan(expected)).mean() > 0.999
    error = np.abs(found - expected)[np.isfinite(found) & np.isfinite(expected)]
    # Another compiler: exp, log and the order of sums differ in the last bits, and layers that are as good may swap.
    assert np.quantile(error, 0.98) < 1e-3
