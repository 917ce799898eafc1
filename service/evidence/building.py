"""Evidence by replay: a session is a pure fold, so its packets give again what it worked with, to the bit.

The packets are read from the journal and folded by ``service.engine.vehicle.Vehicle``, as the engine does, from an
older checkpoint on. The replay is held against what the live session stored, and the evidence says how they compare.
"""

from __future__ import annotations

import math
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, is_dataclass, replace
from enum import Enum
from importlib.metadata import version
from typing import Any, Final

import numpy as np
from sqlalchemy import Engine, func, select

from core.accident.placing import Accident
from core.navigation import state
from core.navigation.track import TRACK
from core.session import SNAPSHOT_VERSION
from schemas.notifications import rfc3339
from service.accidents.rows import accident_row
from service.engine import checkpoints
from service.engine.sessions import session_config
from service.engine.vehicle import Vehicle
from service.evidence.bundle import Bundle, pack
from service.evidence.tape import Table, Tape
from service.ingest.journal_rows import load_rows, read_after
from service.storage.accidents import REVIEWER, AccidentRow
from service.storage.database import read
from service.storage.evidence import AFTER_NS, BEFORE_NS, OpenEvidence
from service.storage.tables import journal, track_points
from service.storage.vehicles import VehicleRef

LEAD_NS: Final = 300_000_000_000
"""Without a checkpoint to go on from, a session begins so long before the evidence: it finds mounting and attitude
within a minute of driving, and waits in rest; a choice."""

GAP_NS: Final = 100_000_000
"""Samples further apart are a gap: the slowest box that is taken samples at 50 Hz."""

_LIBRARIES: Final = ("telefuse", "numpy", "numba", "scipy")
_NOT_COMPARED: Final = ("trip_id", "received_ns", "stored_ns", "verdict", "street", "evidence")


@dataclass(frozen=True, slots=True)
class Built:
    """A bundle, and whether the vehicle's packets reached the end of what is to be kept."""

    bundle: Bundle
    reached: bool


def build(
    database: Engine,
    wanted: OpenEvidence,
    accident: AccidentRow,
    ref: VehicleRef,
    gap_wait_ns: int,
    give_way: Callable[[], None] = lambda: None,
) -> Built:
    """Replay a vehicle's packets around an accident and take down what its session worked with.

    ``ref`` has the vehicle's calibrations; its settings are those of the time of the accident. ``give_way`` is called
    between packets.
    """
    ref = replace(ref, config=wanted.config)
    tape = Tape(wanted.t_ns, wanted.t_ns - BEFORE_NS, wanted.t_ns + AFTER_NS)
    until_ns = max(tape.to_ns, accident.decided_t_ns)
    saved = None
    if wanted.anchor_journal_id is not None:
        with read(database) as connection:
            saved = checkpoints.load_older(connection, ref.pk, wanted.anchor_journal_id)
    after_id, begun = _beginning(database, ref.pk, tape.from_ns) if saved is None else (saved.journal_id, "checkpoint")
    opened: list[bytes | None] = []

    def factory(config: Any, calibrations: Any, snapshot: bytes | None) -> Any:
        session = tape.open(config, calibrations, snapshot)
        opened.append(snapshot)
        return session

    vehicle = Vehicle(ref, saved, factory, gap_wait_ns, 0)
    if begun == "checkpoint" and opened[0] is None:
        begun = "anew"  # of another version: it could not be read
    for entry in read_after(database, ref.pk, after_id):
        vehicle.fold([entry], lambda ids: load_rows(database, ids), tape)
        if tape.now_ns > until_ns:
            break
        give_way()
    tables = tape.tables()
    said = {
        "accident": {
            "id": accident.id,
            "tenant_id": accident.tenant_id,
            "vehicle_id": ref.vehicle_id,
            "t_ns": accident.t_ns,
            "time": rfc3339(accident.t_ns),
            "revisions": [_plain(one) for one in tape.accidents if one.impact.t_ns == accident.t_ns],
        },
        "covered": _covered(tape, tables["samples"]),
        "replay": {"from": begun, **_compared(database, tape, accident, ref)},
        "suppressed": [_plain(one) for one in tape.suppressed],
        "settings": ref.config.model_dump(mode="json"),
        "calibrations": [
            {
                "version": one.version,
                "valid_from_ns": one.valid_from_ns,
                "journal_id": one.journal_id,
                "calibration": one.calibration.model_dump(mode="json", exclude_none=True),
            }
            for one in ref.calibrations
        ],
        "session": _plain(replace(session_config(ref.config), calibrations=())),
        "instruments": None if tape.instruments is None else _plain(tape.instruments),
        "names": {"aid": list(state.AIDS), "outcome": list(state.OUTCOMES)},
        "packets": [
            {
                "boot_id": one.boot_id,
                "sequence": one.sequence,
                "start_t_ns": one.start_t_ns,
                "received_ns": one.received_ns,
            }
            for one in tape.packets
        ],
        "versions": {
            **{name: version(name) for name in _LIBRARIES},
            "python": platform.python_version(),
            "machine": platform.machine(),
            "snapshot": SNAPSHOT_VERSION,
        },
    }
    bundle = pack(tables, [one.payload for one in tape.packets], tape.snapshot or b"", said)
    return Built(bundle, tape.now_ns >= tape.to_ns)


def _beginning(database: Engine, vehicle_pk: int, from_ns: int) -> tuple[int, str]:
    """Where a session has to begin that has no checkpoint: exact if that is where the vehicle's own began."""
    mine = journal.c.vehicle_pk == vehicle_pk
    with read(database) as connection:
        first = connection.execute(select(func.min(journal.c.id)).where(mine)).scalar_one()
        early = connection.execute(
            select(func.max(journal.c.id)).where(mine, journal.c.start_t_ns < from_ns - LEAD_NS)
        ).scalar_one()
    whole = early is None or first is None or early < first
    return (0, "first_packet") if whole else (early, "anew")


def _covered(tape: Tape, samples: Table) -> dict[str, Any]:
    t_ns = samples["t_ns"]
    if not len(t_ns):
        return {"from_ns": None, "to_ns": None, "gaps": [], "whole": False, "asked_ns": [tape.from_ns, tape.to_ns]}
    at = np.flatnonzero(np.diff(t_ns) > GAP_NS)
    gaps = [[int(t_ns[i]), int(t_ns[i + 1])] for i in at]
    first, last = int(t_ns[0]), int(t_ns[-1])
    whole = not gaps and first - tape.from_ns <= GAP_NS and tape.to_ns - last <= GAP_NS
    return {
        "asked_ns": [tape.from_ns, tape.to_ns],
        "from_ns": first,
        "to_ns": last,
        "gaps": gaps,
        "whole": whole,
        "rate_hz": None if len(t_ns) < 2 else float(1e9 / np.median(np.diff(t_ns))),
    }


def _compared(database: Engine, tape: Tape, accident: AccidentRow, ref: VehicleRef) -> dict[str, Any]:
    """How the replay compares with what the live session stored: ``same`` is whether all of it agrees to the bit."""
    differences: list[str] = []
    same_revision = [
        one for one in tape.accidents if one.impact.t_ns == accident.t_ns and one.impact.revision == accident.revision
    ]
    if accident.detail["detector"] != REVIEWER:
        if same_revision:
            differences += _different(same_revision[-1], accident, ref)
        else:
            differences.append(f"revision {accident.revision} of the accident was not found")
    rows = {int(t): row for part in tape.rows for t, row in zip(part.t_ns, part.values, strict=True)}
    with read(database) as connection:
        stored = connection.execute(
            select(track_points.c.t_ns, track_points.c.lat_deg, track_points.c.lon_deg, track_points.c.alt_m).where(
                track_points.c.vehicle_pk == ref.pk, track_points.c.t_ns.between(tape.from_ns, tape.to_ns)
            )
        ).all()
    compared = [(point, rows[point.t_ns]) for point in stored if point.t_ns in rows]
    equal = sum(
        (point.lat_deg, point.lon_deg, point.alt_m)
        == (math.degrees(row[TRACK["lat_rad"]]), math.degrees(row[TRACK["lon_rad"]]), row[TRACK["alt_m"]])
        for point, row in compared
    )
    if equal < len(compared):
        differences.append(f"{len(compared) - equal} of {len(compared)} stored positions")
    return {"same": not differences, "differences": differences, "positions_compared": len(compared)}


def _different(found: Accident, stored: AccidentRow, ref: VehicleRef) -> list[str]:
    again = accident_row(ref, found, trip_id=None, received_ns=0, stored_ns=0)
    skipped = {*_NOT_COMPARED, "detail"} | ({"status"} if stored.verdict else set())
    names = [
        name for name in AccidentRow.__slots__ if name not in skipped and getattr(again, name) != getattr(stored, name)
    ]
    return names + [name for name, value in again.detail.items() if stored.detail.get(name) != value]


def _plain(value: Any) -> Any:
    """Anything of the core as JSON takes it; NaN and infinity are null."""
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    if isinstance(value, Enum):
        return value.name.lower() if isinstance(value.value, int) else value.value
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(name): _plain(one) for name, one in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return [_plain(one) for one in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value
