"""The database connection: SQLite with full durability by default, PostgreSQL in production.

SQLite runs in WAL mode with ``synchronous=FULL``: a commit returns only after the log is fsynced, so
what was committed outlives a killed process and a power cut, as far as the disk keeps its word.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final
from weakref import WeakKeyDictionary

from pydantic_core import from_json  # three times as fast as json's
from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.engine import make_url
from sqlalchemy.engine.interfaces import DBAPIConnection
from sqlalchemy.pool import ConnectionPoolEntry

BUSY_TIMEOUT_MS: Final = 30_000
"""How long SQLite waits for another process's write lock; within one process ``write`` queues fairly."""

_write_locks: WeakKeyDictionary[Engine, threading.Lock] = WeakKeyDictionary()


def open_database(url: str) -> Engine:
    """An engine for ``sqlite:///FILE`` or ``postgresql+psycopg://...``, made once per process.

    Makes the directory of an SQLite file; the schema is ``service.storage.schema``'s.
    """
    parsed = make_url(url)
    if parsed.get_backend_name() != "sqlite":
        return create_engine(parsed, pool_pre_ping=True, pool_use_lifo=True, json_deserializer=from_json)
    if not parsed.database or parsed.database == ":memory:":
        raise ValueError("SQLite in memory has one connection and keeps nothing; give a file: sqlite:///FILE")
    Path(parsed.database).parent.mkdir(parents=True, exist_ok=True)
    arguments = {"check_same_thread": False, "isolation_level": None}
    # The connection used last knows its pages still; the first in line would be another each time.
    engine = create_engine(parsed, connect_args=arguments, json_deserializer=from_json, pool_use_lifo=True)
    _write_locks[engine] = threading.Lock()

    @event.listens_for(engine, "connect")
    def _configure(connection: DBAPIConnection, _record: ConnectionPoolEntry) -> None:
        cursor = connection.cursor()
        for pragma in (
            f"busy_timeout={BUSY_TIMEOUT_MS}",
            "journal_mode=WAL",
            "synchronous=FULL",
            "foreign_keys=ON",
        ):
            cursor.execute(f"PRAGMA {pragma}")
        cursor.close()

    @event.listens_for(engine, "begin")
    def _begin(connection: Connection) -> None:
        # The driver's own BEGIN comes too late for a snapshot; a writer must ask for the lock at once,
        # or two readers that both turn into writers would deadlock.
        mode = "IMMEDIATE" if connection.get_execution_options().get("telefuse_write") else "DEFERRED"
        connection.exec_driver_sql(f"BEGIN {mode}")

    return engine


@contextmanager
def read(engine: Engine) -> Iterator[Connection]:
    """A consistent view for reading: what others commit meanwhile is not seen."""
    options = {} if engine in _write_locks else {"isolation_level": "REPEATABLE READ", "postgresql_readonly": True}
    with engine.connect().execution_options(**options) as connection, connection.begin():
        yield connection


@contextmanager
def write(engine: Engine) -> Iterator[Connection]:
    """One transaction for writing: committed, and durable, when the block ends without an error.

    On SQLite, which has one writer at a time, the writers of this process queue here rather than
    in SQLite's own polling.
    """
    lock = _write_locks.get(engine)
    if lock is None:
        with engine.begin() as connection:
            yield connection
        return
    with lock, engine.connect().execution_options(telefuse_write=True) as connection, connection.begin():
        yield connection
