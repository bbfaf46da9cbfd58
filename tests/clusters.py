"""Dask clusters of this machine: a scheduler and workers of one thread, in processes of their own."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path


class LocalCluster:
    """A scheduler and its workers, without nannies that start them again; ``close`` ends them all.

    Parameters
    ----------
    folder : Path
        Of the logs and of what Dask writes.
    workers : int
    tls : dict of str to Path
        Options of Dask's commands, such as ``{"tls-ca-file": ...}``; no encryption when empty.
    **environment
        Of the scheduler.
    """

    def __init__(
        self, folder: Path, *, workers: int = 2, tls: dict[str, Path] | None = None, **environment: str
    ) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.folder, self.started = folder, list[subprocess.Popen]()
        self.common = ["--no-dashboard", *(part for name, path in (tls or {}).items() for part in (f"--{name}", path))]
        self.address = f"{'tls' if tls else 'tcp'}://127.0.0.1:{self.port}"
        host = ["--host", f"{'tls' if tls else 'tcp'}://127.0.0.1", "--port", str(self.port)]
        self.scheduler = self.start("dask_scheduler", *host, *self.common, **environment)
        self.workers = [self.add_worker() for _ in range(workers)]

    def add_worker(self, **environment: str) -> subprocess.Popen:
        options = [self.address, "--no-nanny", "--nthreads", "1", "--local-directory", self.folder / "dask"]
        return self.start("dask_worker", *options, *self.common, **environment)

    def start(self, module: str, *arguments: object, **environment: str) -> subprocess.Popen:
        command = [sys.executable, "-m", f"distributed.cli.{module}", *map(str, arguments)]
        paths = {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
        with (self.folder / f"{module}-{len(self.started)}.log").open("wb") as log:
            process = subprocess.Popen(command, stdout=log, stderr=log, env=os.environ | paths | environment)
        self.started.append(process)
        return process

    def close(self) -> None:
        for process in self.started:
            process.kill()
            process.wait()


def sleep_or_die(task: str, seconds: float) -> str:
    """A task for workers: ``poison`` ends its worker as the system does for lack of memory."""
    time.sleep(seconds)
    if task == "poison":
        os.kill(os.getpid(), signal.SIGKILL)
    return task
