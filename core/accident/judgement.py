"""From what a pulse was like to the probability that it was an accident, with the reasons for it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from core.accident.thresholds import AftermathThresholds
from core.accident.weights import JudgementThresholds

LEAST_MPS: Final = 0.05
"""A change beyond reach counts as no less, m/s: the logarithm's end, far below what is suspected."""


AIRBAG_DEPLOYED: Final = "airbag deployed"


@dataclass(frozen=True, slots=True)
class Evidence:
    """What a suspected pulse was like.

    Parameters
    ----------
    delta_v_mps : change of horizontal velocity as it was read
    beyond_mps : by how much it exceeds what tyres, pedals and steering can
    duration_s : its length
    swing_mps : range of the vertical change of velocity around it
    retained : share of the change that was kept, 0..1
    abrupt : largest acceleration right before and after, over its peak
    rate_radps, jolt_radps, tip_radps : the fastest rotation, the largest change of it, and that of roll and pitch alone
    aside : share of the change that is across the vehicle
    speed_mps : fused speed just before; NaN while unknown
    stood : whether the vehicle had stood
    clipping_s : for how long an axis of the accelerometer read its full scale at a stretch
    fell : whether the box fell freely just before
    pinned : whether an axis jumped to its full scale and nothing else moved more than it had before
    sound : share of the change that is left without the spikes of single samples
    """

    delta_v_mps: float
    beyond_mps: float
    duration_s: float
    swing_mps: float
    retained: float
    abrupt: float
    rate_radps: float
    jolt_radps: float
    tip_radps: float
    aside: float
    speed_mps: float
    stood: bool
    clipping_s: float
    fell: bool
    pinned: bool
    sound: float


@dataclass(frozen=True, slots=True)
class Aftermath:
    """What followed an accident. Speeds NaN while unknown, ``rough_mps2`` the largest rms of the vertical acceleration.

    ``rolled_only`` is whether nothing but a tilt told it: a vehicle that rolled over comes to rest.
    """

    speed_before_mps: float
    least_speed_mps: float
    rest_s: float
    turned_rad: float
    rough_mps2: float
    airbag: bool
    power_loss: bool
    rolled_only: bool = False


def log_odds(evidence: Evidence, limits: JudgementThresholds) -> float:
    """Log-odds that a pulse was an accident: a sum of what speaks for and against it.

    For it speaks the change of velocity beyond the tyres' reach; against it a vertical blow that is larger than the
    horizontal one, that it lifts and tips what it strikes as wheels on kerbs and hands on boxes do, a swing back, a
    length that crash pulses do not have, and what only a loose box or a failing converter does.
    """
    ratio = evidence.swing_mps / max(evidence.delta_v_mps, 1e-3)
    duration_s = max(evidence.duration_s, 1e-3)
    total = limits.base + limits.beyond * math.log(max(evidence.beyond_mps, LEAST_MPS) / limits.beyond_mps)
    total -= limits.vertical * max(0.0, ratio - limits.vertical_from)
    # Of a larger vertical blow, that of a clipped crash may be, the ratio above speaks alone.
    lifted = min(ratio, limits.vertical_from) + evidence.tip_radps / max(evidence.delta_v_mps, 1e-3)
    total -= limits.lifted * max(0.0, lifted - limits.lifted_from)
    total -= limits.retained * max(0.0, limits.retained_from - evidence.retained)
    total -= limits.short * max(0.0, math.log(limits.short_s / duration_s))
    total -= limits.long * max(0.0, math.log(duration_s / limits.long_s))
    if evidence.rate_radps > limits.rotation_radps:
        total -= limits.rotation * math.log(evidence.rate_radps / limits.rotation_radps)
    short = evidence.abrupt < limits.abrupt_share or evidence.duration_s < limits.glitch_s
    # A gyroscope that says nothing at all says nothing of whether a blow turned the car.
    unknown = evidence.jolt_radps == 0.0
    glitch = short and evidence.jolt_radps < limits.abrupt_radps and not (unknown and evidence.clipping_s > 0.0)
    sharp = evidence.abrupt < limits.sharp_share and evidence.clipping_s == 0.0
    glitch = glitch or (sharp and evidence.jolt_radps < limits.sharp_radps)
    spiked = evidence.sound < limits.sound_share and evidence.jolt_radps < limits.sharp_radps
    # What clipped was harder than it read, and what swells or rings is a body's, though no gyroscope felt it.
    weak = evidence.delta_v_mps < limits.unturned_mps and evidence.clipping_s == 0.0 and evidence.abrupt < 1.0
    unturned = weak and 0.0 < evidence.jolt_radps < limits.unturned_radps
    glitch = glitch or spiked or unturned or evidence.delta_v_mps > limits.most_mps
    if _stopped_by_a_stone(evidence, limits):
        total -= limits.crawl
    stuck = evidence.pinned or evidence.clipping_s > limits.stuck_s
    return min(total, limits.impossible) if glitch or stuck or evidence.fell else total


def _stopped_by_a_stone(evidence: Evidence, limits: JudgementThresholds) -> bool:
    """Whether a crawling vehicle lost no more than its speed and some rebound, along its way: as at a kerb stone.

    A stone met aslant pushes across as well.
    """
    crawls = evidence.speed_mps < limits.crawl_mps and not evidence.stood
    most_mps = limits.crawl_share * (evidence.speed_mps + limits.crawl_sds * limits.speed_sd_mps)
    along_mps = evidence.delta_v_mps * math.sqrt(1.0 - min(evidence.aside, 1.0) ** 2)
    return crawls and along_mps < most_mps and evidence.aside < limits.crawl_aside


def followed(odds: float, after: Aftermath, limits: JudgementThresholds, watched: AftermathThresholds) -> float:
    """Log-odds of an accident with how it went on; flags have been added when they came."""
    if after.rolled_only and after.rest_s < watched.rest_s and not math.isnan(after.least_speed_mps):
        odds -= limits.rolled_on
    if after.rest_s >= watched.rest_s and after.speed_before_mps > watched.moving_mps:
        odds += limits.rested
    elif drove_on(after, watched):
        odds -= limits.drove_on
    return odds


def drove_on(after: Aftermath, watched: AftermathThresholds) -> bool:
    """Whether the vehicle never slowed down after what was taken for an accident."""
    fast = after.speed_before_mps > watched.drove_on_mps
    return fast and after.least_speed_mps > watched.drove_on_share * after.speed_before_mps


def probability(odds: float) -> float:
    """The probability that log-odds stand for."""
    if odds < 0.0:
        return math.exp(max(odds, -700.0)) / (1.0 + math.exp(max(odds, -700.0)))
    return 1.0 / (1.0 + math.exp(-min(odds, 700.0)))


def confidence(odds: float, limits: JudgementThresholds) -> float:
    """The probability that is told: the log-odds' weights are summed as if they were independent, so that they have to
    be stretched to hold (Platt 1999)."""
    return probability(limits.told_slope * odds + limits.told_shift)


def reasons(after: Aftermath, watched: AftermathThresholds, *, clipped: bool, rollover: bool) -> tuple[str, ...]:
    """What a reader should know beside the figures."""
    told = []
    if after.airbag:
        told.append(AIRBAG_DEPLOYED)
    if after.power_loss:
        told.append("power lost")
    if rollover:
        told.append("rolled over")
    if after.rest_s >= watched.rest_s:
        told.append("came to rest")
    elif drove_on(after, watched):
        told.append("drove on")
    if abs(after.turned_rad) > math.radians(45.0):
        told.append(f"turned by {round(abs(math.degrees(after.turned_rad)))} degrees")
    if after.rough_mps2 > watched.off_road_mps2:
        told.append("shaken as off the road")
    if clipped:
        told.append("accelerometer clipped")
    return tuple(told)
