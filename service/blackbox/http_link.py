"""A box's link over HTTP: what is under way goes in one request, and its answer is the acknowledgement."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import httpx

from service.blackbox.box import Ack, LinkError, LinkListener, Outgoing

_TIMEOUT_S: Final = 15.0
_FINAL: Final = frozenset({400, 401, 403, 404, 405, 413, 415})  # asking again brings the same answer


class HttpLink:
    """Posts packets to a service at ``base_url``; ``token`` is an API key with the scope telemetry:write."""

    def __init__(self, base_url: str, token: str | None = None) -> None:
        headers = {"Content-Type": "application/x-protobuf"}
        if token is not None:
            headers["Authorization"] = f"Bearer {token}"
        self._url = f"{base_url.rstrip('/')}/v1/telemetry"
        self._client = httpx.Client(headers=headers, timeout=_TIMEOUT_S)
        self._listener: LinkListener | None = None

    def open(self, listener: LinkListener) -> None:
        """Note whom to tell."""
        self._listener = listener

    def send(self, packets: Sequence[Outgoing]) -> None:
        """Post packets and pass the answer on; raises LinkError where there was none, or no good one."""
        body = b"".join(_varint(len(packet.data)) + packet.data for packet in packets)
        try:
            response = self._client.post(self._url, content=body)
        except httpx.HTTPError as error:
            raise LinkError(f"{self._url}: {error or type(error).__name__}") from error
        if response.status_code != httpx.codes.ACCEPTED:
            message = f"{self._url} answers {response.status_code}: {_detail(response)}"
            raise LinkError(message, final=response.status_code in _FINAL)
        assert self._listener is not None
        for ack in _acks(response):
            self._listener.on_ack(ack)

    def close(self) -> None:
        """Close the connection."""
        self._client.close()


def _acks(response: httpx.Response) -> list[Ack]:
    try:
        answer = response.json()
        refused = [(str(item["boot_id"]), int(item["sequence"]), str(item["code"])) for item in answer["refused"]]
        durable = {str(item["boot_id"]): int(item["sequence"]) for item in answer["durable"]}
    except (ValueError, KeyError, TypeError) as error:
        raise LinkError(f"{response.url} answers what no telefuse service says") from error
    boots = {**{boot_id: 0 for boot_id, _, _ in refused}, **durable}
    return [
        Ack(boot_id, sequence, tuple((number, code) for of_boot, number, code in refused if of_boot == boot_id))
        for boot_id, sequence in boots.items()
    ]


def _detail(response: httpx.Response) -> str:
    try:
        return str(response.json()["detail"])
    except (ValueError, KeyError, TypeError):
        return response.reason_phrase


def _varint(value: int) -> bytes:
    encoded = bytearray()
    while value > 0x7F:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    encoded.append(value)
    return bytes(encoded)
