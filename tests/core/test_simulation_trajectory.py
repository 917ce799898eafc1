"""The simulated truth obeys physics: an independent strapdown, fed with its IMU, gets back its path."""

from __future__ import annotations

import math

import numpy as np
import pymap3d
import pytest

from core.earth import EARTH_RATE_RADPS, gravity_mps2
from core.errors import InvalidInputError
from core.rotation import matrix_from_rpy
from core.simulation.crashes import Crash
from core.simulation.route import RouteBuilder
from core.simulation.shapes import Shape, peak_rate, step
from core.simulation.trajectory import Place, Trajectory, drive

PLACE = Place(math.radians(40.4168), math.radians(-3.7038), 650.0, (25.0, 0.0, 36.0))
EARTH_RATE_E = np.array([0.0, 0.0, EARTH_RATE_RADPS])


def _busy_route() -> RouteBuilder:
    """Everything that the route can do, within some two minutes."""
    b = RouteBuilder(heading_deg=70.0)
    b.hold(5.0).to_speed(12.0).grade(5.0).hold(8.0).turn(80.0, 40.0).bump(0.06, 0.8, 2.0).hold(5.0)
    b.grade(-3.0).turn(-120.0, 45.0).change_lane(3.5).hold(10.0).to_speed(6.0, 3.0).turn(95.0, 9.0).hold(3.0)
    b.crash(Crash(3.8, pdof_deg=35.0, duration_s=0.25, shape=Shape.HALF_SINE, yaw_deg=-9.0)).roll_out().hold(5.0)
    b.to_speed(20.0, 2.5).hold(15.0).crash(Crash(10.0, pdof_deg=350.0, yaw_deg=14.0)).roll_out().hold(10.0)
    return b


@pytest.fixture(scope="module")
def truth() -> Trajectory:
    return drive(_busy_route().build(), PLACE, 200.0)


def _inertial_strapdown(truth: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Runge-Kutta 4 in the inertial frame over pairs of samples: ECEF positions, and their times.

    Shares no equation with the simulator, which solves the local-level navigation equations.
    """

    def earth_turned(t: float) -> np.ndarray:
        c, s = math.cos(EARTH_RATE_RADPS * t), math.sin(EARTH_RATE_RADPS * t)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    def gravitation_e(r_e: np.ndarray) -> np.ndarray:
        lat, lon, alt = pymap3d.ecef2geodetic(*r_e)
        lat, lon = math.radians(lat), math.radians(lon)
        down = -np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])
        return gravity_mps2(lat, float(alt)) * down + np.cross(EARTH_RATE_E, np.cross(EARTH_RATE_E, r_e))

    def rates(v, C, f, w, pull):
        skew = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        return v, C @ f + pull, C @ skew

    lat, lon = truth.lat_rad[0], truth.lon_rad[0]
    r = np.array(pymap3d.geodetic2ecef(math.degrees(lat), math.degrees(lon), truth.alt_m[0]))
    C_e_from_n = np.array(
        [
            [-math.sin(lat) * math.cos(lon), -math.sin(lon), -math.cos(lat) * math.cos(lon)],
            [-math.sin(lat) * math.sin(lon), math.cos(lon), -math.cos(lat) * math.sin(lon)],
            [math.cos(lat), 0.0, -math.sin(lat)],
        ]
    )
    v = C_e_from_n @ truth.v_n[0] + np.cross(EARTH_RATE_E, r)
    C = C_e_from_n @ matrix_from_rpy(*truth.rpy_rad[0])
    h = 2 * (truth.t_s[1] - truth.t_s[0])
    indices = range(0, truth.t_s.size - 2, 2)
    found = [r]
    for k in indices:
        t, f, w = truth.t_s[k], truth.f_b, truth.omega_b
        # Gravitation in the middle of the step, where the car is v h / 2 on: within 0.1 m its gradient is nothing.
        middle = earth_turned(t + h / 2)
        pull = middle @ gravitation_e(middle.T @ (r + v * h / 2))
        k1 = rates(v, C, f[k], w[k], pull)
        k2 = rates(v + h / 2 * k1[1], C + h / 2 * k1[2], f[k + 1], w[k + 1], pull)
        k3 = rates(v + h / 2 * k2[1], C + h / 2 * k2[2], f[k + 1], w[k + 1], pull)
        k4 = rates(v + h * k3[1], C + h * k3[2], f[k + 2], w[k + 2], pull)
        r = r + h / 6 * (k1[0] + 2 * k2[0] + 2 * k3[0] + k4[0])
        v = v + h / 6 * (k1[1] + 2 * k2[1] + 2 * k3[1] + k4[1])
        C = C + h / 6 * (k1[2] + 2 * k2[2] + 2 * k3[2] + k4[2])
        found.append(earth_turned(t + h).T @ r)
    return np.array(found), truth.t_s[[0, *(k + 2 for k in indices)]]


def test_an_independent_strapdown_gets_back_the_path(truth: Trajectory) -> None:
    r_e, t_s = _inertial_strapdown(truth)
    rows = np.searchsorted(truth.t_s, t_s - 1e-9)
    north_east_up = pymap3d.ecef2enu(
        *r_e.T, np.degrees(truth.lat_rad[rows]), np.degrees(truth.lon_rad[rows]), truth.alt_m[rows]
    )
    error_m = np.linalg.norm(north_east_up, axis=0)
    # Two minutes with two crashes and a bump: what is left is the strapdown's own 10 ms steps over the
    # pulses; a wrong sign of Coriolis alone would give 2 * 7e-5 * 12 m/s * t^2 / 2, some 10 m.
    assert truth.t_s[-1] > 100.0
    assert error_m.max() < 0.05


def test_velocity_is_the_rate_of_the_position(truth: Trajectory) -> None:
    east, north, up = pymap3d.geodetic2enu(
        np.degrees(truth.lat_rad),
        np.degrees(truth.lon_rad),
        truth.alt_m,
        np.degrees(truth.lat_rad[0]),
        np.degrees(truth.lon_rad[0]),
        truth.alt_m[0],
    )
    dt = truth.t_s[1] - truth.t_s[0]
    moved = np.stack([np.diff(north), np.diff(east), -np.diff(up)]) / dt
    mean_v = (truth.v_n[1:] + truth.v_n[:-1]).T / 2
    # Over 1.5 km the plane of the first position and the local one differ by 2.4e-4 rad: 5 mm/s at 20 m/s.
    # The mean of two velocities over 5 ms inside a 17 g pulse is off by dt^2 / 12 of the jerk.
    assert np.abs(moved - mean_v).max() < 0.02


def test_the_car_goes_where_it_points_but_for_crashes_and_springs(truth: Trajectory) -> None:
    v_right = -np.sin(truth.rpy_rad[:, 2]) * truth.v_n[:, 0] + np.cos(truth.rpy_rad[:, 2]) * truth.v_n[:, 1]
    crash_s = [t for t, _ in _busy_route().build().crashes]
    calm = np.all([(truth.t_s < t) | (truth.t_s > t + 1.5) for t in crash_s], axis=0)
    assert np.abs(v_right[calm]).max() < 1e-9
    assert np.abs(v_right).max() > 1.0


def test_at_rest_it_feels_gravity_and_the_turning_earth(truth: Trajectory) -> None:
    assert truth.f_b[0] == pytest.approx([0.0, 0.0, -gravity_mps2(PLACE.lat_rad, PLACE.alt_m)], abs=1e-12)
    assert np.linalg.norm(truth.omega_b[0]) == pytest.approx(EARTH_RATE_RADPS, rel=1e-12)


@pytest.mark.parametrize("pdof_deg", [0.0, 90.0, 180.0, 270.0, 35.0])
def test_a_crash_changes_velocity_by_its_delta_v_from_its_direction(pdof_deg: float) -> None:
    crash = Crash(4.0, pdof_deg=pdof_deg, duration_s=0.12)
    b = RouteBuilder(heading_deg=30.0).to_speed(10.0).hold(2.0)
    begin_s = b.t_s
    truth = drive(b.crash(crash).hold(1.0).build(), PLACE, 1000.0)
    before, after = np.searchsorted(truth.t_s, [begin_s, begin_s + crash.duration_s])
    change = truth.v_n[after] - truth.v_n[before]
    heading = math.radians(30.0)
    forward = change[0] * math.cos(heading) + change[1] * math.sin(heading)
    right = -change[0] * math.sin(heading) + change[1] * math.cos(heading)
    pdof = math.radians(pdof_deg)
    # 1 ms of the tyres' braking of the slide (7 m/s2) may lie between the sample and the pulse's end.
    assert forward == pytest.approx(-4.0 * math.cos(pdof), abs=0.01)
    assert right == pytest.approx(-4.0 * math.sin(pdof), abs=0.01)
    felt = np.hypot(truth.f_b[before:after, 0], truth.f_b[before:after, 1]).max()
    # Roll and pitch of a degree mix gravity into the level axes.
    assert felt == pytest.approx(crash.peak_mps2, abs=0.5)


def test_a_bump_lifts_the_car_and_lets_it_down_again() -> None:
    b = RouteBuilder().to_speed(8.0).hold(3.0).bump(0.08, 1.0)
    truth = drive(b.hold(8.0).build(), PLACE, 200.0)
    risen = truth.alt_m - truth.alt_m[0]
    assert 0.01 < risen.max() < 0.12
    # The flat road falls away from the level plane by d^2 / 2R, under a millimetre here.
    assert abs(risen[-1]) < 1e-3
    assert np.abs(truth.f_b[:, 2] + 9.8).max() > 3.0


@pytest.mark.parametrize("shape", list(Shape))
def test_steps_go_from_zero_to_one_and_their_rate_is_their_derivative(shape: Shape) -> None:
    x = np.linspace(0.0, 1.0, 20001)
    value, rate = step(shape, x)
    assert value[0] == pytest.approx(0.0, abs=1e-12)
    assert value[-1] == pytest.approx(1.0, abs=1e-12)
    assert (rate >= 0.0).all()
    assert rate[[0, -1]] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert rate.max() == pytest.approx(peak_rate(shape), rel=1e-6)
    # Central differences of a function whose second derivative is bounded by 300: h * 300 / 2.
    assert np.abs(np.gradient(value, x) - rate)[1:-1].max() < 0.01


def test_what_cannot_be_driven_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="turn of radius"):
        RouteBuilder().turn(90.0, 10.0)
    with pytest.raises(InvalidInputError, match="rate_hz is 5"):
        drive(RouteBuilder().hold(10.0).build(), PLACE, 5.0)
    with pytest.raises(InvalidInputError, match=r"0\.5 to 25"):
        Crash(90.0)
