"""Trips are assessed: how sure the track is of speed and tilt, manoeuvres, records and their sums, and erasure.

Revision ID: 0004
Revises: 0003
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None

trips = sa.table("trips", sa.column("due_ns", sa.BigInteger))


def upgrade() -> None:
    """Go to this revision. All trips so far are due, by their track as it is."""
    for name in ("sd_v_h_mps", "sd_tilt_deg", "sd_accel_bias_mps2"):
        op.add_column("track_points", sa.Column(name, sa.Float(precision=53), nullable=True))
    op.add_column("trips", sa.Column("due_ns", sa.BigInteger(), nullable=True))
    op.add_column("trips", sa.Column("assessed_ns", sa.BigInteger(), nullable=True))
    op.add_column("trips", sa.Column("model_sha256", sa.String(length=64), nullable=True))
    op.create_index("ix_trips_due_ns", "trips", ["due_ns"])
    op.execute(sa.update(trips).values(due_ns=0))
    op.create_table(
        "manoeuvres",
        sa.Column("id", sa.String(length=36), nullable=False),
        sa.Column("tenant_id", sa.String(length=64), nullable=False),
        sa.Column("vehicle_pk", sa.BigInteger(), nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("start_ns", sa.BigInteger(), nullable=False),
        sa.Column("peak_ns", sa.BigInteger(), nullable=False),
        sa.Column("end_ns", sa.BigInteger(), nullable=False),
        sa.Column("stored_ns", sa.BigInteger(), nullable=False),
        sa.Column("peak_mps2", sa.Float(precision=53), nullable=False),
        sa.Column("direction", sa.String(length=8), nullable=False),
        sa.Column("aggressive", sa.Boolean(), nullable=False),
        sa.Column("counted", sa.Boolean(), nullable=False),
        sa.Column("recovery", sa.Boolean(), nullable=False),
        sa.Column("excused", sa.String(length=16), nullable=True),
        sa.Column("verdict", sa.String(length=16), nullable=True),
        *(
            sa.Column(name, sa.Float(precision=53), nullable=True)
            for name in (
                "speed_before_mps",
                "speed_at_peak_mps",
                "speed_after_mps",
                "across_mps2",
                "radius_m",
                "heading_change_deg",
                "lat_deg",
                "lon_deg",
                "sd_n_m",
                "sd_e_m",
                "cov_ne_m2",
            )
        ),
        _of_tenant("manoeuvres"),
        _of_vehicle("manoeuvres"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_manoeuvres")),
    )
    op.create_index("ix_manoeuvres_vehicle_pk_start_ns", "manoeuvres", ["vehicle_pk", "start_ns"])
    op.create_table(
        "trip_records",
        sa.Column("trip_id", sa.String(length=36), nullable=False),
        sa.Column("vehicle_pk", sa.BigInteger(), nullable=False),
        sa.Column("start_ns", sa.BigInteger(), nullable=False),
        sa.Column("day", sa.Date(), nullable=False),
        sa.Column("model_sha256", sa.String(length=64), nullable=False),
        sa.Column("assessed_ns", sa.BigInteger(), nullable=False),
        sa.Column("record", sa.JSON(), nullable=False),
        sa.Column("cells", sa.LargeBinary(), nullable=False),
        sa.Column("timeline", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(
            ["trip_id"], ["trips.id"], name=op.f("fk_trip_records_trip_id_trips"), ondelete="CASCADE"
        ),
        _of_vehicle("trip_records"),
        sa.PrimaryKeyConstraint("trip_id", name=op.f("pk_trip_records")),
    )
    op.create_index("ix_trip_records_vehicle_pk_start_ns", "trip_records", ["vehicle_pk", "start_ns"])
    op.create_index("ix_trip_records_vehicle_pk_day", "trip_records", ["vehicle_pk", "day"])
    op.create_table(
        "record_rollups",
        sa.Column("vehicle_pk", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("period", sa.String(length=8), nullable=False),
        sa.Column("begin", sa.Date(), nullable=False),
        sa.Column("zone", sa.String(length=64), nullable=False),
        sa.Column("record", sa.JSON(), nullable=False),
        sa.Column("cells", sa.LargeBinary(), nullable=False),
        _of_vehicle("record_rollups"),
        sa.PrimaryKeyConstraint("vehicle_pk", "period", "begin", name=op.f("pk_record_rollups")),
    )
    op.create_table(
        "erasure_requests",
        sa.Column("id", sa.String(length=36), nullable=False),
        sa.Column("tenant_id", sa.String(length=64), nullable=False),
        sa.Column("vehicle_id", sa.String(length=128), nullable=False),
        sa.Column("from_ns", sa.BigInteger(), nullable=True),
        sa.Column("to_ns", sa.BigInteger(), nullable=True),
        sa.Column("unregister", sa.Boolean(), nullable=False),
        sa.Column("reason", sa.String(length=4000), nullable=False),
        sa.Column("actor", sa.String(length=32), nullable=True),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.Column("removed", sa.JSON(), nullable=False),
        _of_tenant("erasure_requests"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_erasure_requests")),
    )
    op.create_index("ix_erasure_requests_tenant_id_created_ns", "erasure_requests", ["tenant_id", "created_ns"])


def downgrade() -> None:
    """Go back to the one before: what was made of trips is lost."""
    for name in ("erasure_requests", "record_rollups", "trip_records", "manoeuvres"):
        op.drop_table(name)
    op.drop_index("ix_trips_due_ns", "trips")
    with op.batch_alter_table("trips") as table:
        for column in ("model_sha256", "assessed_ns", "due_ns"):
            table.drop_column(column)
    with op.batch_alter_table("track_points", table_kwargs={"sqlite_with_rowid": False}) as table:
        for column in ("sd_accel_bias_mps2", "sd_tilt_deg", "sd_v_h_mps"):
            table.drop_column(column)


def _of_tenant(table: str) -> sa.ForeignKeyConstraint:
    return sa.ForeignKeyConstraint(["tenant_id"], ["tenants.id"], name=op.f(f"fk_{table}_tenant_id_tenants"))


def _of_vehicle(table: str) -> sa.ForeignKeyConstraint:
    return sa.ForeignKeyConstraint(
        ["vehicle_pk"], ["vehicles.pk"], name=op.f(f"fk_{table}_vehicle_pk_vehicles"), ondelete="CASCADE"
    )
