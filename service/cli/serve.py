"""``telefuse serve``: the service, until it is told to stop."""

from __future__ import annotations

import argparse
import gc
import logging
import signal
import socket
from pathlib import Path
from types import FrameType
from typing import Final

import uvicorn
from fastapi import FastAPI

from service import settings
from service.app import create_app
from service.errors import ServiceError, UsageError
from service.observability import configure_logging
from service.runtime import Runtime
from service.settings import Settings

BACKLOG: Final = 2048
"""Connections that may wait to be taken."""

GRACEFUL_S: Final = 20
"""How long requests under way may take when the service stops, before their connections are closed."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Flags: one a setting."""
    parser.add_argument("--print-settings", action="store_true", help="show every setting with its source, and end")
    settings.add_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Serve until SIGTERM or SIGINT; then finish what was begun and end with 0."""
    loaded = settings.from_arguments(arguments)
    if arguments.print_settings:
        print(settings.describe(loaded))
        return 0
    configure_logging(loaded.settings.log_level)
    serve(loaded.settings)
    return 0


def serve(chosen: Settings) -> None:
    """Run the service; raises ServiceError where it cannot start."""
    listener = _listen(chosen.http_host, chosen.http_port)
    app = create_app(chosen, Runtime(chosen))
    server = _Server(server_config(app), chosen)
    # uvicorn stops at a signal and then raises it again for whoever handled it before: that it was asked to
    # stop and did is no failure, so nobody should.
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, _ignore)
    # What the operator can put right is said once, in one line, without uvicorn's traceback.
    logging.getLogger("uvicorn.error").addFilter(lambda _: not isinstance(_startup_error(app), ServiceError))
    try:
        server.run(sockets=[listener])
    except SystemExit:
        if server.started:
            raise
    finally:
        listener.close()
    if not server.started:
        error = _startup_error(app)
        if isinstance(error, ServiceError):
            raise error
        raise UsageError(f"the service could not start: {error or 'the log says why'}")


def server_config(app: FastAPI) -> uvicorn.Config:
    """How the application is served."""
    return uvicorn.Config(
        app,
        http="httptools",
        loop="uvloop",
        lifespan="on",
        log_config=None,
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=GRACEFUL_S,
    )


def _startup_error(app: FastAPI) -> Exception | None:
    return getattr(app.state, "startup_error", None)


class _Server(uvicorn.Server):
    """Says where it listens once it does."""

    def __init__(self, config: uvicorn.Config, chosen: Settings) -> None:
        super().__init__(config)
        self._chosen = chosen

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start, then print the addresses."""
        await super().startup(sockets)
        if not self.started or not sockets:
            return
        # Hundreds of thousands of objects of modules and compiled code live as long as the process: looked through by
        # the garbage collector, they stopped everything for 80 ms at a time.
        gc.collect()
        gc.freeze()
        host, port = sockets[0].getsockname()[:2]
        base = f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
        lines = [f"telefuse serves {base}/v1", f"  reference  {base}/docs", f"  metrics    {base}/metrics"]
        if self._chosen.zenoh_mode in ("router", "peer"):
            lines.append(f"  zenoh      {' '.join(self._chosen.zenoh_listen)} ({self._chosen.zenoh_mode})")
        elif self._chosen.zenoh_mode == "client":
            lines.append(f"  zenoh      {' '.join(self._chosen.zenoh_connect)} (client)")
        lines.append(f"  data       {Path(self._chosen.data_dir).resolve()}")
        print("\n".join(lines), flush=True)


def _listen(host: str, port: int) -> socket.socket:
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family, backlog=BACKLOG)
    except OSError as error:
        raise UsageError(
            f"cannot listen on http_host {host}, http_port {port}: {error.strerror or error}; choose another port, "
            "or 0 for a free one"
        ) from error


def _ignore(_number: int, _frame: FrameType | None) -> None:
    return
