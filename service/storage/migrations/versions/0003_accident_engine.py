"""Accidents that are told in steps and reviewed, candidates that were none, evidence, and who did what.

Revision ID: 0003
Revises: 0002
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

accidents = sa.table("accidents", sa.column("status", sa.String), sa.column("revision", sa.Integer), sa.column("kind"))


def upgrade() -> None:
    """Go to this revision. Accidents of before are suspected: nothing that followed has confirmed them."""
    op.add_column("checkpoints", sa.Column("t_ns", sa.BigInteger(), nullable=True))
    for column in (
        sa.Column("revision", sa.Integer(), nullable=True),
        sa.Column("kind", sa.String(length=16), nullable=True),
        sa.Column("verdict", sa.String(length=16), nullable=True),
        sa.Column("street", sa.String(length=300), nullable=True),
    ):
        op.add_column("accidents", column)
    op.execute(sa.update(accidents).values(status="suspected", revision=0, kind="collision"))
    with op.batch_alter_table("accidents") as table:
        table.alter_column("revision", existing_type=sa.Integer(), nullable=False)
        table.alter_column("kind", existing_type=sa.String(length=16), nullable=False)
    op.create_table(
        "older_checkpoints",
        sa.Column("vehicle_pk", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("journal_id", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("t_ns", sa.BigInteger(), nullable=False),
        sa.Column("sequencer", sa.JSON(), nullable=False),
        sa.Column("session", sa.LargeBinary(), nullable=False),
        sa.Column("stored_ns", sa.BigInteger(), nullable=False),
        _of_vehicle("older_checkpoints"),
        sa.PrimaryKeyConstraint("vehicle_pk", "journal_id", name=op.f("pk_older_checkpoints")),
    )
    op.create_table(
        "accident_candidates",
        sa.Column("id", sa.String(length=36), nullable=False),
        sa.Column("tenant_id", sa.String(length=64), nullable=False),
        sa.Column("vehicle_pk", sa.BigInteger(), nullable=False),
        sa.Column("t_ns", sa.BigInteger(), nullable=False),
        sa.Column("decided_t_ns", sa.BigInteger(), nullable=False),
        sa.Column("received_ns", sa.BigInteger(), nullable=False),
        sa.Column("stored_ns", sa.BigInteger(), nullable=False),
        sa.Column("reason", sa.String(length=32), nullable=False),
        sa.Column("probability", sa.Float(precision=53), nullable=False),
        sa.Column("verdict", sa.String(length=16), nullable=True),
        sa.Column("lat_deg", sa.Float(precision=53), nullable=True),
        sa.Column("lon_deg", sa.Float(precision=53), nullable=True),
        sa.Column("alt_m", sa.Float(precision=53), nullable=True),
        sa.Column("sd_n_m", sa.Float(precision=53), nullable=True),
        sa.Column("sd_e_m", sa.Float(precision=53), nullable=True),
        sa.Column("cov_ne_m2", sa.Float(precision=53), nullable=True),
        sa.Column("heading_deg", sa.Float(precision=53), nullable=True),
        sa.Column("mode", sa.SmallInteger(), nullable=False),
        sa.Column("detail", sa.JSON(), nullable=False),
        _of_tenant("accident_candidates"),
        _of_vehicle("accident_candidates"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_accident_candidates")),
    )
    op.create_index("ix_accident_candidates_tenant_id_t_ns", "accident_candidates", ["tenant_id", "t_ns"])
    op.create_index("ix_accident_candidates_vehicle_pk_t_ns", "accident_candidates", ["vehicle_pk", "t_ns"])
    op.create_index("ix_accident_candidates_stored_ns", "accident_candidates", ["stored_ns"])
    op.create_table(
        "evidence",
        sa.Column("accident_id", sa.String(length=36), nullable=False),
        sa.Column("vehicle_pk", sa.BigInteger(), nullable=False),
        sa.Column("t_ns", sa.BigInteger(), nullable=False),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("anchor_journal_id", sa.BigInteger(), nullable=True),
        sa.Column("config", sa.JSON(), nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.Column("built_ns", sa.BigInteger(), nullable=True),
        sa.Column("reason", sa.String(length=500), nullable=True),
        sa.Column("sha256", sa.String(length=64), nullable=True),
        sa.Column("bundle", sa.LargeBinary(), nullable=True),
        sa.ForeignKeyConstraint(
            ["accident_id"], ["accidents.id"], name=op.f("fk_evidence_accident_id_accidents"), ondelete="CASCADE"
        ),
        _of_vehicle("evidence"),
        sa.PrimaryKeyConstraint("accident_id", name=op.f("pk_evidence")),
    )
    op.create_index(op.f("ix_evidence_vehicle_pk"), "evidence", ["vehicle_pk"])
    op.create_index("ix_evidence_status", "evidence", ["status"])
    op.create_table(
        "reviews",
        sa.Column("id", sa.String(length=36), nullable=False),
        sa.Column("tenant_id", sa.String(length=64), nullable=False),
        sa.Column("vehicle_pk", sa.BigInteger(), nullable=False),
        sa.Column("subject_id", sa.String(length=36), nullable=False),
        sa.Column("verdict", sa.String(length=16), nullable=False),
        sa.Column("note", sa.String(length=4000), nullable=False),
        sa.Column("reviewer", sa.String(length=32), nullable=True),
        sa.Column("before", sa.String(length=32), nullable=False),
        sa.Column("after", sa.String(length=32), nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        _of_tenant("reviews"),
        _of_vehicle("reviews"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_reviews")),
    )
    op.create_index(op.f("ix_reviews_vehicle_pk"), "reviews", ["vehicle_pk"])
    op.create_index("ix_reviews_subject_id_created_ns", "reviews", ["subject_id", "created_ns"])
    op.create_table(
        "audit",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), autoincrement=True, nullable=False),
        sa.Column("tenant_id", sa.String(length=64), nullable=False),
        sa.Column("t_ns", sa.BigInteger(), nullable=False),
        sa.Column("actor", sa.String(length=32), nullable=True),
        sa.Column("action", sa.String(length=64), nullable=False),
        sa.Column("subject", sa.String(length=200), nullable=False),
        sa.Column("detail", sa.JSON(), nullable=False),
        _of_tenant("audit"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_audit")),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_audit_tenant_id_id", "audit", ["tenant_id", "id"])


def downgrade() -> None:
    """Go back to the one before, which would show all accidents: those that turned out to be none are removed."""
    for name in ("audit", "reviews", "evidence", "accident_candidates", "older_checkpoints"):
        op.drop_table(name)
    op.execute(sa.delete(accidents).where(accidents.c.status.in_(("retracted", "false"))))
    op.execute(sa.update(accidents).values(status="detected"))
    with op.batch_alter_table("accidents") as table:
        for column in ("street", "verdict", "kind", "revision"):
            table.drop_column(column)
    with op.batch_alter_table("checkpoints") as table:
        table.drop_column("t_ns")


def _of_tenant(table: str) -> sa.ForeignKeyConstraint:
    return sa.ForeignKeyConstraint(["tenant_id"], ["tenants.id"], name=op.f(f"fk_{table}_tenant_id_tenants"))


def _of_vehicle(table: str) -> sa.ForeignKeyConstraint:
    return sa.ForeignKeyConstraint(
        ["vehicle_pk"], ["vehicles.pk"], name=op.f(f"fk_{table}_vehicle_pk_vehicles"), ondelete="CASCADE"
    )
