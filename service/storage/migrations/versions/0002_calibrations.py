"""Calibrations with their validity in a table of their own, and the runs that they come from.

Revision ID: 0002
Revises: 0001
"""

from __future__ import annotations

import time
from uuid import uuid4

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None

vehicles = sa.table("vehicles", sa.column("pk", sa.BigInteger), sa.column("config", sa.JSON))


def upgrade() -> None:
    """Go to this revision."""
    calibrations = op.create_table(
        "calibrations",
        sa.Column("id", sa.String(length=36), nullable=False),
        sa.Column("vehicle_pk", sa.BigInteger(), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("base", sa.Integer(), nullable=True),
        sa.Column("valid_from_ns", sa.BigInteger(), nullable=False),
        sa.Column("origin", sa.String(length=16), nullable=False),
        sa.Column("run_id", sa.String(length=36), nullable=True),
        sa.Column("created_by", sa.String(length=32), nullable=True),
        sa.Column("journal_id", sa.BigInteger(), nullable=False),
        sa.Column("stored_ns", sa.BigInteger(), nullable=False),
        sa.Column("calibration", sa.JSON(), nullable=False),
        sa.ForeignKeyConstraint(
            ["vehicle_pk"], ["vehicles.pk"], name=op.f("fk_calibrations_vehicle_pk_vehicles"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_calibrations")),
        sa.UniqueConstraint("vehicle_pk", "version", name=op.f("uq_calibrations_vehicle_pk_version")),
    )
    op.create_index("ix_calibrations_vehicle_pk_valid_from_ns", "calibrations", ["vehicle_pk", "valid_from_ns"])
    op.create_table(
        "calibration_runs",
        sa.Column("id", sa.String(length=36), nullable=False),
        sa.Column("vehicle_pk", sa.BigInteger(), nullable=False),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("progress", sa.Float(precision=53), nullable=False),
        sa.Column("options", sa.JSON(), nullable=False),
        sa.Column("recording_bytes", sa.BigInteger(), nullable=False),
        sa.Column("recording_sha256", sa.String(length=64), nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.Column("started_ns", sa.BigInteger(), nullable=True),
        sa.Column("finished_ns", sa.BigInteger(), nullable=True),
        sa.Column("result", sa.JSON(), nullable=True),
        sa.Column("problem", sa.JSON(), nullable=True),
        sa.Column("has_report", sa.Boolean(), nullable=False),
        sa.Column("decision", sa.String(length=16), nullable=True),
        sa.Column("decided_ns", sa.BigInteger(), nullable=True),
        sa.Column("version", sa.Integer(), nullable=True),
        sa.ForeignKeyConstraint(
            ["vehicle_pk"], ["vehicles.pk"], name=op.f("fk_calibration_runs_vehicle_pk_vehicles"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_calibration_runs")),
    )
    op.create_index("ix_calibration_runs_vehicle_pk_created_ns", "calibration_runs", ["vehicle_pk", "created_ns"])
    op.create_index("ix_calibration_runs_status", "calibration_runs", ["status"])
    _move_out_of_settings(calibrations)


def _move_out_of_settings(calibrations: sa.Table) -> None:
    """A calibration was one of the vehicle's settings, and held for all its packets."""
    connection = op.get_bind()
    for pk, config in connection.execute(sa.select(vehicles.c.pk, vehicles.c.config)).all():
        if "calibration" not in config:
            continue
        calibration = config.pop("calibration")
        connection.execute(sa.update(vehicles).where(vehicles.c.pk == pk).values(config=config))
        if calibration is not None:
            connection.execute(
                sa.insert(calibrations).values(
                    id=str(uuid4()),
                    vehicle_pk=pk,
                    version=1,
                    valid_from_ns=0,
                    origin="registration",
                    journal_id=0,
                    stored_ns=time.time_ns(),
                    calibration=calibration,
                )
            )


def downgrade() -> None:
    """Go back to the one before: of a vehicle's calibrations the last given one stays, as far as it was known then."""
    connection = op.get_bind()
    rows = connection.execute(
        sa.text("SELECT vehicle_pk, id FROM calibrations WHERE base IS NULL ORDER BY valid_from_ns, version")
    )
    last = {row.vehicle_pk: row.id for row in rows}
    table = sa.table("calibrations", sa.column("id", sa.String), sa.column("calibration", sa.JSON))
    for pk, calibration_id in last.items():
        stored = connection.execute(sa.select(table.c.calibration).where(table.c.id == calibration_id)).scalar_one()
        config = connection.execute(sa.select(vehicles.c.config).where(vehicles.c.pk == pk)).scalar_one()
        kept = {
            sensor: {name: stored[sensor][name] for name in ("scale", "misalignment", "bias") if name in stored[sensor]}
            for sensor in ("accelerometer", "gyroscope")
            if stored.get(sensor) is not None
        }
        connection.execute(
            sa.update(vehicles).where(vehicles.c.pk == pk).values(config={**config, "calibration": kept})
        )
    op.drop_table("calibration_runs")
    op.drop_table("calibrations")
