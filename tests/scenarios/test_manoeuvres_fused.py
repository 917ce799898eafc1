"""Manoeuvres from the filter's own attitude and speed: on simulated drives as from truth, on real ones few."""

from __future__ import annotations

import numpy as np
import pytest

from core.driving.horizontal import HorizontalMotion
from core.driving.manoeuvres import Episode, Manoeuvre, ManoeuvreThresholds, ManoeuvreTracker
from core.session import Session
from core.simulation.scenarios import SimulatedDrive, simulate
from service.recordings.drive_folder import Drive, read_drive
from service.recordings.fusing import fuse_config, vehicle_config
from service.recordings.simulated import drive_of
from tests.recordings import recording

CALM = ManoeuvreThresholds(braking_mps2=1.5, acceleration_mps2=1.5, cornering_mps2=2.2)
"""Thresholds that ordinary driving passes, so that a simulated drive has many."""


class Beside:
    """A session's detector, with a tracker of manoeuvres that sees the same samples."""

    def __init__(self, session: Session, tracker: ManoeuvreTracker) -> None:
        self.detector, self.tracker, self.found = session._detector, tracker, []

    def step(self, motion):
        self.found += self.tracker.step(motion)
        return self.detector.step(motion)

    def turn(self, C_new_from_old):
        self.tracker.turn(C_new_from_old)
        self.detector.turn(C_new_from_old)

    def __getattr__(self, name):
        return getattr(self.detector, name)


def fused(drive: Drive, limits: ManoeuvreThresholds | None = None) -> list[Episode]:
    session = Session(fuse_config(vehicle_config(drive)))
    session._detector = beside = Beside(session, ManoeuvreTracker(limits))
    session.step(drive.measurements)
    return beside.found


def from_truth(drive: SimulatedDrive, limits: ManoeuvreThresholds) -> list[Episode]:
    truth = drive.trajectory
    yaw_rad, dt = np.unwrap(truth.rpy_rad[:, 2]), np.diff(truth.t_s).mean()
    a_n = np.gradient(truth.v_n, dt, axis=0)
    cosine, sine = np.cos(yaw_rad), np.sin(yaw_rad)
    rows = HorizontalMotion(
        t_ns=drive.measurements.imu_t_ns,
        forward_mps2=cosine * a_n[:, 0] + sine * a_n[:, 1],
        right_mps2=cosine * a_n[:, 1] - sine * a_n[:, 0],
        yaw_radps=np.gradient(yaw_rad, dt),
        speed_mps=truth.speed_mps,
    )
    return ManoeuvreTracker(limits).step_horizontal(rows)


def matched(one: Episode, others: list[Episode]) -> bool:
    return any(
        (one.kind, one.direction) == (other.kind, other.direction)
        and one.start_t_ns < other.end_t_ns
        and other.start_t_ns < one.end_t_ns
        for other in others
    )


def is_clear(one: Episode) -> bool:
    """Not within a tenth of its threshold, where it may fall on either side."""
    limits = {
        Manoeuvre.BRAKING: CALM.braking_mps2,
        Manoeuvre.ACCELERATION: CALM.acceleration_mps2,
        Manoeuvre.CORNERING: CALM.cornering_mps2,
    }
    return one.peak_mps2 > 1.1 * limits.get(one.kind, 0.0)


@pytest.mark.parametrize(
    ("scenario", "kinds"),
    [
        ("city", {Manoeuvre.BRAKING, Manoeuvre.ACCELERATION, Manoeuvre.CORNERING}),
        ("highway", {Manoeuvre.BRAKING, Manoeuvre.LANE_CHANGE}),
    ],
)
def test_simulated_manoeuvres_are_found_by_the_filter_as_by_truth(scenario, kinds):
    simulated = simulate(scenario, seed=6, duration_s=420.0, rate_hz=100.0)
    settled_ns = simulated.start_t_ns + 60_000_000_000
    found, true = (
        [one for one in some if one.start_t_ns > settled_ns]
        for some in (fused(drive_of(simulated), CALM), from_truth(simulated, CALM))
    )
    clear = [one for one in true if is_clear(one)]
    assert len(clear) >= 10
    assert {one.kind for one in clear} >= kinds
    assert [one for one in clear if not matched(one, found)] == []
    assert [one for one in found if is_clear(one) and not matched(one, true)] == []


@pytest.mark.parametrize(
    ("name", "most"),
    [
        # Once right round to the left at 7 m/s and 11.5 m of radius, and three brisk starts; nothing on the others.
        ("kth_stockholm", {Manoeuvre.CORNERING: 1, Manoeuvre.ACCELERATION: 3}),
        ("boston_vn100", {}),
        ("comma2k19_segment", {}),
    ],
)
def test_real_drives_are_calm(name, most):
    found = fused(read_drive(recording("drives", name)))
    for kind in Manoeuvre:
        assert sum(one.kind is kind for one in found) <= most.get(kind, 0)
    for corner in (one for one in found if one.kind is Manoeuvre.CORNERING):
        assert corner.direction == "left"
        assert corner.radius_m == pytest.approx(11.5, abs=1.0)  # speed over yaw rate, each good to some percent
