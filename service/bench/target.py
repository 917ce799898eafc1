"""The service under load as its callers see it: over HTTP only, be it our own or one that runs already."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import httpx

from schemas.times import parse_time
from service.blackbox.box import Link
from service.blackbox.http_link import HttpLink
from service.blackbox.zenoh_link import ZenohLink
from service.errors import ServiceError
from service.storage.tenants import DEFAULT_TENANT

MOUNTING: Final = {"mounting_rpy_deg": [0.0, 0.0, 0.0]}
"""The simulated boxes are fitted straight."""

REFUSED_WEBHOOK: Final = "webhook_target_refused"
TIMEOUT_S: Final = 30.0
PAGE: Final = 100


class TargetFailedError(ServiceError):
    """The service under load did not do what was asked of it."""

    code = "target_failed"


@dataclass(frozen=True, slots=True)
class Address:
    """Where a service is: HTTP address, Zenoh endpoint (None: packets go over HTTP), and an API key if it needs one."""

    http_url: str
    zenoh_endpoint: str | None = None
    token: str | None = None

    def link(self, vehicle_id: str) -> Link:
        """A box's way to it."""
        if self.zenoh_endpoint is None:
            return HttpLink(self.http_url, self.token)
        return ZenohLink(self.zenoh_endpoint, DEFAULT_TENANT, vehicle_id)


@dataclass(frozen=True, slots=True)
class Counts:
    """Packets that were made durable, each copy of one, and packets that were fused and stored."""

    accepted: int
    fused: int

    def since(self, before: Counts) -> Counts:
        """What was added since then."""
        return Counts(self.accepted - before.accepted, self.fused - before.fused)


class Target:
    """``with Target(address) as target``: sets up what a test needs, reads what came of it, and removes it again."""

    def __init__(self, address: Address) -> None:
        self.address = address
        headers = {} if address.token is None else {"Authorization": f"Bearer {address.token}"}
        self._client = httpx.Client(base_url=address.http_url, headers=headers, timeout=TIMEOUT_S, trust_env=False)
        self._made: list[str] = []

    def __enter__(self) -> Target:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            for path in self._made:
                self._ask("DELETE", path)
        except TargetFailedError:
            if kind is None:  # else it would hide what went wrong first
                raise
        finally:
            self._client.close()

    def register(self, vehicle_ids: Sequence[str]) -> None:
        """Register the test's vehicles."""
        for vehicle_id in vehicle_ids:
            path = f"/v1/vehicles/{vehicle_id}"
            self._ask("PUT", path, {"config": MOUNTING})
            self._made.append(path)

    def listen(self, url: str) -> str | None:
        """Have accidents told to ``url``; the secret, or None where the service sends nothing to private addresses."""
        settings = {"url": url, "description": "telefuse bench", "types": ["accident.detected"]}
        try:
            endpoint = self._ask("POST", "/v1/webhook-endpoints", settings).json()
        except TargetFailedError as error:
            if error.extra.get("problem") == REFUSED_WEBHOOK:
                return None
            raise
        self._made.insert(0, f"/v1/webhook-endpoints/{endpoint['id']}")
        secret: str = endpoint["secret"]
        return secret

    def counts(self) -> Counts:
        """How many packets the service has taken and fused since it started."""
        values = dict(line.rpartition(" ")[::2] for line in self._ask("GET", "/metrics").text.splitlines())
        try:
            return Counts(*(round(float(values[f"telefuse_packets_{name}_total"])) for name in ("accepted", "fused")))
        except (KeyError, ValueError) as error:
            raise TargetFailedError(
                f"{self.address.http_url}/metrics has no telefuse_packets_…: is it a telefuse service?"
            ) from error

    def accidents(self, vehicle_ids: Sequence[str]) -> dict[str, int]:
        """When the packet that decided each accident of these vehicles was received, UTC nanoseconds."""
        found: dict[str, int] = {}
        for vehicle_id in vehicle_ids:
            following: str | None = f"/v1/accidents?vehicle={vehicle_id}&limit={PAGE}"
            while following is not None:
                response = self._ask("GET", following)
                for feature in response.json()["features"]:
                    found[feature["id"]] = parse_time(feature["properties"]["received_at"])
                following = response.links.get("next", {}).get("url")
        return found

    def _ask(self, method: str, path: str, content: Mapping[str, Any] | None = None) -> httpx.Response:
        where = f"{method} {self.address.http_url}{path}"
        try:
            response = self._client.request(method, path, json=content)
        except httpx.HTTPError as error:
            raise TargetFailedError(f"{where}: {error or type(error).__name__}; is the service running?") from error
        if response.is_error:
            raise TargetFailedError(
                f"{where} answers {response.status_code}: {response.text}", problem=_problem_code(response)
            )
        return response


def _problem_code(response: httpx.Response) -> str | None:
    try:
        return str(response.json()["code"])
    except (ValueError, KeyError, TypeError):
        return None
