"""The demo's result for people and for programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from service.demo.boxes import Box
from service.demo.comparison import Crash
from service.demo.service_process import ServiceProcess
from service.demo.story import Result

PRODUCTS: Final = ("payd", "phyd", "pwyd")


def figures(result: Result) -> dict[str, Any]:
    """One object with SI units; the first keys of each level are the interface's, the others may grow."""
    vehicles = {vehicle_id: _scores_of(scores) for vehicle_id, scores in result.scores.items()}
    longest = max(result.tunnels, key=lambda tunnel: tunnel.max_error_m, default=None)
    return {
        "accidents": [_crash_figures(crash) for crash in result.crashes],
        "false_accidents": len(result.invented),
        "tunnel": {
            "duration_s": None if longest is None else longest.duration_s,
            "max_error_m": None if longest is None else longest.max_error_m,
            "max_error_before_crash_m": None if longest is None else longest.max_error_before_crash_m,
        },
        "packets": {
            "sent": result.sent,
            "acknowledged": result.acknowledged,
            "processed": result.processed,
            "lost": result.lost,
        },
        "webhooks": {"delivered": result.delivered, "verified": result.verified, "expected": result.events},
        "scores": _scores_of(next(iter(result.scores.values()), {})) | {"vehicles": vehicles},
        "seconds": result.seconds,
        "shortfalls": result.shortfalls(),
    }


def table(result: Result, boxes: Sequence[Box]) -> str:
    """What was found against what was true."""
    sections = [_boxes(result, boxes)]
    if result.crashes:
        sections.append(_crashes(result))
    elif not result.invented:
        sections.append(
            "Accidents\n  none found" + ("" if any(box.drive.truth for box in boxes) else ", none expected")
        )
    sections += [_invented(result)] if result.invented else []
    sections += [_tunnels(result)] if result.tunnels else []
    sections.append(
        f"Packets\n  sent {result.sent}, acknowledged {result.acknowledged}, processed {result.processed}, "
        f"lost {result.lost}"
    )
    sections.append(
        f"Webhooks\n  {result.events} sent (a ping among them), {result.delivered} delivered, "
        f"{result.verified} with a valid signature"
    )
    sections.append(_scores(result))
    short = result.shortfalls()
    verdict = "Everything promised held." if not short else "What fell short\n" + "\n".join(f"  {one}" for one in short)
    return "\n\n".join([*sections, verdict])


def addresses(service: ServiceProcess, box: Box, result: Result) -> str:
    """Where to look, and what to type."""
    url = service.http_url
    found = [crash.found["id"] for crash in result.crashes if crash.found is not None]
    return "\n".join(
        [
            "Have a look",
            f"  {url}/docs                the interface",
            f"  curl {url}/v1/accidents",
            *(f"  {url}/v1/accidents/{accident_id}/dossier  an accident on a page" for accident_id in found[:1]),
            f"  curl {url}/v1/vehicles/{box.vehicle_id}/state",
            f"  curl {url}/v1/vehicles/{box.vehicle_id}/trips",
            f"  curl {url}/v1/vehicles/{box.vehicle_id}/scores   why, in sentences",
            f"  curl {url}/v1/events",
            f"  curl {url}/metrics",
            f"  Zenoh {service.zenoh_endpoint}, log {service.log_path}",
        ]
    )


def _boxes(result: Result, boxes: Sequence[Box]) -> str:
    rows = [("vehicle", "over", "sensor", "drive", "fused distance")]
    rows += [
        (box.vehicle_id, box.transport, box.sensor, box.drive.name, f"{result.distance_m[box.vehicle_id]:.0f} m")
        for box in boxes
    ]
    return "Vehicles\n" + _columns(rows)


def _crashes(result: Result) -> str:
    rows: list[tuple[str, ...]] = [
        ("vehicle", "at", "GNSS", "severity", "place off by", "stated sd", "Δv off by", "alert after")
    ]
    rows += [_crash_row(crash) for crash in result.crashes]
    return "Accidents, against the truth\n" + _columns(rows)


def _crash_row(crash: Crash) -> tuple[str, ...]:
    where = "tunnel" if crash.in_outage else "yes"
    at = (crash.vehicle_id, f"{crash.t_s:.1f} s", where)
    if crash.found is None:
        return (*at, f"NOT FOUND ({crash.true_severity})", "", "", "", "")
    severity = crash.found["properties"]["severity"]
    latency = "none came" if crash.alert_latency_ms is None else f"{crash.alert_latency_ms:.0f} ms"
    return (
        *at,
        severity if severity == crash.true_severity else f"{severity} (true: {crash.true_severity})",
        f"{crash.position_error_m:.1f} m",
        f"{crash.position_sd_m:.1f} m",
        f"{crash.delta_v_error_mps:+.1f} m/s",
        latency,
    )


def _invented(result: Result) -> str:
    rows = [("vehicle", "at", "severity", "confidence")]
    for one in result.invented:
        facts = one["properties"]
        rows.append((facts["vehicle_id"], facts["time"], facts["severity"], f"{facts['confidence']:.2f}"))
    return "Accidents found where none was\n" + _columns(rows)


def _tunnels(result: Result) -> str:
    rows = [("vehicle", "from", "for", "greatest error", "before the crash")]
    rows += [
        (
            tunnel.vehicle_id,
            f"{tunnel.start_s:.0f} s",
            f"{tunnel.duration_s:.0f} s",
            f"{tunnel.max_error_m:.1f} m",
            f"{tunnel.max_error_before_crash_m:.1f} m",
        )
        for tunnel in result.tunnels
    ]
    return "Without GNSS, against the truth\n" + _columns(rows)


def _scores(result: Result) -> str:
    """Scores with their intervals: of so little driving they are the portfolio's more than the driver's."""
    rows: list[tuple[str, ...]] = [("vehicle", *PRODUCTS, "of the driver's own")]
    for vehicle_id, scores in result.scores.items():
        told = [_score(scores.get(product)) for product in PRODUCTS]
        own = [one["credibility"] for one in scores.values()]
        rows.append((vehicle_id, *told, f"{100 * max(own):.0f} % at most" if own else ""))
    return "Scores of 0 to 100, the portfolio's mean driver has 70; with 95 % intervals\n" + _columns(rows)


def _score(score: Mapping[str, Any] | None) -> str:
    if score is None or score["score"] is None:
        return "none"
    low, high = score["interval95"]
    return f"{score['score']:.1f} ({low:.0f} to {high:.0f})"


def _scores_of(scores: Mapping[str, Any]) -> dict[str, float | None]:
    return {product: scores[product]["score"] if product in scores else None for product in PRODUCTS}


def _columns(rows: Sequence[tuple[str, ...]]) -> str:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows)
    return "\n".join(f"  {line}" for line in lines)


def _crash_figures(crash: Crash) -> dict[str, Any]:
    return {
        "found": crash.found is not None,
        "position_error_m": crash.position_error_m,
        "delta_v_error_mps": crash.delta_v_error_mps,
        "alert_latency_ms": crash.alert_latency_ms,
        "vehicle_id": crash.vehicle_id,
        "t_s": crash.t_s,
        "in_outage": crash.in_outage,
        "position_sd_m": crash.position_sd_m,
        "severity": None if crash.found is None else crash.found["properties"]["severity"],
        "severity_true": crash.true_severity,
    }
