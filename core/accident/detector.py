"""The project's accident detector: what no tyre can bring about is judged, told at once, and followed."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from core.accident import suppressed, trigger
from core.accident.clipping import Whole
from core.accident.converters import hangs
from core.accident.events import Candidate, FeltImpact, Findings, Impact, Kind, Severity, Status, VehicleMotion
from core.accident.impacts import (
    belonging,
    deployed,
    each_of,
    felt,
    may_be_braking,
    refined,
    unsure_direction_sd_deg,
    weighed,
)
from core.accident.judgement import AIRBAG_DEPLOYED, Aftermath, confidence, followed, probability, reasons
from core.accident.level import HEADING_COS, HEADING_SIN, ROLL_RATE, YAW_RATE, LevelMotion
from core.accident.momentum import MOST_BLOWS, Momentum, begun, checked, settled, struck
from core.accident.open_accident import Open, Weak
from core.accident.pulse import ANY, Pulse, read_pulse, spin_from
from core.accident.thresholds import DetectorThresholds
from core.accident.tilted import lying
from core.accident.trigger import NEVER, Stop, scan
from core.measurements import FLAG_AIRBAG, FLAG_POWER_LOSS, FLAG_TOW, FloatArray

NAME: Final = "telefuse"

_RANKS: Final = (Severity.LOW_SPEED, Severity.SEVERE, Severity.AIRBAG)


class ImpactDetector:
    """Folds vehicle motion into accidents; the same samples give the same however they are cut.

    A pulse is suspected where the horizontal velocity changed by more than tyres can (``trigger``), read off
    the samples (``pulse``) and judged (``judgement``). An accident is told as suspected as soon as it is likelier than
    not, told again when its pulse is over and when a worse impact follows within ``grouping_s``, and
    confirmed or retracted by what followed. What was judged to be none is told as a candidate with a name.
    """

    def __init__(self, thresholds: DetectorThresholds | None = None) -> None:
        self._limits = limits = thresholds or DetectorThresholds()
        self._level = LevelMotion(limits.level)
        self._registers = trigger.fresh_registers()
        self._marks: FloatArray = np.zeros(trigger.MARKS)
        self._spans_ns = trigger.times_ns(limits.trigger, limits.aftermath)
        self._reaches = trigger.levels(limits.trigger)
        self._open: Open | None = None
        self._weak: Weak | None = None
        self._flags: int | None = None
        self._airbag_ns = self._power_loss_ns = NEVER
        self._towed = False
        self._told_ns = NEVER
        self._ignition: bool | None = None

    def step(self, motion: VehicleMotion) -> Findings:
        """Take the next samples, in time order; return what was decided in them."""
        level, found = self._level, Findings([], [])
        row = level.extend(motion)
        self._ignition = motion.ignition
        self._towed = bool(motion.flags & FLAG_TOW)
        while True:
            row, evidence_row, stop = scan(
                level.t_ns, level.x, level.flags, row, self._registers, self._marks, self._spans_ns, self._reaches
            )
            if stop == Stop.END:
                break
            if stop in (Stop.EARLY, Stop.WHOLE):
                self._judge(row, evidence_row, stop == Stop.WHOLE, found)
            elif stop == Stop.SHOCKS:
                self._name_shocks(row, found)
            elif stop == Stop.MANOEUVRE:
                self._name_manoeuvre(row, found)
            elif stop == Stop.TILTED:
                self._lies(row, found)
            elif stop == Stop.LEANT:
                self._leans(row, found)
            else:
                self._close(row, found)
            row += 1
        self._take_flags(motion.flags, found)
        return found

    def turn(self, C_new_from_old: FloatArray) -> None:
        """Take samples in other body axes from now on."""
        self._level.turn(C_new_from_old)
        if self._open is not None:
            self._open = replace(self._open, momentum=None)  # what was forward is not any more

    def state(self) -> dict[str, npt.NDArray[np.generic]]:
        """Arrays from which ``load`` goes on, to the bit."""
        kept = {
            "open": None if self._open is None else asdict(self._open),
            "weak": None if self._weak is None else asdict(self._weak),
            "flags": self._flags,
            "airbag_ns": self._airbag_ns,
            "power_loss_ns": self._power_loss_ns,
            "told_ns": self._told_ns,
        }
        return {
            **self._level.state(),
            "detector.registers": self._registers,
            "detector.marks": self._marks,
            "detector.kept": np.frombuffer(json.dumps(kept).encode(), dtype=np.uint8),
        }

    def load(self, arrays: Mapping[str, npt.NDArray[np.generic]]) -> None:
        """Go on from a ``state``."""
        self._level.load(arrays)
        self._registers = np.array(arrays["detector.registers"], dtype=np.int64)
        self._marks = np.array(arrays["detector.marks"], dtype=np.float64)
        kept = json.loads(arrays["detector.kept"].tobytes())
        self._open = None if kept["open"] is None else Open.of(kept["open"])
        self._weak = None if kept["weak"] is None else Weak(**kept["weak"])
        self._flags, self._told_ns = kept["flags"], kept["told_ns"]
        self._airbag_ns, self._power_loss_ns = kept["airbag_ns"], kept["power_loss_ns"]

    def _judge(self, row: int, evidence_row: int, whole: bool, found: Findings) -> None:
        """Judge the suspected pulse at ``row``, with rows up to ``evidence_row`` as evidence."""
        limits, registers, level = self._limits, self._registers, self._level
        t_ns, now = level.t_ns, int(level.t_ns[row])
        start = int(np.searchsorted(t_ns, registers[trigger.START]))
        ends = evidence_row, max(row - 1, evidence_row)
        told = self._told_ns == registers[trigger.START]
        judged = read_pulse(t_ns, level.x, level.flags, start, ends, limits.trigger, limits.pulse)
        first_ns = int(t_ns[judged.first])
        fell = trigger.lately(registers, trigger.FELL, first_ns, limits.trigger.fell_before_s)
        odds = weighed(level, judged, limits, fell=fell)
        same = self._open is not None and first_ns <= self._open.last_ns + _ns(limits.aftermath.grouping_s)
        if not whole:
            rows, unturned = (judged.first, row), limits.judgement.unturned_radps
            waits = same or hangs(t_ns, level.x, level.flags, rows, judged.jolt_radps, unturned)
            if not waits and probability(odds) >= self._needed(judged, row):
                self._tell(judged, odds, row, found)
            return
        if probability(odds) < self._holds(told=told):
            registers[trigger.PULSE], registers[trigger.FLOOR] = 0, now
            self._dismiss(judged, odds, told, row, found)
            return
        pulse = self._described(judged, start, ends, told=told)
        broken_off = evidence_row < row
        if not told and not same and not broken_off:  # told now, and again with the end of its flank
            registers[trigger.SETTLED] = now
            self._tell(pulse, odds, row, found)
            return
        registers[trigger.PULSE], registers[trigger.FLOOR] = 0, now
        impact, unclipped = self._felt(pulse, row, odds)
        if told:
            self._update(impact, odds, row, found, self._struck(self._opened.momentum, impact, pulse, row, unclipped))
        elif not same:
            momentum = self._struck(self._begun(pulse, row), impact, pulse, row, unclipped)
            self._begin(impact, odds, row, found, momentum)
        elif not self._spins(judged):
            self._add(impact, odds, row, found, self._struck(self._opened.momentum, impact, pulse, row, unclipped))

    def _tell(self, pulse: Pulse, odds: float, row: int, found: Findings) -> None:
        """Tell an accident whose pulse is to be judged again once it is over, or its flank is."""
        self._told_ns = int(self._registers[trigger.START])
        self._registers[trigger.SEEN_EARLY] = trigger.TOLD
        impact, _ = self._felt(pulse, row, odds)
        self._begin(impact, odds, row, found, self._begun(pulse, row))

    def _felt(self, pulse: Pulse, row: int, odds: float) -> tuple[Impact, Whole | None]:
        """The accident that a pulse of such log-odds is, as it is told at ``row``; dear where it clipped."""
        parked = self._stood_parked(int(self._level.t_ns[pulse.first]))
        return felt(self._level, pulse, row, odds, NAME, self._limits, parked=parked)

    def _needed(self, pulse: Pulse, row: int) -> float:
        """How likely a pulse that goes on has to be for it to be told."""
        limits, age_ns = self._limits.judgement, int(self._level.t_ns[row] - self._level.t_ns[pulse.first])
        if age_ns < _ns(limits.late_s):
            return limits.tell_early
        return limits.tell_late if may_be_braking(pulse, limits) else limits.tell

    def _holds(self, *, told: bool) -> float:
        """How likely a pulse that is over has to be for it to be told, or not to be taken back."""
        limits = self._limits.judgement
        # What was hardly plain when it was told has to hold.
        return limits.retract if told and probability(self._opened.odds) >= limits.tell_early else limits.tell

    def _described(self, judged: Pulse, start: int, ends: tuple[int, int], *, told: bool) -> Pulse:
        """The blow by which an accident is described, where it is judged by the spin or the slide that follows it."""
        level, limits, as_told = self._level, self._limits, ANY
        t_ns, x = level.t_ns, level.x
        if told:
            impact = self._opened.impact
            first, row = np.searchsorted(t_ns, [impact.t_ns, impact.decided_t_ns])
            (forward, right), (cos, sin) = impact.delta_v_b_mps, x[first, [HEADING_COS, HEADING_SIN]]
            as_told = float(forward * cos - right * sin), float(forward * sin + right * cos), int(row)
        spin_row = spin_from(x, start, judged.first, limits.pulse.spin_radps)
        if spin_row is not None and t_ns[spin_row] - t_ns[start] >= _ns(limits.trigger.shortest_s):
            ends = spin_row, spin_row
        elif not told:
            return judged
        blow = read_pulse(t_ns, x, level.flags, start, ends, limits.trigger, limits.pulse, as_told)
        return blow if blow.beyond_mps > 0.0 else judged

    def _spins(self, pulse: Pulse) -> bool:
        """Whether what would be a further blow is no more than what the spin or fall after the last does to the box."""
        limits, x = self._limits, self._level.x
        if limits.rollover.tracks == 1:  # what was struck falls over, and strikes the ground
            falls = float(np.max(np.abs(x[pulse.first : pulse.last + 1, ROLL_RATE])))
            if falls > limits.rollover.topples_radps and pulse.beyond_mps < falls * limits.pulse.arm_m:
                return True
        rate = abs(float(x[pulse.first, YAW_RATE]))
        return rate > limits.pulse.spin_radps and pulse.beyond_mps < rate * rate * limits.pulse.arm_m * pulse.felt_s

    def _begun(self, pulse: Pulse, row: int) -> Momentum:
        level = self._level
        return begun(level.t_ns, level.x, level.flags, pulse.first, row, self._registers)

    def _struck(
        self, was: Momentum | None, impact: Impact, pulse: Pulse, row: int, whole: Whole | None
    ) -> Momentum | None:
        if was is None or len(was.blows) >= MOST_BLOWS:
            return None
        t_ns, x, flags = self._level.t_ns, self._level.x, self._level.flags
        was = checked(was, t_ns, x, flags, (pulse.first, row), self._registers, self._limits.aftermath)
        return struck(was, impact, t_ns, x, flags, (pulse.first, pulse.last), whole)

    def _stood_parked(self, t_ns: int) -> bool:
        """Whether the vehicle stood, parked, until a time: what then pushes it is no journey's accident."""
        if t_ns - int(self._registers[trigger.RESTED]) > _ns(self._limits.trigger.rest_s):
            return False
        if self._ignition is not None:
            return not self._ignition
        moved_ns = int(self._registers[trigger.MOVED])
        if moved_ns > t_ns:  # it moves since it was struck
            moved_ns = int(self._registers[trigger.MOVED_BEFORE])
        return t_ns - moved_ns > _ns(self._limits.aftermath.parked_s)

    @property
    def _opened(self) -> Open:
        assert self._open is not None
        return self._open

    def _begin(self, impact: Impact, odds: float, row: int, found: Findings, momentum: Momentum | None = None) -> None:
        """Tell a new accident; one that is still open is closed first."""
        if self._open is not None:
            self._close(row, found)
        impact = replace(impact, each=_each(momentum, impact) or each_of([] if momentum is None else [impact]))
        self._open = Open(impact, odds, impact.decided_t_ns, momentum)
        self._registers[trigger.OPEN], self._registers[trigger.OPEN_FROM] = 1, impact.decided_t_ns
        self._marks[trigger.LEAST_SPEED] = math.nan
        self._marks[[trigger.MOST_ROUGH, trigger.TURNED, trigger.LONGEST_REST]] = 0.0
        found.impacts.append(impact)
        self._go_on()

    def _go_on(self) -> None:
        """Follow the open accident from its latest impact on; the shock around it is its own."""
        until_ns = self._opened.last_ns + _ns(self._limits.aftermath.follow_s)
        self._registers[trigger.OPEN_UNTIL] = until_ns
        self._registers[[trigger.SHOCK_START, trigger.HARD_SINCE, trigger.HARD_UNTIL]] = NEVER
        self._weak = None

    def _update(
        self,
        impact: Impact,
        odds: float,
        row: int,
        found: Findings,
        momentum: Momentum | None,
        impacts: int | None = None,
    ) -> None:
        """Tell the open accident again, with what is known now."""
        was = self._opened
        if was.airbag and AIRBAG_DEPLOYED not in impact.reasons:
            impact = replace(impact, reasons=(AIRBAG_DEPLOYED, *impact.reasons))
        impact = replace(
            belonging(impact, was.impact),
            revision=was.impact.revision + 1,
            impacts=was.impact.impacts if impacts is None else impacts,
            each=_each(momentum, was.impact),
            confidence=confidence(odds, self._limits.judgement),
        )
        self._open = replace(was, impact=impact, odds=odds, last_ns=int(self._level.t_ns[row]), momentum=momentum)
        found.impacts.append(impact)
        self._go_on()

    def _add(self, impact: Impact, odds: float, row: int, found: Findings, momentum: Momentum | None) -> None:
        """A further impact of the open accident: told at once where it is worse, counted where it is not."""
        was = self._opened
        count, odds = was.impact.impacts + 1, max(odds, was.odds)
        if impact.delta_v_mps > was.impact.delta_v_mps:
            self._update(impact, odds, row, found, momentum, impacts=count)
            return
        counted = replace(was.impact, impacts=count, each=_each(momentum, was.impact))
        self._open = replace(was, impact=counted, odds=odds, last_ns=impact.decided_t_ns, momentum=momentum)
        self._go_on()

    def _dismiss(self, pulse: Pulse, odds: float, told: bool, row: int, found: Findings) -> None:
        """Keep a pulse that was none, until the shock around it is over; retract what was told of it too early."""
        registers = self._registers
        if self._open is not None and not told:
            return
        first_ns = int(self._level.t_ns[pulse.first])
        kept = self._weak is None or odds > self._weak.odds
        if kept or told:
            impact, _ = self._felt(pulse, row, odds)
            if kept:
                delta_v, agrees = impact.delta_v_mps, impact.paper_agrees
                self._weak = Weak(first_ns, odds, delta_v, impact.duration_s, impact.peak_mps2, agrees)
            if told:
                self._finish(replace(impact, t_ns=self._opened.impact.t_ns), odds, Status.RETRACTED, found)
        if registers[trigger.SHOCK_START] == NEVER:
            registers[trigger.SHOCK_START], registers[trigger.SHOCKS] = first_ns, 1
        registers[trigger.SHOCK_LAST] = self._level.t_ns[row]

    def _close(self, row: int, found: Findings) -> None:
        """Confirm or retract the open accident by what followed it."""
        was, limits, marks = self._opened, self._limits, self._marks
        now = int(self._level.t_ns[row])
        after = Aftermath(
            speed_before_mps=was.impact.speed_before_mps,
            least_speed_mps=float(marks[trigger.LEAST_SPEED]),
            rest_s=float(marks[trigger.LONGEST_REST]),
            turned_rad=float(marks[trigger.TURNED]),
            rough_mps2=math.sqrt(max(float(marks[trigger.MOST_ROUGH]), 0.0)),
            airbag=was.airbag,
            power_loss=was.power_loss,
            rolled_only=was.impact.kind is Kind.ROLLOVER and was.impact.impacts == 1,
        )
        odds = followed(was.odds, after, limits.judgement, limits.aftermath)
        status = Status.CONFIRMED if probability(odds) >= limits.judgement.tell else Status.RETRACTED
        told = reasons(after, limits.aftermath, clipped=was.impact.clipped, rollover=was.impact.rollover)
        impact = self._settled(was, row)
        self._finish(replace(impact, decided_t_ns=now, reasons=told), odds, status, found)

    def _settled(self, was: Open, row: int) -> Impact:
        """The open accident with what its rest, or its rolling on, tells of what clipped: also which blow was worst."""
        if was.momentum is None or not was.momentum.blows:
            return was.impact
        level, limits, worst = self._level, self._limits, was.impact
        impacts = [blow.impact for blow in was.momentum.blows]
        at = max(range(len(impacts)), key=lambda k: impacts[k].delta_v_mps)
        found = settled(was.momentum, level.t_ns, level.x, row, self._registers, limits.aftermath)
        if found is not None and not worst.rollover:
            at, means_mps, covariances = found
            of_each = zip(impacts, means_mps, covariances, strict=True)
            impacts = [refined(one, mean, spread, limits) if one.clipped else one for one, mean, spread in of_each]
            worst = impacts[at]
        worst = replace(belonging(worst, was.impact), pdof_sd_deg=unsure_direction_sd_deg(impacts, at))
        return replace(worst, each=each_of(impacts))

    def _finish(self, impact: Impact, odds: float, status: Status, found: Findings) -> None:
        was = self._opened
        said = confidence(odds, self._limits.judgement)
        impact = replace(impact, status=status, confidence=said, revision=was.impact.revision + 1)
        found.impacts.append(impact)
        self._open, self._registers[trigger.OPEN] = None, 0
        if status is Status.RETRACTED and self._weak is None:
            found.candidates.append(suppressed.of_retracted(impact))

    def _name_shocks(self, row: int, found: Findings) -> None:
        """Tell what a shock, or a train of them, was; what belongs to an accident is no candidate."""
        if self._open is None:
            found.candidates.append(
                suppressed.of_shocks(self._level, self._registers, row, self._weak, self._limits, towed=self._towed)
            )
        self._registers[trigger.SHOCK_START], self._weak = NEVER, None

    def _name_manoeuvre(self, row: int, found: Findings) -> None:
        """Tell emergency braking and hard cornering, unless it was an accident's."""
        registers = self._registers
        if self._open is None:
            candidate = suppressed.of_manoeuvre(self._level, registers, self._marks, row, self._limits)
            if candidate is not None:
                found.candidates.append(candidate)
        registers[[trigger.HARD_SINCE, trigger.HARD_UNTIL]] = NEVER

    def _lies(self, row: int, found: Findings) -> None:
        """Something lies on its side or roof: the vehicle, as an accident's part or by itself, or the box."""
        level, limits = self._level, self._limits
        if self._open is not None:
            was = self._open
            severity = max(was.impact.severity, Severity.SEVERE, key=_RANKS.index)
            impact = replace(was.impact, decided_t_ns=int(level.t_ns[row]), rollover=True, severity=severity)
            self._update(impact, max(was.odds, limits.rollover.odds), row, found, was.momentum)
            return
        lies = lying(level, self._registers, row, NAME, limits, towed=self._towed)
        if isinstance(lies, Candidate):
            found.candidates.append(lies)
        else:
            self._begin(lies, limits.rollover.odds, row, found)

    def _leans(self, row: int, found: Findings) -> None:
        """Tell what leans a parked vehicle."""
        if self._open is None:
            found.candidates.append(suppressed.of_lean(self._level, self._registers, row, self._limits))

    def _take_flags(self, flags: int, found: Findings) -> None:
        """An airbag or a loss of power near an open accident makes it surer; an airbag is told at once."""
        if not self._level.t_ns.size:
            return
        row, limits = len(self._level.t_ns) - 1, self._limits
        now = int(self._level.t_ns[row])
        risen, fresh = flags & ~(self._flags or 0), self._flags is not None
        if risen & FLAG_AIRBAG:
            self._airbag_ns = now
        if risen & FLAG_POWER_LOSS:
            self._power_loss_ns = now
        self._flags = flags
        if self._open is None and risen & FLAG_AIRBAG and fresh:
            odds = limits.judgement.airbag
            self._begin(deployed(self._level, row, NAME, odds, limits), odds, row, found)
            self._open = replace(self._opened, airbag=True)
            return
        if self._open is None:
            return
        was, since_ns = self._open, self._open.impact.t_ns - _ns(limits.aftermath.follow_s)
        if self._power_loss_ns >= since_ns and not was.power_loss:
            self._open = was = replace(was, power_loss=True, odds=was.odds + limits.judgement.flagged)
        if self._airbag_ns >= since_ns and not was.airbag:
            self._open = replace(was, airbag=True)
            self._update(
                replace(was.impact, decided_t_ns=now), was.odds + limits.judgement.flagged, row, found, was.momentum
            )


def _each(momentum: Momentum | None, was: Impact) -> tuple[FeltImpact, ...]:
    """The figures of an accident's impacts so far; as they were told where they are not followed any more."""
    if momentum is None or not momentum.blows:
        return was.each
    return each_of([blow.impact for blow in momentum.blows])


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)
