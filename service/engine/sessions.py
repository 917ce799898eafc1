"""The sessions that the engine runs: ``core.session`` with the settings that a vehicle has."""

from __future__ import annotations

from core.session import Session, SessionConfig
from schemas.vehicles import VehicleConfig


def session_config(config: VehicleConfig) -> SessionConfig:
    """A vehicle's settings in the units of the core."""
    return SessionConfig()


def open_session(config: VehicleConfig, snapshot: bytes | None) -> Session:
    """A new session, or one that goes on from a snapshot; raises SnapshotError."""
    settings = session_config(config)
    return Session(settings) if snapshot is None else Session.restore(settings, snapshot)
