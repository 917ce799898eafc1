"""What a detector told, set against what happened: found or missed, how well described, cried wolf, named."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
from scipy.stats import beta, chi2

from core.accident.detector import ImpactDetector
from core.accident.events import Candidate, FeltImpact, Impact, NoAccident, Status, VehicleMotion
from core.accident.paper_rule import PaperRule
from core.accident.thresholds import TriggerThresholds
from core.accident.weights import JudgementThresholds
from core.simulation.accident_classes import LOW_SPEED_MPS
from core.simulation.collisions import Truth
from core.simulation.disturbances import NonAccident

OURS: Final = "telefuse"
PAPER: Final = "paper"
DETECTORS: Final[Mapping[str, Callable[[], ImpactDetector | PaperRule]]] = {OURS: ImpactDetector, PAPER: PaperRule}

TRIGGER_MPS: Final = 8.0 / 3.6
"""49 CFR 563.5: 8 km/h."""
BEFORE_NS: Final = 1_000_000_000
AFTER_NS: Final = 5_000_000_000
"""What is told from so long before an accident's first blow to so long after its last belongs to it, ns."""
NAMED_AFTER_NS: Final = 2_000_000_000
SAME_NS: Final = 200_000_000
"""An impact that is told so near to a true one is that one, ns: less than is between two of the corpus."""
CONFIDENCE_EDGES: Final = (0.0, 0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)

NAMES: Final[Mapping[NonAccident, frozenset[NoAccident]]] = {
    NonAccident.POTHOLE: frozenset({NoAccident.POTHOLE}),
    NonAccident.SPEED_BUMP: frozenset({NoAccident.SPEED_BUMP}),
    NonAccident.KERB: frozenset({NoAccident.KERB}),
    NonAccident.RAILWAY_CROSSING: frozenset({NoAccident.RAILWAY_CROSSING}),
    NonAccident.VIBRATION: frozenset({NoAccident.VIBRATION_TRAIN}),
    NonAccident.PARKING_BUMP: frozenset({NoAccident.KERB}),
    NonAccident.DOOR_SLAM: frozenset({NoAccident.DOOR_SLAM}),
    NonAccident.BOOT_SLAM: frozenset({NoAccident.DOOR_SLAM}),
    NonAccident.EMERGENCY_BRAKING: frozenset({NoAccident.EMERGENCY_BRAKING}),
    NonAccident.HARD_CORNERING: frozenset({NoAccident.HARD_CORNERING}),
    NonAccident.SWERVE: frozenset({NoAccident.HARD_CORNERING}),
    NonAccident.TOW: frozenset({NoAccident.TOWING}),
    NonAccident.BOX_KNOCKED: frozenset({NoAccident.BOX_KNOCKED}),
    NonAccident.BOX_DROPPED: frozenset({NoAccident.BOX_DROPPED}),
    NonAccident.SENSOR_GLITCH: frozenset({NoAccident.SENSOR_GLITCH}),
    NonAccident.FERRY: frozenset({NoAccident.FERRY}),
    NonAccident.CAR_WASH: frozenset({NoAccident.VIBRATION_TRAIN}),
    NonAccident.TRAILER_COUPLING: frozenset({NoAccident.TRAILER_COUPLING}),
    NonAccident.TIPPING_BODY: frozenset({NoAccident.TOWING, NoAccident.TRAILER_COUPLING}),
    NonAccident.KNEELING: frozenset({NoAccident.TOWING, NoAccident.DOOR_SLAM}),
    NonAccident.WHEELIE: frozenset({NoAccident.SPEED_BUMP, NoAccident.POTHOLE}),
    NonAccident.STOPPIE: frozenset({NoAccident.EMERGENCY_BRAKING, NoAccident.SPEED_BUMP}),
    NonAccident.FALL_AT_REST: frozenset({NoAccident.FELL_OVER}),
    NonAccident.SIDE_STAND: frozenset[NoAccident](),
}
"""The detector's names that are right for what is simulated."""


@dataclass(frozen=True, slots=True)
class Story:
    """One accident as it was told: each revision in its order."""

    revisions: tuple[Impact, ...]

    @property
    def first(self) -> Impact:
        """As it was told at once."""
        return self.revisions[0]

    @property
    def last(self) -> Impact:
        """As it stands in the end."""
        return self.revisions[-1]

    @property
    def stands(self) -> bool:
        """Whether it was not retracted."""
        return self.last.status is not Status.RETRACTED


def listen(detector: str, motions: Iterable[VehicleMotion]) -> tuple[list[Story], list[Candidate]]:
    """What a detector tells of samples that follow one another."""
    return heard(DETECTORS[detector](), motions)


def heard(
    listening: ImpactDetector | PaperRule, motions: Iterable[VehicleMotion]
) -> tuple[list[Story], list[Candidate]]:
    """What a fresh detector tells of samples that follow one another."""
    found = [listening.step(motion) for motion in motions]
    return stories(one for each in found for one in each.impacts), [one for each in found for one in each.candidates]


def stories(impacts: Iterable[Impact]) -> list[Story]:
    """Impacts by the accident that they belong to."""
    told: dict[int, list[Impact]] = {}
    for one in impacts:
        told.setdefault(one.t_ns, []).append(one)
    return [Story(tuple(revisions)) for revisions in told.values()]


def accident_record(
    truth: Truth, t_ns: int, clipped: bool, told: Sequence[Story], candidates: Sequence[Candidate]
) -> dict[str, Any]:
    """One accident and what was told of it; None where nothing was."""
    last_ns = t_ns + round(1e9 * (truth.impacts[-1]["t_s"] - truth.t_s))
    mine = [one for one in told if one.stands and t_ns - BEFORE_NS <= one.first.t_ns <= last_ns + AFTER_NS]
    probabilities = [(one.first.confidence, one.last.confidence, True) for one in mine]
    if not mine:
        near = [one.probability for one in candidates if t_ns - BEFORE_NS <= one.t_ns <= last_ns + AFTER_NS]
        probabilities += [(likeliest, likeliest, True) for likeliest in sorted(near)[-1:]]
    record: dict[str, Any] = {
        "class": truth.name,
        "kind": truth.kind,
        "delta_v_mps": truth.delta_v_mps,
        "found": bool(mine),
        "told_again": max(len(mine) - 1, 0),
        "withdrawn": any(not one.stands for one in told),
        "elsewhere": sum(one.stands for one in told) - len(mine),
        "clipped": clipped,
        "probabilities": probabilities,
        "suppressed_as": [one.reason.value for one in candidates][:3],
    }
    if mine:
        story = min(mine, key=lambda one: abs(one.first.t_ns - t_ns))
        last = story.last
        low, high = last.delta_v_interval_mps
        record |= {
            "delay_s": (story.first.decided_t_ns - t_ns) / 1e9,  # so that 150 ms are 0.15 s to the bit
            "start_error_s": (story.first.t_ns - t_ns) * 1e-9,
            "clipped": last.clipped,
            "delta_v_error_mps": last.delta_v_mps - truth.delta_v_mps,
            "in_interval": low <= truth.delta_v_mps <= high if math.isfinite(low) else None,
            "direction_error_deg": _off_deg(last.pdof_deg, truth.pdof_deg),
            "direction_in_interval": _direction_holds(last.pdof_deg, last.pdof_sd_deg, truth.pdof_deg),
            "each": [
                _each_record(one, t_ns + round(1e9 * (one["t_s"] - truth.t_s)), last.each) for one in truth.impacts
            ],
            "kind_told": last.kind.value,
            "rollover_told": last.rollover,
            "confidence": last.confidence,
        }
    return record


def _each_record(true: Mapping[str, float], t_ns: int, told: Sequence[FeltImpact]) -> dict[str, Any]:
    """One of an accident's impacts and what was told of itself."""
    near = [one for one in told if abs(one.t_ns - t_ns) <= SAME_NS]
    if not near:
        return {"told": False}
    one = min(near, key=lambda one: abs(one.t_ns - t_ns))
    low, high = one.delta_v_interval_mps
    return {
        "told": True,
        "clipped": one.clipped,
        "relative_error": abs(one.delta_v_mps - true["delta_v_mps"]) / true["delta_v_mps"],
        "in_interval": low <= true["delta_v_mps"] <= high,
        "direction_error_deg": _off_deg(one.pdof_deg, true["pdof_deg"]),
    }


def _off_deg(told_deg: float, true_deg: float) -> float:
    return abs(math.remainder(told_deg - true_deg, 360.0))


def _direction_holds(told_deg: float, sd_deg: float, true_deg: float) -> bool | None:
    """Whether the true direction is in the 95 % interval that was told; None where none was."""
    return _off_deg(told_deg, true_deg) <= 1.96 * sd_deg if math.isfinite(sd_deg) else None


def accident_figures(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Recall by class and by change of velocity, and how well what was found was described."""
    found = [one for one in records if one["found"]]
    clipped = [one for one in found if one["clipped"]]
    whole = [one for one in found if not one["clipped"]]
    bands: dict[str, Callable[[float], bool]] = {
        "all": lambda dv: True,
        "from_8_kmh": lambda dv: dv >= TRIGGER_MPS,
        "low_speed": lambda dv: dv < LOW_SPEED_MPS,
        "below_8_kmh": lambda dv: dv < TRIGGER_MPS,
        "severe": lambda dv: dv >= LOW_SPEED_MPS,
    }
    classes = dict.fromkeys(one["class"] for one in records)
    errors = np.array([one["delta_v_error_mps"] for one in whole])
    sizes = np.array([one["delta_v_mps"] for one in whole])
    off = np.abs(errors) > np.maximum(0.1 * sizes, 1.0 / 3.6)
    directions = np.array([one["direction_error_deg"] for one in found])
    delays = np.array([one["delay_s"] for one in found])
    rolled = [one for one in found if one["kind"] == "rollover"]
    return {
        "accidents": len(records),
        "recall": {
            name: share([one["found"] for one in records if inside(one["delta_v_mps"])])
            for name, inside in bands.items()
        },
        "recall_by_class": {name: share([one["found"] for one in records if one["class"] == name]) for name in classes},
        "told_again": sum(one["told_again"] for one in records),
        "told_elsewhere": sum(one["elsewhere"] for one in records),
        "precision": share([True] * len(found) + [False] * sum(one["elsewhere"] for one in records)),
        "delta_v_unclipped": {
            "count": len(whole),
            "outside_10_percent_and_1_kmh": _mean(off),
            "abs_error_mps": _spread(np.abs(errors)),
            "relative_error": _spread(np.abs(errors) / np.maximum(sizes, 1e-9)),
            "bias_mps": _mean(errors),
            "interval_coverage": _mean([one["in_interval"] for one in whole if one["in_interval"] is not None]),
        },
        "delta_v_clipped": {
            "count": len(clipped),
            "relative_error": _spread(
                np.array([abs(one["delta_v_error_mps"]) / one["delta_v_mps"] for one in clipped])
            ),
            "interval_coverage": _mean([one["in_interval"] for one in clipped if one["in_interval"] is not None]),
        },
        "direction": {
            "beyond_15_deg": _mean(directions > 15.0),
            "unclipped_beyond_15_deg": _mean([one["direction_error_deg"] > 15.0 for one in whole]),
            "clipped_beyond_15_deg": _mean([one["direction_error_deg"] > 15.0 for one in clipped]),
            "error_deg": _spread(directions),
            "interval_coverage": _mean(
                [one["direction_in_interval"] for one in found if one["direction_in_interval"] is not None]
            ),
        },
        "each_impact": _each_figures([one["each"] for one in found if len(one["each"]) > 1]),
        "delay": {"beyond_150_ms": _mean(delays > 0.150), "delay_s": _spread(delays), "late": _late(found)},
        "rollovers_named": _mean([one["rollover_told"] for one in rolled]),
        "parked_hits_named": _mean([one["kind_told"] == "parked_hit" for one in found if one["kind"] == "parked_hit"]),
    }


def _each_figures(accidents: Sequence[Sequence[Mapping[str, Any]]]) -> dict[str, Any]:
    """How well the single impacts of accidents of several were described."""
    impacts = [one for each in accidents for one in each]
    told = [one for one in impacts if one["told"]]
    parts = {
        "unclipped": [one for one in told if not one["clipped"]],
        "clipped": [one for one in told if one["clipped"]],
    }
    return {
        "accidents": len(accidents),
        "count": len(impacts),
        "told": share([one["told"] for one in impacts]),
        **{
            name: {
                "count": len(ones),
                "relative_error": _spread(np.array([one["relative_error"] for one in ones])),
                "interval_coverage": _mean([one["in_interval"] for one in ones]),
                "beyond_15_deg": _mean([one["direction_error_deg"] > 15.0 for one in ones]),
            }
            for name, ones in parts.items()
        },
    }


def _late(found: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Of those told later than 150 ms, how many had not yet moved, free of noise, as brakes and tyres cannot.

    ``within_margin``: by less than is suspected at all; ``below_likely``: by less than speaks for an accident.
    """
    excess = np.array([one["excess_mps"] for one in found if one["delay_s"] > 0.150 and "excess_mps" in one])
    if not excess.size:
        return None
    trigger, judgement = TriggerThresholds(), JudgementThresholds()
    likely_mps = judgement.beyond_mps * math.exp(-judgement.base / judgement.beyond)
    return {
        "count": excess.size,
        "excess_mps": _spread(excess),
        "within_margin": int(np.sum(excess < trigger.margin_mps)),
        "below_likely": int(np.sum(excess < likely_mps)),
        "likely_mps": likely_mps,
    }


def quiet_record(
    kind: NonAccident, begin_ns: int, end_ns: int, told: Sequence[Story], candidates: Sequence[Candidate]
) -> dict[str, Any]:
    """One non-accident and what it was taken for: told as an accident, a name, or nothing at all."""
    span = begin_ns - BEFORE_NS, end_ns + NAMED_AFTER_NS
    alarms = [one for one in told if span[0] <= one.first.t_ns <= span[1]]
    named = [one for one in candidates if span[0] <= one.t_ns <= span[1]]
    likeliest = max(named, key=lambda one: one.probability) if named else None
    standing = [one for one in alarms if one.stands]
    return {
        "kind": kind.value,
        "false_alarms": len(standing),
        "withdrawn": len(alarms) - len(standing),
        "named": None if likeliest is None else likeliest.reason.value,
        "right": likeliest is not None and likeliest.reason in NAMES[kind],
        "probabilities": [(one.first.confidence, one.last.confidence, False) for one in alarms]
        + ([] if likeliest is None or alarms else [(likeliest.probability, likeliest.probability, False)]),
    }


def quiet_figures(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """By kind: how many, how many cried wolf, how many were named, and as what."""
    kinds = dict.fromkeys(one["kind"] for one in records)
    table = {}
    for kind in kinds:
        mine = [one for one in records if one["kind"] == kind]
        names: dict[str, int] = {}
        for one in mine:
            name = "accident" if one["false_alarms"] else one["named"] or "nothing"
            names[name] = names.get(name, 0) + 1
        table[kind] = {
            "count": len(mine),
            "false_alarms": sum(one["false_alarms"] for one in mine),
            "withdrawn": sum(one["withdrawn"] for one in mine),
            "named_right": share([one["right"] for one in mine if one["named"] is not None]),
            "taken_for": dict(sorted(names.items(), key=lambda item: -item[1])),
        }
    return {
        "count": len(records),
        "false_alarms": sum(one["false_alarms"] for one in records),
        "withdrawn": sum(one["withdrawn"] for one in records),
        "named_right": share([one["right"] for one in records if one["named"] is not None]),
        "kinds": table,
    }


def reliability(records: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Of what was said to be an accident with a probability, how many were: by bins, and the Brier score.

    Of accidents told and of candidates suppressed alike; as it stood first and as it stands in the end.
    """
    rows = [row for one in records for row in one["probabilities"]]
    found: dict[str, Any] = {"count": len(rows)}
    for name, column in (("first", 0), ("last", 1)):
        said = np.array([row[column] for row in rows])
        true = np.array([row[2] for row in rows], dtype=float)
        bins = []
        for low, high in pairwise(CONFIDENCE_EDGES):
            inside = (said >= low) & ((said < high) | (high == 1.0))
            if inside.any():
                bins.append(
                    {
                        "from": low,
                        "to": high,
                        "count": int(inside.sum()),
                        "said": float(said[inside].mean()),
                        "accidents": share(true[inside] > 0.5),
                    }
                )
        found[name] = {"brier": _mean((said - true) ** 2), "bins": bins}
    return found


def rate(count: int, km: float) -> dict[str, float]:
    """Count per 100 000 km with its exact 95 % Poisson interval (Garwood 1936)."""
    scale = 1e5 / km
    low = 0.0 if count == 0 else float(chi2.ppf(0.025, 2 * count)) / 2.0
    high = float(chi2.ppf(0.975, 2 * count + 2)) / 2.0
    return {"count": count, "per_100000_km": scale * count, "low": scale * low, "high": scale * high}


def share(outcomes: Sequence[bool] | Any) -> dict[str, float | None]:
    """Share of true ones with its exact 95 % interval."""
    n, k = len(outcomes), int(np.sum(outcomes))
    if n == 0:
        return {"count": 0, "share": None, "missed": None, "low": None, "high": None}
    low, high = proportion_interval(k, n)
    return {"count": n, "share": k / n, "missed": 1.0 - k / n, "low": low, "high": high}


def proportion_interval(k: float, n: float) -> tuple[float, float]:
    """Exact 95 % interval of a share of which ``k`` of ``n`` were seen (Clopper & Pearson 1934); of weighed ones
    neither is whole."""
    low = 0.0 if k < 1e-9 else float(beta.ppf(0.025, k, n - k + 1.0))
    high = 1.0 if n - k < 1e-9 else float(beta.ppf(0.975, k + 1.0, n - k))
    return low, high


def _mean(values: Any) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _spread(values: Any) -> dict[str, float | None]:
    if not len(values):
        return dict.fromkeys(("median", "p95", "max"))
    return {
        "median": float(np.median(values)),
        "p95": float(np.percentile(values, 95.0)),
        "max": float(np.max(values)),
    }
