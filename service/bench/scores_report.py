"""The scores' figures as tables for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from service.bench.tables import aligned


def tables(found: Mapping[str, Any]) -> str:
    """Lift, calibration, deciles, stability, intervals, wrong models."""
    claims, drivers = found["claims"], found["drivers"]
    lines = [
        f"{drivers} simulated drivers, {claims} claims in the year after the one that is scored; model"
        f" {found['model']['name']} {found['model']['version']} {found['model']['sha256'][:12]}",
        "",
        "lift: Gini and AUC of claims by the order of each; Gini of the true rates has no chance of claims in it",
        *aligned(_lift(found["lift"])),
        "",
        "calibration: slope of claims on predicted, 1 where the spread is right; balance is the mean relativity",
        *aligned(_calibration(found["calibration"], found["balance"])),
        "",
        "reliability, all three together, by tenths of predicted: claims a driver",
        *aligned(_deciles(found["calibration"]["all"]["deciles"])),
        "",
        "stability: rank correlation of neighbouring months; change of the score to the one of the whole year, points",
        *aligned(_stability(found["stability"])),
        "",
        "intervals of 95 % of relativity: how many hold what the model itself would say after 100 years, and the true",
        "claim rate (which holds what the product does not see, so that no product is expected to)",
        *aligned(_coverage(found["coverage"])),
        "",
        "phyd as shipped, and what the same figures say of models that are wrong on purpose",
        *aligned(_wrong(found["wrong_models"])),
    ]
    return "\n".join(lines)


def _lift(lift: Mapping[str, Any]) -> Sequence[Sequence[str]]:
    rows = [("", "Gini", "of true rates", "AUC", "Gini over mileage's")]
    for name, one in lift.items():
        rows.append(
            (
                name,
                _with(one["gini"], one["gini_interval95"]),
                f"{one['gini_of_true_rates']:.3f}",
                _with(one["auc"], one["auc_interval95"]),
                "" if name == "mileage" else _with(one["gini_over_mileage"], one["gini_over_mileage_interval95"]),
            )
        )
    return rows


def _calibration(calibration: Mapping[str, Any], balance: Mapping[str, float]) -> Sequence[Sequence[str]]:
    rows = [("", "slope", "of true rates", "tenths that hold", "balance")]
    for name, one in calibration.items():
        slope = _with(one["slope"], one["slope_interval95"])
        inside = f"{one['deciles_inside']} of {len(one['deciles'])}"
        rows.append((name, slope, f"{one['slope_of_true_rates']:.2f}", inside, f"{balance[name]:.3f}"))
    return rows


def _deciles(deciles: Sequence[Mapping[str, Any]]) -> Sequence[Sequence[str]]:
    rows = [("tenth", "predicted", "actual", "true rate")]
    for place, one in enumerate(deciles, 1):
        rows.append(
            (str(place), f"{one['predicted']:.3f}", _with(one["actual"], one["interval95"]), f"{one['true']:.3f}")
        )
    return rows


def _stability(stability: Mapping[str, Any]) -> Sequence[Sequence[str]]:
    changes = list(next(iter(stability.values()))["change_to_12_months"])
    rows = [("", "months' rank", "sd between drivers", *(f"from {one.replace('_', ' ')}" for one in changes))]
    for name, one in stability.items():
        told = (one["change_to_12_months"][change] for change in changes)
        cells = (f"{part['median_points']:.1f} median, {part['p95_points']:.1f} at 95 %" for part in told)
        rows.append((name, f"{one['month_to_month_rank_correlation']:.2f}", f"{one['sd_points']:.1f}", *cells))
    return rows


def _coverage(coverage: Mapping[str, Any]) -> Sequence[Sequence[str]]:
    rows = [("", "after", "hold the model's", "hold the true rate", "median width of ln")]
    for name, periods in coverage.items():
        for period, one in periods.items():
            shares = (f"{100.0 * one[key]:.1f} %" for key in ("model", "claims"))
            rows.append((name, period.replace("_", " "), *shares, f"{one['median_width_ln']:.2f}"))
    return rows


def _wrong(wrong: Mapping[str, Any]) -> Sequence[Sequence[str]]:
    rows = [("", "slope", "of true rates", "after 1 month", "Gini", "of true rates", "1 month's intervals hold")]
    for name, one in wrong.items():
        held, month = one.get("coverage_1_month"), one.get("slope_1_month_of_true_rates")
        rows.append(
            (
                name.replace("_", " "),
                _with(one["slope"], one["slope_interval95"]),
                f"{one['slope_of_true_rates']:.2f}",
                "" if month is None else f"{month:.2f}",
                f"{one['gini']:.3f}",
                f"{one['gini_of_true_rates']:.3f}",
                "" if held is None else f"{100.0 * held:.1f} %",
            )
        )
    return rows


def _with(value: float, interval: Sequence[float]) -> str:
    return f"{value:.3f} ({interval[0]:.3f} to {interval[1]:.3f})"
