"""Scores by age and sex over a simulated portfolio with known claim rates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from core.scoring.fairness import Scored, fairness
from core.scoring.score import Product
from service.bench import scores
from service.bench.scores import PhaseTell, predicted_claims, relativities
from service.bench.tables import aligned

DRIVERS = scores.DRIVERS


def measure(count: int, tell: PhaseTell) -> dict[str, Any]:
    """Each product's fairness, with the claims that all three together predict."""
    run = scores.simulated(count, lambda done, total: tell("a year of drivers", done, total), monthly=False)
    year = run.by_period[12]
    predicted = predicted_claims(relativities(year)["all"], run.claims)
    found: dict[str, Any] = {"drivers": count, "model_sha256": run.model.sha256}
    for product in Product:
        rows = []
        for i, one in enumerate(year):
            score = one[product].score
            if score is not None:
                who = (run.portfolio.age[i], run.portfolio.sex[i])
                true = float(run.portfolio.claims_per_year[i])
                rows.append(Scored(*who, score, float(predicted[i]), int(run.claims[i]), true))
        found[product.value] = fairness(rows)
    return found


def tables(found: Mapping[str, Any]) -> str:
    """A table a product."""
    lines = []
    for product in Product:
        one = found[product.value]
        unknown = ", ".join(f"{name} {100.0 * share:.0f} %" for name, share in one["unknown_share"].items())
        lines += [f"{product.value}: {one['drivers']} drivers; unknown: {unknown}"]
        head = ("", "drivers", "mean score", "gap", "gap at equal risk", "claims", "predicted", "actual/predicted")
        rows = [head]
        for groups in one["groups"].values():
            for group in groups:
                ratio, ends = group["actual_over_predicted"], group["actual_over_predicted_interval95"]
                rows.append(
                    (
                        group["group"],
                        str(group["drivers"]),
                        f"{group['mean_score']:.1f}",
                        _gap(group["gap"]),
                        _gap(group["controlled_gap"]),
                        str(group["claims"]),
                        f"{group['predicted']:.1f}",
                        "" if ratio is None else f"{ratio:.2f} ({ends[0]:.2f} to {ends[1]:.2f})",
                    )
                )
        lines += [*aligned(rows), ""]
    return "\n".join(lines[:-1])


def _gap(gap: Mapping[str, Any] | None) -> str:
    if gap is None:
        return ""
    low, high = gap["interval95"]
    return f"{gap['points']:+.1f} ({low:+.1f} to {high:+.1f})"
