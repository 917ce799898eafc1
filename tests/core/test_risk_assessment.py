"""The assessment of instants: the paper's scenario 1 whole, what is left out, what uncertainty does, and smoothness."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.errors import InvalidInputError
from core.risk.assessment import assess
from core.risk.belief import THETA, mass_of, named, pignistic
from core.risk.driver import Driver
from core.risk.environment import Environment, Road
from core.risk.lookup import tables_of
from core.risk.motion import Motion
from core.risk.vehicle import vehicle_of
from service.risk.loading import risk_model, vehicle_model

MONDAY_16_H_NS = 1_463_428_800_000_000_000
"""2016-05-16T20:00Z, 16 h in Montréal."""
MONTREAL_S = -4 * 3600.0


def surroundings(n=1, **road):
    known = {"limit_kmh": np.nan, "kind": "", "surroundings": "", "district": "", "position_sd_m": 0.0} | road
    columns = {name: np.broadcast_to(np.asarray(value), n).copy() for name, value in known.items()}
    ones = np.ones(n)
    t_ns = MONDAY_16_H_NS + np.arange(n) * 1_000_000_000
    return Environment(t_ns, MONTREAL_S, np.radians(45.5) * ones, np.radians(-73.6) * ones, Road(**columns))


def driven(speed_kmh, forward=0.0, right=0.0, speed_sd=0.0, acceleration_sd=0.0):
    columns = np.broadcast_arrays(np.asarray(speed_kmh) / 3.6, forward, right, speed_sd, acceleration_sd)
    return Motion(*(np.atleast_1d(np.array(column, float)) for column in columns))


LOST = driven(np.nan, np.nan, np.nan, np.nan, np.nan)
TOWN = {"limit_kmh": 50.0, "kind": "primary", "surroundings": "urban"}


def risk_of(motion, **road):
    """The vehicle's risk alone, by day."""
    n = len(motion.speed_mps)
    return vehicle_model().assess(motion, surroundings(n, **(TOWN | road)).road, np.full(n, 0.5))


def test_scenario_1_of_the_paper_from_its_tables():
    found = assess(risk_model("paper"), Driver(32, "M"), surroundings(district="Ville-Marie"), LOST)
    environment = mass_of({"MR": 0.25, "HR": 0.5, "MR|HR": 0.25})
    assert found.entities["environment"][0] == pytest.approx(environment, abs=1e-12)
    told = {name: round(mass, 4) for name, mass in named(found.fused[0]).items() if mass}
    assert told == {"MR": 0.5250, "HR": 0.1212, "LR|MR": 0.1114, "LR|MR|HR": 0.2424}
    assert found.coverage["driver.age_sex"].tolist() == [1.0]
    assert found.coverage["vehicle.motion"].tolist() == [0.0]


def test_what_is_not_known_is_left_out_and_covers_nothing():
    nobody = assess(risk_model(), Driver(), surroundings(), driven(30.0))
    assert set(nobody.entities) == {"environment", "vehicle"}
    for name in ("driver.age", "driver.sex", "driver.experience", "environment.road_class", "vehicle.speed"):
        assert nobody.coverage[name].tolist() == [0.0]
    assert nobody.fused[0, THETA] == 0.0
    elsewhere = assess(risk_model("paper"), Driver(50, "F"), surroundings(district="Laval"), driven(30.0))
    assert "driver" not in elsewhere.entities
    assert elsewhere.coverage["environment.district"].tolist() == [0.0]
    assert elsewhere.coverage["environment.hour"].tolist() == [1.0]


def test_each_instant_is_fused_of_the_sources_that_know_it():
    kinds = np.array(["primary", "", "residential", ""])
    road = {"kind": kinds, "surroundings": np.where(kinds == "", "", "rural")}
    together = assess(risk_model(), Driver(32, "M"), surroundings(4, **road), driven([30.0] * 4))
    for i in range(4):
        one = {name: column[i] for name, column in road.items()}
        environment = surroundings(1, **one)
        environment = replace(environment, t_ns=environment.t_ns + i * 1_000_000_000)
        alone = assess(risk_model(), Driver(32, "M"), environment, driven(30.0))
        assert (together.fused[i] == alone.fused[0]).all()
    assert together.coverage["environment.road_class"].tolist() == [1.0, 0.0, 1.0, 0.0]


def test_speed_against_the_limit():
    speeds = driven([30.0, 50.0, 55.0, 60.0, 90.0])
    assert risk_of(speeds).risk == pytest.approx([0.0, 0.0, 0.5, 1.0, 1.0], abs=1e-12)
    outside = risk_of(speeds, limit_kmh=50.0, surroundings="rural", kind="trunk")
    assert outside.risk == pytest.approx([0.0, 0.0, 0.25, 0.5, 1.0], abs=1e-12)
    assert outside.excess_kmh == pytest.approx([-20.0, 0.0, 5.0, 10.0, 40.0])
    among_people = risk_of(speeds, kind="living_street")
    assert among_people.risk[2] == pytest.approx(1.0)
    night = vehicle_model().assess(speeds, surroundings(5, **TOWN).road, np.full(5, -0.5))
    assert night.risk == pytest.approx([0.0, 0.0, 1.0, 1.0, 1.0], abs=1e-12)


def test_accelerations_in_the_g_g_diagram():
    forward = np.array([0.0, -3.0, -4.0, 2.8, 0.0, 0.0, 0.0, -3.0])
    right = np.array([0.0, 0.0, 0.0, 0.0, 2.0, -3.0, 4.0, 3.0])
    assert risk_of(driven(np.full(8, 40.0), forward, right)).risk == pytest.approx(
        [0.0, 0.5, 1.0, 0.5, 0.0, 0.5, 1.0, 1.0], abs=1e-12
    )


def test_less_lateral_acceleration_is_borne_at_speed():
    by_speed = [risk_of(driven(v, 0.0, 1.9), limit_kmh=130.0, surroundings="rural", kind="motorway").risk[0]
                for v in (40.0, 80.0, 100.0, 130.0)]  # fmt: skip
    assert by_speed[0] == 0.0
    assert by_speed == sorted(by_speed)
    assert by_speed[-1] > 0.9


@pytest.mark.parametrize("limit", [0.0, 999.0, -30.0, np.nan])
def test_a_limit_that_is_none_is_not_known(limit):
    found = risk_of(driven(90.0), limit_kmh=limit)
    assert np.isnan(found.speed_risk).all()
    assert found.coverage["speed"].tolist() == [0.0]
    assert found.risk.tolist() == [0.0]
    assert found.bad_limits == (0 if np.isnan(limit) else 1)


def test_where_the_law_knows_no_limit_the_recommended_speed_counts():
    motorway = {"limit_kmh": np.inf, "surroundings": "rural", "kind": "motorway"}
    assert risk_of(driven([130.0, 150.0]), **motorway).risk == pytest.approx([0.0, 1.0], abs=1e-12)


def test_doubt_goes_to_theta_and_out_of_the_coverage():
    """Class widths in town: 5 km/h, of which half is 0.69 m/s: one sd of it leaves .317 beyond."""
    half_mps = 2.5 / 3.6
    doubtful = risk_of(driven(55.0, speed_sd=half_mps))
    assert doubtful.mass[0, THETA] == pytest.approx(0.3173105, abs=1e-7)
    assert doubtful.coverage["speed"][0] == pytest.approx(1.0 - 0.3173105, abs=1e-7)
    assert doubtful.coverage["motion"].tolist() == [1.0]
    assert risk_of(driven(55.0, speed_sd=half_mps / 4.0)).mass[0, THETA] == 0.0, "a chance of 6e-5 is no doubt"
    assert risk_of(driven([10.0, 90.0], speed_sd=half_mps)).mass[:, THETA].tolist() == [0.0, 0.0], "far from any other"
    assert risk_of(driven(30.0, right=3.0, acceleration_sd=0.5)).mass[0, THETA] == pytest.approx(0.3173105, abs=1e-7)
    assert risk_of(driven(30.0, acceleration_sd=0.5)).mass[0, THETA] == 0.0
    assert risk_of(driven(90.0), position_sd_m=25.0).mass[0, THETA] == pytest.approx(0.3173105, abs=1e-7)
    unknown = risk_of(driven(90.0), limit_kmh=np.nan, position_sd_m=500.0)
    assert unknown.mass[0, THETA] == 0.0, "nothing that depends on the position is known"


def test_a_doubtful_place_makes_district_and_road_doubtful():
    table = {"name": "district", "entity": "environment", "source": "a choice",
             "rows": [{"when": {"district": "Here"}, "mass": {"HR": 1.0}}]}  # fmt: skip
    model = replace(risk_model(), tables=tables_of({"table": [table]}))
    found = assess(model, Driver(), surroundings(2, district="Here", position_sd_m=[0.0, 250.0]), driven([0.0, 0.0]))
    assert found.coverage["environment.district"] == pytest.approx([1.0, 1.0 - 0.3173105], abs=1e-7)
    assert found.entities["environment"][:, THETA] == pytest.approx([0.0, 0.3173105], abs=1e-7)


@pytest.mark.parametrize("limit", [50.0, np.nan])
def test_a_small_error_of_navigation_makes_a_small_error_of_masses(limit):
    """Through all speeds and accelerations in steps of 0.01 km/h and 0.01 m/s2 no mass jumps: by at most 2 % a step,
    where the steepest flank goes from one class to the next over 5 km/h and 1 m/s2."""
    steps = np.arange(0.0, 100.0, 0.01)
    speeding = risk_of(driven(steps), limit_kmh=limit)
    turning = risk_of(driven(np.full(1000, 40.0), right=np.arange(0.0, 10.0, 0.01)), limit_kmh=limit)
    for found in (speeding, turning):
        assert np.abs(np.diff(found.mass, axis=0)).max() < 0.1
    at_limit = risk_of(driven([50.0, 50.1]), limit_kmh=limit)
    assert at_limit.risk[1] - at_limit.risk[0] < 1e-3, "no kink at the limit, where people drive"


def test_attribution_of_entities_sums_to_the_mean_over_knowing_nothing():
    found = assess(risk_model(), Driver(20, "M"), surroundings(3, **TOWN), driven([30.0, 56.0, 80.0]))
    shares = found.attribution()
    total = sum(shares.values())
    assert total == pytest.approx(pignistic(found.fused).mean(axis=0) - 1 / 3, abs=1e-12)
    slow, fast = (assess(risk_model(), Driver(20, "M"), surroundings(**TOWN), driven(v)) for v in (30.0, 80.0))
    assert fast.attribution()["vehicle"][2] > 0.0 > slow.attribution()["vehicle"][2]


def test_what_is_no_model_of_the_vehicle_is_refused():
    with pytest.raises(InvalidInputError, match=r"no section \[speeding\]"):
        vehicle_of({})
    numbers = dict(vehicle_model().numbers)
    with pytest.raises(InvalidInputError, match=r"\[setting\] has no number for 'motorway'"):
        vehicle_of(numbers | {"setting": {}})
    with pytest.raises(InvalidInputError, match="five risks that rise"):
        vehicle_of(numbers | {"masses": {"risk": [0, 1, 1, 2, 3]}})
