"""The calibration's figures as tables for people."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from service.bench import calibration_noise
from service.bench.calibration_targets import TURNED
from service.bench.tables import aligned, verdicts


def tables(found: Mapping[str, Any]) -> str:
    """One table a part, and at the end what is asked against what was measured."""
    makers: Mapping[str, Callable[[Any], Iterable[str]]] = {
        "minimiser": _minimiser,
        "units": _units,
        "repeated": _repeated,
        "gyroscope": _gyroscope,
        "recordings": _recordings,
        "noise": _noise,
        "left_out": _left_out,
        "targets": verdicts,
    }
    return "\n\n".join("\n".join(make(found[name])) for name, make in makers.items() if found.get(name))


def _minimiser(found: Mapping[str, Any]) -> Iterable[str]:
    yield "the dog leg beside SciPy's least_squares; iterations and ms, or what was not found:"
    names = list(found["missed"])
    rows = [("", "problem", *names)]
    for row in found["problems"]:
        cells = (_run(row["minimisers"][name]) for name in names)
        rows.append((row["collection"], row["problem"], *cells))
    yield from aligned(rows, left=(0, 1))


def _run(one: Mapping[str, Any]) -> str:
    return f"{one['iterations']} in {one['ms']:.1f} ms" if one["found"] else f"missed after {one['iterations']}"


def _units(found: Mapping[str, Any]) -> Iterable[str]:
    yield f"{found['units']} simulated units, {found['positions']} positions of 5 s; error against its stated sd:"
    rows = [("parameter", "RMS", "within 3 sd")]
    for name, outside in found["outside_3_sd"].items():
        rows.append((name, f"{found['rms_over_sd'][name]:.2f}", f"{100 * (1 - outside):.2f} %"))
    yield from aligned(rows)


def _repeated(found: Mapping[str, Any]) -> Iterable[str]:
    yield (f"variances over {found['recordings']} recordings of a unit, {found['units']} units; biases in g:")
    rows = [("", "mean", "largest", "seed 1, table 2")]
    for name, one in found["variances"].items():
        rows.append((name, *(f"{one[key]:.2e}" for key in ("mean", "largest", "seed1"))))
    yield from aligned(rows)


def _gyroscope(found: Mapping[str, Any]) -> Iterable[str]:
    yield from ("the gyroscope:", *_units(found["units"]))
    repeated = found["repeated"]
    for protocol, variances in repeated["variances"].items():
        yield ""
        yield (
            f"the gyroscope turned {TURNED[protocol]}; variances over {repeated['recordings']} recordings of a unit, "
            f"{repeated['units']} units; biases in rad/s:"
        )
        rows = [("", "mean", "largest", "least possible", "seed 1, table 3", "")]
        for name, one in variances.items():
            least, limit = one["cramer_rao"], one["seed1"]
            verdict = "out of reach" if least is not None and least > limit else ""
            told = "" if least is None else f"{least:.2e}"
            rows.append((name, f"{one['mean']:.2e}", f"{one['largest']:.2e}", told, f"{limit:.2e}", verdict))
        yield from aligned(rows)
    sure = math.sqrt(2.0 / (repeated["units"] * (repeated["recordings"] - 1)))
    yield (
        "least possible: Cramer-Rao, by the data sheet's white noise of the rates alone; a mean is sure to "
        f"{100.0 * sure:.0f} %"
    )
    asked = ", ".join(f"{turns:.0f} for {name}" for name, turns in found["least_turns"].items())
    yield (
        "whole turns a move, at the full scale of 250 deg/s and all for one product, that table 3 would take at "
        f"least: {asked}"
    )


def _recordings(found: Mapping[str, Any]) -> Iterable[str]:
    yield "recordings; scale, misalignment and bias with their sd:"
    for name, one in found.items():
        rms_mmps2 = 1e3 * one["residual_rms_mps2"]
        yield f"  {name}: {one['positions']} positions, |a| off by {rms_mmps2:.2f} mm/s2 RMS"
        values = (*one["scale"], *one["misalignment"], *one["bias"])
        pairs = [f"{value:.6g} ± {sd:.2g}" for value, sd in zip(values, one["sd"], strict=True)]
        for i in range(0, 9, 3):
            yield f"    {'  '.join(pairs[i : i + 3])}"
        if one["advice"]:
            yield f"    {one['advice']}"


def _noise(found: Mapping[str, Any]) -> Iterable[str]:
    yield f"{calibration_noise.ADIS}: {found['duration_s']:.0f} s at rest; 95 % intervals in brackets:"
    other = "floor, non-overlapping, deg/h"
    rows = [("axis", "random walk, deg/sqrt(h)", "floor, deg/h", "at, s", "spans of that", other)]
    for name, one in found["axes"].items():
        at = "" if one["floor_tau_s"] is None else f"{one['floor_tau_s']:.0f}"
        spans = "" if one["floor_tau_s"] is None else f"{found['duration_s'] / one['floor_tau_s']:.0f}"
        cells = _interval(one["random_walk"], 2), _interval(one["floor"], 1), at, spans
        rows.append((name, *cells, f"{one['floor_non_overlapping']:.1f}"))
    floor = "not reached" if found["floor_rms"] is None else f"{found['floor_rms']:.1f}"
    rows.append(("rms", f"{found['random_walk_rms']:.2f}", floor, "", "", ""))
    yield from aligned(rows)
    low, high = calibration_noise.FLOOR
    yield (
        f"outside {low:.0f} to {high:.0f} deg/h, found without overlapping: {found['floors_outside']} floors, "
        f"{found['floor_intervals_outside']} of them with their whole interval"
    )


def _interval(one: Mapping[str, float] | None, digits: int) -> str:
    if one is None:
        return "not reached"
    return f"{one['value']:.{digits}f} ({one['low']:.{digits}f} to {one['high']:.{digits}f})"


def _left_out(found: Mapping[str, str]) -> Iterable[str]:
    for part, name in found.items():
        yield f"{part}: left out, as there is no '{name}'; say by --recordings where the calibration recordings are"
