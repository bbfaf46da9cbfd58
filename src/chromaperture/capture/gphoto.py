"""A tethered DSLR through gphoto2: every frame is a photograph taken on request, not a live view."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from chromaperture.capture.files import read_counts
from chromaperture.capture.picture_format import described
from chromaperture.capture.source import Frame, PictureSource
from chromaperture.capture.threaded_source import not_there
from chromaperture.system.errors import InputError, needed

_HINT = "tethered cameras need gphoto2: pip install 'chromaperture[cameras]'"


@dataclass(kw_only=True, eq=False)
class TetheredCamera(PictureSource):
    """Take a photograph for each frame; the place is a port of `gphoto2 --auto-detect`, or empty."""

    kind = "gphoto2"

    count: int | None = None  # of photographs; unlimited when absent
    shutterspeed: str | None = None
    iso: str | None = None
    aperture: str | None = None
    retry_s: float = 1.0  # between attempts to reconnect a lost camera

    def __post_init__(self) -> None:
        self._camera: Any = None

    def open(self) -> None:
        """Connect to the camera and apply the settings."""
        gphoto2 = needed("gphoto2", _HINT)
        camera = gphoto2.Camera()
        try:
            if self.place:
                ports = gphoto2.PortInfoList()
                ports.load()
                camera.set_port_info(ports[ports.lookup_path(self.place)])
            camera.init()
            settings = {"shutterspeed": self.shutterspeed, "iso": self.iso, "f-number": self.aperture}
            for name, value in settings.items():
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
        gphoto2 = needed("gphoto2", _HINT)
        index = 0
        with tempfile.TemporaryDirectory(prefix="chromaperture-") as folder:
            while self.count is None or index < self.count:
                try:
                    made = self._camera.capture(gphoto2.GP_CAPTURE_IMAGE)
                    path = Path(folder, made.name)
                    file = self._camera.file_get(made.folder, made.name, gphoto2.GP_FILE_TYPE_NORMAL)
                    file.save(str(path))
                except gphoto2.GPhoto2Error as error:
                    self.report("lost", f"{self.name} does not answer ({error.string}); looking for it again")
                    self._reconnect()
                    continue
                counts, encoding, form = read_counts(path, **self.levels)
                path.unlink()
                yield Frame(counts, encoding, time.time(), index, {"file": made.name} | described(form))
                index += 1

    def _reconnect(self) -> None:
        while True:
            self.close()
            time.sleep(self.retry_s)
            try:
                self.open()
            except InputError:
                continue
            self.report("reconnected", f"{self.name} is back")
            return


def tethered_cameras() -> list[str]:
    """List the ports of the cameras found by gphoto2."""
    found = needed("gphoto2", _HINT).Camera.autodetect()
    return [str(found.get_value(i)) for i in range(found.count())]
