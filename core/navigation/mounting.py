"""Finds how the box sits in the car: tilt from gravity, yaw from acceleration against GNSS.

What is observed, and what it adds up to, is in ``mounting_evidence``; here fixes are chosen and decisions made. Cars
that are fast drive forwards, so the direction of travel is the body's x axis. ``C_b_from_m`` is the identity until the
evidence against that is significant, and constant from one finding to the next. All is decided at whole seconds from
what lies before them, so that packets do not matter.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import GNSS, FloatArray, TimeArray
from core.navigation.admission import timely
from core.navigation.alignment import MAX_GAP_S, SECOND_NS, fix_velocity, next_second_ns, offsets_m
from core.navigation.mounting_evidence import (
    REST,
    SPANS,
    SUMS,
    MountingEvidence,
    MountingTuning,
    N,
    Span,
    add_motion,
    add_rest,
    carried_force,
    regress,
)

NEAR_S: Final = 5.0
"""Fixes further from the last sample are left out: the samples have a hole, or the time is damaged. A choice."""


class MountingFinder:
    """Folds samples and fixes into evidence on the mounting, and decides on it at whole seconds.

    Attributes
    ----------
    C_b_from_m : (3, 3) what samples have to be turned by
    """

    def __init__(self, tuning: MountingTuning | None = None) -> None:
        self.tuning = tuning or MountingTuning()
        self.C_b_from_m: FloatArray = np.eye(3)
        self._sums: FloatArray = np.zeros((len(SPANS), SUMS))
        self._rest: FloatArray = np.zeros(REST)
        self._found_sd_rad: FloatArray = np.full(2, math.inf)
        self._verdict = np.zeros(3, np.bool_)  # contradicted, agreed, settled
        self._evaluation_ns: TimeArray = np.zeros(1, np.int64)
        self._observed_ns: TimeArray = np.zeros(1, np.int64)  # the newest fix that was made use of
        self._imu_t_ns: TimeArray = np.empty(0, np.int64)
        self._imu: FloatArray = np.empty((0, 6))
        self._gnss_t_ns: TimeArray = np.empty(0, np.int64)
        self._gnss: FloatArray = np.empty((0, len(GNSS)))

    _STATE = (
        "C_b_from_m",
        "_sums",
        "_rest",
        "_found_sd_rad",
        "_verdict",
        "_evaluation_ns",
        "_observed_ns",
        "_imu_t_ns",
        "_imu",
        "_gnss_t_ns",
        "_gnss",
    )

    def arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """The whole state by name."""
        return {name.lstrip("_"): getattr(self, name) for name in self._STATE}

    def load(self, arrays: dict[str, npt.NDArray[np.generic]]) -> None:
        """Take over what ``arrays`` gave."""
        for name in self._STATE:
            setattr(self, name, arrays[name.lstrip("_")])

    @property
    def found(self) -> bool:
        """Whether the nominal mounting was found wrong, and another in its place."""
        return bool(self._found_sd_rad[1] < math.inf)

    @property
    def found_sd_rad(self) -> tuple[float, float]:
        """Sd of tilt and of yaw of ``C_b_from_m`` when it was found; infinite before."""
        return float(self._found_sd_rad[0]), float(self._found_sd_rad[1])

    @property
    def contradicted(self) -> bool:
        """Whether ``C_b_from_m`` is known to be wrong, with no better one found yet."""
        return bool(self._verdict[0])

    @property
    def agreed(self) -> bool:
        """Whether accelerations were seen that are as ``C_b_from_m`` has them."""
        return bool(self._verdict[1])

    @property
    def settled(self) -> bool:
        """Whether ``C_b_from_m`` agrees as surely as another would have to be known to be found in its place."""
        return bool(self._verdict[2])

    @property
    def undisputed(self) -> bool:
        """Whether enough of the drive was seen without a word against ``C_b_from_m``."""
        waited = any(
            sums[N] >= self.tuning.patience * span.weight for sums, span in zip(self._sums, SPANS, strict=True)
        )
        return not self.contradicted and (self.agreed or waited)

    # Samples in, decisions out

    def boundary_ns(self, t_ns: int) -> int:
        """The whole second at which is judged next; ``t_ns`` is the next sample's time."""
        if self._evaluation_ns[0] == 0:
            self._evaluation_ns[0] = next_second_ns(np.int64(t_ns))
        return int(self._evaluation_ns[0])

    def add(self, t_ns: TimeArray, f_m: FloatArray, omega_m: FloatArray, gnss: tuple[TimeArray, FloatArray]) -> None:
        """Samples in m before the next whole second, in order, and usable fixes; late or far ones are left out."""
        last_ns = int(self._imu_t_ns[-1]) if len(self._imu_t_ns) else 0
        newest_ns = int(self._gnss_t_ns[-1] if len(self._gnss_t_ns) else self._observed_ns[0])
        kept, _ = timely(gnss[0], t_ns, last_ns, newest_ns, NEAR_S, NEAR_S)
        self._gnss_t_ns = np.concatenate([self._gnss_t_ns, gnss[0][kept]])
        self._gnss = np.concatenate([self._gnss, gnss[1][kept]])
        self._imu_t_ns = np.concatenate([self._imu_t_ns, t_ns])
        self._imu = np.concatenate([self._imu, np.hstack([f_m, omega_m])])

    def evaluate(self, t_ns: int) -> FloatArray | None:
        """Judge what was before ``boundary_ns``, now that a sample at ``t_ns``, not before it, has come.

        Returns
        -------
        (3, 3) the turn C_new_from_old of the body axes if another mounting was found; the identity where the one gone
        by has just become ``contradicted``, so that nothing learnt by it is gone by any longer; else None
        """
        self._observe(int(np.searchsorted(self._gnss_t_ns, self._evaluation_ns[0])))
        self._trim(int(self._evaluation_ns[0]))
        self._evaluation_ns[0] = next_second_ns(np.int64(t_ns))
        evidence, was_contradicted = self.evidence(), self.contradicted
        contradicted = self._contradicts(evidence)
        if contradicted and evidence.yaw_sd_rad <= self.tuning.found_sd_rad:
            turn = evidence.C_b_from_m @ self.C_b_from_m.T
            self.C_b_from_m = evidence.C_b_from_m
            self._found_sd_rad[:] = evidence.tilt_sd_rad, evidence.yaw_sd_rad
            self._verdict[:] = False, True, True
            return turn
        agreed = not contradicted and evidence.yaw_sd_rad <= self.tuning.agreed_sd_rad
        self._verdict[:] = contradicted, agreed, agreed and evidence.yaw_sd_rad <= self.tuning.found_sd_rad
        return np.eye(3) if contradicted and not was_contradicted else None

    def recent(self) -> tuple[TimeArray, FloatArray, TimeArray, FloatArray]:
        """The last seconds of samples in m, (n,) and (n, 6), and of fixes, (k,) and rows."""
        return self._imu_t_ns, self._imu, self._gnss_t_ns, self._gnss

    def _trim(self, t_ns: int) -> None:
        longest_s = max((span.span_s + self.tuning.slack_s) * (span.fixes - 1) for span in SPANS)
        keep_ns = t_ns - int(longest_s * 1e9) - SECOND_NS
        kept = self._imu_t_ns >= keep_ns
        self._imu_t_ns, self._imu = self._imu_t_ns[kept], self._imu[kept]
        kept = self._gnss_t_ns >= keep_ns
        self._gnss_t_ns, self._gnss = self._gnss_t_ns[kept], self._gnss[kept]

    # Observations

    def _observe(self, count: int) -> None:
        """Add what the newest of the first ``count`` fixes makes with those before it to the sums."""
        if count == 0 or self._gnss_t_ns[count - 1] <= self._observed_ns[0]:
            return
        newest = count - 1
        self._observed_ns[0] = self._gnss_t_ns[newest]
        velocity = fix_velocity(self._gnss[newest]) is not None
        for sums, span in zip(self._sums, SPANS, strict=True):
            if span.velocity is not velocity:
                continue
            chosen = self._against(newest, span)
            if chosen is None:
                continue
            t_ns, fixes = self._gnss_t_ns[chosen], self._gnss[chosen]
            force_m, area_s, hole_s = carried_force(self._imu_t_ns, self._imu, t_ns)
            if hole_s > MAX_GAP_S:
                continue
            if velocity:
                v = np.array([fix_velocity(fix) for fix in fixes], dtype=float)[:, :2]
            else:
                v = np.diff(offsets_m(fixes), axis=0) / (np.diff(t_ns) * 1e-9)[:, None]
            self._add(sums, span.weight, force_m, v[0], (v[1] - v[0]) / area_s, v[1])

    def _against(self, newest: int, span: Span) -> list[int] | None:
        """Which fixes make an observation with the ``newest``, in order; None if they are not there."""
        chosen = [newest]
        while len(chosen) < span.fixes:
            after_ns = int(self._gnss_t_ns[chosen[0]])
            # Fixes come with some milliseconds of jitter.
            k = int(np.searchsorted(self._gnss_t_ns, after_ns - int((span.span_s - 0.1) * 1e9), side="right")) - 1
            while span.velocity and k >= 0 and fix_velocity(self._gnss[k]) is None:
                k -= 1
            if k < 0 or (after_ns - int(self._gnss_t_ns[k])) * 1e-9 > span.span_s + self.tuning.slack_s:
                return None
            chosen.insert(0, k)
        return chosen

    def _add(
        self,
        sums: FloatArray,
        weight: float,
        force_m: FloatArray,
        v0: FloatArray,
        accel: FloatArray,
        v1: FloatArray,
    ) -> None:
        """Judge an observation, north and east: rest, motion that can be believed, or neither."""
        t = self.tuning
        if abs(math.hypot(*force_m) - STANDARD_GRAVITY_MPS2) > t.max_accel_mps2:
            return
        if max(math.hypot(*v0), math.hypot(*v1)) <= t.standing_mps:
            add_rest(self._rest, force_m, t.rest_memory_s)
            return
        middle = 0.5 * (v0 + v1)
        speed, size = math.hypot(*middle), math.hypot(*accel)
        if speed < t.min_speed_mps or size > t.max_accel_mps2:
            return
        evidence = regress(sums, self._rest, t)
        if sums[N] + self._rest[0] >= t.level_weight:
            # Whatever the yaw is, both have to be of a size.
            felt = evidence.C_b_from_m @ (force_m - evidence.force_m)
            if abs(math.hypot(felt[0], felt[1]) - size) > t.mismatch_mps2:
                return
        along = middle[0] * accel[0] + middle[1] * accel[1]
        across = middle[0] * accel[1] - middle[1] * accel[0]
        add_motion(sums, force_m, np.array([along, across]) / speed, weight, t.memory_s)

    # Evidence

    def evidence(self) -> MountingEvidence:
        """The mounting that the surest kind of observation speaks for."""
        found = [regress(sums, self._rest, self.tuning) for sums in self._sums]
        return min(found, key=lambda evidence: (evidence.yaw_sd_rad, evidence.tilt_sd_rad))

    def _contradicts(self, evidence: MountingEvidence) -> bool:
        """Whether the evidence speaks against ``C_b_from_m`` by more than small angles, significantly."""
        t = self.tuning
        turn = evidence.C_b_from_m @ self.C_b_from_m.T
        tilt = math.acos(min(1.0, max(-1.0, float(turn[2, 2]))))
        if tilt - t.significance * evidence.tilt_sd_rad > t.most_tilt_rad:
            return True
        yaw = abs(math.atan2(turn[1, 0], turn[0, 0]))
        return evidence.yaw_sd_rad <= t.agreed_sd_rad and yaw - t.significance * evidence.yaw_sd_rad > t.most_yaw_rad
