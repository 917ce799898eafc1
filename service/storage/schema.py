"""The database's schema: brought up to date, or back, by Alembic migrations that ship with the code."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from alembic.util import CommandError
from sqlalchemy import Connection, Engine, text

from service.errors import DatabaseError
from service.storage.database import write

HEAD: Final = "head"
BASE: Final = "base"

_ADVISORY_LOCK: Final = 0x7E1E_F05E
"""PostgreSQL's lock under which one process migrates while the others wait; any fixed number would do."""


def upgrade(engine: Engine, revision: str = HEAD) -> tuple[str | None, str | None]:
    """Bring the schema to ``revision`` in one transaction; returns the revisions before and after.

    Processes that start together do it one after another, so that all but one find nothing to do.
    Raises DatabaseError where the schema is from a newer version than this code.
    """
    return _run(engine, command.upgrade, revision)


def downgrade(engine: Engine, revision: str) -> tuple[str | None, str | None]:
    """Bring the schema back to ``revision``; what newer revisions had added is lost."""
    return _run(engine, command.downgrade, revision)


def current(connection: Connection) -> str | None:
    """The revision that the database is at; None for an empty one."""
    return MigrationContext.configure(connection).get_current_revision()


def newest() -> str:
    """The revision that this code works with."""
    head = ScriptDirectory.from_config(_config()).get_current_head()
    assert head is not None
    return head


def _config(connection: Connection | None = None) -> Config:
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).with_name("migrations")).replace("%", "%%"))
    config.attributes["connection"] = connection
    return config


def _run(engine: Engine, migrate: Callable[[Config, str], None], revision: str) -> tuple[str | None, str | None]:
    with write(engine) as connection:
        if connection.dialect.name == "postgresql":
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _ADVISORY_LOCK})
        before = current(connection)
        try:
            migrate(_config(connection), revision)
        except CommandError as error:
            raise DatabaseError(
                f"the database's schema is at revision {before}, which this version cannot bring to {revision}: "
                f"{error}; use the version of telefuse that wrote it, or a newer one"
            ) from error
        return before, current(connection)
