"""A service of one's own: ``telefuse serve`` as a process beside this one, on loopback and a given data directory."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Final

import httpx

import service
from service.errors import ServiceError
from service.settings import ENV_PREFIX, Settings

READY_S: Final = 120.0
"""How long a start may take; on a machine that has never run it the filter is compiled first, some 20 s."""

STOP_S: Final = 45.0
POLL_S: Final = 0.05

_COMMAND: Final = "import sys; from service.cli import main; sys.exit(main())"
_LOG_TAIL: Final = 5


class ServiceFailedError(ServiceError):
    """The service did not start, or is gone."""

    code = "service_failed"


class ServiceProcess:
    """Starts, watches and ends one service. Its settings are flags alone: neither environment nor file weighs in."""

    def __init__(self, data_dir: Path, http_port: int, zenoh_port: int, **settings: str) -> None:
        self.data_dir = data_dir.resolve()
        self.http_url = f"http://127.0.0.1:{http_port}"
        self.zenoh_endpoint = f"tcp/127.0.0.1:{zenoh_port}"
        self.log_path = self.data_dir / "service.log"
        self._flags = {
            "data_dir": str(self.data_dir),
            "http_port": str(http_port),
            "zenoh_listen": self.zenoh_endpoint,
            "auth": "off",
            **settings,
        }
        self._process: subprocess.Popen[bytes] | None = None

    def start(self, ready_s: float = READY_S) -> None:
        """Start it and wait until it is ready; raises ServiceFailedError."""
        self.data_dir.mkdir(parents=True, exist_ok=True)
        flags = [word for name, value in self._flags.items() for word in (f"--{name.replace('_', '-')}", value)]
        environment = {name: value for name, value in os.environ.items() if not name.startswith(ENV_PREFIX)}
        sources = str(Path(service.__file__).resolve().parent.parent)
        environment["PYTHONPATH"] = os.pathsep.join(filter(None, [sources, environment.get("PYTHONPATH")]))
        with self.log_path.open("ab") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-c", _COMMAND, "serve", *flags],
                cwd=self.data_dir,  # so that no telefuse.toml of the caller's directory is read
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )
        deadline = time.monotonic() + ready_s
        with httpx.Client(base_url=self.http_url, timeout=2.0, trust_env=False) as client:
            while not _is_ready(client):
                if self._process.poll() is not None:
                    raise ServiceFailedError(
                        f"the service ended with status {self._process.returncode}: {self._tail()}"
                    )
                if time.monotonic() > deadline:
                    self.kill()
                    raise ServiceFailedError(f"the service was not ready within {ready_s:g} s: {self._tail()}")
                time.sleep(POLL_S)

    def stop(self) -> int:
        """Ask it to finish and wait; returns its exit status, 0 for a clean end."""
        if self._process is None:
            return 0
        self._process.terminate()
        try:
            return self._process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            self.kill()
            return self._process.wait()

    def kill(self) -> None:
        """End it at once, as a power cut would."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def wait(self) -> int:
        """Wait until it ends by itself; returns its exit status."""
        return 0 if self._process is None else self._process.wait()

    def _tail(self) -> str:
        lines = self.log_path.read_text(errors="replace").splitlines()
        return " | ".join(lines[-_LOG_TAIL:]) or f"it said nothing in {self.log_path}"


def _is_ready(client: httpx.Client) -> bool:
    try:
        return client.get("/readyz").status_code == httpx.codes.OK
    except httpx.HTTPError:
        return False


def free_port(preferred: int = 0) -> int:
    """A port on loopback on which nobody listens: the preferred one, if it is free."""
    for port in (preferred, 0):
        try:
            with socket.create_server(("127.0.0.1", port)) as listener:
                return int(listener.getsockname()[1])
        except OSError:
            continue
    raise ServiceFailedError("there is no free port on 127.0.0.1")


def default_ports() -> tuple[int, int]:
    """The service's usual HTTP and Zenoh ports where they are free, else others."""
    usual = Settings()
    return free_port(usual.http_port), free_port(int(usual.zenoh_listen[0].rpartition(":")[2]))
