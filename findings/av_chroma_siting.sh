#!/usr/bin/env bash
# FFmpeg's conversion of 4:2:0 frames to R, G, B through PyAV, for chroma that lies on the left column or in the middle.
#
# Expected: clips of the same planes, one tagged left, one centre, give other colours, chroma moved by a quarter of its
# sample: by the tag R and B stand on the same place.
# Seen with PyAV 18.1.0: at the frame's own size rgb24, rgb48le and gbrp are the same to the last bit whatever the tag, at
# every interpolation; yuv444p, gbrpf32le and rgb24 of another size follow it. In a frame of one colour (.8, .4, .2) times
# a pattern, chroma on the left and tagged so, R stands .92 px off B in rgb24 and on it in gbrpf32le; of grey nothing
# moves.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q numpy==2.4.6 av==18.1.0
"$folder/venv/bin/python" - <<'PYTHON'
import io

import av
import numpy as np

WIDTH, HEIGHT, PERIOD_PX = 256, 64, 64
LEFT, CENTRE = 0, 1  # codes of H.264 and H.265
x = np.arange(WIDTH)


def planes(colour):
    """Y', C'b, C'r of full range, BT.601, of a colour times a wave; chroma on the left of two, between two rows."""
    red, green, blue = colour
    luma = 0.299 * red + 0.587 * green + 0.114 * blue
    wave = 150 + 80 * np.cos(2 * np.pi * x / PERIOD_PX)
    rows = luma * wave, 128 + (blue - luma) / 1.772 * wave[::2], 128 + (red - luma) / 1.402 * wave[::2]
    return [np.tile(np.round(row), (HEIGHT // n, 1)).astype(np.uint8) for row, n in zip(rows, (1, 2, 2))]


def frame_of(colour, siting):
    """The planes, through lossless H.264 that is tagged with the siting."""
    file = io.BytesIO()
    with av.open(file, "w", format="matroska") as clip:
        stream = clip.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuvj420p"
        stream.options = {"qp": "0", "x264-params": f"chromaloc={siting}:qp=0"}
        frame = av.VideoFrame(WIDTH, HEIGHT, "yuvj420p")
        for plane, values in zip(frame.planes, planes(colour)):
            plane.update(np.pad(values, ((0, 0), (0, plane.line_size - plane.width))).tobytes())
        for packet in [*stream.encode(frame), *stream.encode(None)]:
            clip.mux(packet)
    file.seek(0)
    with av.open(file) as clip:
        return next(clip.decode(video=0))


def converted(siting, form, **how):
    frame = frame_of((0.8, 0.4, 0.2), siting).reformat(format=form, **how)
    return [bytes(plane) for plane in frame.planes]


def apart_px(colour, form):
    """R against B by the phase of the wave."""
    rgb = frame_of(colour, LEFT).to_ndarray(format=form).astype(float)
    wave = np.exp(-2j * np.pi * x[PERIOD_PX:-PERIOD_PX] / PERIOD_PX)
    red, blue = (rgb[HEIGHT // 2, PERIOD_PX:-PERIOD_PX, i] @ wave for i in (0, 2))
    return float(np.angle(blue / red)) * PERIOD_PX / (2 * np.pi)


for form in ("rgb24", "rgb48le", "gbrp"):
    for how in ("FAST_BILINEAR", "BILINEAR", "BICUBIC", "AREA", "LANCZOS"):
        same = converted(LEFT, form, interpolation=how) == converted(CENTRE, form, interpolation=how)
        assert same, f"{form} by {how} follows the tag"
for form, how in (("yuv444p", {}), ("gbrpf32le", {}), ("rgb24", {"width": 2 * WIDTH, "height": 2 * HEIGHT})):
    assert converted(LEFT, form, **how) != converted(CENTRE, form, **how), f"{form} {how} no longer follows the tag"
found = {(name, form): apart_px(colour, form)
         for name, colour in (("(.8, .4, .2)", (0.8, 0.4, 0.2)), ("grey", (0.5, 0.5, 0.5)))
         for form in ("rgb24", "gbrpf32le")}
for (name, form), px in found.items():
    print(f"{name} as {form}: R and B are {abs(px):.2f} px apart")
assert abs(abs(found["(.8, .4, .2)", "rgb24"]) - 0.92) < 0.02, "R and B are another distance apart in rgb24"
assert abs(found["(.8, .4, .2)", "gbrpf32le"]) < 0.02, "R and B are apart in gbrpf32le"
assert abs(found["grey", "rgb24"]) < 0.01, "grey moves"
PYTHON
