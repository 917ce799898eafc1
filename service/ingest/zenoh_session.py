"""Opening Zenoh: configurations for the service and for a box, and an opening that cannot hang."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import zenoh

from service.errors import UsageError
from service.settings import Settings

OPEN_TIMEOUT_S: Final = 10.0
"""Opening takes half a second; where it hangs (an unreachable endpoint, say) it is given up after this."""

MAX_SESSIONS: Final = 20_000
"""Boxes that a router lets in; Zenoh's own default is 1000."""

MAX_MESSAGE_BYTES: Final = 16 * 2**20
"""What a box can make a router hold of one message; far above a packet's limit, which is answered with a reason."""

_RECONNECT: Final = {"period_init_ms": 200, "period_max_ms": 2000, "period_increase_factor": 2}


def service_config(settings: Settings) -> tuple[zenoh.Config, tuple[str, ...]]:
    """The service's configuration and the endpoints that it listens on; port 0 becomes a free port."""
    config = zenoh.Config() if settings.zenoh_config is None else _read_config(settings.zenoh_config)
    listen = (
        tuple(_with_port(endpoint) for endpoint in settings.zenoh_listen) if settings.zenoh_mode != "client" else ()
    )
    # Without shared memory: Zenoh 1.10 has counters for some 350 sessions of one machine and refuses the next.
    values: dict[str, Any] = {
        "mode": settings.zenoh_mode,
        "connect/endpoints": list(settings.zenoh_connect),
        "connect/retry": _RECONNECT,
        "scouting/multicast/enabled": False,
        "transport/unicast/max_sessions": MAX_SESSIONS,
        "transport/shared_memory/enabled": False,
        "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
    }
    if settings.zenoh_mode != "client":
        values["listen/endpoints"] = list(listen)
    if settings.zenoh_mode == "router":
        # The routers that it joins may start later than it does.
        values |= {"connect/timeout_ms": 0, "connect/exit_on_failure": False}
    return _insert(config, values), listen


def client_config(endpoints: Sequence[str]) -> zenoh.Config:
    """A box's configuration: it reaches the service by these endpoints and comes back when they do."""
    return _insert(
        zenoh.Config(),
        {
            "mode": "client",
            "connect/endpoints": list(endpoints),
            "connect/retry": _RECONNECT,
            "scouting/multicast/enabled": False,
            # Each box on the service's own machine would take one of its few hundred counters.
            "transport/shared_memory/enabled": False,
        },
    )


def open_session(config: zenoh.Config, timeout_s: float = OPEN_TIMEOUT_S) -> zenoh.Session:
    """Open a session; raises zenoh.ZError, or TimeoutError where Zenoh would wait for longer."""
    result: list[zenoh.Session | BaseException] = []
    abandoned = threading.Event()

    def attempt() -> None:
        try:
            session = zenoh.open(config)
        except BaseException as error:
            result.append(error)
            return
        result.append(session)
        if abandoned.is_set():
            session.close()  # type: ignore[no-untyped-call]

    thread = threading.Thread(target=attempt, name="zenoh-open", daemon=True)
    thread.start()
    thread.join(timeout_s)
    if not result:
        abandoned.set()
        raise TimeoutError(f"Zenoh did not open within {timeout_s:g} s")
    if isinstance(result[0], BaseException):
        raise result[0]
    return result[0]


def one_line(error: BaseException) -> str:
    """An error of Zenoh without the place in its sources that it adds."""
    return " ".join(str(error).partition(" at /")[0].split()).rstrip("!")


def _read_config(path: Path) -> zenoh.Config:
    try:
        return zenoh.Config.from_file(str(path))
    except zenoh.ZError as error:
        raise UsageError(f"setting zenoh_config: {path}: {one_line(error)}") from error


def _insert(config: zenoh.Config, values: Mapping[str, Any]) -> zenoh.Config:
    for key, value in values.items():
        config.insert_json5(key, json.dumps(value))
    return config


def _with_port(endpoint: str) -> str:
    """A TCP endpoint with a free port in the place of 0; Zenoh would take one without saying which."""
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    if protocol != "tcp" or port != "0":
        return endpoint
    with socket.create_server(
        (host.strip("[]"), 0), family=socket.AF_INET6 if "[" in host else socket.AF_INET
    ) as server:
        return f"tcp/{host}:{server.getsockname()[1]}"
