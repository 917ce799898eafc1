"""The first tables: tenants and keys, vehicles, journal and checkpoints, track, trips, accidents, events, webhooks."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Go to this revision."""
    op.create_table(
        "tenants",
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_tenants")),
    )
    op.create_table(
        "api_keys",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("tenant_id", sa.String(length=64), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("key_sha256", sa.String(length=64), nullable=False),
        sa.Column("scopes", sa.JSON(), nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.Column("expires_ns", sa.BigInteger(), nullable=True),
        sa.Column("revoked_ns", sa.BigInteger(), nullable=True),
        sa.ForeignKeyConstraint(["tenant_id"], ["tenants.id"], name=op.f("fk_api_keys_tenant_id_tenants")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_api_keys")),
        sa.UniqueConstraint("key_sha256", name=op.f("uq_api_keys_key_sha256")),
    )
    op.create_index(op.f("ix_api_keys_tenant_id"), "api_keys", ["tenant_id"])
    op.create_table(
        "idempotency_keys",
        sa.Column("tenant_id", sa.String(length=64), nullable=False),
        sa.Column("key", sa.String(length=255), nullable=False),
        sa.Column("request_sha256", sa.String(length=64), nullable=False),
        sa.Column("status", sa.Integer(), nullable=False),
        sa.Column("headers", sa.JSON(), nullable=False),
        sa.Column("body", sa.LargeBinary(), nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["tenant_id"], ["tenants.id"], name=op.f("fk_idempotency_keys_tenant_id_tenants")),
        sa.PrimaryKeyConstraint("tenant_id", "key", name=op.f("pk_idempotency_keys")),
    )
    op.create_table(
        "vehicles",
        sa.Column("pk", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), autoincrement=True, nullable=False),
        sa.Column("tenant_id", sa.String(length=64), nullable=False),
        sa.Column("vehicle_id", sa.String(length=128), nullable=False),
        sa.Column("config", sa.JSON(), nullable=False),
        sa.Column("registered_ns", sa.BigInteger(), nullable=False),
        sa.Column("updated_ns", sa.BigInteger(), nullable=False),
        sa.Column("last_seen_ns", sa.BigInteger(), nullable=True),
        sa.ForeignKeyConstraint(["tenant_id"], ["tenants.id"], name=op.f("fk_vehicles_tenant_id_tenants")),
        sa.PrimaryKeyConstraint("pk", name=op.f("pk_vehicles")),
        sa.UniqueConstraint("tenant_id", "vehicle_id", name=op.f("uq_vehicles_tenant_id_vehicle_id")),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "webhook_endpoints",
        sa.Column("id", sa.String(length=36), nullable=False),
        sa.Column("tenant_id", sa.String(length=64), nullable=False),
        sa.Column("url", sa.String(length=2048), nullable=False),
        sa.Column("description", sa.String(length=500), nullable=False),
        sa.Column("types", sa.JSON(), nullable=False),
        sa.Column("secrets", sa.JSON(), nullable=False),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.Column("updated_ns", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["tenant_id"], ["tenants.id"], name=op.f("fk_webhook_endpoints_tenant_id_tenants")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_webhook_endpoints")),
    )
    op.create_index(op.f("ix_webhook_endpoints_tenant_id"), "webhook_endpoints", ["tenant_id"])
    op.create_table(
        "accidents",
        sa.Column("id", sa.String(length=36), nullable=False),
        sa.Column("tenant_id", sa.String(length=64), nullable=False),
        sa.Column("vehicle_pk", sa.BigInteger(), nullable=False),
        sa.Column("trip_id", sa.String(length=36), nullable=True),
        sa.Column("t_ns", sa.BigInteger(), nullable=False),
        sa.Column("decided_t_ns", sa.BigInteger(), nullable=False),
        sa.Column("received_ns", sa.BigInteger(), nullable=False),
        sa.Column("stored_ns", sa.BigInteger(), nullable=False),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("severity", sa.String(length=16), nullable=False),
        sa.Column("confidence", sa.Float(precision=53), nullable=False),
        sa.Column("lat_deg", sa.Float(precision=53)),
        sa.Column("lon_deg", sa.Float(precision=53)),
        sa.Column("alt_m", sa.Float(precision=53)),
        sa.Column("sd_n_m", sa.Float(precision=53)),
        sa.Column("sd_e_m", sa.Float(precision=53)),
        sa.Column("cov_ne_m2", sa.Float(precision=53)),
        sa.Column("heading_deg", sa.Float(precision=53), nullable=True),
        sa.Column("mode", sa.SmallInteger(), nullable=False),
        sa.Column("detail", sa.JSON(), nullable=False),
        sa.ForeignKeyConstraint(["tenant_id"], ["tenants.id"], name=op.f("fk_accidents_tenant_id_tenants")),
        sa.ForeignKeyConstraint(
            ["vehicle_pk"], ["vehicles.pk"], name=op.f("fk_accidents_vehicle_pk_vehicles"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_accidents")),
    )
    op.create_index("ix_accidents_tenant_id_t_ns", "accidents", ["tenant_id", "t_ns"])
    op.create_index("ix_accidents_vehicle_pk_t_ns", "accidents", ["vehicle_pk", "t_ns"])
    op.create_table(
        "checkpoints",
        sa.Column("vehicle_pk", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("journal_id", sa.BigInteger(), nullable=False),
        sa.Column("sequencer", sa.JSON(), nullable=False),
        sa.Column("session", sa.LargeBinary(), nullable=False),
        sa.Column("stored_ns", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(
            ["vehicle_pk"], ["vehicles.pk"], name=op.f("fk_checkpoints_vehicle_pk_vehicles"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("vehicle_pk", name=op.f("pk_checkpoints")),
    )
    op.create_table(
        "events",
        sa.Column("cursor", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), autoincrement=True, nullable=False),
        sa.Column("id", sa.String(length=36), nullable=False),
        sa.Column("tenant_id", sa.String(length=64), nullable=False),
        sa.Column("vehicle_pk", sa.BigInteger(), nullable=True),
        sa.Column("type", sa.String(length=64), nullable=False),
        sa.Column("t_ns", sa.BigInteger(), nullable=False),
        sa.Column("received_ns", sa.BigInteger(), nullable=False),
        sa.Column("stored_ns", sa.BigInteger(), nullable=False),
        sa.Column("body", sa.JSON(), nullable=False),
        sa.ForeignKeyConstraint(["tenant_id"], ["tenants.id"], name=op.f("fk_events_tenant_id_tenants")),
        sa.ForeignKeyConstraint(
            ["vehicle_pk"], ["vehicles.pk"], name=op.f("fk_events_vehicle_pk_vehicles"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("cursor", name=op.f("pk_events")),
        sa.UniqueConstraint("id", name=op.f("uq_events_id")),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_events_tenant_id_cursor", "events", ["tenant_id", "cursor"])
    op.create_index("ix_events_vehicle_pk", "events", ["vehicle_pk"])
    op.create_table(
        "journal",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), autoincrement=True, nullable=False),
        sa.Column("vehicle_pk", sa.BigInteger(), nullable=False),
        sa.Column("boot_id", sa.String(length=64), nullable=False),
        sa.Column("sequence", sa.BigInteger(), nullable=False),
        sa.Column("start_t_ns", sa.BigInteger(), nullable=False),
        sa.Column("received_ns", sa.BigInteger(), nullable=False),
        sa.Column("payload", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(
            ["vehicle_pk"], ["vehicles.pk"], name=op.f("fk_journal_vehicle_pk_vehicles"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_journal")),
        sa.UniqueConstraint("vehicle_pk", "boot_id", "sequence", name=op.f("uq_journal_vehicle_pk_boot_id_sequence")),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_journal_vehicle_pk_id", "journal", ["vehicle_pk", "id"])
    op.create_index("ix_journal_vehicle_pk_start_t_ns", "journal", ["vehicle_pk", "start_t_ns"])
    op.create_table(
        "track_points",
        sa.Column("vehicle_pk", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("t_ns", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("lat_deg", sa.Float(precision=53), nullable=False),
        sa.Column("lon_deg", sa.Float(precision=53), nullable=False),
        sa.Column("alt_m", sa.Float(precision=53), nullable=False),
        sa.Column("vn_mps", sa.Float(precision=53), nullable=False),
        sa.Column("ve_mps", sa.Float(precision=53), nullable=False),
        sa.Column("vd_mps", sa.Float(precision=53), nullable=False),
        sa.Column("roll_deg", sa.Float(precision=53), nullable=True),
        sa.Column("pitch_deg", sa.Float(precision=53), nullable=True),
        sa.Column("yaw_deg", sa.Float(precision=53), nullable=True),
        sa.Column("sd_n_m", sa.Float(precision=53), nullable=False),
        sa.Column("sd_e_m", sa.Float(precision=53), nullable=False),
        sa.Column("sd_d_m", sa.Float(precision=53), nullable=False),
        sa.Column("cov_ne_m2", sa.Float(precision=53), nullable=False),
        sa.Column("sd_yaw_deg", sa.Float(precision=53), nullable=True),
        sa.Column("gnss_used", sa.Boolean(), nullable=False),
        sa.Column("mode", sa.SmallInteger(), nullable=False),
        sa.ForeignKeyConstraint(
            ["vehicle_pk"], ["vehicles.pk"], name=op.f("fk_track_points_vehicle_pk_vehicles"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("vehicle_pk", "t_ns", name=op.f("pk_track_points")),
        sqlite_with_rowid=False,
    )
    op.create_table(
        "trips",
        sa.Column("id", sa.String(length=36), nullable=False),
        sa.Column("vehicle_pk", sa.BigInteger(), nullable=False),
        sa.Column("start_ns", sa.BigInteger(), nullable=False),
        sa.Column("end_ns", sa.BigInteger(), nullable=False),
        sa.Column("ended", sa.Boolean(), nullable=False),
        sa.Column("start_lat_deg", sa.Float(precision=53), nullable=False),
        sa.Column("start_lon_deg", sa.Float(precision=53), nullable=False),
        sa.Column("end_lat_deg", sa.Float(precision=53), nullable=False),
        sa.Column("end_lon_deg", sa.Float(precision=53), nullable=False),
        sa.Column("distance_m", sa.Float(precision=53), nullable=False),
        sa.Column("moving_s", sa.Float(precision=53), nullable=False),
        sa.Column("coasting_s", sa.Float(precision=53), nullable=False),
        sa.Column("max_speed_mps", sa.Float(precision=53), nullable=False),
        sa.ForeignKeyConstraint(
            ["vehicle_pk"], ["vehicles.pk"], name=op.f("fk_trips_vehicle_pk_vehicles"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_trips")),
    )
    op.create_index("ix_trips_vehicle_pk_start_ns", "trips", ["vehicle_pk", "start_ns"])
    op.create_table(
        "deliveries",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), autoincrement=True, nullable=False),
        sa.Column("event_id", sa.String(length=36), nullable=False),
        sa.Column("endpoint_id", sa.String(length=36), nullable=False),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("next_attempt_ns", sa.BigInteger(), nullable=True),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.Column("finished_ns", sa.BigInteger(), nullable=True),
        sa.Column("last_status_code", sa.Integer(), nullable=True),
        sa.Column("last_error", sa.String(length=500), nullable=True),
        sa.ForeignKeyConstraint(
            ["endpoint_id"],
            ["webhook_endpoints.id"],
            name=op.f("fk_deliveries_endpoint_id_webhook_endpoints"),
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["event_id"], ["events.id"], name=op.f("fk_deliveries_event_id_events"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_deliveries")),
        sa.UniqueConstraint("event_id", "endpoint_id", name=op.f("uq_deliveries_event_id_endpoint_id")),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_deliveries_endpoint_id_id", "deliveries", ["endpoint_id", "id"])
    op.create_index("ix_deliveries_next_attempt_ns", "deliveries", ["next_attempt_ns"])
    op.create_index("ix_deliveries_endpoint_id_next_attempt_ns", "deliveries", ["endpoint_id", "next_attempt_ns"])
    op.create_table(
        "delivery_attempts",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), autoincrement=True, nullable=False),
        sa.Column("delivery_id", sa.BigInteger(), nullable=False),
        sa.Column("started_ns", sa.BigInteger(), nullable=False),
        sa.Column("duration_ms", sa.Float(precision=53), nullable=False),
        sa.Column("status_code", sa.Integer(), nullable=True),
        sa.Column("error", sa.String(length=500), nullable=True),
        sa.ForeignKeyConstraint(
            ["delivery_id"],
            ["deliveries.id"],
            name=op.f("fk_delivery_attempts_delivery_id_deliveries"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_delivery_attempts")),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_delivery_attempts_delivery_id"), "delivery_attempts", ["delivery_id"])


def downgrade() -> None:
    """Go back to the one before."""
    for table in (
        "delivery_attempts",
        "deliveries",
        "trips",
        "track_points",
        "journal",
        "events",
        "checkpoints",
        "accidents",
        "webhook_endpoints",
        "vehicles",
        "idempotency_keys",
        "api_keys",
        "tenants",
    ):
        op.drop_table(table)
