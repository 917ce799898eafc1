"""The filter on real recordings, through what ``telefuse fuse`` runs: bounds that the project promises."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from core.navigation.track import Mode
from service.recordings.drive_folder import read_drive
from service.recordings.fusing import Outage, figures, fuse, fuse_config, vehicle_config
from tests.recordings import recording

NAMES = ["kth_stockholm", "comma2k19_segment", "boston_vn100"]


@functools.cache
def drive(name):
    return read_drive(recording("drives", name))


@functools.cache
def fused(name, *outages):
    """What the session made of a drive, at its samples' rate, and the figures of ``telefuse fuse --json``."""
    recording = drive(name)
    made = fuse(recording, fuse_config(vehicle_config(recording)), outages)
    return made, figures(recording, made, outages)


def test_a_hundred_seconds_without_gnss_in_stockholm():
    _, found = fused("kth_stockholm", Outage(200.0, 99.0))
    assert found["aids"]["speed"]["fused"] > 500
    # 9.77 m RMS: a published MATLAB filter with non-holonomic constraints on this very outage.
    assert found["outage_rms_m"] < 9.77
    assert found["outages"][0]["against"] == "gnss"


def test_a_minute_of_motorway_against_a_survey_grade_reference():
    _, found = fused("comma2k19_segment")
    assert found["against"] == "reference"
    assert found["position_rms_offset_removed_m"] < 1.5  # the reference sits elsewhere on the car
    assert np.hypot(*found["offset_ned_m"][:2]) < 4.0  # and not further off than that
    assert found["yaw_rms_deg"] < 2.0


def test_half_a_minute_without_gnss_on_the_motorway():
    _, found = fused("comma2k19_segment", Outage(20.0, 30.0))
    assert found["outage_rms_m"] < 6.0
    assert found["outages"][0]["distance_m"] > 300.0


def test_twelve_minutes_of_boston_with_nothing_but_positions():
    made, found = fused("boston_vn100")
    assert found["aligned_after_s"] < 120.0
    assert found["gnss_rms_m"] < 3.0  # its fixes, with an HDOP of 1.5, scatter as much
    assert "reset" not in found["aids"].get("imu", {})
    mode = made.track.column("mode")
    assert (mode[mode != Mode.ALIGNING] == Mode.AIDED).mean() > 0.95


@pytest.mark.parametrize("name", NAMES)
def test_every_drive_runs_through_with_a_sound_track_and_no_accident(name):
    made, found = fused(name)
    assert made.accidents == ()
    track = made.track
    assert (np.diff(track.t_ns) > 0).all()
    navigating = track.column("mode") != Mode.ALIGNING
    assert np.isfinite(track.values[navigating]).all()
    assert navigating.mean() > 0.8
    assert np.hypot(track.column("vn_mps"), track.column("ve_mps"))[navigating].max() < 40.0
    assert found["aids"]["gnss_position"].get("rejected_gate", 0) < 0.02 * found["aids"]["gnss_position"]["fused"]


@pytest.mark.parametrize("start_s", [60.0, 90.0, 120.0, 150.0, 180.0])
def test_any_minute_without_gnss_in_stockholm_stays_on_the_block(start_s):
    _, found = fused("kth_stockholm", Outage(start_s, 60.0))
    # 20 m: a degree of heading and 3 % of speed over up to 700 m; the fixes compared with scatter by 3 m themselves.
    assert found["outage_rms_m"] < 20.0
