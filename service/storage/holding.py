"""One service works on a database at a time: journal and engine each rely on being the only one."""

from __future__ import annotations

import fcntl
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

from sqlalchemy import Engine, text
from sqlalchemy.exc import DBAPIError, OperationalError

from service.errors import DatabaseError

_ADVISORY_LOCK: Final = 0x7E1E_F05F
"""PostgreSQL's lock that a running service holds; any fixed number would do that nothing else uses."""


def hold_database(engine: Engine) -> Callable[[], None]:
    """Hold the database for this process; returns what lets go. The hold ends with the process, however it ends.

    Raises DatabaseError where another service holds it, or it cannot be reached.
    """
    file = engine.url.database
    if engine.dialect.name == "sqlite":
        in_memory = not file or file == ":memory:"
        return (lambda: None) if in_memory else _hold_file(Path(str(file)))
    return _hold_server(engine)


def _hold_file(database: Path) -> Callable[[], None]:
    try:
        database.parent.mkdir(parents=True, exist_ok=True)
        lock = database.with_name(database.name + ".lock").open("w")
    except OSError as error:
        raise DatabaseError(f"{database.parent} cannot be written: {error.strerror}; set another data_dir") from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        lock.close()
        raise _held_elsewhere(str(database)) from None
    return lock.close


def _hold_server(engine: Engine) -> Callable[[], None]:
    name = engine.url.render_as_string(hide_password=True)
    try:
        connection = engine.connect()
    except OperationalError as error:
        raise DatabaseError(f"{name} cannot be reached: {error.orig}") from error
    # The lock is the connection's, not a transaction's: it lasts until the connection is closed.
    connection.execution_options(isolation_level="AUTOCOMMIT")
    if not connection.execute(text("SELECT pg_try_advisory_lock(:key)"), {"key": _ADVISORY_LOCK}).scalar_one():
        connection.close()
        raise _held_elsewhere(name)

    def let_go() -> None:
        # Said, not left to the connection's end, which the server may come to know of a moment later.
        with suppress(DBAPIError):
            connection.execute(text("SELECT pg_advisory_unlock(:key)"), {"key": _ADVISORY_LOCK})
        connection.invalidate()  # closed for good: back in the pool it would keep the lock
        connection.close()

    return let_go


def _held_elsewhere(name: str) -> DatabaseError:
    return DatabaseError(
        f"{name} is in use by another telefuse service; stop it, or give this one a database of its own"
    )
