"""A tethered DSLR through gphoto2: every frame asked for is a photograph taken, so nothing is live."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from chromaperture.capture.files import read_counts
from chromaperture.capture.source import Event, FileSource, Frame, Listener
from chromaperture.capture.threaded_source import not_there
from chromaperture.errors import InputError, MissingDependencyError


def load_gphoto2() -> Any:
    """Import gphoto2; raises MissingDependencyError naming the extra."""
    try:
        import gphoto2
    except ImportError:
        raise MissingDependencyError("tethered cameras need gphoto2: pip install 'chromaperture[cameras]'") from None
    return gphoto2


class TetheredCamera(FileSource):
    """Take a photograph whenever a frame is asked for; RAW files become half-size superpixels.

    Parameters
    ----------
    port : str
        As `gphoto2 --auto-detect` shows it; empty for the first camera.
    count : int, optional
        Photographs to take; without end when absent.
    shutterspeed, iso, aperture : str, optional
        Settings in the camera's own words.
    black_level, white_level : float, optional
    retry_s : float
        Pause between two attempts to find a lost camera again.
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
        retry_s: float = 1.0,
        listener: Listener | None = None,
    ) -> None:
        super().__init__(f"gphoto2:{port}" if port else "gphoto2", listener=listener)
        self._port, self._count, self._retry_s = port, count, retry_s
        self._settings = {"shutterspeed": shutterspeed, "iso": iso, "f-number": aperture}
        self._levels = {"black_level": black_level, "white_level": white_level}
        self._camera: Any = None

    def open(self) -> None:
        """Connect and set what was asked for."""
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
        """Let the camera go."""
        if self._camera is not None:
            self._camera.exit()
        self._camera = None

    def frames(self) -> Iterator[Frame]:
        """Take photographs; a camera that went away is waited for."""
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
                counts, encoding = read_counts(path, **self._levels)
                path.unlink()
                yield Frame(counts, encoding, time.time(), index, {"file": made.name})
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
    """List the ports of the cameras gphoto2 sees."""
    found = load_gphoto2().Camera.autodetect()
    return [str(found.get_value(i)) for i in range(found.count())]
