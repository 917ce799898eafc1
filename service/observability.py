"""What an operator can see: metrics of one runtime, and log lines as JSON on stderr."""

from __future__ import annotations

import json
import logging
import sys
from datetime import UTC, datetime
from typing import Final

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, PlatformCollector, ProcessCollector
from prometheus_client.exposition import CONTENT_TYPE_LATEST, generate_latest

METRICS_CONTENT_TYPE: Final = CONTENT_TYPE_LATEST

_COMMIT_BUCKETS_S: Final = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 5.0)
_ALERT_BUCKETS_S: Final = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 15.0, 60.0)
_REQUEST_BUCKETS_S: Final = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 5.0)


class Metrics:
    """The metrics of one runtime, in a registry of their own: two runtimes in a process do not meet."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        ProcessCollector(registry=self.registry)
        PlatformCollector(registry=self.registry)

        def counter(name: str, text: str, *labels: str) -> Counter:
            return Counter(f"telefuse_{name}", text, labels, registry=self.registry)

        def gauge(name: str, text: str) -> Gauge:
            return Gauge(f"telefuse_{name}", text, registry=self.registry)

        def histogram(name: str, text: str, buckets: tuple[float, ...], *labels: str) -> Histogram:
            return Histogram(f"telefuse_{name}", text, labels, buckets=buckets, registry=self.registry)

        self.packets_received_total = counter("packets_received", "Packets that arrived.", "transport")
        self.packets_accepted_total = counter("packets_accepted", "Packets made durable.")
        self.packets_duplicate_total = counter("packets_duplicate", "Packets that were there already.")
        self.packets_refused_total = counter("packets_refused", "Packets refused for good, by reason.", "code")
        self.gaps_stepped_over_total = counter("gaps_stepped_over", "Gaps in a vehicle's sequence given up on.")
        self.session_rejections_total = counter(
            "session_rejections", "Measurements that a vehicle's session did not use.", "aid", "outcome"
        )
        self.accidents_total = counter("accidents", "Accidents found.", "severity")
        self.trips_assessed_total = counter("trips_assessed", "Trips assessed, or assessed anew.", "outcome")
        self.trips_unmatched_total = counter(
            "trips_unmatched", "Assessments in which a trip's roads could not be looked up, by what follows.", "outcome"
        )
        self.webhook_deliveries_total = counter("webhook_deliveries", "Attempts to deliver a webhook.", "outcome")

        self.journal_queue = gauge("journal_queue", "Packets that wait to become durable.")
        self.engine_backlog = gauge("engine_backlog", "Durable packets that wait to be fused.")
        self.trips_waiting = gauge("trips_waiting", "Trips that ended and wait to be assessed.")
        self.vehicles_active = gauge("vehicles_active", "Vehicles whose session is in memory.")

        self.journal_commit_seconds = histogram(
            "journal_commit_seconds", "Time of one group commit of the journal.", _COMMIT_BUCKETS_S
        )
        self.alert_latency_seconds = histogram(
            "alert_latency_seconds", "From a packet's arrival to the webhook that it caused.", _ALERT_BUCKETS_S
        )
        self.http_request_seconds = histogram(
            "http_request_seconds", "Time of an HTTP request.", _REQUEST_BUCKETS_S, "operation", "status"
        )

    def exposition(self) -> bytes:
        """All metrics in the Prometheus text format."""
        return generate_latest(self.registry)


class JsonFormatter(logging.Formatter):
    """A log record as one line of JSON; ``extra={"fields": {...}}`` adds keys of its own."""

    def format(self, record: logging.LogRecord) -> str:
        """The line."""
        line: dict[str, object] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        fields = getattr(record, "fields", None)
        if isinstance(fields, dict):
            line.update(fields)
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)


def configure_logging(level: str) -> None:
    """Send every log line of this process to stderr as JSON; uvicorn's own access log is replaced by ours."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonFormatter())
    logging.basicConfig(level=level.upper(), handlers=[handler], force=True)
    for name in ("uvicorn", "uvicorn.error", "uvicorn.access"):
        logger = logging.getLogger(name)
        logger.handlers.clear()
        logger.propagate = name != "uvicorn.access"
    # These tell of every request, statement and step at INFO.
    for name in ("httpx", "httpcore", "alembic", "sqlalchemy.engine", "uvicorn"):
        logging.getLogger(name).setLevel(max(logging.WARNING, logging.getLogger().level))
