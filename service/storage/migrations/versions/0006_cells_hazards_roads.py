"""Evidence of cells, what explains a manoeuvre, and trips whose roads are looked up again.

Revision ID: 0006
Revises: 0005
"""

from __future__ import annotations

import numpy as np
import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None

_CHUNK = 500
"""Trips at once."""
trip_records = sa.table(
    "trip_records",
    sa.column("trip_id", sa.String),
    sa.column("vehicle_pk", sa.BigInteger),
    sa.column("start_ns", sa.BigInteger),
    sa.column("cells", sa.LargeBinary),
)


def upgrade() -> None:
    """Go to this revision. Trips that have records already are evidence of their cells."""
    trip_cells = op.create_table(
        "trip_cells",
        sa.Column("vehicle_pk", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("cell", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("distance_mm", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("start_ns", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.ForeignKeyConstraint(
            ["vehicle_pk"], ["vehicles.pk"], name=op.f("fk_trip_cells_vehicle_pk_vehicles"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("vehicle_pk", "cell", "distance_mm", "start_ns", name=op.f("pk_trip_cells")),
        sqlite_with_rowid=False,
    )
    _fill(trip_cells)
    op.add_column("manoeuvres", sa.Column("excused_by", sa.String(length=36), nullable=True))
    op.create_index("ix_manoeuvres_excused_by", "manoeuvres", ["excused_by"])
    op.create_index("ix_manoeuvres_tenant_id_start_ns", "manoeuvres", ["tenant_id", "start_ns"])
    op.add_column("trips", sa.Column("road_failures", sa.Integer(), nullable=True))


def downgrade() -> None:
    """Go back to the one before."""
    with op.batch_alter_table("trips") as table:
        table.drop_column("road_failures")
    op.drop_index("ix_manoeuvres_tenant_id_start_ns", "manoeuvres")
    op.drop_index("ix_manoeuvres_excused_by", "manoeuvres")
    with op.batch_alter_table("manoeuvres") as table:
        table.drop_column("excused_by")
    op.drop_table("trip_cells")


def _fill(trip_cells: sa.Table) -> None:
    # As ``service.storage.trip_cells`` did at this revision: later ones may do otherwise.
    connection, last = op.get_bind(), ""
    chosen = sa.select(trip_records).order_by(trip_records.c.trip_id).limit(_CHUNK)
    while records := connection.execute(chosen.where(trip_records.c.trip_id > last)).all():
        last = records[-1].trip_id
        rows = [
            {"vehicle_pk": one.vehicle_pk, "cell": cell, "distance_mm": mm, "start_ns": one.start_ns}
            for one in records
            for cell, mm, _ in np.frombuffer(one.cells, "<i8").reshape(3, -1).T.tolist()
            if cell and mm
        ]
        if rows:
            connection.execute(trip_cells.insert(), rows)
