"""Every reader of a file that somebody else may have written, with files that it reads.

Only `InputError` may leave a reader, whatever the file holds.
"""

from __future__ import annotations

import io
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import av
import numpy as np
import pillow_heif
import tifffile
from PIL import Image

from chromaperture.calibration.session import read_session
from chromaperture.capture.exif import read_exif
from chromaperture.capture.files import image_size, read_image
from chromaperture.capture.open import open_source
from chromaperture.depth.pointcloud import PointCloud, write_ply
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.pinhole import focused_at
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.printing.aperture_file import load_aperture
from chromaperture.optics.simulator.scene import load_scene
from chromaperture.products.posed_sequence import read_trajectory
from chromaperture.products.result_files import read_depth, read_result
from chromaperture.settings.methods import AccurateConfig, Config, preset
from chromaperture.settings.toml_file import with_file

pillow_heif.register_heif_opener()
DATA = Path(__file__).parents[1] / "data"
CORPUS = Path(__file__).parent / "corpus"
CONFIGS = (Config(), Config("paper", preset("paper")), Config("accurate", AccurateConfig.for_blur(0.4)))


@dataclass(frozen=True)
class Reader:
    """A reader and what it is tried on."""

    name: str
    file: str  # name of the file whose content is mutated, in an empty folder
    read: Callable[[Path], object]  # takes the path of that file
    seeds: Callable[[], list[bytes]]  # contents that are read without an error
    is_text: bool = False  # written by hand
    prepare: Callable[[Path], None] = lambda folder: None  # puts the other files into the folder


def _corpus(kind: str) -> Callable[[], list[bytes]]:
    return lambda: [path.read_bytes() for path in sorted((CORPUS / kind).iterdir())]


@cache
def _picture() -> np.ndarray:
    return np.random.default_rng(0).integers(20, 1000, (12, 16, 3)).astype(np.uint16)


def _pictures(*formats: str) -> Callable[[], list[bytes]]:
    def make() -> list[bytes]:
        deep, made = _picture(), []
        for name in formats:
            memory = io.BytesIO()
            if name == "deep TIFF":
                tifffile.imwrite(memory, deep, photometric="rgb")
            elif name == "packed TIFF":
                tifffile.imwrite(memory, deep, photometric="rgb", compression="zlib", tile=(16, 16))
            elif name == "deep PPM":
                memory.write(b"P6\n16 12\n65535\n" + deep.astype(">u2").tobytes())
            else:
                kind, _, chroma = name.partition(" ")
                options = {"quality": 95} if chroma else _OPTIONS.get(name, {})
                Image.fromarray((deep // 4).astype(np.uint8)).save(memory, kind, **options)
            made.append(memory.getvalue())
        return made

    return make


_OPTIONS = {"JPEG": {"quality": 95, "subsampling": 0}, "WEBP": {"lossless": True}}


def _clips() -> list[bytes]:
    frame, made = av.VideoFrame.from_ndarray((_picture() // 4).astype(np.uint8), format="rgb24"), []
    for kind, codec, layout in (
        ("mp4", "libx264", "yuv420p"),
        ("matroska", "ffv1", "yuv422p10le"),
        ("avi", "mjpeg", "yuvj420p"),
    ):
        memory = io.BytesIO()
        with av.open(memory, "w", format=kind) as clip:
            stream = clip.add_stream(codec, rate=10)
            stream.width, stream.height, stream.pix_fmt = frame.width, frame.height, layout
            clip.mux(stream.encode(frame))
            clip.mux(stream.encode())
        made.append(memory.getvalue())
    return made


def _read_clip(path: Path) -> None:
    with open_source(str(path), listener=lambda event: None) as source:
        for frame in source:
            assert frame.image.ndim == 3


def _read_picture(path: Path) -> None:
    image_size(path)
    read_exif(path)
    image = read_image(path, black_level=0, white_level=1023)
    assert (image.dtype, image.ndim, image.shape[2]) == (np.float32, 3, 3)
    assert np.isfinite(image).all()


def _read_camera(path: Path) -> None:
    assert Calibration.load(path).summary()["scale_px_mm"] > 0


def _copy_recording(folder: Path) -> None:
    shutil.copytree(DATA / "recordings" / "format_2", folder, dirs_exist_ok=True)


def _replay(path: Path) -> None:
    folder = path.parent if path.parent.name != "frames" else path.parents[1]
    with open_source(f"replay:{folder}", listener=lambda event: None) as source:
        for frame in source:
            assert frame.image.ndim == 3


def _prepare_session(folder: Path) -> None:
    shutil.copytree(CORPUS / "session_folder", folder, dirs_exist_ok=True)


def _with_each_config(path: Path) -> None:
    errors = []
    for config in CONFIGS:
        try:
            with_file(config, path)
        except Exception as error:
            errors.append(error)
    for error in sorted(errors, key=lambda e: type(e).__name__ == "InputError"):
        raise error


def _points() -> list[bytes]:
    points = np.random.default_rng(0).normal(size=(20, 3)).astype(np.float32)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "points.ply"
        write_ply(path, PointCloud(points, _picture().reshape(-1, 3)[:20].astype(np.uint8)))
        return [path.read_bytes()]


def _maps(kind: str) -> list[bytes]:
    memory, values = io.BytesIO(), _picture()[..., 0].astype(np.float32)
    if kind == "npy":
        np.save(memory, values)
    else:
        tifffile.imwrite(memory, values, metadata=None)
    return [memory.getvalue()]


def _files(*paths: Path) -> Callable[[], list[bytes]]:
    return lambda: [path.read_bytes() for path in paths]


_TRAJECTORY = b"# s, m\n0.5 0.1 0.2 0.3 0 0 0 1\n1 0 0 0 0 0 1 1\n"
READERS = {
    reader.name: reader
    for reader in (
        Reader("lens", "lens.toml", lambda p: focused_at(load_lens(p), 2000.0), _corpus("lens"), True),
        Reader("aperture", "aperture.toml", load_aperture, _corpus("aperture"), True),
        Reader("drawing", "aperture.svg", load_aperture, _corpus("drawing"), True),
        Reader("scene", "scene.toml", load_scene, _corpus("scene"), True),
        Reader("config", "settings.toml", _with_each_config, _corpus("config"), True),
        Reader("session", "session.toml", lambda p: read_session(p.parent), _corpus("session"), True, _prepare_session),
        Reader("distances", "distances.csv", lambda p: read_session(p.parent), _corpus("distances"), True,
               _prepare_session),
        Reader("camera", "camera.asdf", _read_camera, _corpus("camera")),
        Reader("recording", "index.jsonl", _replay, _files(DATA / "recordings" / "format_2" / "index.jsonl"), False,
               _copy_recording),
        Reader("frame", "frames/00000000.tiff", _replay,
               _files(DATA / "recordings" / "format_2" / "frames" / "00000000.tiff"), False, _copy_recording),
        Reader("picture", "photo.png", _read_picture, _pictures("PNG", "JPEG", "BMP", "WEBP", "PPM", "deep PPM")),
        Reader("chroma", "photo.jpg", _read_picture, _pictures("JPEG 4:2:0", "WEBP 4:2:0", "AVIF 4:2:0", "HEIF 4:2:0")),
        Reader("clip", "clip.mp4", _read_clip, _clips),
        Reader("map", "photo.depth.tiff", read_depth, lambda: _maps("tiff")),
        Reader("array", "map.npy", read_depth, lambda: _maps("npy")),
        Reader("points", "points.ply", read_result, _points),
        Reader("trajectory", "t.txt", read_trajectory, lambda: [_TRAJECTORY], True),
        Reader("tiff", "photo.tiff", _read_picture, _pictures("deep TIFF", "packed TIFF", "TIFF")),
    )
}  # fmt: skip
