"""What the benchmark found, as figures (INTERFACES, section 8) and as a table for people."""

from __future__ import annotations

from typing import Any

from service.bench.load import LoadFigures
from service.bench.stages import STAGES, StageFigures

_WHAT = {
    "receive": "Zenoh over loopback, put to callback",
    "decode": "protobuf decoded, everything in it checked",
    "journal": "group commits into SQLite, fsynced",
    "fuse": "the session's step: filter, detector, trips",
    "store": "track, trips, events, checkpoints into SQLite",
}


def figures(load: LoadFigures, stages: StageFigures, rate_hz: float) -> dict[str, Any]:
    """The figures by the keys that are promised, and some more."""
    return {
        "vehicles": load.vehicles,
        "rate_hz": rate_hz,
        "seconds": load.seconds,
        "packets_per_s": round(load.packets_per_s, 1),
        "real_time_factor": round(load.packets_per_s / load.vehicles, 2),
        "sent": load.sent,
        "acknowledged": load.acknowledged,
        "lost": load.lost,
        "resent": load.resent,
        "duplicates_sent": load.duplicates_sent,
        "duplicates_applied": load.duplicates_applied,
        "latency_ms": {name: _rounded(load.latency_ms(percent)) for name, percent in (("p50", 50), ("p99", 99))},
        "latency_alerts": None if load.latencies_ms is None else len(load.latencies_ms),
        "latency_packets_per_s": round(load.latency_load_per_s, 1),
        "accidents": load.accidents,
        "alerts": load.alerts,
        "stages": {name: {"limit_per_s": round(stages.limits_per_s[name], 1)} for name in STAGES},
        "fusion_ns_per_epoch": round(stages.fusion_ns_per_epoch, 1),
    }


def table(load: LoadFigures, stages: StageFigures, rate_hz: float) -> str:
    """The same, to be read."""
    lines = [
        f"{load.vehicles} vehicles, packets of 1 s at {rate_hz:g} Hz, as fast as fused, for {load.seconds:g} s:",
        f"  {load.packets_per_s:,.0f} packets/s, {load.packets_per_s / load.vehicles:.1f} times real time; "
        f"that is {load.packets_per_s:,.0f} vehicles in real time",
        f"  sent {load.sent}, acknowledged {load.acknowledged}, lost {load.lost}",
        f"  sent twice {load.duplicates_sent + load.resent}, taken twice {load.duplicates_applied}",
        f"from a packet's arrival to the alert that it caused, at {load.latency_load_per_s:,.0f} packets/s:",
        f"  {_latency(load)}",
        "each stage alone, packets/s:",
        *(f"  {name:8} {stages.limits_per_s[name]:>10,.0f}   {_WHAT[name]}" for name in STAGES),
        f"  a session takes {stages.fusion_ns_per_epoch:,.0f} ns a sample",
    ]
    return "\n".join(lines)


def _latency(load: LoadFigures) -> str:
    median, worst = load.latency_ms(50), load.latency_ms(99)
    if load.latencies_ms is None:
        return "not measured: the service sends no webhooks to private addresses"
    if median is None or worst is None:
        return "not measured: no crash happened; give it more --seconds"
    return f"median {median:.0f} ms, 99th percentile {worst:.0f} ms, over {len(load.latencies_ms)} alerts"


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 2)
