"""Show the distance and the error bar under the mouse, on every picture of the page.

viser's pictures report no mouse. So the page carries the values of every few pixels, and a script of its own, which
viser inserts as HTML, shows the one below the mouse.
"""

from __future__ import annotations

import base64
import math

import numpy as np

from chromaperture.app.live.pictures import BAR_PX

_MOST = 160  # values along the longer side, chosen by hand: 50 KB a frame, a value every 2 px of a panel's picture

# Runs once, when its (empty) picture cannot be loaded: browsers run no <script> that is inserted. A picture of the page
# is known by its size. One "?" is a pixel without a distance; the colour bar beside the depth has none.
_SCRIPT = """
if (!window.chromaperture) {
  window.chromaperture = {};
  const box = document.createElement('div');
  box.id = 'chromaperture-reading';
  box.style.cssText = 'position:fixed;z-index:9999;pointer-events:none;padding:2px 6px;border-radius:4px;'
    + 'background:#14161a;color:#e8e6e3;font:13px sans-serif;white-space:nowrap;display:none';
  document.body.appendChild(box);
  let mouse = null;
  const show = () => {
    const data = document.getElementById('chromaperture-values');
    const image = mouse && document.elementFromPoint(mouse.clientX, mouse.clientY);
    box.style.display = 'none';
    if (!data || !image || image.tagName !== 'IMG' || !image.src.startsWith('blob:')) return;
    const d = data.dataset, width = +d.width, height = +d.height;
    const extra = image.naturalWidth - width;
    if (image.naturalHeight !== height || (extra !== 0 && extra !== +d.bar)) return;
    const place = image.getBoundingClientRect();
    const x = Math.floor((mouse.clientX - place.left) / place.width * image.naturalWidth);
    const y = Math.floor((mouse.clientY - place.top) / place.height * height);
    if (x < 0 || y < 0 || x >= width || y >= height) return;
    if (window.chromaperture.text !== d.values) {
      window.chromaperture.text = d.values;
      const bytes = Uint8Array.from(atob(d.values), c => c.charCodeAt(0));
      window.chromaperture.values = new Float32Array(bytes.buffer);
    }
    const values = window.chromaperture.values, columns = +d.columns, step = +d.step;
    const at = 2 * (Math.floor(y / step) * columns + Math.floor(x / step));
    const distance = values[at], sigma = values[at + 1];
    box.textContent = distance > 0 ? distance.toFixed(0) + ' mm \\u00b1 ' + sigma.toFixed(0) + ' mm' : 'unknown';
    box.style.display = 'block';
    box.style.left = Math.min(mouse.clientX + 14, window.innerWidth - box.offsetWidth - 4) + 'px';
    box.style.top = (mouse.clientY + 18) + 'px';
  };
  document.addEventListener('mousemove', event => { mouse = event; show(); });
  setInterval(show, 200);
}
"""


def probe_html() -> str:
    """Return the element that starts the script in a browser."""
    escaped = _SCRIPT.replace("&", "&amp;").replace('"', "&quot;")
    return f'<img src="data:," style="display:none" onerror="{escaped}">'


def values_html(depth_mm: np.ndarray, sigma_mm: np.ndarray) -> str:
    """Return the element that holds the values of a frame; see `encode_values`.

    Parameters
    ----------
    depth_mm, sigma_mm : (H, W) float, NaN unknown
        Of the pictures as the page shows them, one value a pixel.
    """
    height, width = depth_mm.shape
    step = math.ceil(max(height, width) / _MOST)
    text = encode_values(depth_mm[::step, ::step], sigma_mm[::step, ::step])
    columns = -(-width // step)
    return (
        f'<span id="chromaperture-values" style="display:none" data-width="{width}" data-height="{height}" '
        f'data-bar="{BAR_PX}" data-step="{step}" data-columns="{columns}" data-values="{text}"></span>'
    )


def encode_values(depth_mm: np.ndarray, sigma_mm: np.ndarray) -> str:
    """Encode pairs of depth and error bar, row by row, as little-endian float32 in base64; NaN stays NaN."""
    return base64.b64encode(np.stack([depth_mm, sigma_mm], axis=-1).astype("<f4").tobytes()).decode("ascii")
