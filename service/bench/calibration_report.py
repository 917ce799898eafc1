"""The calibration's figures as tables for people."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from service.bench.tables import aligned, verdicts


def tables(found: Mapping[str, Any]) -> str:
    """One table a part, and at the end what is asked against what was measured."""
    makers: Mapping[str, Callable[[Any], Iterable[str]]] = {
        "minimiser": _minimiser,
        "units": _units,
        "repeated": _repeated,
        "recordings": _recordings,
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
