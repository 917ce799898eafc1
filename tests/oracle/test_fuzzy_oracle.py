"""The three fuzzy systems against scikit-fuzzy, over the whole range of their inputs."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from core.risk.fuzzy import POINTS
from service.risk.loading import vehicle_model

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import skfuzzy

AGREES = 1e-9
"""Both sum the same trapezoids over the same points, in another order."""
RANGES = {
    "speed": {"excess": (-3.0, 4.0), "darkness": (0.0, 1.0)},
    "motion": {"lateral": (0.0, 6.0), "longitudinal": (-6.0, 6.0)},
    "vehicle": {"speed": (0.0, 1.0), "motion": (0.0, 1.0), "setting": (0.0, 1.0)},
}


def degree(one, x):
    """Membership by scikit-fuzzy's own functions; a shoulder is far away."""
    a, b, c, d = one.foot_left, one.core_left, one.core_right, one.foot_right
    if not one.rounded:
        return skfuzzy.trapmf(x, [a, b, c, d])
    rising = np.ones_like(x) if np.isinf(a) else skfuzzy.smf(x, a, b)
    falling = np.ones_like(x) if np.isinf(d) else skfuzzy.zmf(x, c, d)
    return np.minimum(rising, falling)


def inferred(system, values):
    """One instant, by scikit-fuzzy's memberships, maximum, minimum and centroid."""
    universe = np.linspace(*system.span, POINTS)
    outline = np.zeros(POINTS)
    for rule in system.rules:
        fires = min(
            max(float(degree(system.inputs[name][term], np.array([values[name]]))[0]) for term in terms)
            for name, terms in rule.when.items()
        )
        outline = np.fmax(outline, np.fmin(fires, degree(system.output[rule.then], universe)))
    return skfuzzy.defuzz(universe, outline, "centroid")


@pytest.mark.parametrize("name", RANGES)
def test_inference_agrees_with_scikit_fuzzy(name):
    system = getattr(vehicle_model(), name)
    rng = np.random.default_rng(5)
    values = {variable: rng.uniform(*bounds, 150) for variable, bounds in RANGES[name].items()}
    ours = system.infer(**values)
    theirs = [inferred(system, {variable: column[i] for variable, column in values.items()}) for i in range(150)]
    assert ours == pytest.approx(theirs, abs=AGREES)


@pytest.mark.parametrize("name", RANGES)
def test_every_input_has_an_answer_and_both_ends_are_reached(name):
    system = getattr(vehicle_model(), name)
    axes = [np.linspace(low, high, 41) for low, high in RANGES[name].values()]
    grid = np.array(np.meshgrid(*axes)).reshape(len(axes), -1)
    risk = system.infer(**dict(zip(RANGES[name], grid, strict=True)))
    assert np.isfinite(risk).all()
    assert (risk.min(), risk.max()) == pytest.approx((0.0, 1.0), abs=1e-12)
