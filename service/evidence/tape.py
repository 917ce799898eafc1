"""What a session worked with around an accident, taken down while its packets are folded again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from core.accident.placing import Accident, Suppressed
from core.calibration.in_force import BoxCalibration
from core.measurements import GNSS_COLUMNS, FloatArray, Measurements
from core.navigation.filter import FilterOutput
from core.navigation.records import RECORD_COLUMNS, AidRecords
from core.navigation.state import T_NEXT_OUTPUT
from core.navigation.track import TRACK_COLUMNS, Track
from core.past import BodySamples
from core.session import MountingEstimate, Outputs, Session, SessionConfig
from schemas.vehicles import VehicleConfig
from service.engine.sessions import session_config
from service.ingest.journal_rows import JournalEntry
from service.storage.calibrations import GivenCalibration

Table = npt.NDArray[np.void]
"""Rows with named columns, ``t_ns`` first."""

SAMPLE_COLUMNS: Final = (
    *(f"{axis}_s_mps2" for axis in ("ax", "ay", "az")),
    *(f"{axis}_s_radps" for axis in ("gx", "gy", "gz")),
    *(f"{axis}_b_mps2" for axis in ("ax", "ay", "az")),
    *(f"{axis}_b_radps" for axis in ("gx", "gy", "gz")),
    *(f"down_{axis}" for axis in ("x", "y", "z")),
    "speed_mps",
    "clipped",
    "held",
)
"""Specific force and rate as measured in sensor axes (s), and calibrated in the vehicle's (b: forward, right, down);
the fused vertical in b and horizontal speed, NaN while unknown; 1 where the accelerometer clipped or the gyroscope
hung."""

AID_TABLES: Final = {
    "gnss": GNSS_COLUMNS,
    "magnetometer": ("mx_s_ut", "my_s_ut", "mz_s_ut"),
    "wheel_speed": ("speed_mps",),
    "barometer": ("pressure_pa",),
}
_AID_FIELDS: Final = {
    "gnss": ("gnss_t_ns", "gnss"),
    "magnetometer": ("magnetometer_t_ns", "magnetic_s_ut"),
    "wheel_speed": ("speed_t_ns", "speed_mps"),
    "barometer": ("barometer_t_ns", "pressure_pa"),
}


@dataclass(frozen=True, slots=True)
class Instruments:
    """Calibration in force and mounting, as of one instant."""

    calibration: BoxCalibration
    mounting: MountingEstimate
    clock_offset_ns: int


class Tape:
    """Records from the packet on in which ``from_ns`` lies; tables hold what lies between there and ``to_ns``.

    ``snapshot`` is the session's state just before the first of ``packets``: both together give the tables again.
    """

    def __init__(self, t_ns: int, from_ns: int, to_ns: int) -> None:
        self.t_ns, self.from_ns, self.to_ns = t_ns, from_ns, to_ns
        self.now_ns = 0
        self.snapshot: bytes | None = None
        self.packets: list[JournalEntry] = []
        self.accidents: list[Accident] = []
        self.suppressed: list[Suppressed] = []
        self.rows: list[Track] = []
        self.instruments: Instruments | None = None
        self._measured: list[Measurements] = []
        self._fused: list[tuple[BodySamples, FilterOutput]] = []
        self._dense: Session | None = None
        self._states: list[Track] = []

    # --- A session of its own ---------------------------------------------------------------------

    def open(
        self, config: VehicleConfig, calibrations: Sequence[GivenCalibration], snapshot: bytes | None
    ) -> RecordedSession:
        """A session that records here: a ``SessionFactory``. Raises SnapshotError."""
        settings = session_config(config, calibrations)
        session = Session(settings) if snapshot is None else Session.restore(settings, snapshot)
        if self._dense is not None:  # settings changed on the way
            self._dense = _dense(settings, self._dense.snapshot())
        return RecordedSession(session, self)

    def take(self, session: Session, measurements: Measurements) -> Outputs:
        """Step ``session`` and take down what it works with."""
        recording = self.snapshot is not None
        before = b"" if recording else session.snapshot()
        self._measured, self._fused = (self._measured, self._fused) if recording else ([], [])
        session.tape = self
        outputs = session.step(measurements)
        self.now_ns = session.filter.t_ns
        if not recording and self.now_ns >= self.from_ns:
            self.snapshot = before
            self._dense = _dense(session.config, before)
        if self._dense is not None:
            self._states.append(self._dense.step(measurements).track)
        if self.instruments is None or self.now_ns < self.t_ns:
            self.instruments = Instruments(session.calibration, session.mounting, session.clock_offset_ns)
        return outputs

    def measured(self, measurements: Measurements) -> None:
        """Valid measurements in sensor axes."""
        self._measured.append(measurements)

    def fused(self, samples: BodySamples, output: FilterOutput) -> None:
        """Calibrated samples of these, with what the filter made of them."""
        self._fused.append((samples, output))

    def add(self, outputs: Outputs, packet: JournalEntry) -> None:
        """What the session made of a packet."""
        self.accidents += outputs.accidents
        self.suppressed += outputs.suppressed
        self.rows.append(outputs.track)
        if self.snapshot is not None:
            self.packets.append(packet)

    # --- What was recorded ------------------------------------------------------------------------

    def tables(self) -> dict[str, Table]:
        """All tables by name."""
        samples = self._samples()
        states, records = Track.joined(self._states), AidRecords.joined([out.records for _, out in self._fused])
        found = {
            "samples": samples,
            "states": self._table(states.t_ns, states.values, TRACK_COLUMNS),
            "innovations": self._table(records.t_ns, records.values, RECORD_COLUMNS),
        }
        for name, columns in AID_TABLES.items():
            times, rows = _AID_FIELDS[name]
            t_ns = np.concatenate([np.empty(0, np.int64), *(getattr(m, times) for m in self._measured)])
            values = [getattr(m, rows).reshape(-1, len(columns)) for m in self._measured]
            found[name] = self._table(t_ns, np.concatenate([np.empty((0, len(columns))), *values]), columns)
        return found

    def _samples(self) -> Table:
        raw_t_ns = np.concatenate([np.empty(0, np.int64), *(m.imu_t_ns for m in self._measured)])
        none = np.empty((0, len(SAMPLE_COLUMNS)))
        raw = [np.hstack([m.f_s, m.omega_s]) for m in self._measured]
        body = [
            np.hstack([s.f_b, s.omega_b, out.epochs, s.saturated[:, None], s.held[:, None]]) for s, out in self._fused
        ]
        values = np.hstack([np.concatenate([none[:, :6], *raw]), np.concatenate([none[:, 6:], *body])])
        return self._table(raw_t_ns, values, SAMPLE_COLUMNS)

    def _table(self, t_ns: npt.NDArray[np.int64], values: FloatArray, columns: Sequence[str]) -> Table:
        inside = (t_ns >= self.from_ns) & (t_ns <= self.to_ns)
        table = np.empty(int(inside.sum()), [("t_ns", "<i8"), *((name, "<f8") for name in columns)])
        table["t_ns"] = t_ns[inside]
        for index, name in enumerate(columns):
            table[name] = values[inside, index]
        return table


class RecordedSession:
    """A session as the engine uses it, which a tape listens to."""

    def __init__(self, session: Session, tape: Tape) -> None:
        self._session, self._tape = session, tape

    def step(self, measurements: Measurements) -> Outputs:
        """Take the next measurements."""
        return self._tape.take(self._session, measurements)

    def snapshot(self) -> bytes:
        """The whole state as bytes."""
        return self._session.snapshot()


def _dense(config: SessionConfig, snapshot: bytes) -> Session:
    """The same session with a row at each sample: rows are told, nothing depends on how often they are."""
    tuning = replace(config.filter.tuning, output_interval_s=0.0)
    session = Session.restore(replace(config, filter=replace(config.filter, tuning=tuning)), snapshot)
    session.filter.ti[T_NEXT_OUTPUT] = 0  # not only from the next of the usual rows on
    return session
