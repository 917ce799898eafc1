"""A real HTTP receiver of webhooks on loopback whose answers are scripted, for tests."""

from __future__ import annotations

import json
import socket
import ssl
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from standardwebhooks import Webhook


@dataclass(frozen=True)
class Answer:
    """How one request is answered. ``until`` holds the answer back until the event is set."""

    status: int = 204
    headers: dict[str, str] = field(default_factory=dict)
    body: bytes = b""
    until: threading.Event | None = None
    drip_s: float | None = None
    """Send the body for ever, a byte each so many seconds, until the sender hangs up."""
    drip_headers: bool = False
    """The same, with header bytes: no status is ever finished."""


@dataclass(frozen=True)
class Received:
    path: str
    headers: dict[str, str]
    body: bytes
    peer: tuple[str, int]

    @property
    def id(self) -> str:
        return self.headers["webhook-id"]

    @property
    def message(self) -> dict:
        return json.loads(self.body)

    def verify(self, secret: str) -> dict:
        """The message, if its signature holds by the public package (raises where not)."""
        return Webhook(secret).verify(self.body, self.headers)


class WebhookReceiver:
    """``with WebhookReceiver() as receiver``: collects requests; ``answers`` are used up first, then ``default``."""

    def __init__(self, tls: ssl.SSLContext | None = None, port: int = 0) -> None:
        self.default = Answer()
        self.answers: deque[Answer] = deque()
        self.requests: list[Received] = []
        self.connections = 0
        self.hung_up = threading.Event()
        """Set when a sender closed the connection on a dripping answer."""
        self._changed = threading.Condition()
        self._server = ThreadingHTTPServer(("127.0.0.1", port), self._handler())
        self._server.daemon_threads = True
        self._scheme = "http"
        if tls is not None:
            self._server.socket = tls.wrap_socket(self._server.socket, server_side=True)
            self._scheme = "https"
        self.port: int = self._server.server_address[1]

    def url(self, path: str = "/hook", host: str = "127.0.0.1") -> str:
        return f"{self._scheme}://{host}:{self.port}{path}"

    def wait_for(self, count: int, timeout_s: float = 10.0) -> list[Received]:
        """The requests, once there are ``count`` of them."""
        with self._changed:
            if not self._changed.wait_for(lambda: len(self.requests) >= count, timeout_s):
                raise AssertionError(f"{len(self.requests)} of {count} requests came within {timeout_s} s")
            return list(self.requests)

    def __enter__(self) -> WebhookReceiver:
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.02,), daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def _next_answer(self, received: Received) -> Answer:
        with self._changed:
            self.requests.append(received)
            self._changed.notify_all()
            return self.answers.popleft() if self.answers else self.default

    def _handler(receiver) -> type[BaseHTTPRequestHandler]:
        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"
            disable_nagle_algorithm = True

            def setup(self) -> None:
                receiver.connections += 1
                super().setup()

            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                headers = {name.lower(): value for name, value in self.headers.items()}
                answer = receiver._next_answer(Received(self.path, headers, body, self.client_address))
                if answer.until is not None and not answer.until.wait(30):
                    return None
                if answer.drip_headers:
                    self.wfile.write(b"HTTP/1.1 200 OK\r\nX-Slow: ")
                    return self._drip(answer.drip_s or 0.01)
                self.send_response(answer.status)
                for name, value in answer.headers.items():
                    self.send_header(name, value)
                if answer.drip_s is not None:
                    self.send_header("Content-Length", "1000000")
                    self.end_headers()
                    return self._drip(answer.drip_s)
                if answer.status != 204:
                    self.send_header("Content-Length", str(len(answer.body)))
                self.end_headers()
                self.wfile.write(answer.body)
                return None

            def _drip(self, every_s: float) -> None:
                self.close_connection = True
                try:
                    while True:
                        self.wfile.write(b"x")
                        self.wfile.flush()
                        time.sleep(every_s)
                except OSError:
                    receiver.hung_up.set()

            def log_message(self, *_: object) -> None:
                pass

        return Handler


def closed_port() -> int:
    """A loopback port on which nobody listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
