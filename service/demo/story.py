"""The demo's course: boxes send, the service finds, alerts arrive, and all of it is held against the truth."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import httpx

from service.blackbox.box import BoxFigures
from service.demo.alert_receiver import AlertReceiver, Received
from service.demo.boxes import Box, send_all
from service.demo.comparison import FOUND_WITHIN_M, Crash, Tunnel, compare_accidents, compare_tunnels
from service.demo.service_process import ServiceFailedError, ServiceProcess

PROCESSED_WITHIN_S: Final = 60.0
DELIVERED_WITHIN_S: Final = 15.0
SCORED_WITHIN_S: Final = 60.0
"""Trips are scored beside the packets, once the boxes have fallen silent."""
POLL_S: Final = 0.05


@dataclass(frozen=True, slots=True)
class Result:
    """Everything that the demo found out."""

    crashes: tuple[Crash, ...]
    invented: tuple[Mapping[str, Any], ...]
    tunnels: tuple[Tunnel, ...]
    sent: int
    acknowledged: int
    processed: int
    distance_m: Mapping[str, float]
    scores: Mapping[str, Mapping[str, Any]]
    events: int
    alerts: tuple[Received, ...]
    seconds: float

    @property
    def lost(self) -> int:
        """Packets that a box sent and the service did not process."""
        return self.sent - self.processed

    @property
    def delivered(self) -> int:
        """Webhook messages that arrived, each counted once."""
        return len({alert.id for alert in self.alerts})

    @property
    def verified(self) -> int:
        """Those of them whose signature holds."""
        return len({alert.id for alert in self.alerts if alert.verified})

    def shortfalls(self) -> list[str]:
        """What was promised and did not hold; empty if all did."""
        short = []
        for crash in self.crashes:
            name = f"{crash.vehicle_id}: the crash at {crash.t_s:.1f} s"
            if crash.position_error_m is None:
                short.append(f"{name} was not found")
                continue
            if crash.position_error_m > FOUND_WITHIN_M:
                short.append(f"{name} was placed {crash.position_error_m:.1f} m away, promised {FOUND_WITHIN_M:g} m")
            if crash.alert_latency_ms is None:
                short.append(f"{name} brought no alert")
        short += [f"{one['properties']['vehicle_id']}: an accident was invented" for one in self.invented]
        short += [f"{one}: its trips were not scored" for one, scores in self.scores.items() if not scores]
        if self.lost:
            short.append(f"{self.lost} packets were lost")
        if self.delivered < self.events:
            short.append(f"{self.events - self.delivered} of {self.events} webhooks did not arrive")
        if self.verified < self.delivered:
            short.append(f"{self.delivered - self.verified} webhooks have a signature that does not hold")
        return short


def play(
    service: ServiceProcess, receiver: AlertReceiver, boxes: Sequence[Box], progress: Callable[[int, int], None]
) -> Result:
    """Run the whole story on a service that is ready."""
    started_s = time.monotonic()
    with httpx.Client(base_url=service.http_url, timeout=10.0) as client:
        for box in boxes:
            _checked(client.put(f"/v1/vehicles/{box.vehicle_id}", json={"config": box.config.model_dump(mode="json")}))
        endpoint = _checked(
            client.post("/v1/webhook-endpoints", json={"url": receiver.url, "description": "the demo's own receiver"})
        )
        receiver.secret = endpoint["secret"]
        ping = _checked(client.post(f"/v1/webhook-endpoints/{endpoint['id']}:test"))
        figures = send_all(boxes, service, progress)
        processed = _wait_processed(client, sum(one.acknowledged for one in figures))
        scores = {box.vehicle_id: _wait_scored(client, box.vehicle_id) for box in boxes}
        wanted = {ping["event_id"], *(event["id"] for event in _all_events(client))}
        alerts = receiver.wait_until(lambda came: wanted <= {one.id for one in came}, DELIVERED_WITHIN_S)
        return _judge(client, boxes, figures, processed, scores, len(wanted), alerts, started_s)


def _judge(
    client: httpx.Client,
    boxes: Sequence[Box],
    figures: Sequence[BoxFigures],
    processed: int,
    scores: Mapping[str, Mapping[str, Any]],
    events: int,
    alerts: Sequence[Received],
    started_s: float,
) -> Result:
    alert_ns = {
        alert.message["data"]["accident_id"]: alert.arrived_ns
        for alert in reversed(alerts)
        if alert.verified and alert.message["type"] == "accident.detected"
    }
    crashes: list[Crash] = []
    invented: list[Mapping[str, Any]] = []
    tunnels: list[Tunnel] = []
    distances: dict[str, float] = {}
    for box in boxes:
        found = _pages(client, f"/v1/accidents?vehicle={box.vehicle_id}", "features")
        mine, extra = compare_accidents(box.vehicle_id, box.drive, found, alert_ns)
        crashes += mine
        invented += extra
        trips = _pages(client, f"/v1/vehicles/{box.vehicle_id}/trips", "trips")
        distances[box.vehicle_id] = sum(trip["distance_m"] for trip in trips)
        tracks = [_checked(client.get(f"/v1/trips/{trip['id']}/track")) for trip in trips]
        track = {"features": [feature for one in tracks for feature in one["features"]]}
        tunnels += compare_tunnels(box.vehicle_id, box.drive, track)
    return Result(
        crashes=tuple(crashes),
        invented=tuple(invented),
        tunnels=tuple(tunnels),
        sent=sum(one.sent for one in figures),
        acknowledged=sum(one.acknowledged for one in figures),
        processed=processed,
        distance_m=distances,
        scores=scores,
        events=events,
        alerts=tuple(alerts),
        seconds=time.monotonic() - started_s,
    )


def _wait_processed(client: httpx.Client, acknowledged: int) -> int:
    """Packets that are fused and stored, once these are all that were acknowledged or it takes too long."""
    deadline = time.monotonic() + PROCESSED_WITHIN_S
    while True:
        fused = round(_metric(client, "telefuse_packets_fused_total"))
        if fused >= acknowledged or time.monotonic() > deadline:
            return fused
        time.sleep(POLL_S)


def _wait_scored(client: httpx.Client, vehicle_id: str) -> Mapping[str, Any]:
    """The vehicle's scores by product once all of its trips are in them; nothing if that takes too long."""
    deadline = time.monotonic() + SCORED_WITHIN_S
    while time.monotonic() < deadline:
        trips = _pages(client, f"/v1/vehicles/{vehicle_id}/trips", "trips")
        scores: Mapping[str, Any] = _checked(client.get(f"/v1/vehicles/{vehicle_id}/scores"))["scores"]
        if all(one["trips"] == len(trips) for one in scores.values()):
            return scores
        time.sleep(10 * POLL_S)
    return {}


def _metric(client: httpx.Client, name: str) -> float:
    for line in client.get("/metrics").raise_for_status().text.splitlines():
        if line.startswith(f"{name} "):
            return float(line.split()[1])
    raise ServiceFailedError(f"/metrics has no {name}")


def _all_events(client: httpx.Client) -> list[Mapping[str, Any]]:
    found: list[Mapping[str, Any]] = []
    cursor: str | None = None
    while True:
        page = _checked(client.get("/v1/events", params={} if cursor is None else {"after": cursor}))
        found += page["events"]
        cursor = page["cursor"]
        if not page["more"]:
            return found


def _pages(client: httpx.Client, url: str, name: str) -> list[Mapping[str, Any]]:
    """All items of a list that pages by ``Link: rel="next"``."""
    items: list[Mapping[str, Any]] = []
    following: str | None = url
    while following is not None:
        response = client.get(following)
        items += _checked(response)[name]
        following = response.links.get("next", {}).get("url")
    return items


def _checked(response: httpx.Response) -> Mapping[str, Any]:
    if response.is_error:
        raise ServiceFailedError(
            f"{response.request.method} {response.url} answers {response.status_code}: {response.text}"
        )
    content: Mapping[str, Any] = response.json()
    return content
