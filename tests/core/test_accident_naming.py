"""What shakes a car or a box and is no accident has the name of what it was."""

from __future__ import annotations

import csv
import gzip

import numpy as np
import pytest

from core.accident.events import NoAccident
from core.accident.naming import NamingThresholds
from core.accident.shocks import rises
from core.simulation.corpus import quiet_case
from core.simulation.disturbances import NonAccident as Happening
from tests.crash_timelines import EPOCH_NS, IMPACT_S, G, drive, find, named
from tests.recordings import recording


def test_a_box_that_falls_freely_before_it_strikes_is_a_box_and_no_car():
    motion = drive((3.3, 1.5, 0.3, -3.4, 0.05), falls=[(3.0, 3.3)])
    t_s = (motion.t_ns - EPOCH_NS) * 1e-9
    motion.omega_b[(t_s >= 3.0) & (t_s < 3.5)] += [1.0, 2.0, 0.0]  # it tumbles
    assert find(motion) == []
    assert named(motion) == [NoAccident.BOX_DROPPED]


@pytest.mark.parametrize("speed_mps", [0.75, 0.85, 1.0])
def test_a_kerb_stone_that_stops_a_crawling_car_is_none_though_the_speed_is_off_by_its_own_sd(speed_mps):
    bump = (IMPACT_S, -1.3, 0.1, 0.0, 0.12)  # 1 m/s and a third of it back
    assert find(drive(bump, speed_mps=speed_mps)) == []
    assert len(find(drive((IMPACT_S, -2.2, 0.1, 0.0, 0.12), speed_mps=speed_mps))) == 1


def test_what_tips_a_box_more_than_it_pushes_it_is_a_hand_and_no_crash():
    motion = drive((IMPACT_S, 1.4, 0.8, 0.3, 0.09))
    since = np.maximum((motion.t_ns - EPOCH_NS) * 1e-9 - IMPACT_S, 0.0)
    assert len(find(motion)) == 1
    motion.omega_b[:, 0] += 3.0 * np.sin(50.0 * since) * np.exp(-12.0 * since)
    assert find(motion) == []


@pytest.mark.parametrize(
    ("kind", "seed", "name"),
    [
        (Happening.RAILWAY_CROSSING, 1034, NoAccident.RAILWAY_CROSSING),
        (Happening.RAILWAY_CROSSING, 1353, NoAccident.RAILWAY_CROSSING),
        (Happening.POTHOLE, 1042, NoAccident.POTHOLE),
        (Happening.VIBRATION, 1123, NoAccident.VIBRATION_TRAIN),
        (Happening.KERB, 1036, NoAccident.KERB),
        (Happening.TRAILER_COUPLING, 1002, NoAccident.TRAILER_COUPLING),
        (Happening.DOOR_SLAM, 1008, NoAccident.DOOR_SLAM),
        (Happening.BOOT_SLAM, 1008, NoAccident.DOOR_SLAM),
    ],
)
def test_what_shakes_a_car_has_the_name_of_how_it_shakes(kind, seed, name):
    assert set(named(quiet_case(kind, seed).motion)) == {name}


def test_a_box_that_lay_half_way_and_creeps_over_the_limit_is_no_rollover():
    motion = drive(seconds=14.0)
    t_s = (motion.t_ns - EPOCH_NS) * 1e-9
    roll = np.radians(55.0) * np.clip((t_s - 3.0) / 0.3, 0.0, 1.0) + np.radians(10.0) * np.clip((t_s - 6.0) / 4.0, 0, 1)
    motion.down_b[:] = np.column_stack([np.zeros_like(roll), np.sin(roll), np.cos(roll)])
    motion.f_b[:] += G * (np.array([0.0, 0.0, 1.0]) - motion.down_b)
    motion.omega_b[:, 0] += np.gradient(roll, t_s)
    assert find(motion) == []


def test_recorded_bumps_lift_a_car_first_and_recorded_potholes_let_it_sink_first():
    path = recording("data", "shocks_road_anomalies_2017", "road_anomalies.csv.gz")
    series, limit = {}, NamingThresholds().rises
    with gzip.open(path, "rt") as file:
        for row in csv.DictReader(file):
            series.setdefault((row["label"], row["series"]), []).append(float(row["acc_z"]))
    lifted = {"asphalt_bumps": [], "metal_bumps": [], "potholes": []}
    for (label, _), up in series.items():
        if label in lifted:
            down = np.median(up) - np.array(up)  # 50 Hz, gravity and its scale's error left out
            lifted[label].append(rises(np.arange(len(up), dtype=np.int64) * 20_000_000, down) > limit)
    assert {label: len(found) for label, found in lifted.items()} == dict.fromkeys(lifted, 100)
    assert sum(lifted["asphalt_bumps"]) >= 70  # 78, 94 and 12 when it was written
    assert sum(lifted["metal_bumps"]) >= 85
    assert sum(lifted["potholes"]) <= 20
