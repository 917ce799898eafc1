"""Every table of the service, once. Times are UTC nanoseconds; ids that senders see are text."""

from __future__ import annotations

from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    Column,
    Date,
    Float,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    SmallInteger,
    String,
    Table,
    Text,
    UniqueConstraint,
)

metadata = MetaData(
    naming_convention={
        "ix": "ix_%(column_0_N_label)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s_%(referred_table_name)s",
        "pk": "pk_%(table_name)s",
    }
)

# SQLite counts rows only through a column declared exactly INTEGER.
RowId = BigInteger().with_variant(Integer, "sqlite")

tenants = Table(
    "tenants",
    metadata,
    Column("id", String(64), primary_key=True),
    Column("name", String(200), nullable=False),
    Column("created_ns", BigInteger, nullable=False),
)

api_keys = Table(
    "api_keys",
    metadata,
    Column("id", String(32), primary_key=True),
    Column("tenant_id", String(64), ForeignKey("tenants.id"), nullable=False, index=True),
    Column("name", String(200), nullable=False),
    Column("key_sha256", String(64), nullable=False, unique=True),
    Column("scopes", JSON, nullable=False),
    Column("created_ns", BigInteger, nullable=False),
    Column("expires_ns", BigInteger),
    Column("revoked_ns", BigInteger),
)

vehicles = Table(
    "vehicles",
    metadata,
    Column("pk", RowId, primary_key=True, autoincrement=True),
    Column("tenant_id", String(64), ForeignKey("tenants.id"), nullable=False),
    Column("vehicle_id", String(128), nullable=False),
    Column("config", JSON, nullable=False),
    Column("registered_ns", BigInteger, nullable=False),
    Column("updated_ns", BigInteger, nullable=False),
    Column("last_seen_ns", BigInteger),
    UniqueConstraint("tenant_id", "vehicle_id"),
    sqlite_autoincrement=True,
)

calibrations = Table(
    "calibrations",
    metadata,
    Column("id", String(36), primary_key=True),
    Column("vehicle_pk", BigInteger, ForeignKey("vehicles.pk", ondelete="CASCADE"), nullable=False),
    Column("version", Integer, nullable=False),
    Column("base", Integer),
    Column("valid_from_ns", BigInteger, nullable=False),
    Column("origin", String(16), nullable=False),
    Column("run_id", String(36)),
    Column("created_by", String(32)),
    Column("journal_id", BigInteger, nullable=False),
    Column("stored_ns", BigInteger, nullable=False),
    Column("calibration", JSON, nullable=False),
    UniqueConstraint("vehicle_pk", "version"),
    Index("ix_calibrations_vehicle_pk_valid_from_ns", "vehicle_pk", "valid_from_ns"),
)
"""Each row holds from ``valid_from_ns`` (0: ever since) until the next one does. ``base`` is null where somebody gave
it; else it is the given version (0: none) whose biases a trip brought up to date, and holds as long as that one does.
Packets up to ``journal_id`` were folded, or are to be folded again, without it."""

calibration_runs = Table(
    "calibration_runs",
    metadata,
    Column("id", String(36), primary_key=True),
    Column("vehicle_pk", BigInteger, ForeignKey("vehicles.pk", ondelete="CASCADE"), nullable=False),
    Column("status", String(16), nullable=False),
    Column("progress", Float(53), nullable=False),
    Column("options", JSON, nullable=False),
    Column("recording_bytes", BigInteger, nullable=False),
    Column("recording_sha256", String(64), nullable=False),
    Column("created_ns", BigInteger, nullable=False),
    Column("started_ns", BigInteger),
    Column("finished_ns", BigInteger),
    Column("result", JSON),
    Column("problem", JSON),
    Column("has_report", Boolean, nullable=False),
    Column("decision", String(16)),
    Column("decided_ns", BigInteger),
    Column("version", Integer),
    Index("ix_calibration_runs_vehicle_pk_created_ns", "vehicle_pk", "created_ns"),
    Index("ix_calibration_runs_status", "status"),
)
"""``status`` is queued, running, done or failed; ``decision`` accepted or refused. The uploaded recording and the
report are files in the data directory, by the run's id."""

journal = Table(
    "journal",
    metadata,
    Column("id", RowId, primary_key=True, autoincrement=True),
    Column("vehicle_pk", BigInteger, ForeignKey("vehicles.pk", ondelete="CASCADE"), nullable=False),
    Column("boot_id", String(64), nullable=False),
    Column("sequence", BigInteger, nullable=False),
    Column("start_t_ns", BigInteger, nullable=False),
    Column("received_ns", BigInteger, nullable=False),
    Column("payload", LargeBinary, nullable=False),
    UniqueConstraint("vehicle_pk", "boot_id", "sequence"),
    Index("ix_journal_vehicle_pk_id", "vehicle_pk", "id"),
    Index("ix_journal_vehicle_pk_start_t_ns", "vehicle_pk", "start_t_ns"),
    sqlite_autoincrement=True,
)
"""Packets as they came, in the order in which they became durable."""

checkpoints = Table(
    "checkpoints",
    metadata,
    Column(
        "vehicle_pk", BigInteger, ForeignKey("vehicles.pk", ondelete="CASCADE"), primary_key=True, autoincrement=False
    ),
    Column("journal_id", BigInteger, nullable=False),
    Column("t_ns", BigInteger),
    Column("sequencer", JSON, nullable=False),
    Column("session", LargeBinary, nullable=False),
    Column("stored_ns", BigInteger, nullable=False),
)
"""State of a vehicle after every journal row up to ``journal_id``; recovery goes on from there. ``t_ns`` is its newest
sample's, by the box's clock; null before the first."""

older_checkpoints = Table(
    "older_checkpoints",
    metadata,
    Column(
        "vehicle_pk", BigInteger, ForeignKey("vehicles.pk", ondelete="CASCADE"), primary_key=True, autoincrement=False
    ),
    Column("journal_id", BigInteger, primary_key=True, autoincrement=False),
    Column("t_ns", BigInteger, nullable=False),
    Column("sequencer", JSON, nullable=False),
    Column("session", LargeBinary, nullable=False),
    Column("stored_ns", BigInteger, nullable=False),
)
"""A few earlier checkpoints of a vehicle, from which the minute before an accident can be replayed."""

track_points = Table(
    "track_points",
    metadata,
    Column(
        "vehicle_pk", BigInteger, ForeignKey("vehicles.pk", ondelete="CASCADE"), primary_key=True, autoincrement=False
    ),
    Column("t_ns", BigInteger, primary_key=True, autoincrement=False),
    Column("lat_deg", Float(53), nullable=False),
    Column("lon_deg", Float(53), nullable=False),
    Column("alt_m", Float(53), nullable=False),
    Column("vn_mps", Float(53), nullable=False),
    Column("ve_mps", Float(53), nullable=False),
    Column("vd_mps", Float(53), nullable=False),
    Column("roll_deg", Float(53)),
    Column("pitch_deg", Float(53)),
    Column("yaw_deg", Float(53)),
    Column("sd_n_m", Float(53), nullable=False),
    Column("sd_e_m", Float(53), nullable=False),
    Column("sd_d_m", Float(53), nullable=False),
    Column("cov_ne_m2", Float(53), nullable=False),
    Column("sd_yaw_deg", Float(53)),
    Column("gnss_used", Boolean, nullable=False),
    Column("mode", SmallInteger, nullable=False),
    Column("sd_v_h_mps", Float(53)),
    Column("sd_tilt_deg", Float(53)),
    Column("sd_accel_bias_mps2", Float(53)),
    sqlite_with_rowid=False,
)
"""``sd_v_h_mps``, ``sd_tilt_deg`` and ``sd_accel_bias_mps2`` are of one horizontal axis; null in rows from before."""

trips = Table(
    "trips",
    metadata,
    Column("id", String(36), primary_key=True),
    Column("vehicle_pk", BigInteger, ForeignKey("vehicles.pk", ondelete="CASCADE"), nullable=False),
    Column("start_ns", BigInteger, nullable=False),
    Column("end_ns", BigInteger, nullable=False),
    Column("ended", Boolean, nullable=False),
    Column("start_lat_deg", Float(53), nullable=False),
    Column("start_lon_deg", Float(53), nullable=False),
    Column("end_lat_deg", Float(53), nullable=False),
    Column("end_lon_deg", Float(53), nullable=False),
    Column("distance_m", Float(53), nullable=False),
    Column("moving_s", Float(53), nullable=False),
    Column("coasting_s", Float(53), nullable=False),
    Column("max_speed_mps", Float(53), nullable=False),
    Column("due_ns", BigInteger),
    Column("assessed_ns", BigInteger),
    Column("model_sha256", String(64)),
    Column("road_failures", Integer),
    Index("ix_trips_vehicle_pk_start_ns", "vehicle_pk", "start_ns"),
    Index("ix_trips_due_ns", "due_ns"),
)
"""``due_ns`` is since when, by the service's clock, a trip waits to be assessed, or assessed anew as something about it
changed; null where there is nothing to do, later than now where only its roads are to be looked up again.
``model_sha256`` names what it was assessed by. ``road_failures`` is how often one after the other some of its roads
could not be looked up; null where they were."""

manoeuvres = Table(
    "manoeuvres",
    metadata,
    Column("id", String(36), primary_key=True),
    Column("tenant_id", String(64), ForeignKey("tenants.id"), nullable=False),
    Column("vehicle_pk", BigInteger, ForeignKey("vehicles.pk", ondelete="CASCADE"), nullable=False),
    Column("kind", String(16), nullable=False),
    Column("start_ns", BigInteger, nullable=False),
    Column("peak_ns", BigInteger, nullable=False),
    Column("end_ns", BigInteger, nullable=False),
    Column("stored_ns", BigInteger, nullable=False),
    Column("peak_mps2", Float(53), nullable=False),
    Column("direction", String(8), nullable=False),
    Column("aggressive", Boolean, nullable=False),
    Column("counted", Boolean, nullable=False),
    Column("recovery", Boolean, nullable=False),
    Column("excused", String(16)),
    Column("excused_by", String(36)),
    Column("verdict", String(16)),
    Column("speed_before_mps", Float(53)),
    Column("speed_at_peak_mps", Float(53)),
    Column("speed_after_mps", Float(53)),
    Column("across_mps2", Float(53)),
    Column("radius_m", Float(53)),
    Column("heading_change_deg", Float(53)),
    Column("lat_deg", Float(53)),
    Column("lon_deg", Float(53)),
    Column("sd_n_m", Float(53)),
    Column("sd_e_m", Float(53)),
    Column("cov_ne_m2", Float(53)),
    Index("ix_manoeuvres_vehicle_pk_start_ns", "vehicle_pk", "start_ns"),
    Index("ix_manoeuvres_tenant_id_start_ns", "tenant_id", "start_ns"),
    Index("ix_manoeuvres_excused_by", "excused_by"),
)
"""A manoeuvre belongs to the trip within whose time it began. ``excused`` says why it does not count against the
driver: accident, hazard or reviewer; ``excused_by`` names the accident or candidate that explains it, also when that is
not kept any more. ``verdict`` is what a reviewer said last. The place is null where there is none, and goes with the
track."""

trip_records = Table(
    "trip_records",
    metadata,
    Column("trip_id", String(36), ForeignKey("trips.id", ondelete="CASCADE"), primary_key=True),
    Column("vehicle_pk", BigInteger, ForeignKey("vehicles.pk", ondelete="CASCADE"), nullable=False),
    Column("start_ns", BigInteger, nullable=False),
    Column("day", Date, nullable=False),
    Column("model_sha256", String(64), nullable=False),
    Column("assessed_ns", BigInteger, nullable=False),
    Column("record", JSON, nullable=False),
    Column("cells", LargeBinary, nullable=False),
    Column("timeline", LargeBinary, nullable=False),
    Index("ix_trip_records_vehicle_pk_start_ns", "vehicle_pk", "start_ns"),
    Index("ix_trip_records_vehicle_pk_day", "vehicle_pk", "day"),
)
"""What a trip adds to scores: ``core.scoring.record.Record`` with its cells apart (``cell_sums``), and its masses
by second (``service.trips.timeline``). ``day`` is the local one on which it began."""

trip_cells = Table(
    "trip_cells",
    metadata,
    Column(
        "vehicle_pk", BigInteger, ForeignKey("vehicles.pk", ondelete="CASCADE"), primary_key=True, autoincrement=False
    ),
    Column("cell", BigInteger, primary_key=True, autoincrement=False),
    Column("distance_mm", BigInteger, primary_key=True, autoincrement=False),
    Column("start_ns", BigInteger, primary_key=True, autoincrement=False),
    sqlite_with_rowid=False,
)
"""The cells of ``trip_records`` once more, so that of each the trips that drove farthest in it are found at once; a
vehicle's trips are told apart by when they began."""

record_rollups = Table(
    "record_rollups",
    metadata,
    Column(
        "vehicle_pk", BigInteger, ForeignKey("vehicles.pk", ondelete="CASCADE"), primary_key=True, autoincrement=False
    ),
    Column("period", String(8), primary_key=True),
    Column("begin", Date, primary_key=True),
    Column("zone", String(64), nullable=False),
    Column("record", JSON, nullable=False),
    Column("cells", LargeBinary, nullable=False),
)
"""Sums of records by ``service.local_days.Period``: of a day over its trips, of each longer one over those below it;
``zone`` is the one by which days are told apart."""

accidents = Table(
    "accidents",
    metadata,
    Column("id", String(36), primary_key=True),
    Column("tenant_id", String(64), ForeignKey("tenants.id"), nullable=False),
    Column("vehicle_pk", BigInteger, ForeignKey("vehicles.pk", ondelete="CASCADE"), nullable=False),
    Column("trip_id", String(36)),
    Column("t_ns", BigInteger, nullable=False),
    Column("decided_t_ns", BigInteger, nullable=False),
    Column("received_ns", BigInteger, nullable=False),
    Column("stored_ns", BigInteger, nullable=False),
    Column("revision", Integer, nullable=False),
    Column("kind", String(16), nullable=False),
    Column("status", String(16), nullable=False),
    Column("verdict", String(16)),
    Column("severity", String(16), nullable=False),
    Column("confidence", Float(53), nullable=False),
    Column("street", String(300)),
    Column("lat_deg", Float(53)),
    Column("lon_deg", Float(53)),
    Column("alt_m", Float(53)),
    Column("sd_n_m", Float(53)),
    Column("sd_e_m", Float(53)),
    Column("cov_ne_m2", Float(53)),
    Column("heading_deg", Float(53)),
    Column("mode", SmallInteger, nullable=False),
    Column("detail", JSON, nullable=False),
    Index("ix_accidents_tenant_id_t_ns", "tenant_id", "t_ns"),
    Index("ix_accidents_vehicle_pk_t_ns", "vehicle_pk", "t_ns"),
)
"""The place is null where a box never had a fix. ``detail`` holds the impact's own figures (Δv, direction, peak, ...)
by their names. ``status`` is suspected, confirmed or retracted as the detector says, or confirmed or false as a
reviewer said last (``verdict``); that stands, whatever the detector says later."""

accident_candidates = Table(
    "accident_candidates",
    metadata,
    Column("id", String(36), primary_key=True),
    Column("tenant_id", String(64), ForeignKey("tenants.id"), nullable=False),
    Column("vehicle_pk", BigInteger, ForeignKey("vehicles.pk", ondelete="CASCADE"), nullable=False),
    Column("t_ns", BigInteger, nullable=False),
    Column("decided_t_ns", BigInteger, nullable=False),
    Column("received_ns", BigInteger, nullable=False),
    Column("stored_ns", BigInteger, nullable=False),
    Column("reason", String(32), nullable=False),
    Column("probability", Float(53), nullable=False),
    Column("verdict", String(16)),
    Column("lat_deg", Float(53)),
    Column("lon_deg", Float(53)),
    Column("alt_m", Float(53)),
    Column("sd_n_m", Float(53)),
    Column("sd_e_m", Float(53)),
    Column("cov_ne_m2", Float(53)),
    Column("heading_deg", Float(53)),
    Column("mode", SmallInteger, nullable=False),
    Column("detail", JSON, nullable=False),
    Index("ix_accident_candidates_tenant_id_t_ns", "tenant_id", "t_ns"),
    Index("ix_accident_candidates_vehicle_pk_t_ns", "vehicle_pk", "t_ns"),
    Index("ix_accident_candidates_stored_ns", "stored_ns"),
)
"""What felt like an accident and was judged to be none; ``verdict`` is what a reviewer said last."""

evidence = Table(
    "evidence",
    metadata,
    Column("accident_id", String(36), ForeignKey("accidents.id", ondelete="CASCADE"), primary_key=True),
    Column("vehicle_pk", BigInteger, ForeignKey("vehicles.pk", ondelete="CASCADE"), nullable=False, index=True),
    Column("t_ns", BigInteger, nullable=False),
    Column("status", String(16), nullable=False),
    Column("anchor_journal_id", BigInteger),
    Column("config", JSON, nullable=False),
    Column("created_ns", BigInteger, nullable=False),
    Column("built_ns", BigInteger),
    Column("reason", String(500)),
    Column("sha256", String(64)),
    Column("bundle", LargeBinary),
    Index("ix_evidence_status", "status"),
)
"""``status`` is pending, partial (what there was when the vehicle fell silent; looked at again for a while), complete,
final (partial for good) or failed (``reason`` says why). ``anchor_journal_id`` names the older checkpoint to replay
from, null for none. ``config`` are the vehicle's settings of then. ``bundle`` is one file, ``sha256`` over what it
holds."""

reviews = Table(
    "reviews",
    metadata,
    Column("id", String(36), primary_key=True),
    Column("tenant_id", String(64), ForeignKey("tenants.id"), nullable=False),
    Column("vehicle_pk", BigInteger, ForeignKey("vehicles.pk", ondelete="CASCADE"), nullable=False, index=True),
    Column("subject_id", String(36), nullable=False),
    Column("verdict", String(16), nullable=False),
    Column("note", String(4000), nullable=False),
    Column("reviewer", String(32)),
    Column("before", String(32), nullable=False),
    Column("after", String(32), nullable=False),
    Column("created_ns", BigInteger, nullable=False),
    Index("ix_reviews_subject_id_created_ns", "subject_id", "created_ns"),
)
"""What people said of accidents, candidates, manoeuvres (``subject_id``); ``reviewer`` is an API key's id, null while
auth is off; ``before`` and ``after`` are the subject's status."""

erasure_requests = Table(
    "erasure_requests",
    metadata,
    Column("id", String(36), primary_key=True),
    Column("tenant_id", String(64), ForeignKey("tenants.id"), nullable=False),
    Column("vehicle_id", String(128), nullable=False),
    Column("from_ns", BigInteger),
    Column("to_ns", BigInteger),
    Column("unregister", Boolean, nullable=False),
    Column("reason", String(4000), nullable=False),
    Column("actor", String(32)),
    Column("created_ns", BigInteger, nullable=False),
    Column("removed", JSON, nullable=False),
    Index("ix_erasure_requests_tenant_id_created_ns", "tenant_id", "created_ns"),
)
"""What was erased, for whom to show it to: ``removed`` counts rows by table. It outlives the vehicle."""

audit = Table(
    "audit",
    metadata,
    Column("id", RowId, primary_key=True, autoincrement=True),
    Column("tenant_id", String(64), ForeignKey("tenants.id"), nullable=False),
    Column("t_ns", BigInteger, nullable=False),
    Column("actor", String(32)),
    Column("action", String(64), nullable=False),
    Column("subject", String(200), nullable=False),
    Column("detail", JSON, nullable=False),
    Index("ix_audit_tenant_id_id", "tenant_id", "id"),
    sqlite_autoincrement=True,
)
"""Who did what to what: kept when the subject is erased, so nothing personal goes into ``detail``."""

rating_documents = Table(
    "rating_documents",
    metadata,
    Column("tenant_id", String(64), ForeignKey("tenants.id"), primary_key=True),
    Column("part", String(32), primary_key=True),
    Column("version", Integer, primary_key=True, autoincrement=False),
    Column("text", Text),
    Column("created_ns", BigInteger, nullable=False),
    Column("created_by", String(32)),
)
"""What a tenant rates by: TOML or JSON, as it was sent; null takes the shipped one back. The newest version holds."""

events = Table(
    "events",
    metadata,
    Column("cursor", RowId, primary_key=True, autoincrement=True),
    Column("id", String(36), nullable=False, unique=True),
    Column("tenant_id", String(64), ForeignKey("tenants.id"), nullable=False),
    Column("vehicle_pk", BigInteger, ForeignKey("vehicles.pk", ondelete="CASCADE")),
    Column("type", String(64), nullable=False),
    Column("t_ns", BigInteger, nullable=False),
    Column("received_ns", BigInteger, nullable=False),
    Column("stored_ns", BigInteger, nullable=False),
    Column("body", JSON, nullable=False),
    Index("ix_events_tenant_id_cursor", "tenant_id", "cursor"),
    Index("ix_events_vehicle_pk", "vehicle_pk"),
    sqlite_autoincrement=True,
)
"""What happened, told once: the catch-up feed, and what webhooks carry. ``received_ns`` is when the
packet that caused it came in, so that latency can be measured."""

webhook_endpoints = Table(
    "webhook_endpoints",
    metadata,
    Column("id", String(36), primary_key=True),
    Column("tenant_id", String(64), ForeignKey("tenants.id"), nullable=False, index=True),
    Column("url", String(2048), nullable=False),
    Column("description", String(500), nullable=False),
    Column("types", JSON, nullable=False),
    Column("secrets", JSON, nullable=False),
    Column("status", String(16), nullable=False),
    Column("created_ns", BigInteger, nullable=False),
    Column("updated_ns", BigInteger, nullable=False),
)
"""``types`` is a list of event types, empty for all; ``secrets`` a list of {secret, expires_ns};
``status`` is enabled or disabled."""

deliveries = Table(
    "deliveries",
    metadata,
    Column("id", RowId, primary_key=True, autoincrement=True),
    Column("event_id", String(36), ForeignKey("events.id", ondelete="CASCADE"), nullable=False),
    Column("endpoint_id", String(36), ForeignKey("webhook_endpoints.id", ondelete="CASCADE"), nullable=False),
    Column("status", String(16), nullable=False),
    Column("attempts", Integer, nullable=False),
    Column("next_attempt_ns", BigInteger),
    Column("created_ns", BigInteger, nullable=False),
    Column("finished_ns", BigInteger),
    Column("last_status_code", Integer),
    Column("last_error", String(500)),
    UniqueConstraint("event_id", "endpoint_id"),
    Index("ix_deliveries_endpoint_id_id", "endpoint_id", "id"),
    Index("ix_deliveries_next_attempt_ns", "next_attempt_ns"),
    Index("ix_deliveries_endpoint_id_next_attempt_ns", "endpoint_id", "next_attempt_ns"),
    sqlite_autoincrement=True,
)
"""The outbox: a row an event an endpoint, written in the event's own transaction. ``status`` is
pending, delivered, dead or cancelled; ``next_attempt_ns`` is set only while pending."""

delivery_attempts = Table(
    "delivery_attempts",
    metadata,
    Column("id", RowId, primary_key=True, autoincrement=True),
    Column("delivery_id", BigInteger, ForeignKey("deliveries.id", ondelete="CASCADE"), nullable=False, index=True),
    Column("started_ns", BigInteger, nullable=False),
    Column("duration_ms", Float(53), nullable=False),
    Column("status_code", Integer),
    Column("error", String(500)),
    sqlite_autoincrement=True,
)

idempotency_keys = Table(
    "idempotency_keys",
    metadata,
    Column("tenant_id", String(64), ForeignKey("tenants.id"), primary_key=True),
    Column("key", String(255), primary_key=True),
    Column("request_sha256", String(64), nullable=False),
    Column("status", Integer, nullable=False),
    Column("headers", JSON, nullable=False),
    Column("body", LargeBinary, nullable=False),
    Column("created_ns", BigInteger, nullable=False),
)
