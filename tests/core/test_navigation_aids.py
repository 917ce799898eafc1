"""Every aid takes away the errors that it sees, and leaves a record of it."""

from __future__ import annotations

import math

import pytest

from core.earth import radii_m
from core.measurements import GNSS
from core.navigation import state
from core.navigation.state import (
    ATT,
    BARO_BIAS,
    GNSS_DELAY,
    GNSS_ERROR,
    GYRO_BIAS,
    MOUNT_PITCH,
    MOUNT_YAW,
    POS,
    SPEED_SCALE,
    VEL,
)
from core.navigation.tuning import Tuning
from tests.navigation_cases import (
    ALT,
    LAT,
    NOW_NS,
    SCALE,
    Case,
)

SECOND_ORDER = 0.02
"""Share of an error that one exact update may leave: the measurement's own spread (below 0.5 %) and, of an angle
of 4 mrad or a scale of 0.5 %, its products with itself and the other states' estimates."""


@pytest.mark.parametrize(
    ("index", "error", "sd"),
    [
        (POS, 2.0, 5.0),
        (POS + 1, -2.0, 5.0),
        (POS + 2, 3.0, 5.0),
        (ATT, 4e-3, 0.1),
        (ATT + 1, -4e-3, 0.1),
        (ATT + 2, 4e-3, 0.1),
        (GNSS_ERROR, 2.0, 5.0),
        (GNSS_ERROR + 1, -2.0, 5.0),
        (GNSS_ERROR + 2, 3.0, 5.0),
        (GNSS_DELAY, 0.1, 0.3),
    ],
)
def test_a_position_takes_away_what_it_sees(index, error, sd):
    case = Case.of(index, error, sd)
    assert case.left(index) == pytest.approx(error, rel=1e-3)
    # Of an attitude error the height row and the gate leave out what the lever arm makes: no height, and 2 mm.
    assert case.position(case.fix(alt_m=math.nan, sd_h_m=2e-3) if ATT <= index < ATT + 3 else case.fix())
    assert abs(case.left(index)) < SECOND_ORDER * abs(error)
    assert case.counts[state.A_POSITION, state.FUSED] == 1


@pytest.mark.parametrize(
    ("index", "error", "form"),
    [
        (VEL, 0.3, "velocity"),
        (VEL + 1, 0.3, "velocity"),
        (VEL + 2, 0.3, "velocity"),
        (GNSS_DELAY, 0.1, "velocity"),
        (VEL, 0.3, "course"),
        (VEL + 1, 0.3, "course"),
        (GNSS_DELAY, -0.1, "course"),
    ],
)
def test_a_velocity_takes_away_what_it_sees(index, error, form):
    case = Case.of(index, error, 1.0)
    fix = case.fix()
    if form == "course":
        north, east = fix[GNSS["vn_mps"]], fix[GNSS["ve_mps"]]
        nothing = dict.fromkeys(("vn_mps", "ve_mps", "vd_mps"), math.nan)
        fix = case.fix(speed_mps=math.hypot(north, east), course_rad=math.atan2(east, north) % math.tau, **nothing)
    case.velocity(fix)
    assert abs(case.left(index)) < SECOND_ORDER * abs(error)
    assert case.counts[state.A_VELOCITY, state.FUSED] == 1


@pytest.mark.parametrize(
    ("index", "error", "sd"),
    [
        (VEL, 0.2, 1.0),
        (VEL + 1, 0.2, 1.0),
        (VEL + 2, -0.2, 1.0),
        (ATT, 4e-3, 0.1),
        (ATT + 1, 4e-3, 0.1),
        (ATT + 2, -4e-3, 0.1),
        (MOUNT_PITCH, 4e-3, 0.1),
        (MOUNT_YAW, -4e-3, 0.1),
    ],
)
def test_going_where_the_wheels_point_takes_away_what_it_sees(index, error, sd):
    case = Case.of(index, error, sd)
    case.going_straight()
    assert abs(case.left(index)) < SECOND_ORDER * abs(error)
    assert case.counts[state.A_NHC, state.FUSED] == 2


@pytest.mark.parametrize(
    ("index", "error", "sd"),
    [
        (VEL, 0.2, 1.0),
        (VEL + 1, 0.2, 1.0),
        (VEL + 2, -0.2, 10.0),
        (ATT, 4e-3, 0.3),
        (ATT + 1, 4e-3, 0.3),
        (ATT + 2, -4e-3, 0.3),
        (SPEED_SCALE, 5e-3, 0.1),
        (MOUNT_PITCH, 4e-3, 0.3),
        (MOUNT_YAW, -4e-3, 0.3),
    ],
)
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_wheel_speed_takes_away_what_it_sees(index, error, sd, way):
    # Sliding sideways and lifting, so that attitude and mounting are seen along the forward axis too.
    case = Case.of(index, error, sd, v_vehicle=(way * 12.0, 4.0, -3.0))
    case.speed((1.0 + SCALE) * 12.0)  # the same when it reverses
    assert abs(case.left(index)) < SECOND_ORDER * abs(error)
    assert case.counts[state.A_SPEED, state.FUSED] == 1


@pytest.mark.parametrize(
    ("index", "error", "sd"),
    [*((VEL + i, 0.05, 1.0) for i in range(3)), *((GYRO_BIAS + i, 1e-3, 1e-2) for i in range(3))],
)
def test_standing_takes_away_what_it_sees(index, error, sd):
    case = Case.of(index, error, sd, v_vehicle=(0.0, 0.0, 0.0))
    case.standing()
    assert abs(case.left(index)) < SECOND_ORDER * abs(error)
    assert case.counts[state.A_ZUPT, state.FUSED] == case.counts[state.A_ZARU, state.FUSED] == 1


@pytest.mark.parametrize(("index", "error", "sd"), [(ATT, 4e-3, 0.1), (ATT + 2, -0.05, 0.3)])
def test_a_magnetic_field_takes_away_what_it_sees(index, error, sd):
    # A tilt about east moves no field that points north, so it is not seen.
    case = Case.of(index, error, sd)
    case.magnetic()
    assert abs(case.left(index)) < SECOND_ORDER * abs(error)
    assert case.counts[state.A_MAGNETOMETER, state.FUSED] == 1


@pytest.mark.parametrize(("index", "error", "sd"), [(POS + 2, -3.0, 5.0), (BARO_BIAS, 40.0, 100.0)])
def test_an_air_pressure_takes_away_what_it_sees(index, error, sd):
    case = Case.of(index, error, sd)
    case.barometer()
    assert abs(case.left(index)) < SECOND_ORDER * abs(error)
    assert case.counts[state.A_BAROMETER, state.FUSED] == 1


def test_an_aid_leaves_one_record_an_axis_of_what_it_measured():
    case = Case.of(POS, 2.0, 5.0)
    case.position(case.fix())
    axes = (state.A_POSITION, 0), (state.A_POSITION, 1), (state.A_HEIGHT, 0)
    north, east, height = (case.records.of(aid, axis) for aid, axis in axes)
    assert len(case.records.t_ns) == len(north.t_ns) + len(east.t_ns) + len(height.t_ns) == 3
    innovation = [float(one.column("innovation")[0]) for one in (north, east, height)]
    assert innovation == pytest.approx([2.0, 0.0, 0.0], abs=1e-4)
    variance = [float(one.column("variance")[0]) for one in (north, east, height)]
    assert variance == pytest.approx([25.0 + 1e-6, 1e-6, 1e-6], rel=1e-6)
    assert north.column("ratio")[0] == pytest.approx(2.0**2 / 25.0 / Tuning().gate_position, rel=1e-3)
    assert (case.records.column("outcome") == state.FUSED).all()


@pytest.mark.parametrize("heading", [0.1, 2.2, -1.6])
def test_a_position_moves_with_the_vehicle_between_its_time_and_now(heading):
    case = Case.of(POS, 0.0, 5.0)
    lag_s, fix = 0.4, case.fix()
    v_n = case.truth[state.X_V : state.X_V + 3]
    meridian, transverse = radii_m(LAT)
    fix[GNSS["lat_rad"]] -= lag_s * v_n[0] / (meridian + ALT)
    fix[GNSS["lon_rad"]] -= lag_s * v_n[1] / ((transverse + ALT) * math.cos(LAT))
    before_ns = NOW_NS - round(lag_s * 1e9)
    case.position(fix, before_ns)
    assert abs(case.left(POS)) < 1e-3


def test_spreads_come_from_the_receiver_then_from_dilution_then_from_the_default():
    def spread_after(**said):
        case = Case.of(POS, 0.0, 1e3, tuning=Tuning())
        unsaid = dict.fromkeys(("sd_h_m", "sd_v_m"), math.nan)
        case.position(case.fix(**(unsaid | said)))
        return math.sqrt(case.p[0])

    t = Tuning()
    assert spread_after(sd_h_m=4.0, hdop=1.0) == pytest.approx(4.0, rel=1e-4)  # P before is 1000 m: a share of 1e-5
    assert spread_after(sd_h_m=0.01) == pytest.approx(t.gnss_sd_floor_m, rel=1e-4)
    assert spread_after(hdop=1.5) == pytest.approx(1.5 * t.gnss_uere_m, rel=1e-4)
    assert spread_after() == pytest.approx(t.gnss_sd_h_m, rel=1e-4)


def test_the_air_adds_to_what_the_geometry_of_the_sky_does_to_heights():
    case = Case.of(POS + 2, 0.0, 1e3, tuning=Tuning())
    case.position(case.fix(hdop=1.2, vdop=2.0, sd_h_m=math.nan, sd_v_m=math.nan))
    t = Tuning()
    expected_m = 2.0 * t.gnss_uere_m * t.gnss_height_factor
    assert math.sqrt(case.p[(POS + 2) * (state.N_STATES + 1)]) == pytest.approx(expected_m, rel=1e-4)
