"""Live messages for robotics tools, through Foxglove's SDK: a WebSocket server, or an MCAP file of the same messages.

Messages are Foxglove's own schemas (protobuf), which Foxglove, Lichtblick and others show without any code of ours.
Encodings of depth are those of REP 118: 16UC1 in mm, 0 unknown, or 32FC1 in m, NaN unknown.
"""

from __future__ import annotations

import contextlib
import re
from pathlib import Path
from typing import Any, Self

import numpy as np
from scipy.spatial.transform import Rotation

from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA, within_error
from chromaperture.products.rectified import CAMERA_FRAME, DepthEncoding, View, stamp_ns
from chromaperture.system.errors import InputError, MissingDependencyError

WORLD_FRAME = "world"
DEFAULT_PORT = 8765  # of Foxglove, which its "open connection" proposes
_MOST_POINTS = 100_000  # of a cloud: 1.6 MB a message; chosen by hand
# Messages kept for a slow client before the oldest are dropped: of six a frame, some three frames; chosen by hand.
_BACKLOG = 20


def foxglove() -> Any:
    """Import Foxglove's SDK; raises MissingDependencyError naming the extra."""
    try:
        import foxglove
        import foxglove.channels
        import foxglove.messages
    except ImportError:
        raise MissingDependencyError("streams need the extra: pip install 'chromaperture[stream]'") from None
    return foxglove


class FoxgloveStream:
    """Send views and poses; a context manager.

    Parameters
    ----------
    target : str
        ``HOST:PORT`` or ``HOST``, of a WebSocket server on this machine, or ``NAME.mcap``. Whoever reaches the server
        sees the pictures: it knows no passwords, so 127.0.0.1 is the choice unless the network is trusted.
    camera_matrix : (3, 3) float, px
    depth_encoding : {"16UC1", "32FC1"}
    max_relative_sigma : float
        Largest sigma / depth of depth and cloud; see `within_error`.

    Attributes
    ----------
    url : str
        Of the server, once it runs; the file's name where there is none.
    sent : int
        Views sent.

    Raises
    ------
    MissingDependencyError
        The extra ``stream`` is not installed.
    InputError
        The target cannot be used, or the file exists; on entering, the server cannot be started or the file made.
    """

    def __init__(
        self,
        target: str,
        *,
        camera_matrix: np.ndarray,
        depth_encoding: DepthEncoding = "16UC1",
        max_relative_sigma: float = MAX_RELATIVE_SIGMA,
    ) -> None:
        if depth_encoding not in ("16UC1", "32FC1"):
            raise InputError(f"unknown encoding of depth {depth_encoding!r}: choose 16UC1 (mm) or 32FC1 (m)")
        self._sdk = sdk = foxglove()
        self._matrix, self._encoding, self._limit = np.asarray(camera_matrix, float), depth_encoding, max_relative_sigma
        self._context = context = sdk.Context()  # of this stream alone
        kinds = sdk.channels
        self._images = {
            part: kinds.RawImageChannel(f"/camera/{part}/image_rect", context=context)
            for part in ("color", "depth", "sigma", "confidence")
        }
        self._info = kinds.CameraCalibrationChannel("/camera/camera_info", context=context)
        self._points = kinds.PointCloudChannel("/camera/depth/points", context=context)
        self._transform = kinds.FrameTransformChannel("/tf", context=context)
        self._sink: Any = None
        self._target, self.url, self.sent = target, target, 0
        self._file = Path(target) if target.endswith(".mcap") else None
        if self._file is None:
            address(target)  # says what is wrong with it before the work
        elif self._file.exists():
            raise InputError(f"{self._file} exists already; choose another name")

    def __enter__(self) -> Self:
        if self._file is not None:
            self._sink = _opened(self._sdk, self._file, self._context)
            return self
        host, port = address(self._target)
        try:
            self._sink = self._sdk.start_server(
                name="chromaperture", host=host, port=port, context=self._context, message_backlog_size=_BACKLOG
            )
        except Exception as error:  # the SDK raises a RuntimeError of its own
            raise InputError(f"cannot stream on {self._target} ({error}); choose another --stream HOST:PORT") from None
        self.url = f"ws://{f'[{host}]' if ':' in host else host}:{self._sink.port}"
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """End the server, or complete the file; a file of no view is removed."""
        sink, self._sink = self._sink, None
        if sink is not None:
            with contextlib.suppress(RuntimeError):  # the SDK: closed already
                sink.close() if self._file is not None else sink.stop()
            if self._file is not None and not self.sent:
                self._file.unlink(missing_ok=True)

    def send(self, view: View) -> None:
        """Send a view: colour, depth, sigma (m), confidence, camera, coloured points (m)."""
        messages = self._sdk.messages
        stamp = messages.Timestamp(*divmod(view.time_ns, 10**9))
        head = {"timestamp": stamp, "frame_id": CAMERA_FRAME}
        z_mm = within_error(view.z_mm, view.sigma_mm, self._limit)
        height, width = z_mm.shape
        for part, (encoding, pixels) in view.ros_pictures(self._encoding, z_mm).items():
            image = messages.RawImage(
                **head, width=width, height=height, encoding=encoding, step=pixels.nbytes // height,
                data=np.ascontiguousarray(pixels).tobytes(),
            )  # fmt: skip
            self._images[part].log(image, log_time=view.time_ns)
        k = self._matrix.ravel().tolist()
        info = messages.CameraCalibration(
            **head, width=width, height=height, distortion_model="plumb_bob", D=[0.0] * 5, K=k,
            R=np.eye(3).ravel().tolist(), P=[*k[:3], 0.0, *k[3:6], 0.0, *k[6:9], 0.0],
        )  # fmt: skip
        self._info.log(info, log_time=view.time_ns)
        self._points.log(self._cloud(head, z_mm, view.color), log_time=view.time_ns)
        self.sent += 1

    def send_pose(self, pose: np.ndarray, time_s: float) -> None:
        """Send the pose of the camera in the world, (4, 4), mm."""
        messages, time_ns = self._sdk.messages, stamp_ns(time_s)
        x, y, z = (pose[:3, 3] / 1000).tolist()
        qx, qy, qz, qw = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
        transform = messages.FrameTransform(
            timestamp=messages.Timestamp(*divmod(time_ns, 10**9)),
            parent_frame_id=WORLD_FRAME,
            child_frame_id=CAMERA_FRAME,
            translation=messages.Vector3(x=x, y=y, z=z),
            rotation=messages.Quaternion(x=qx, y=qy, z=qz, w=qw),
        )
        self._transform.log(transform, log_time=time_ns)

    def _cloud(self, head: dict[str, Any], z_mm: np.ndarray, color: np.ndarray) -> Any:
        messages, numbers = self._sdk.messages, self._sdk.messages.PackedElementFieldNumericType
        v, u = np.nonzero(np.isfinite(z_mm) & (z_mm > 0))
        step = max(1, -(-len(v) // _MOST_POINTS))
        v, u = v[::step], u[::step]
        z = z_mm[v, u] / np.float32(1000)
        m = self._matrix
        points = np.empty(len(z), dtype=[("xyz", "<f4", 3), ("rgba", "u1", 4)])
        points["xyz"] = np.stack([(u - m[0, 2]) / m[0, 0] * z, (v - m[1, 2]) / m[1, 1] * z, z], axis=1)
        points["rgba"][:, :3], points["rgba"][:, 3] = color[v, u], 255
        fields = [messages.PackedElementField(name=n, offset=4 * i, type=numbers.Float32) for i, n in enumerate("xyz")]
        fields += [
            messages.PackedElementField(name=n, offset=12 + i, type=numbers.Uint8)
            for i, n in enumerate(("red", "green", "blue", "alpha"))
        ]
        origin = messages.Pose(
            position=messages.Vector3(x=0.0, y=0.0, z=0.0), orientation=messages.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
        )
        return messages.PointCloud(
            **head, pose=origin, point_stride=points.itemsize, fields=fields, data=points.tobytes()
        )


def address(text: str) -> tuple[str, int]:
    """Split ``HOST:PORT``, ``[IPV6]:PORT`` or ``HOST``; raises InputError."""
    found = re.fullmatch(r"\[([0-9a-fA-F:.]+)\](?::(\d{1,5}))?|([^:/\s]+)(?::(\d{1,5}))?", text)
    port = int((found[2] or found[4] or DEFAULT_PORT) if found else 0)
    if found is None or port > 65535:
        raise InputError(f"--stream {text!r} is not understood: give HOST:PORT, such as 127.0.0.1:8765, or NAME.mcap")
    return found[1] or found[3], port


def _opened(sdk: Any, path: Path, context: Any) -> Any:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return sdk.open_mcap(path, context=context)
    except OSError as error:
        raise InputError(f"cannot write {path} ({error.strerror or error}); choose another name") from None
