"""A video file as a source, through the FFmpeg inside PyAV."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import av
import av.container
import av.logging

from chromaperture.capture.checks import check_primaries
from chromaperture.capture.decoded_frame import counts_of_frame, format_of_frame
from chromaperture.capture.picture_format import PictureFormat, described
from chromaperture.capture.source import Frame, PictureSource, checked_fps
from chromaperture.color.encoding import Siting, StatedFacts, choose_encoding
from chromaperture.system.errors import InputError

_WHITELISTS = {
    "protocol_whitelist": "file",
    "format_whitelist": "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpeg,mpegvideo,yuv4mpegpipe,mjpeg,mxf,asf,"
    "flv,ogg,h264,hevc,nut",
}
_MOST_MISSING_S = 0.25  # of a clip's stated length, beside the last frames: its sound may last longer
_CENTRED_Y4M = (b" C420jpeg", b" C420 ", b" C420\n")  # mjpegtools' names of 4:2:0; the others lie left


@dataclass(kw_only=True, eq=False)
class VideoSource(PictureSource):
    """Frames of a clip as stored: half the size for 4:2:0, chroma at the left by default, as codecs define it."""

    fps: float | None = None  # in place of the clip's own times
    siting: Siting | None = None
    primaries: Literal["srgb"] | None = None

    def __post_init__(self) -> None:
        if self.fps is not None:
            checked_fps(self.fps)
        self.stated = StatedFacts(self.siting, self.primaries)
        if self.camera_encoding is not None:
            self.stated = self.stated.or_else(self.camera_encoding.stated)
        self.form: PictureFormat | None = None
        self._clip: av.container.InputContainer | None = None

    def open(self) -> None:
        """Open the clip."""
        if not os.path.isfile(self.name):
            raise InputError(f"no video at {self.name}")
        try:
            # A name with a colon would be an address, and a list of files would open others.
            self._clip = av.open(os.path.abspath(self.name), options=dict(_WHITELISTS))
            # Threads of whole frames work on between calls. PyAV 18.1 frees them under the interpreter's lock, for
            # which they wait to report damage: a clip that is left in mid-way would never close.
            self._clip.streams.video[0].thread_type = "SLICE"
            self.total = self._clip.streams.video[0].frames
        except (av.FFmpegError, ValueError, IndexError, OSError):
            self.close()
            raise InputError(
                f"{self.name} is damaged or not a video that FFmpeg reads; convert it, for instance to FFV1"
            ) from None

    def close(self) -> None:
        """Close the clip."""
        if self._clip is not None:
            self._clip.close()
        self._clip = None

    def frames(self) -> Iterator[Frame]:
        """Yield all frames; report when there are fewer than the file declares, and when it is to be turned."""
        if self._clip is None:
            raise InputError(f"{self.name} is not open: use the source in a with statement")
        promised, index, self.form = self._clip.streams.video[0].frames, 0, None
        first_s = last_s = None
        for frame in self._decoded():
            form = self.form
            if form is None or (frame.width, frame.height) != form.size_px:
                form = self.form = self._format(frame)
                if form.turn_degrees and index == 0:
                    said = f"{self.name} is to be turned by {form.turn_degrees} degrees for people; "
                    self.report("turned", said + "frames stay as the sensor delivers them, like the calibration")
                is_guess = form.kind == "mjpeg" and form.reduction > 1 and form.known_from.get("siting") == "default"
                if is_guess and index == 0:
                    left = "chroma of MJPEG is taken to lie left, as webcams write it"
                    self.report("siting", f"{self.name}: {left}; of a still camera's clip say siting=centre")
            counts, white = counts_of_frame(frame, form)
            encoding = choose_encoding(form.encoding(white), counts, **self.levels)
            first_s = frame.time if first_s is None else first_s
            last_s = None if frame.time is None or first_s is None else float(frame.time - first_s)
            time_s = index / (self.fps or 30.0) if self.fps is not None or last_s is None else last_s
            found = Frame(counts, encoding, time_s, index, described(form))
            if index == 0 and encoding.to_srgb is not None:
                check_primaries(found.image, form.space.name, self.name)
            yield found
            index += 1
        if index == 0:
            raise InputError(f"{self.name} holds no frame that can be decoded; record or convert it again")
        length_s = (self._clip.duration or 0) / av.time_base
        if index < promised:
            self.report("skipped", f"{self.name} ends after {index} of {promised} frames")
        elif last_s is not None and last_s * (index + 2) / index + _MOST_MISSING_S < length_s:
            self.report("skipped", f"{self.name} ends after {last_s:.1f} of {length_s:.1f} s")

    def _decoded(self) -> Iterator[av.VideoFrame]:
        """Yield the frames that can be decoded; report the others once."""
        assert self._clip is not None
        is_said = False
        try:
            # Decoders conceal damage, and only log it, on threads of their own.
            with av.logging.Capture(local=False) as said:
                for packet in self._clip.demux(self._clip.streams.video[0]):
                    try:
                        frames = packet.decode()
                    except av.FFmpegError as error:
                        frames = []
                        said.append((av.logging.ERROR, "", str(error.strerror)))
                    if said and not is_said:
                        why = said[0][2].strip()
                        self.report("skipped", f"{self.name} is damaged ({why}): frames are left out, or wrong")
                    is_said = is_said or bool(said)
                    said.clear()
                    yield from frames
        except av.FFmpegError as error:  # of the container
            self.report("skipped", f"{self.name} is damaged ({error.strerror}); the rest is left out")

    def _format(self, frame: av.VideoFrame) -> PictureFormat:
        assert self._clip is not None
        siting: Siting = "left"
        if self._clip.format.name == "yuv4mpegpipe":
            with open(self.name, "rb") as file:
                head = file.readline(200)
            siting = "centre" if any(name in head for name in _CENTRED_Y4M) or b" C" not in head else "left"
        try:
            kind = self._clip.streams.video[0].codec_context.name
            # FFmpeg counts the turn counterclockwise.
            form = format_of_frame(frame, kind, siting=siting, turn_degrees=-int(frame.rotation) % 360)
            return form.with_stated(self.stated)
        except InputError as error:
            raise InputError(f"{self.name}: {error}") from None
