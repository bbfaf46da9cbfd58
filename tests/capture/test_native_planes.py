"""Files with subsampled chroma: colours lie where the scene has them, whatever the codec, siting, matrix and depth.

The scene is a band-limited texture that is known at every place, so that planes are sampled where their standard says
the samples are, and the displacement of R against B is known to be none or four pixels.
"""

from __future__ import annotations

import io
import struct
from fractions import Fraction
from functools import cache

import av
import cv2
import numpy as np
import pillow_heif
import pytest
from PIL import Image, ImageCms

import chromaperture as cap
from chromaperture.capture.files import format_of, image_size
from chromaperture.capture.native_planes import Planes, rgb_of_planes
from chromaperture.capture.open import open_source
from chromaperture.capture.picture_format import PictureFormat
from chromaperture.capture.video import VideoSource
from chromaperture.capture.webcam import Webcam
from chromaperture.products.samples import sample_camera, sample_image
from chromaperture.system.errors import InputError

WIDTH, HEIGHT = 512, 384
SRGB_PROFILE = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
GREY, ORANGE = (0.7, 0.69, 0.7), (0.8, 0.4, 0.2)
COLOURS = [GREY, ORANGE, (0.2, 0.5, 0.3), (0.9, 0.7, 0.6), (0.4, 0.6, 0.9)]  # the last three: leaf, skin, sky
WEIGHTS = {"bt601": (0.299, 0.114, 5), "bt709": (0.2126, 0.0722, 1)}  # of R and B in luma, and FFmpeg's code
FACTORS = {"yuv420p": (2, 2), "yuv422p": (2, 1), "yuv444p": (1, 1), "yuv411p": (4, 1), "yuv440p": (1, 2)}


class Texture:
    """A sum of waves of 20 to 60 px, between 0 and 1."""

    def __init__(self, seed=0):
        rng = np.random.default_rng(seed)
        self.frequency = (1 / rng.uniform(20, 60, 40))[:, None] * unit(rng.uniform(0, 2 * np.pi, 40))
        self.phase = rng.uniform(0, 2 * np.pi, 40)

    def at(self, x, y):
        turns = self.frequency[:, 0, None, None] * x + self.frequency[:, 1, None, None] * y
        waves = np.cos(2 * np.pi * turns + self.phase[:, None, None]).sum(axis=0)
        return np.clip(0.5 + waves / 24, 0, 1)  # five standard deviations


def unit(angle):
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def scene(places, colour, apart_px=0.0):
    """Encoded R, G, B at places of the frame, see `grid`; R is moved right, B left."""
    moved = (apart_px / 2, 0, -apart_px / 2)
    return np.stack([light(*places, d) * c for d, c in zip(moved, colour, strict=True)], axis=2)


@cache
def light(step, start, size, moved_px):
    """The texture at places ``step`` apart, pixel centres being whole numbers."""
    x, y = (np.arange(-(-n // s)) * s + b for n, s, b in zip(size, step, start, strict=True))
    return Texture().at(*np.meshgrid(x - moved_px, y))


def grid(step=(1, 1), start=(0.0, 0.0), size=(WIDTH, HEIGHT)):
    return step, start, size


def sites(factors, siting):
    """The first chroma sample's place: in the middle of its cell, or on the first sample of luma."""
    middle = [(n - 1) / 2 for n in factors]
    return (0 if siting != "centre" else middle[0], 0 if siting == "top-left" else middle[1])


def planes_of(
    colour, factors, siting, *, weights=(0.299, 0.114), bits=8, full=True, apart_px=0.0, size=(WIDTH, HEIGHT)
):
    """Y', C'b, C'r of the scene, each sampled at its own places."""
    red, blue = weights
    top = (1 << bits) - 1
    unit_ = 1 << (bits - 8)
    low, luma, chroma = (0, top, top) if full else (16 * unit_, 219 * unit_, 224 * unit_)
    whole, sparse = (scene(g, colour, apart_px) for g in (grid(size=size), grid(factors, sites(factors, siting), size)))
    y, y_sparse = (rgb @ np.array([red, 1 - red - blue, blue]) for rgb in (whole, sparse))
    cb, cr = (sparse[..., 2] - y_sparse) / (2 * (1 - blue)), (sparse[..., 0] - y_sparse) / (2 * (1 - red))
    parts = low + luma * y, 128 * unit_ + chroma * cb, 128 * unit_ + chroma * cr
    return Planes(*(np.rint(part).clip(0, top).astype(np.uint8 if bits == 8 else np.uint16) for part in parts))


def apart_px(image):
    """Displacement of R against B, px, by the phase of their spectra below 0.12 cycles a pixel."""
    red, blue = (image[4:-4, 4:-4, i].astype(float) for i in (0, 2))
    window = np.hanning(red.shape[0])[:, None] * np.hanning(red.shape[1])
    spectra = [np.fft.fft2((part - part.mean()) * window) for part in (red, blue)]
    fy, fx = np.fft.fftfreq(red.shape[0])[:, None], np.fft.fftfreq(red.shape[1])[None]
    cross = spectra[0] * np.conj(spectra[1]) * ((np.hypot(fx, fy) < 0.12) & (fx > 0))
    turn, weight = np.angle(cross) / (2 * np.pi), np.abs(cross) * np.ones_like(fy)
    return -float((weight * turn * fx).sum() / (weight * fx**2).sum())


# ---- planes


@pytest.mark.parametrize("bits", [8, 10])
@pytest.mark.parametrize("full", [True, False])
@pytest.mark.parametrize("siting", ["centre", "left", "top-left"])
@pytest.mark.parametrize("layout", FACTORS)
def test_colours_are_those_of_the_scene_at_the_chroma_samples(layout, siting, full, bits):
    factors, reduction = FACTORS[layout], max(FACTORS[layout])
    planes = planes_of(ORANGE, factors, siting, bits=bits, full=full)
    form = PictureFormat("", (WIDTH, HEIGHT), bits, factors, siting, full_range=full)
    found = rgb_of_planes(planes, form) / 255
    start = sites((reduction, reduction), "centre")  # of a side that is averaged, too
    start = tuple(s if n > 1 else c for s, n, c in zip(sites(factors, siting), factors, start, strict=True))
    expected = scene(grid((reduction, reduction), start), ORANGE)
    inside = np.s_[2:-2, 2:-2]
    # The low pass of four samples takes up to 5 % of the contrast at 20 px, that of two 2.5 %; counts are rounded.
    assert np.abs(found - expected)[inside].max() < (0.04 if reduction == 4 else 0.016)
    assert abs(apart_px(found)) < 0.02


@pytest.mark.parametrize("size", [(321, 255), (3, 5), (1, 1), (2, 9)])
def test_sizes_that_are_no_multiple_of_a_chroma_cell(size):
    width, height = size
    flat = Planes(
        np.full((height, width), 100, np.uint8),
        *(np.full((-(-height // 2), -(-width // 2)), n, np.uint8) for n in (90, 150)),
    )
    found = rgb_of_planes(flat, PictureFormat("", size, 8, (2, 2), "left"))
    assert found.shape == (-(-height // 2), -(-width // 2), 3)
    expected = 100 + np.array([1.402 * 22, -0.344136 * -38 - 0.714136 * 22, 1.772 * -38])  # ITU-T T.871, section 7
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), atol=0.01)


# ---- photographs


def written(path, colour, *, apart=0.0, **settings):
    if path.suffix == ".heic":
        pillow_heif.register_heif_opener()
    counts = np.rint(255 * scene(grid(), colour, apart)).astype(np.uint8)
    Image.fromarray(counts).save(path, **settings)
    return path


KINDS = {  # file and how it is written; how far a colour may be off a grey, px of the stored picture, at quality 95
    "a.jpg": {"quality": 95, "subsampling": 2},
    "b.jpg": {"quality": 95, "subsampling": 1},
    "a.webp": {"quality": 95},
    "a.avif": {"quality": 95},
    "a.heic": {"quality": 95},
}


@pytest.mark.parametrize("apart", [0.0, 4.0])
@pytest.mark.parametrize("name", KINDS)
def test_colours_of_photographs_are_as_far_apart_as_in_the_scene(tmp_path, name, apart):
    found = []
    for colour in COLOURS:
        path = written(tmp_path / name, colour, apart=apart, **KINDS[name])
        assert image_size(path) == (WIDTH // 2, HEIGHT // 2)
        found.append(2 * apart_px(cap.read_image(path)))
    # Counts are rounded in three channels, and by the codec: 0.01 px in what remains of the texture. At quality 95
    # codecs blur chroma a little more than luma: to 0.15 of 4 px; interpolated chroma takes 0.4 to 0.9.
    np.testing.assert_allclose(found, apart, atol=0.15 if apart else 0.03)


def test_a_heic_file_of_tiles_that_is_to_be_turned_stays_as_the_sensor_delivered_it(tmp_path, monkeypatch):
    if not hasattr(pillow_heif.options, "GRID_TILE_SIZE"):
        pytest.skip("this version of pillow-heif writes no tiles")
    monkeypatch.setattr(pillow_heif.options, "GRID_TILE_SIZE", 128)
    exif = Image.Exif()
    exif[0x0112] = 6  # "turn by 90 degrees clockwise", as a phone that is held upright
    path = written(tmp_path / "a.heic", ORANGE, quality=95, exif=exif.tobytes())
    assert b"grid" in path.read_bytes()
    found, form = cap.read_image(path), format_of(path)
    assert (form.size_px, form.turn_degrees) == ((WIDTH, HEIGHT), 90)
    plain = cap.read_image(written(tmp_path / "b.heic", ORANGE, quality=95))
    assert np.abs(found - plain).max() < 0.06  # another partition into blocks
    assert abs(2 * apart_px(found)) < 0.03


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("a.jpg", {"quality": 95, "subsampling": 0}),
        ("a.webp", {"lossless": True}),
        ("b.webp", {"lossless": True, "icc_profile": SRGB_PROFILE}),
        ("a.avif", {"quality": 95, "subsampling": "4:4:4"}),
    ],
)
def test_full_chroma_keeps_the_size(tmp_path, name, settings):
    path = written(tmp_path / name, ORANGE, **settings)
    assert image_size(path) == cap.read_image(path).shape[1::-1] == (WIDTH, HEIGHT)


@pytest.mark.parametrize("name", [*KINDS, "full.jpg"])
def test_a_file_that_is_cut_off_or_ends_in_zeros_is_refused(tmp_path, name):
    path = written(tmp_path / name, ORANGE, **KINDS.get(name, {"quality": 95, "subsampling": 0}))
    data = path.read_bytes()
    copies = [data[: int(share * len(data))] for share in (0.3, 0.6, 0.97)]
    if name != "a.avif":
        copies.append(data[: len(data) * 2 // 3] + bytes(max(8192, len(data) // 3)))
    for copy in copies:
        path.write_bytes(copy)
        with pytest.raises(InputError) as caught:
            cap.read_image(path)
        assert "\n" not in str(caught.value)


# ---- webcams


class FakeWebcam:
    """What OpenCV hands out of V4L2 without its own conversion: frames of a format that the driver has."""

    kind, data = "YUYV", None

    def __init__(self, *_):
        self.asked = {}

    def isOpened(self):
        return True

    def set(self, setting, value):
        self.asked[setting] = value
        return True

    def get(self, setting):
        return float(cv2.VideoWriter.fourcc(*self.kind)) if setting == cv2.CAP_PROP_FOURCC else 0.0

    def read(self):
        assert self.asked[cv2.CAP_PROP_CONVERT_RGB] == 0
        return True, self.data

    def release(self):
        pass


def as_delivered(kind, colour):
    """A frame of the scene in a webcam's format, chroma at every other pixel of a row."""
    if kind == "NV12":
        planes = planes_of(colour, (2, 2), "left", full=False)
        return np.vstack([planes.luma, np.stack([planes.blue, planes.red], 2).reshape(HEIGHT // 2, WIDTH)])
    planes = planes_of(colour, (2, 1), "left", full=kind == "MJPG")
    if kind == "MJPG":
        context = av.CodecContext.create("mjpeg", "w")
        context.width, context.height, context.pix_fmt, context.time_base = WIDTH, HEIGHT, "yuvj422p", Fraction(1, 30)
        context.options = {"qscale": "2"}
        frame = av.VideoFrame(WIDTH, HEIGHT, "yuvj422p")
        for plane, values in zip(frame.planes, (planes.luma, planes.blue, planes.red), strict=True):
            rows = np.zeros((HEIGHT, plane.line_size), np.uint8)
            rows[:, : values.shape[1]] = values
            plane.update(rows.tobytes())
        return np.frombuffer(bytes(context.encode(frame)[0]), np.uint8)[None]
    chroma = np.stack([planes.blue, planes.red], 2).reshape(HEIGHT, WIDTH)
    return np.stack([planes.luma, chroma] if kind == "YUYV" else [chroma, planes.luma], 2)


@pytest.mark.parametrize("kind", ["YUYV", "UYVY", "NV12", "MJPG"])
def test_colours_of_webcams_are_in_one_place(tmp_path, monkeypatch, kind):
    monkeypatch.setattr(cv2, "VideoCapture", FakeWebcam)
    monkeypatch.setattr(FakeWebcam, "kind", kind)
    (tmp_path / "video0").touch()
    for colour in (GREY, ORANGE):
        monkeypatch.setattr(FakeWebcam, "data", as_delivered(kind, colour))
        frame = Webcam(str(tmp_path / "video0"), pixel_format=kind).read(0)
        assert frame.counts.shape == (HEIGHT // 2, WIDTH // 2, 3)
        assert abs(2 * apart_px(frame.image)) < (0.05 if kind == "MJPG" else 0.02)  # see the clips
        expected = scene(grid((2, 2), (0, 0.5)), colour)
        assert np.abs(frame.counts / 255 - expected)[2:-2, 2:-2].mean() < 0.005


def test_grey_frames_of_a_webcam_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(cv2, "VideoCapture", FakeWebcam)
    monkeypatch.setattr(FakeWebcam, "kind", "GREY")
    monkeypatch.setattr(FakeWebcam, "data", np.full((8, 8), 9, np.uint8))
    (tmp_path / "video0").touch()
    with pytest.raises(InputError, match="the format GREY, which has no colours"):
        Webcam(str(tmp_path / "video0")).read(0)


# ---- video


def clip(path, codec, layout, planes, *, code=2, full=False, trc=2, primaries=2, options=None, times=(0, 1, 2)):
    """Write a clip of the same planes; its siting is told nowhere."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=10, options=options or {})
        stream.height, stream.width = planes.luma.shape
        stream.pix_fmt = layout
        context = stream.codec_context
        context.colorspace, context.color_range, context.color_trc = code, 2 if full else 1, trc
        context.color_primaries = primaries
        for time in times:
            frame = av.VideoFrame(planes.luma.shape[1], planes.luma.shape[0], layout)
            for plane, values in zip(frame.planes, (planes.luma, planes.blue, planes.red), strict=True):
                rows = np.zeros((values.shape[0], plane.line_size // values.itemsize), values.dtype)
                rows[:, : values.shape[1]] = values
                plane.update(rows.tobytes())
            frame.colorspace, frame.color_range, frame.pts = code, 2 if full else 1, time
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def frames_of(path, **settings):
    with VideoSource(str(path), listener=lambda event: None, **settings) as source:
        return list(source)


CLIPS = {  # suffix, codec, layout, its options
    "h264": ("mp4", "libx264", "yuv420p", {"crf": "8"}),
    "hevc 10 bit": ("mkv", "libx265", "yuv420p10le", {"crf": "8", "x265-params": "log-level=none"}),
    "mjpeg 4:2:2": ("avi", "mjpeg", "yuvj422p", {"qscale": "2"}),
    "ffv1": ("mkv", "ffv1", "yuv420p", {}),
    "vp9": ("webm", "libvpx-vp9", "yuv420p", {"crf": "8", "b": "0"}),
}


@pytest.mark.parametrize("siting", ["left", "centre"])
@pytest.mark.parametrize("kind", CLIPS)
def test_colours_of_clips_are_in_one_place(tmp_path, kind, siting):
    suffix, codec, layout, options = CLIPS[kind]
    factors = FACTORS[layout.replace("yuvj", "yuv").removesuffix("10le")]
    bits, full = 10 if "10" in layout else 8, layout.startswith("yuvj")
    moved, wrong = [], []
    for colour in (GREY, ORANGE):
        planes = planes_of(colour, factors, siting, bits=bits, full=full)
        path = clip(tmp_path / f"a.{suffix}", codec, layout, planes, code=5, full=full, options=options)
        for found, stated in ((moved, siting), (wrong, "centre" if siting == "left" else "left")):
            (frame, *_) = frames_of(path, siting=stated)
            assert frame.counts.shape == (HEIGHT // 2, WIDTH // 2, 3)
            found.append(2 * apart_px(frame.image))
    # Codecs keep less of a blue of 0.2 than of a grey: 0.04 px at these qualities, 0.01 without loss.
    assert np.abs(moved).max() < (0.02 if kind == "ffv1" else 0.05), moved
    assert wrong[1] - wrong[0] > 0.7 or wrong[0] - wrong[1] > 0.7  # 0.93 px by the formula: what the siting is worth


def test_left_is_what_a_clip_means_that_does_not_say_it_and_centre_what_y4m_says(tmp_path):
    left, centre = (planes_of(ORANGE, (2, 2), siting) for siting in ("left", "centre"))
    assert abs(apart_px(frames_of(clip(tmp_path / "a.mkv", "ffv1", "yuv420p", left))[0].image)) < 0.02
    head = b"YUV4MPEG2 W512 H384 F10:1 Ip A1:1 C420jpeg\nFRAME\n"
    (tmp_path / "a.y4m").write_bytes(head + b"".join(part.tobytes() for part in (centre.luma, centre.blue, centre.red)))
    assert abs(apart_px(frames_of(tmp_path / "a.y4m")[0].image)) < 0.02


@pytest.mark.parametrize("matrix", WEIGHTS)
@pytest.mark.parametrize("full", [True, False])
def test_matrix_and_range_are_those_that_the_clip_states(tmp_path, matrix, full):
    red, blue, code = WEIGHTS[matrix]
    planes = planes_of(ORANGE, (1, 1), "left", weights=(red, blue), full=full)
    (frame, *_) = frames_of(clip(tmp_path / "a.mkv", "ffv1", "yuv444p", planes, code=code, full=full))
    assert np.abs(frame.counts / 255 - scene(grid(), ORANGE)).max() < 0.01  # two counts of luma and chroma
    known = frame.metadata["photograph_format"]["known_from"]
    assert (known["matrix"], known["range"], known["siting"]) == ("tag", "tag", "default")


def test_deep_clips_keep_their_bits(tmp_path):
    planes = planes_of(ORANGE, (2, 2), "left", bits=16)
    (frame, *_) = frames_of(clip(tmp_path / "a.mkv", "ffv1", "yuv420p16le", planes, full=True))
    coarse = frames_of(clip(tmp_path / "b.mkv", "ffv1", "yuv420p", planes_of(ORANGE, (2, 2), "left"), full=True))[0]
    expected = scene(grid((2, 2), (0, 0.5)), ORANGE)
    errors = [np.abs(f.counts / 255 - expected)[2:-2, 2:-2].std() for f in (frame, coarse)]
    assert errors[0] < 0.9 * errors[1]


def test_where_mjpeg_has_its_chroma_is_said(tmp_path):
    planes = planes_of(ORANGE, (2, 1), "centre", full=True)
    path = clip(tmp_path / "a.avi", "mjpeg", "yuvj422p", planes, full=True)
    said = []
    for siting in (None, "centre"):
        with VideoSource(str(path), siting=siting, listener=said.append) as source:
            list(source)
    assert [event.kind for event in said] == ["siting"]


def test_frames_have_their_own_times(tmp_path):
    planes = planes_of(GREY, (2, 2), "left")
    path = clip(tmp_path / "a.mkv", "ffv1", "yuv420p", planes, times=(0, 1, 2, 5, 9))
    np.testing.assert_allclose([f.time_s for f in frames_of(path)], [0, 0.1, 0.2, 0.5, 0.9], atol=2e-3)  # Matroska: ms
    with open_source(f"{path}?fps=5&white_level=200") as source:
        slow = list(source)
    np.testing.assert_allclose([f.time_s for f in slow], [0, 0.2, 0.4, 0.6, 0.8])
    assert slow[0].encoding.white_level == 200


def test_the_curve_of_a_clip_is_undone(tmp_path):
    light = np.linspace(0, 1, 64)[None] * np.ones((64, 1))
    hlg = np.where(0.265 * light <= 1 / 12, np.sqrt(3 * 0.265 * light),  # BT.2100, table 5, diffuse white at 0.75
                   0.17883277 * np.log(np.maximum(12 * 0.265 * light - 0.28466892, 1e-9)) + 0.55991073)  # fmt: skip
    grey = np.full((64, 64), 512, np.uint16)
    planes = Planes(np.rint(64 + 876 * hlg).astype(np.uint16), grey, grey)
    path = clip(tmp_path / "a.mkv", "ffv1", "yuv444p10le", planes, code=9, trc=18, primaries=9)
    (frame, *_) = frames_of(path)
    assert np.abs(frame.image - light[..., None]).max() < 4e-3  # a count of 10 bits at the white end


def test_a_tag_that_contradicts_the_pixels_is_refused(tmp_path):
    planes = planes_of((0.1, 0.8, 0.3), (1, 1), "left", weights=(0.2627, 0.0593), bits=10, full=False)
    path = clip(tmp_path / "a.mkv", "ffv1", "yuv444p10le", planes, code=9, trc=18, primaries=9)
    with pytest.raises(InputError, match=r"a\.mkv is tagged BT\.2020.*contradicts"):
        frames_of(path)
    assert frames_of(path, primaries="srgb")[0].metadata["photograph_format"]["known_from"]["primaries"] == "option"


def test_a_clip_that_is_to_be_turned_stays_as_the_sensor_delivered_it_and_says_so(tmp_path):
    planes = planes_of(ORANGE, (2, 2), "left")
    path = clip(tmp_path / "a.mp4", "libx264", "yuv420p", planes)
    plain = frames_of(path)[0].counts
    data, one = bytearray(path.read_bytes()), 0x10000
    at = data.index(b"tkhd") + 4 + (40 if data[data.index(b"tkhd") + 4] == 0 else 52)  # ISO 14496-12, 8.3.2
    for turn in ((-one, 0, 0, 0, -one, 0, 0, 0, 1 << 30), (0, one, 0, -one, 0, 0, 0, 0, 1 << 30)):
        data[at : at + 36] = np.array(turn, ">i4").tobytes()
        path.write_bytes(data)
        said = []
        with VideoSource(str(path), listener=said.append) as source:
            frame = next(iter(source))
        np.testing.assert_array_equal(frame.counts, plain)
        assert [event.kind for event in said] == ["turned"]
        assert frame.metadata["photograph_format"]["turn_degrees"] in (90, 180)


def test_a_clip_opens_no_other_file_and_a_name_with_a_colon_is_a_name(tmp_path, monkeypatch):
    clip(tmp_path / "12:30.mp4", "libx264", "yuv420p", planes_of(ORANGE, (2, 2), "left"))
    (tmp_path / "list.mp4").write_text("ffconcat version 1.0\nfile 12:30.mp4\n")
    monkeypatch.chdir(tmp_path)
    assert len(frames_of("12:30.mp4")) == 3
    with pytest.raises(InputError, match="not a video"):
        frames_of("list.mp4")


def test_no_frame_is_decoded_between_calls(tmp_path):
    """A thread that reported damage while its decoder is freed would wait for it, and it for the thread."""
    clip(tmp_path / "clip.mkv", "libx264", "yuv420p", planes_of(ORANGE, (2, 2), "left"))
    with VideoSource(str(tmp_path / "clip.mkv"), listener=lambda event: None) as source:
        next(iter(source))
        assert source._clip.streams.video[0].codec_context.thread_type.name == "SLICE"


def test_grey_and_odd_layouts_are_refused_in_one_line(tmp_path):
    with av.open(str(tmp_path / "grey.mkv"), "w") as container:
        stream = container.add_stream("ffv1", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 64, "gray"
        container.mux(stream.encode(av.VideoFrame.from_ndarray(np.full((64, 64), 9, np.uint8), format="gray")))
        container.mux(stream.encode())
    with pytest.raises(InputError, match=r"grey\.mkv: its frames are gray: depth is in the colours"):
        frames_of(tmp_path / "grey.mkv")
    (tmp_path / "text.mp4").write_text("no clip")
    with pytest.raises(InputError, match="not a video"):
        frames_of(tmp_path / "text.mp4")


@pytest.mark.parametrize(
    ("name", "what"), [("a.gif", "GIF picture"), ("a.mp4", "a video"), ("a.webp", "holds 2 pictures")]
)
def test_a_file_that_is_no_photograph_is_named(tmp_path, name, what):
    path, picture = tmp_path / name, Image.fromarray(np.arange(192, dtype=np.uint8).reshape(8, 8, 3))
    if name == "a.mp4":
        clip(path, "libx264", "yuv420p", planes_of(GREY, (2, 2), "left"))
    else:
        picture.save(path, save_all=True, append_images=[picture.rotate(90)])
    with pytest.raises(InputError, match=what):
        cap.read_image(path)


def test_printed_colours_are_refused(tmp_path):
    Image.new("CMYK", (16, 16), (10, 20, 30, 40)).save(tmp_path / "a.jpg")
    with pytest.raises(InputError, match="CMYK"):
        cap.read_image(tmp_path / "a.jpg")


def test_display_p3_and_adobe_rgb_of_cameras_become_srgb(tmp_path):
    linear = np.array([0.5, 0.25, 0.125])
    # Adobe RGB (1998), 4.3.5.2: gamma 2 51/256; the matrix by its primaries, as in Lindbloom's tables.
    to_adobe = np.array([[0.7151, 0.2849, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0412, 0.9588]])
    adobe = np.rint(255 * (to_adobe @ linear) ** (256 / 563)).astype(np.uint8)
    picture = np.broadcast_to(adobe, (16, 16, 3)).copy()
    picture[0] = picture[1] = 0
    memory = io.BytesIO()
    # A TIFF header, its directory with the Exif pointer, the Exif directory, and that of interoperability: R03.
    words = [b"II*\0", 8, [(0x8769, 4, 1, 26)], [(0xA001, 3, 1, 65535), (0xA005, 4, 1, 56)], [(1, 2, 4, 0x333052)]]
    exif = b"Exif\0\0" + b"".join(map(_packed, words))
    Image.fromarray(picture).save(memory, "JPEG", quality=100, subsampling=0, exif=exif)
    (tmp_path / "a.jpg").write_bytes(memory.getvalue())
    found = cap.read_image(tmp_path / "a.jpg")[12, 8]
    np.testing.assert_allclose(found, linear, atol=0.006)  # a count of 8 bits is 0.004 there
    assert format_of(tmp_path / "a.jpg").space.name == "Adobe RGB"


def _packed(part):
    if isinstance(part, bytes):
        return part
    if isinstance(part, int):
        return struct.pack("<I", part)
    return struct.pack("<H", len(part)) + b"".join(struct.pack("<HHII", *tag) for tag in part) + bytes(4)


# ---- damaged clips, and streams of the camera's own size


def test_damage_that_a_decoder_conceals_is_said(tmp_path):
    path = clip(tmp_path / "a.mp4", "libx264", "yuv420p", planes_of(ORANGE, (2, 2), "left"), options={"crf": "8"})
    data = bytearray(path.read_bytes())
    start = data.index(b"mdat") + 2000
    for at in range(start, start + 20_000, 997):
        data[at] ^= 0xFF
    path.write_bytes(data)
    said = []
    with VideoSource(str(path), listener=said.append) as source:
        list(source)
    assert any("is damaged" in event.message for event in said)


def test_a_clip_of_the_cameras_size_is_exported_at_the_size_of_its_chroma(run, tmp_path):
    counts = cv2.imread(str(sample_image("still_life_cy_halves")), cv2.IMREAD_UNCHANGED)[..., ::-1] / 1016
    coded = np.rint(255 * np.clip(counts, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    with av.open(str(tmp_path / "a.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=10, options={"crf": "10"})
        stream.width, stream.height, stream.pix_fmt = 720, 480, "yuv420p"
        container.mux(stream.encode(av.VideoFrame.from_ndarray(coded, format="rgb24")))
        container.mux(stream.encode())
    command = ("export", tmp_path / "a.mp4", tmp_path / "out", "--camera", sample_camera("still_life_cy_halves"))
    result = run(*command, "--anyway")
    assert result.returncode == 0, result.stderr
    depth = cv2.imread(str(next((tmp_path / "out" / "depth").iterdir())), cv2.IMREAD_UNCHANGED)
    assert depth.shape == (240, 360)
    focal_px = float((tmp_path / "out" / "calibration.txt").read_text().split("\n")[1].split()[0])
    camera = cap.load_camera(sample_camera("still_life_cy_halves")).calibration
    assert focal_px == pytest.approx(camera.lens.camera_matrix[0, 0] / 2, rel=1e-3)
