"""A receiver of webhooks on loopback, as an insurer would run one: it verifies each message before it believes it."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Final

TOLERANCE_S: Final = 300
"""Age beyond which a signed message is not believed (Standard Webhooks recommends five minutes)."""


@dataclass(frozen=True, slots=True)
class Received:
    """One request: its webhook id, when it came, whether its signature holds, and what it says."""

    id: str
    arrived_ns: int
    verified: bool
    message: Mapping[str, Any]


def verify(secret: str, headers: Mapping[str, str], body: bytes, now_s: float) -> bool:
    """Whether a message is signed with ``secret`` and fresh, by the public Standard Webhooks algorithm.

    Written from the specification and apart from the sender, so that it can find the sender wrong.
    """
    try:
        webhook_id, timestamp = headers["webhook-id"], headers["webhook-timestamp"]
        if abs(now_s - int(timestamp)) > TOLERANCE_S:
            return False
        signatures = headers["webhook-signature"].split(" ")
    except (KeyError, ValueError):
        return False
    key = base64.b64decode(secret.removeprefix("whsec_"))
    digest = hmac.digest(key, f"{webhook_id}.{timestamp}.".encode() + body, hashlib.sha256)
    expected = "v1," + base64.b64encode(digest).decode()
    return any(hmac.compare_digest(expected.encode(), signature.encode()) for signature in signatures)


class AlertReceiver:
    """``with AlertReceiver() as receiver``: answers every post with 204 and keeps what came."""

    def __init__(self) -> None:
        self.secret = ""
        self._received: list[Received] = []
        self._changed = threading.Condition()
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), _handler(self))
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, name="alert-receiver", daemon=True)

    @property
    def url(self) -> str:
        """Where it listens."""
        return f"http://127.0.0.1:{self._server.server_address[1]}/alerts"

    def __enter__(self) -> AlertReceiver:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()

    def take(self, headers: Mapping[str, str], body: bytes) -> None:
        """Verify and keep one message."""
        now_ns = time.time_ns()
        verified = verify(self.secret, headers, body, now_ns * 1e-9)
        message = json.loads(body) if verified else {}
        with self._changed:
            self._received.append(Received(headers.get("webhook-id", ""), now_ns, verified, message))
            self._changed.notify_all()

    def wait_until(self, enough: Callable[[list[Received]], bool], timeout_s: float) -> list[Received]:
        """What came, once that is enough or the time is over."""
        with self._changed:
            self._changed.wait_for(lambda: enough(self._received), timeout_s)
            return list(self._received)


def _handler(receiver: AlertReceiver) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_POST(self) -> None:
            length = int(self.headers.get("Content-Length", 0))
            body = self.rfile.read(length)
            if len(body) < length:  # the sender went away in the midst of it: no request, and nobody to answer
                self.close_connection = True
                return
            receiver.take({name.lower(): value for name, value in self.headers.items()}, body)
            self.send_response(204)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            return

    return Handler
