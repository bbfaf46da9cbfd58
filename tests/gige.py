"""A GigE Vision camera on the loopback interface: that of Debian's aravis-tools, alone or behind a line with faults.

The camera itself drops packets by chance, and never sends one again. Behind `Line` it does: the line keeps what the
camera sent, loses packets by a sequence of its own, and answers requests for them.
"""

from __future__ import annotations

import random
import re
import selectors
import shutil
import socket
import struct
import subprocess
import tempfile
import threading
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Self

PROGRAM = shutil.which("arv-fake-gv-camera-0.8")
CAMERA, LINE, GVCP = "127.0.0.1", "127.0.0.2", 3956
READ_REGISTER, WRITE_REGISTER, RESEND = 0x80, 0x82, 0x40
LEADER, TRAILER = 1, 2
HOST_PORT, HOST_ADDRESS, CAPABILITIES, CAN_RESEND = 0xD00, 0xD18, 0x934, 1 << 2
KEPT = 20_000  # packets that can be sent again


class EmulatedCamera:
    """The running camera."""

    def __init__(self, *, lost_per_thousand: int = 0, genicam: Path | None = None) -> None:
        self._options = ["-r", str(lost_per_thousand), *(["-g", str(genicam)] if genicam else [])]

    def __enter__(self) -> Self:
        self._log = tempfile.NamedTemporaryFile("w+", suffix=".log")
        self._start()
        return self

    def _start(self) -> None:
        # Line by line, or what it says last is lost when it is killed; 2: information.
        command = ["stdbuf", "-oL", PROGRAM, "-i", "lo", *self._options, "-d", "stream-thread:2"]
        self._process = subprocess.Popen(command, stdout=self._log, stderr=self._log)

    def __exit__(self, *error: object) -> None:
        self.stop()
        self._log.close()

    def stop(self) -> None:
        """End it, as if its plug was pulled."""
        self._process.kill()
        self._process.wait()

    def restart(self) -> None:
        """Switch it on again."""
        self._start()

    @property
    def sent(self) -> list[int]:
        """Numbers of the frames that it says it has sent, whole or not."""
        return [int(number) for number in re.findall(r"Send frame (\d+)", Path(self._log.name).read_text())]

    @property
    def broken(self) -> set[int]:
        """Numbers of those of which it says it has dropped packets."""
        return {int(number) for number in re.findall(r"Drop GVSP.* frame: ?(\d+)", Path(self._log.name).read_text())}


class Line:
    """Between the camera and who opens the address `LINE`: it loses packets, and sends them again if asked.

    ``swallowed`` says which frames are lost as a whole, ``packets`` cuts frames off, ``device_time_ns`` is the time of
    the camera's clock in all of them.
    """

    def __init__(
        self,
        *,
        lost_per_thousand: float = 0,
        swallowed: Callable[[int], bool] = lambda number: False,
        packets: int | None = None,
        device_time_ns: int | None = None,
    ) -> None:
        self._lost, self._random = lost_per_thousand / 1000, random.Random(0)
        self._swallowed, self._packets, self._device_time_ns = swallowed, packets, device_time_ns
        self._kept: OrderedDict[tuple[int, int], bytes] = OrderedDict()
        self._program: tuple[str, int] | None = None
        self._host, self._host_port = "", 0
        self.sent: list[int] = []  # numbers of the frames that the camera has sent
        self.asked = 0
        self._leave = threading.Event()

    def __enter__(self) -> Self:
        def bound(address: str, port: int = 0) -> socket.socket:
            made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
            made.bind((address, port))
            return made

        self._near, self._far, self._stream = bound(LINE, GVCP), bound(CAMERA), bound(CAMERA)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._leave.set()
        self._thread.join()
        for each in (self._near, self._far, self._stream):
            each.close()

    def stray(self) -> None:
        """Send the program a packet that is no part of a frame."""
        self._near.sendto(bytes(64), (self._host, self._host_port))

    def _run(self) -> None:
        with selectors.DefaultSelector() as waiting:
            for each, taken in (self._near, self._command), (self._far, self._answer), (self._stream, self._packet):
                each.setblocking(False)
                waiting.register(each, selectors.EVENT_READ, taken)
            while not self._leave.is_set():
                for key, _ in waiting.select(0.1):
                    try:
                        while True:
                            key.data(*key.fileobj.recvfrom(65536))
                    except BlockingIOError:
                        pass

    def _command(self, packet: bytes, sender: tuple[str, int]) -> None:
        kind = struct.unpack_from(">H", packet, 2)[0]
        if kind == RESEND:
            number, first, last = struct.unpack_from(">III", packet, 8)
            self.asked += last - first + 1
            for i in range(first, last + 1):
                if kept := self._kept.get((number & 0xFFFF, i)):
                    self._pass_on(kept)
            return
        self._program = sender
        if kind == WRITE_REGISTER:
            register, value = struct.unpack_from(">II", packet, 8)
            if register == HOST_PORT:
                self._host_port, value = value, self._stream.getsockname()[1]
            elif register == HOST_ADDRESS:
                self._host, value = socket.inet_ntoa(packet[12:16]), struct.unpack(">I", socket.inet_aton(CAMERA))[0]
            packet = packet[:8] + struct.pack(">II", register, value)
        self._reads_capabilities = kind == READ_REGISTER and struct.unpack_from(">I", packet, 8)[0] == CAPABILITIES
        self._far.sendto(packet, (CAMERA, GVCP))

    def _answer(self, packet: bytes, sender: tuple[str, int]) -> None:
        if self._reads_capabilities:
            packet = packet[:8] + struct.pack(">I", struct.unpack_from(">I", packet, 8)[0] | CAN_RESEND)
        self._near.sendto(packet, self._program)

    def _packet(self, packet: bytes, sender: tuple[str, int]) -> None:
        number, kind = struct.unpack_from(">HB", packet, 2)
        i = struct.unpack_from(">I", packet, 4)[0] & 0xFFFFFF
        if kind == LEADER:
            self.sent.append(number)
            if self._device_time_ns is not None:
                packet = packet[:12] + struct.pack(">Q", self._device_time_ns) + packet[20:]
        if self._packets is not None and i > self._packets:
            if kind != TRAILER:
                return
            packet = packet[:4] + struct.pack(">I", kind << 24 | self._packets + 1) + packet[8:]
        if self._swallowed(number):
            return
        self._kept[number, i] = packet
        if len(self._kept) > KEPT:
            self._kept.popitem(last=False)
        self._pass_on(packet)

    def _pass_on(self, packet: bytes) -> None:
        if self._random.random() >= self._lost:
            self._near.sendto(packet, (self._host, self._host_port))
