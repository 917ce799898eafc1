"""Builds evidence beside the hot path, once what follows an accident has come in, or the vehicle has fallen silent."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from sqlalchemy import Engine
from sqlalchemy.exc import SQLAlchemyError

from core.measurements import FloatArray, TimeArray
from service.evidence.building import build
from service.evidence.bundle import Bundle, to_bytes
from service.resting import Rest, StoppedError
from service.storage import accidents, evidence, vehicles
from service.storage.database import read, write
from service.storage.evidence import AFTER_NS, OpenEvidence
from service.storage.vehicles import PacketRow, VehicleDirectory

logger = logging.getLogger(__name__)

StreetOf = Callable[[TimeArray, FloatArray, FloatArray, FloatArray], str | None]
"""The street under the last of some points: times ns, latitudes and longitudes in degrees, horizontal sd in metres."""

WAY_TO_STREET_S: Final = 30.0
"""How much of the way up to an accident goes to whoever knows the roads; a choice."""


@dataclass(frozen=True, slots=True)
class EvidencePolicy:
    """When evidence is built.

    ``silent_s``: a vehicle that sends nothing for so long is not waited for: the evidence is what there is. It is
    built again when more comes within ``reopen_s``: a box may be without a network for hours. ``rest_per_work``: the
    thread rests so many times as long as it worked, so that packets go first.
    """

    silent_s: float = 120.0
    reopen_s: float = 86_400.0
    poll_s: float = 2.0
    rest_per_work: float = 3.0


class EvidenceWorker:
    """A thread that looks for evidence to be built; what a crash broke off is found again at the next start."""

    def __init__(
        self,
        database: Engine,
        directory: VehicleDirectory,
        *,
        gap_wait_s: float,
        policy: EvidencePolicy | None = None,
        street_of: StreetOf | None = None,
    ) -> None:
        self._database = database
        self._directory = directory
        self._gap_wait_ns = round(gap_wait_s * 1e9)
        self._policy = EvidencePolicy() if policy is None else policy
        self._street_of = street_of
        self._stopping = threading.Event()
        self._begun_ns = time.time_ns()
        self._tried: dict[str, int] = {}
        self._thread = threading.Thread(target=self._work, name="evidence", daemon=True)

    def start(self) -> None:
        """Begin, with what was left over first."""
        self._begun_ns = time.time_ns()
        self._thread.start()

    def stop(self) -> None:
        """Break off what is under way and end."""
        self._stopping.set()
        self._thread.join()

    def _work(self) -> None:
        while not self._stopping.is_set():
            try:
                self.turn(time.time_ns())
            except StoppedError:
                return
            except SQLAlchemyError as error:
                logger.warning("evidence waits: the database fails: %s", error)
            self._stopping.wait(self._policy.poll_s)

    def turn(self, now_ns: int) -> None:
        """Look once through what is open."""
        with read(self._database) as connection:
            waiting = evidence.open_ones(connection)
            newest = {pk: vehicles.newest_packet(connection, pk) for pk in {one.vehicle_pk for one in waiting}}
        self._tried = {one.accident_id: self._tried.get(one.accident_id, 0) for one in waiting}
        for one in waiting:
            packet = newest[one.vehicle_pk]
            if self._is_due(one, packet, now_ns):
                self._tried[one.accident_id] = 0 if packet is None else packet.received_ns
                self._build(one, packet, now_ns)
            elif one.status == "partial" and now_ns - one.created_ns > self._policy.reopen_s * 1e9:
                with write(self._database) as connection:
                    evidence.finish(connection, one.accident_id)

    def _is_due(self, one: OpenEvidence, packet: PacketRow | None, now_ns: int) -> bool:
        """Whether the packets of the time after the accident are there, or none come any more, and were not tried."""
        if packet is None:  # of a vehicle whose packets are gone: once is enough
            return one.built_ns is None and self._is_silent(None, now_ns)
        if one.built_ns is not None and packet.received_ns <= one.built_ns:
            return False
        if self._is_silent(packet, now_ns):
            return True
        passed = packet.start_t_ns > one.t_ns + AFTER_NS
        return passed and packet.received_ns > self._tried[one.accident_id]

    def _is_silent(self, packet: PacketRow | None, now_ns: int) -> bool:
        heard_ns = self._begun_ns if packet is None else max(packet.received_ns, self._begun_ns)
        return now_ns - heard_ns >= self._policy.silent_s * 1e9

    def _build(self, one: OpenEvidence, packet: PacketRow | None, now_ns: int) -> None:
        try:
            with read(self._database) as connection:
                accident = accidents.find(connection, one.tenant_id, one.accident_id)
            ref = self._directory.by_pk(one.vehicle_pk)
            if accident is None or ref is None:
                return  # erased meanwhile
            rest = Rest(self._stopping, self._policy.rest_per_work)
            built = build(self._database, one, accident, ref, self._gap_wait_ns, rest)
            if not built.reached and not self._is_silent(packet, now_ns):
                return  # packets are missing that may still come
            data = to_bytes(built.bundle)
        except (StoppedError, SQLAlchemyError):
            raise
        except Exception as error:
            logger.exception("the evidence of accident %s cannot be built", one.accident_id)
            with write(self._database) as connection:
                evidence.fail(connection, one.accident_id, f"{type(error).__name__}: {error}", now_ns)
            return
        status = "complete" if built.reached else "partial"
        street = self._street(one, built.bundle)
        with write(self._database) as connection:
            evidence.keep(connection, one.accident_id, status, data, built.bundle.sha256, now_ns)
            if street is not None:
                accidents.name_street(connection, one.accident_id, street)
        replay = built.bundle.manifest["replay"]
        told = logger.info if replay["same"] else logger.warning
        told(
            "the evidence of accident %s is %s, %d kB; its replay %s",
            one.accident_id,
            status,
            len(data) // 1000,
            "is what was stored, to the bit" if replay["same"] else f"differs: {', '.join(replay['differences'])}",
        )

    def _street(self, one: OpenEvidence, bundle: Bundle) -> str | None:
        if self._street_of is None:
            return None
        way = bundle.table("states")
        placed = np.isfinite(way["lat_rad"]) & (way["t_ns"] <= one.t_ns)
        way = way[placed & (way["t_ns"] >= one.t_ns - round(WAY_TO_STREET_S * 1e9))]
        _, first = np.unique(way["t_ns"] // 1_000_000_000, return_index=True)
        way = way[np.unique([*first, len(way) - 1])] if len(way) else way
        if not len(way):
            return None
        sd_m = np.hypot(way["sd_n_m"], way["sd_e_m"]) / np.sqrt(2.0)
        try:
            return self._street_of(way["t_ns"], np.degrees(way["lat_rad"]), np.degrees(way["lon_rad"]), sd_m)
        except Exception:
            logger.exception("the street of accident %s cannot be found", one.accident_id)
            return None
