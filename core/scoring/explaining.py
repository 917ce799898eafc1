"""Scores in plain sentences: what was driven, what others do, what it costs or brings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

from core.scoring.score import Contribution, Score

_TIMES: Final = {
    "night": "by night (22 to 5 h)",
    "morning": "in the morning (5 to 10 h)",
    "midday": "around midday (10 to 15 h)",
    "afternoon": "in the afternoon (15 to 19 h)",
    "evening": "in the evening (19 to 22 h)",
    "hour:others": "at other hours",
}
_COUNTED: Final[Mapping[str, tuple[str, str]]] = {
    "braking": ("harsh braking", "harsh brakings"),
    "acceleration": ("harsh acceleration", "harsh accelerations"),
    "cornering": ("harsh cornering", "harsh cornerings"),
    "lane_change": ("aggressive change of lane", "aggressive changes of lane"),
}
_NOTHING: Final = 0.05
"""Points that are told as none: less than what is shown."""


class Explained(NamedTuple):
    """A contribution's name and sentence."""

    name: str
    sentence: str


def explain(score: Score) -> tuple[Explained, ...]:
    """A sentence a contribution: the base, what weighs most first, the limit; the reason where there is no score."""
    if score.score is None:
        return (Explained("reason", f"No score for this period: {score.reason}."),)
    first = [one for one in score.contributions if one.name == "base"]
    last = [one for one in score.contributions if one.name == "limit"]
    between = [one for one in score.contributions if one.name not in ("base", "limit")]
    between.sort(key=lambda one: (-abs(one.points), one.name))
    return tuple(Explained(one.name, sentence(one, score)) for one in (*first, *between, *last))


def sentence(one: Contribution, score: Score) -> str:
    """As in "12 harsh brakings in 840 km: 1.4 per 100 km, others 0.6; this costs 4.1 points"."""
    if one.name == "base":
        return f"A driver like the portfolio's mean has {one.points:.1f} points."
    if one.name == "limit":
        return f"No score is below 0 or above 100; this {_effect(one.points)}."
    return f"{_said(one, score)}; this {_effect(one.points)}."


def _said(one: Contribution, score: Score) -> str:
    km = f"{score.distance_m * 1e-3:.0f} km"
    if one.value is None:
        if one.name == "speeding_excess" and one.unit and score.coverage.get("limits_certain"):
            return "Never above the limit" + _instead(one, 1.0, "km/h over it when above")
        return {
            "speeding_share": "No limit was known, so nothing is said of speeding",
            "speeding_excess": "No limit was known, so nothing is said of how far above it",
        }.get(one.name, f"Nothing is known of {one.label}")
    if one.name == "mileage":
        told = f"{km} in {score.days:.0f} days: {one.value:.0f} km a year, others {one.portfolio:.0f}"
        return told + _instead(one, 1.0, "km a year")
    if one.name in _COUNTED:
        many = f"{one.count or 'no'} {_COUNTED[one.name][one.count != 1]} in {km}"
        told = f"{many[0].upper()}{many[1:]}: {one.value:.1f} per 100 km, others {one.portfolio:.1f}"
        return told + _instead(one, 0.05, "per 100 km")
    if one.name == "speeding_share":
        told = f"{_percent(one.value)} of the time above the limit, others {_percent(one.portfolio)}"
        return told + _instead(one, 0.01, "")
    if one.name == "speeding_excess":
        told = f"{one.value:.0f} km/h over the limit when above it, others {one.portfolio:.0f}"
        return told + _instead(one, 1.0, "km/h")
    if one.name == "vehicle":
        told = f"Speed and acceleration near the limits {_percent(one.value)}, others {_percent(one.portfolio)}"
        return told + _instead(one, 0.01, "")
    where = _TIMES.get(one.name) or f"{'in' if one.name.startswith(('cell', 'district')) else 'on'} {one.label}"
    others = "" if one.portfolio is None else f", others {_percent(one.portfolio)}"
    return f"{_percent(one.value)} of the distance {where}{others}"


def _instead(one: Contribution, step: float, unit: str) -> str:
    """That something else counts than what was driven, where one sees a difference."""
    if one.counted is None or (one.value is not None and abs(one.counted - one.value) < step):
        return ""
    shown = _percent(one.counted) if step == 0.01 else f"{one.counted:.1f}" if step < 0.1 else f"{one.counted:.0f}"
    return f" (counts as {f'{shown} {unit}'.strip()} by what is known so far)"


def _effect(points: float) -> str:
    if abs(points) < _NOTHING:
        return "changes nothing"
    return f"{'costs' if points < 0.0 else 'brings'} {abs(points):.1f} points"


def _percent(share: float | None) -> str:
    return "" if share is None else f"{100.0 * share:.0f} %"
