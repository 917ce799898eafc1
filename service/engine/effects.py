"""What a vehicle's session brings into the database: rows that may be written twice and count once.

Every row has a key that follows from the vehicle and the packets alone, so that outputs computed again
after a crash meet their own rows.
"""

from __future__ import annotations

import logging
import math
from collections import Counter
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from sqlalchemy import Connection, and_, not_, or_, update

from core.accident.events import NoAccident
from core.accident.placing import Accident, Suppressed
from core.calibration.drift import BiasUpdate
from core.driving.manoeuvres import Episode
from core.driving.trips import Trip
from core.navigation.track import TRACK, Mode, Track
from core.navigation.tuning import Tuning
from core.session import Outputs
from schemas.calibration import Calibration
from schemas.notifications import CalibrationDriftBody, EventBody, EventType, TripBody
from service.accidents.rows import accident_row, candidate_row, degrees_or_none, finite_or_none
from service.accidents.telling import revision_event
from service.engine import checkpoints
from service.engine.checkpoints import Checkpoint
from service.engine.sessions import learnt_calibration
from service.ingest.journal_rows import JournalEntry
from service.stable_ids import event_id, stable_id
from service.storage import accidents, calibrations, candidates, evidence
from service.storage import trips as storage_trips
from service.storage.statements import insert_into
from service.storage.tables import track_points, trips, vehicles
from service.storage.vehicles import VehicleRef
from service.trips.manoeuvres import store_episode
from service.webhooks import outbox
from service.webhooks.outbox import NewEvent

logger = logging.getLogger(__name__)

ROW_INTERVAL_NS: Final = round(Tuning().output_interval_s * 1e9)
"""Grid of the session's rows; see ``core.navigation.kernel``."""

_NEEDED: Final = [TRACK[name] for name in ("lat_rad", "lon_rad", "alt_m", "vn_mps", "ve_mps", "vd_mps")] + [
    TRACK[name] for name in ("sd_n_m", "sd_e_m", "sd_d_m", "cov_ne_m2")
]


class Effects:
    """What one batch of one vehicle's packets brought, until it is stored."""

    def __init__(self, ref: VehicleRef, track_interval_ns: int) -> None:
        self.ref = ref
        self.packets = 0
        self.counts: Counter[str] = Counter()
        self.accidents: list[tuple[Accident, int]] = []
        self.suppressed: list[tuple[Suppressed, int]] = []
        self.biases: list[tuple[BiasUpdate, int]] = []
        self.episodes: list[Episode] = []
        self.checkpoint: Checkpoint | None = None
        self.latest: dict[str, Any] | None = None
        self._track_interval_ns = track_interval_ns
        self._track: list[dict[str, Any]] = []
        self._trips: dict[int, tuple[Trip, int]] = {}
        self._last_seen_ns = 0

    def add(self, outputs: Outputs, packet: JournalEntry) -> None:
        """Take over what the session made of ``packet``."""
        self.packets += 1
        self._last_seen_ns = max(self._last_seen_ns, packet.received_ns)
        self.counts.update(outputs.counts)
        self._add_track(outputs.track)
        for trip in outputs.trips:
            self._trips[trip.start_t_ns] = (trip, packet.received_ns)
        self.biases += [(learnt, packet.received_ns) for learnt in outputs.biases]
        self.episodes += outputs.episodes
        self.suppressed += [(one, packet.received_ns) for one in outputs.suppressed]
        for accident in outputs.accidents:
            self.accidents.append((accident, packet.received_ns))
            if accident.impact.revision == 0 and not math.isfinite(accident.place.lat_rad):
                # A box that never had a fix: it is told all the same, and an operator must see it.
                self.counts["accident.no_position"] += 1
                logger.error("vehicle %s: an impact at %d ns has no place", self.ref.vehicle_id, accident.impact.t_ns)

    @property
    def must_be_kept(self) -> bool:
        """Whether the session's state must be stored with this, so that what it was told is not left without."""
        return bool(self.accidents or self.biases)

    def store(self, connection: Connection, stored_ns: int) -> list[NewEvent]:
        """Write everything in the caller's transaction; returns the events that were not there before."""
        if self._track:
            points = insert_into(connection, track_points).on_conflict_do_nothing()
            connection.execute(points, self._track)
        for trip, _ in self._trips.values():
            self._store_trip(connection, trip, stored_ns)
        for episode in self.episodes:
            store_episode(connection, self.ref, episode, stored_ns)
        for suppressed, received_ns in self.suppressed:
            row = candidate_row(self.ref, suppressed, received_ns=received_ns, stored_ns=stored_ns)
            if candidates.put(connection, row) and row.reason == NoAccident.POTHOLE:  # it may explain a braking
                storage_trips.mark_due(connection, self.ref.pk, row.t_ns, row.t_ns, stored_ns)
        new = [self._store_accident(connection, *found, stored_ns) for found in self.accidents]
        new += [self._trip_completed(*ended) for ended in self._trips.values() if ended[0].ended]
        for learnt in self.biases:
            new += self._store_biases(connection, *learnt, stored_ns)
        told = [event for event in new if outbox.publish(connection, event, stored_ns)]
        if self._last_seen_ns:
            connection.execute(
                update(vehicles)
                .where(
                    vehicles.c.pk == self.ref.pk,
                    or_(vehicles.c.last_seen_ns.is_(None), vehicles.c.last_seen_ns < self._last_seen_ns),
                )
                .values(last_seen_ns=self._last_seen_ns)
            )
        if self.checkpoint is not None:
            checkpoints.save(connection, self.ref.pk, self.checkpoint, stored_ns)
        return told

    def _add_track(self, track: Track) -> None:
        known = np.isfinite(track.values[:, _NEEDED]).all(axis=1)
        rows = [
            self._track_row(t_ns, values)
            for t_ns, values in zip(track.t_ns[known].tolist(), track.values[known].tolist(), strict=True)
            if self._is_kept(t_ns, values)
        ]
        self._track += rows
        if rows:
            self.latest = rows[-1]

    def _is_kept(self, t_ns: int, values: list[float]) -> bool:
        """Whether a row is the first of its interval: rows fall on the first sample of each cell of their own grid.

        While the filter aligns, rows come with the fixes, once a second; all are kept.
        """
        cells = max(self._track_interval_ns // ROW_INTERVAL_NS, 1)
        return values[TRACK["mode"]] == Mode.ALIGNING or t_ns // ROW_INTERVAL_NS % cells == 0

    def _track_row(self, t_ns: int, values: list[float]) -> dict[str, Any]:
        value = dict(zip(TRACK, values, strict=True))
        return {
            "vehicle_pk": self.ref.pk,
            "t_ns": t_ns,
            "lat_deg": math.degrees(value["lat_rad"]),
            "lon_deg": math.degrees(value["lon_rad"]),
            **{name: value[name] for name in ("alt_m", "vn_mps", "ve_mps", "vd_mps")},
            **{f"{name}_deg": degrees_or_none(value[f"{name}_rad"]) for name in ("roll", "pitch", "yaw", "sd_yaw")},
            **{name: value[name] for name in ("sd_n_m", "sd_e_m", "sd_d_m", "cov_ne_m2")},
            "gnss_used": value["gnss_used"] > 0,
            "mode": int(value["mode"]),
            "sd_tilt_deg": degrees_or_none(value["sd_tilt_rad"]),
            **{name: finite_or_none(value[name]) for name in ("sd_v_h_mps", "sd_accel_bias_mps2")},
        }

    def _store_trip(self, connection: Connection, trip: Trip, stored_ns: int) -> None:
        insert = insert_into(connection, trips).values(
            id=stable_id(self.ref, trip.start_t_ns, "trip"),
            vehicle_pk=self.ref.pk,
            start_ns=trip.start_t_ns,
            end_ns=trip.end_t_ns,
            ended=trip.ended,
            start_lat_deg=math.degrees(trip.start_lat_rad),
            start_lon_deg=math.degrees(trip.start_lon_rad),
            end_lat_deg=math.degrees(trip.end_lat_rad),
            end_lon_deg=math.degrees(trip.end_lon_rad),
            distance_m=trip.distance_m,
            moving_s=trip.moving_s,
            coasting_s=trip.coasting_s,
            max_speed_mps=trip.max_speed_mps,
            due_ns=stored_ns,
        )
        kept = ("id", "assessed_ns", "model_sha256", "road_failures")
        # Computed again after a crash, a trip's earlier state must not take the place of its later one.
        connection.execute(
            insert.on_conflict_do_update(
                index_elements=[trips.c.id],
                set_={column.name: column for column in insert.excluded if column.name not in kept},
                where=and_(not_(trips.c.ended), trips.c.end_ns <= insert.excluded.end_ns),
            )
        )

    def _store_accident(self, connection: Connection, accident: Accident, received_ns: int, stored_ns: int) -> NewEvent:
        trip_id = accidents.trip_at(connection, self.ref.pk, accident.impact.t_ns)
        row = accident_row(self.ref, accident, trip_id=trip_id, received_ns=received_ns, stored_ns=stored_ns)
        row = accidents.put(connection, row)
        storage_trips.mark_trip_due(connection, row.trip_id, stored_ns)
        evidence.ask_for(connection, row, self.ref.config, stored_ns)
        return revision_event(row, received_ns)

    def _trip_completed(self, trip: Trip, received_ns: int) -> NewEvent:
        body = TripBody(
            trip_id=stable_id(self.ref, trip.start_t_ns, "trip"),
            vehicle_id=self.ref.vehicle_id,
            start_ns=trip.start_t_ns,
            end_ns=trip.end_t_ns,
            distance_m=trip.distance_m,
            moving_s=trip.moving_s,
            coasting_s=trip.coasting_s,
            max_speed_mps=trip.max_speed_mps,
        )
        return self._event(EventType.TRIP_COMPLETED, body.trip_id, trip.end_t_ns, received_ns, body)

    def _store_biases(
        self, connection: Connection, learnt: BiasUpdate, received_ns: int, stored_ns: int
    ) -> Iterator[NewEvent]:
        t_ns = learnt.biases.t_ns
        calibration_id = stable_id(self.ref, t_ns, "calibration")
        base = {one.version: one.calibration for one in self.ref.calibrations}.get(learnt.version, Calibration())
        version = calibrations.add_learnt(
            connection,
            self.ref.pk,
            calibration_id,
            base=learnt.version,
            valid_from_ns=t_ns,
            stored_ns=stored_ns,
            calibration=learnt_calibration(base, learnt.biases),
        )
        for drift in learnt.drifts:
            body = CalibrationDriftBody(
                vehicle_id=self.ref.vehicle_id,
                calibration_version=version,
                t_ns=t_ns,
                sensor=drift.sensor,
                axis=drift.axis,
                was=drift.was,
                is_=drift.is_,
                sd=drift.sd,
            )
            about = f"{calibration_id}/{drift.sensor}/{drift.axis}"
            yield self._event(EventType.CALIBRATION_DRIFTED, about, t_ns, received_ns, body)

    def _event(self, kind: EventType, about: str, t_ns: int, received_ns: int, body: EventBody) -> NewEvent:
        return NewEvent(
            id=event_id(about, kind.value),
            tenant_id=self.ref.tenant_id,
            vehicle_pk=self.ref.pk,
            type=kind.value,
            t_ns=t_ns,
            received_ns=received_ns,
            body=body.model_dump(by_alias=True),
        )
