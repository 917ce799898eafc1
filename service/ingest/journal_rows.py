"""Rows of the journal: how they are written and read."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from sqlalchemy import Connection, Engine, insert, select

from service.storage.database import read
from service.storage.tables import journal

_CHUNK: Final = 256
"""Rows a query: about 1 MB of usual packets."""


@dataclass(frozen=True, slots=True)
class JournalEntry:
    """A journal row; ``payload`` is empty where it is no packet to fuse."""

    journal_id: int
    vehicle_pk: int
    boot_id: str
    sequence: int
    start_t_ns: int
    received_ns: int
    payload: bytes


NewRow = tuple[int, str, int, int, int, bytes]
"""A row without its id: the fields of ``JournalEntry`` after the first."""

_FIELDS: Final = ("vehicle_pk", "boot_id", "sequence", "start_t_ns", "received_ns", "payload")
_INSERT: Final = insert(journal).returning(journal.c.id, sort_by_parameter_order=True)
_SELECT: Final = select(journal.c.id, *(journal.c[name] for name in _FIELDS)).order_by(journal.c.id)


def insert_rows(connection: Connection, rows: Sequence[NewRow]) -> list[JournalEntry]:
    """Write rows in the order given, within the caller's transaction."""
    if not rows:
        return []
    ids = connection.scalars(_INSERT, [dict(zip(_FIELDS, row, strict=True)) for row in rows])
    return [JournalEntry(journal_id, *row) for journal_id, row in zip(ids, rows, strict=True)]


def read_after(engine: Engine, vehicle_pk: int, after_id: int) -> Iterator[JournalEntry]:
    """A vehicle's rows after a journal id, in order; no connection is held between chunks."""
    while True:
        query = _SELECT.where(journal.c.vehicle_pk == vehicle_pk, journal.c.id > after_id).limit(_CHUNK)
        with read(engine) as connection:
            entries = [JournalEntry(*row) for row in connection.execute(query)]
        yield from entries
        if len(entries) < _CHUNK:
            return
        after_id = entries[-1].journal_id


def load_rows(engine: Engine, ids: Iterable[int]) -> list[JournalEntry]:
    """Rows by their ids, in journal order; ids that are gone are left out."""
    wanted = sorted(ids)
    entries: list[JournalEntry] = []
    with read(engine) as connection:
        for start in range(0, len(wanted), _CHUNK):
            chosen = _SELECT.where(journal.c.id.in_(wanted[start : start + _CHUNK]))
            entries += [JournalEntry(*row) for row in connection.execute(chosen)]
    return entries
