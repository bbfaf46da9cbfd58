"""A tethered DSLR through gphoto2: every frame is a photograph taken on request, not a live view."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from chromaperture.capture.files import read_counts
from chromaperture.capture.picture_format import described
from chromaperture.capture.source import Event, FileSource, Frame, Listener
from chromaperture.capture.threaded_source import not_there
from chromaperture.color.encoding import Encoding
from chromaperture.system.errors import InputError, MissingDependencyError


def load_gphoto2() -> Any:
    """Import gphoto2; raises MissingDependencyError with the extra to install."""
    try:
        import gphoto2
    except ImportError:
        raise MissingDependencyError("tethered cameras need gphoto2: pip install 'chromaperture[cameras]'") from None
    return gphoto2


class TetheredCamera(FileSource):
    """Take a photograph for each frame; RAW files become half-size superpixels.

    Parameters
    ----------
    port : str
        As listed by `gphoto2 --auto-detect`; empty for the first camera.
    count : int, optional
        Number of photographs; unlimited when absent.
    shutterspeed, iso, aperture : str, optional
        Settings as the camera spells them.
    black_level, white_level, camera_encoding : float or Encoding, optional
        See `choose_encoding`.
    retry_s : float
        Pause between attempts to reconnect a lost camera.
    listener : callable, optional
    """

    def __init__(
        self,
        port: str = "",
        *,
        count: int | None = None,
        shutterspeed: str | None = None,
        iso: str | None = None,
        aperture: str | None = None,
        black_level: float | None = None,
        white_level: float | None = None,
        camera_encoding: Encoding | None = None,
        retry_s: float = 1.0,
        listener: Listener | None = None,
    ) -> None:
        super().__init__(f"gphoto2:{port}" if port else "gphoto2", listener=listener)
        self._port, self._count, self._retry_s = port, count, retry_s
        self._settings = {"shutterspeed": shutterspeed, "iso": iso, "f-number": aperture}
        self._levels: dict[str, Any] = {"black_level": black_level, "white_level": white_level}
        self._levels["camera_encoding"] = camera_encoding
        self._camera: Any = None

    def open(self) -> None:
        """Connect to the camera and apply the settings."""
        gphoto2 = load_gphoto2()
        camera = gphoto2.Camera()
        try:
            if self._port:
                ports = gphoto2.PortInfoList()
                ports.load()
                camera.set_port_info(ports[ports.lookup_path(self._port)])
            camera.init()
            for name, value in self._settings.items():
                if value is not None:
                    widget = camera.get_single_config(name)
                    widget.set_value(str(value))
                    camera.set_single_config(name, widget)
        except gphoto2.GPhoto2Error as error:
            camera.exit()
            raise not_there(self.name, f"{error.string}; is it on, and not mounted by the desktop?") from None
        self._camera = camera

    def close(self) -> None:
        """Release the camera."""
        if self._camera is not None:
            self._camera.exit()
        self._camera = None

    def frames(self) -> Iterator[Frame]:
        """Take photographs; wait for a lost camera to return."""
        gphoto2 = load_gphoto2()
        index = 0
        with tempfile.TemporaryDirectory(prefix="chromaperture-") as folder:
            while self._count is None or index < self._count:
                try:
                    made = self._camera.capture(gphoto2.GP_CAPTURE_IMAGE)
                    path = Path(folder, made.name)
                    file = self._camera.file_get(made.folder, made.name, gphoto2.GP_FILE_TYPE_NORMAL)
                    file.save(str(path))
                except gphoto2.GPhoto2Error as error:
                    self.listener(Event("lost", f"{self.name} does not answer ({error.string}); looking for it again"))
                    self._reconnect()
                    continue
                counts, encoding, form = read_counts(path, **self._levels)
                path.unlink()
                yield Frame(counts, encoding, time.time(), index, {"file": made.name} | described(form))
                index += 1

    def _reconnect(self) -> None:
        while True:
            self.close()
            time.sleep(self._retry_s)
            try:
                self.open()
            except InputError:
                continue
            self.listener(Event("reconnected", f"{self.name} is back"))
            return


def tethered_cameras() -> list[str]:
    """List the ports of the cameras found by gphoto2."""
    found = load_gphoto2().Camera.autodetect()
    return [str(found.get_value(i)) for i in range(found.count())]
