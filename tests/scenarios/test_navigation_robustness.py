"""Given drives, when a receiver, a clock or a sensor fails, then the navigation stays sound, honest, and comes back."""

from __future__ import annotations

import pytest

from tests.robustness import CASES, DRIVES, OWN_SOLUTION, RECOVERY_S, measured

EACH = [(case, drive) for case in CASES for drive in DRIVES if case != "frozen speed" or drive in ("highway 1", "kth")]
each = pytest.mark.parametrize(("case", "drive"), EACH, ids=[f"{case}-{drive}" for case, drive in EACH])

SHARE = 0.99
"""Of the instants outside the faults, inside three sd: the issue's figure. A normal error is so for 99.7 %."""

UNNOTICED = (
    "outliers", "short jump", "late", "drops", "gaps", "duplicates", "saturation", "temperature", "temperature unsaid",
    "not a number",
)  # fmt: skip
"""Faults that must not show at all: what is wrong is alone against everything else, or is in no reading used."""

# Faults that inertial samples contradict at once. Not among them: a spoofer that begins where the truth is and drags
# off by 0.4 m/s2, no more than level and bias may be off by, and reflections that drift off by 1 m/s.
REFUSED = {
    "outliers": "gnss_position.rejected_gate",
    "short jump": "gnss_position.rejected_gate",
    "jump": "gnss_position.rejected_gate",
    "duplicates": "imu.rejected_time",
    "not a number": "imu.rejected_range",
    "clock 3 s back": "clock.stepped_back",
    "clock 30 s back": "clock.stepped_back",
}
AT_MOST_M = {
    # Believed after some seconds, as nothing else says where the vehicle is: then wrong by the fault and no more. 25 %
    # and 10 m: a step that is taken over swings the heading.
    "jump": 60.0 * 1.25 + 10.0,
    "multipath ramp": 20.0 * 1.25 + 10.0,
    "spoof": 60.0 * 1.25 + 10.0,
    "slow spoof": 20.0 * 1.25 + 10.0,
    # A second at 33 m/s.
    "receiver clock ahead": 33.0 * 1.25,
    "receiver clock behind": 33.0 * 1.25,
    # A fix repeated to the last bit while the vehicle moves tells nothing: as bad as none for so long, no worse.
    "frozen": 20.0,
    "frozen at rest": 20.0,
    "frozen for long": 60.0,
    "frozen speed": 20.0,
    # Of 5 s without an axis: 2 m/s2 unseen, 25 m; 0.2 rad/s unseen at 10 m/s, 25 m.
    "stuck gyroscope": 25.0,
    "stuck accelerometer": 25.0,
    "long gaps": 25.0,
}


def pooled(case, drives):
    """Share of the instants outside the fault inside three sd, the worst axis, over drives; and the figures."""
    all_figures = [measured(case, drive) for drive in drives]
    instants = sum(one.instants_outside for one in all_figures)
    shares = [sum(f.share_outside[axis] * f.instants_outside for f in all_figures) / instants for axis in range(3)]
    return min(shares), "\n".join(map(str, all_figures))


@each
def test_the_state_stays_finite_and_its_covariance_symmetric_and_positive(case, drive):
    found = measured(case, drive)
    assert found.finite, found
    # Relative to the spreads: rounding of sums of a few hundred products, between two rounds of symmetrising.
    assert found.asymmetry < 1e-9, found
    assert found.least_eigenvalue > 0.0, found


@each
def test_ten_seconds_of_good_fixes_bring_it_back(case, drive):
    found = measured(case, drive)
    assert found.recovery_s <= RECOVERY_S, found


@pytest.mark.parametrize(
    ("case", "against"),
    [
        (case, against)
        for case in ("undisturbed", *(case for case in CASES if not case.startswith("temperature")))
        for against in ("truth", "own solution")
    ],
)
def test_outside_the_fault_errors_are_inside_three_sd(case, against):
    drives = [drive for drive in DRIVES if (drive in OWN_SOLUTION) == (against == "own solution")]
    share, told = pooled(case, drives)
    assert share >= SHARE, told


@pytest.mark.parametrize(("case", "drive"), [(case, drive) for case in UNNOTICED for drive in DRIVES])
def test_what_need_not_disturb_does_not(case, drive):
    found = measured(case, drive)
    assert min(found.share_inside) >= SHARE, found
    # Nothing is found anew that is not without the fault, as in the canyon of one of the drives.
    assert found.refused.get("gnss_position.reset", 0) <= 0, found
    assert found.refused.get("imu.reset", 0) <= 0, found


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize(("case", "count"), REFUSED.items(), ids=REFUSED.keys())
def test_what_is_refused_is_counted(case, count, drive):
    found = measured(case, drive)
    assert found.refused.get(count, 0) > 0, found


@pytest.mark.parametrize(
    ("case", "drive"),
    [(case, drive) for case, drive in EACH if case in AT_MOST_M],
    ids=[f"{case}-{drive}" for case, drive in EACH if case in AT_MOST_M],
)
def test_what_cannot_be_told_from_the_truth_errs_no_further_than_it(case, drive):
    found = measured(case, drive)
    assert found.max_inside_m <= AT_MOST_M[case], found
