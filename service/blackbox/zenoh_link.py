"""A box's link over Zenoh: a client of the service's router, there again whenever the router is."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Final

import zenoh

from schemas.keys import zenoh_prefix
from service.blackbox.box import Ack, LinkError, LinkListener, Outgoing
from service.ingest.zenoh_session import client_config, one_line, open_session

_OPEN_TIMEOUT_S: Final = 5.0


class ZenohLink:
    """Puts packets on the vehicle's key and listens for acknowledgements; holds its liveliness token."""

    def __init__(self, endpoint: str, tenant_id: str, vehicle_id: str) -> None:
        self._endpoint = endpoint
        self._prefix = zenoh_prefix(tenant_id, vehicle_id)
        self._listener: LinkListener | None = None
        self._session: zenoh.Session | None = None
        self._listened_to = False
        self._kept: list[object] = []  # declarations end with their objects
        self._usual: zenoh.Publisher | None = None
        self._urgent: zenoh.Publisher | None = None

    def open(self, listener: LinkListener) -> None:
        """Note whom to tell; the connection is made with the first packet."""
        self._listener = listener

    def send(self, packets: Sequence[Outgoing]) -> None:
        """Put packets; raises LinkError where no service listens, for what is put then is lost."""
        try:
            usual, urgent = self._publishers()
            if not self._listened_to:
                raise LinkError(f"no service takes packets at {self._endpoint}")
            for packet in packets:
                (urgent if packet.urgent else usual).put(packet.data, encoding="application/x-protobuf")
        except (zenoh.ZError, TimeoutError) as error:
            raise LinkError(f"{self._endpoint}: {one_line(error)}") from error

    def close(self) -> None:
        """Close; the service sees the box go."""
        if self._session is not None:
            self._session.close()  # type: ignore[no-untyped-call]
            self._session = None

    def _publishers(self) -> tuple[zenoh.Publisher, zenoh.Publisher]:
        if self._usual is not None and self._urgent is not None:
            return self._usual, self._urgent
        if self._session is None:
            self._session = open_session(client_config([self._endpoint]), _OPEN_TIMEOUT_S)
        session, key = self._session, f"{self._prefix}/telemetry"
        self._kept = [
            session.declare_subscriber(f"{self._prefix}/ack", self._on_ack),
            session.liveliness().declare_token(f"{self._prefix}/alive"),
        ]
        self._urgent = session.declare_publisher(
            key,
            congestion_control=zenoh.CongestionControl.BLOCK,
            reliability=zenoh.Reliability.RELIABLE,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
        )
        self._usual = session.declare_publisher(
            key, congestion_control=zenoh.CongestionControl.BLOCK, reliability=zenoh.Reliability.RELIABLE
        )
        self._kept.append(self._usual.declare_matching_listener(self._on_matching))
        return self._usual, self._urgent

    def _on_matching(self, status: zenoh.MatchingStatus) -> None:
        self._listened_to = status.matching
        if status.matching and self._listener is not None:
            self._listener.on_connected()

    def _on_ack(self, sample: zenoh.Sample) -> None:
        try:
            message = json.loads(sample.payload.to_bytes())
            refused = tuple((int(item["sequence"]), str(item["code"])) for item in message["refused"])
            ack = Ack(str(message["boot_id"]), int(message["sequence"]), refused, bool(message.get("gap")))
        except (ValueError, KeyError, TypeError):
            return  # not of a service that we know; silence brings the packets again
        if self._listener is not None:
            self._listener.on_ack(ack)
