"""The path that a vehicle drove, sampled by distance: where it was, how the road rose and leant, how sure that is."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from core.measurements import FloatArray
from core.navigation.poses import LONGEST_STEP_S, covariance_at
from core.navigation.solution import Solution
from core.navigation.track import TRACK, Mode
from core.tunables import Tunables, tunable

STEP_M: Final = 1.0
"""Distance between samples of the path, m: a fifth of the usual spacing of the profile; a choice."""


@dataclass(frozen=True, slots=True)
class PathTuning(Tunables):
    """How a car shows the road under it."""

    min_speed_mps: float = tunable(
        1.0, unit="m/s", low=0.1, high=10, source="choice: below it the course is no direction of the road"
    )
    window_m: float = tunable(
        10.0, unit="m", low=2, high=100, source="choice: grade and bank are means over it; a car is 4 m long"
    )
    body_sd_rad: float = tunable(
        0.003, unit="rad", low=0, high=0.05, source="choice: heave of 1-2 cm and pitch on the springs over the window"
    )
    roll_rad_per_mps2: float = tunable(
        0.0089, unit="rad/(m/s2)", low=0, high=0.03, source="5 deg/g; cars 3-7 deg/g (Gillespie 1992, ch. 6)"
    )
    roll_sd_rad_per_mps2: float = tunable(
        0.0036, unit="rad/(m/s2)", low=0, high=0.03, source="2 deg/g: the spread between cars (Gillespie 1992, ch. 6)"
    )


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Samples ``STEP_M`` apart, in the order driven; (n,) each unless said.

    ``stretch`` counts the pieces between holes of the solution, and ``s_m`` is the distance driven. ``course_rad`` is
    the direction of travel; ``grade`` is rise over horizontal distance that way and ``bank_rad`` the cross slope,
    positive where the road falls to the right of it. ``var_h_m2`` is the (n, 2, 2) covariance north and east.
    ``lean_sd_rad`` is what one sd of the springs' stiffness does to the bank, with its sign.
    """

    stretch: npt.NDArray[np.int64]
    s_m: FloatArray
    t_s: FloatArray
    lat_rad: FloatArray
    lon_rad: FloatArray
    alt_m: FloatArray
    course_rad: FloatArray
    grade: FloatArray
    bank_rad: FloatArray
    lean_sd_rad: FloatArray
    var_h_m2: FloatArray
    var_alt_m2: FloatArray
    var_grade: FloatArray
    var_bank_rad2: FloatArray

    def __len__(self) -> int:
        return len(self.s_m)


def path_of(solution: Solution, tuning: PathTuning, gravity_mps2: float) -> Path | None:
    """Sample a solution by distance; what stands still or has no covariance gives no samples, None if all does.

    Grade is the mean of the vertical over the horizontal velocity along the window, so it does not see the steps that
    a causal position makes at fixes. Bank is the vehicle's roll without what the springs give to lateral acceleration:
    the body leans outwards by k (a - g bank), so that bank = (roll + k a) / (1 + k g). A wrong roll of the box in
    the car goes into the bank as it is.
    """
    track = solution.track
    values = track.values
    rows = (track.column("mode") != Mode.ALIGNING) & np.isfinite(values[:, : TRACK["sd_n_m"]]).all(axis=1)
    covariance, reached = covariance_at(solution, track.t_ns[rows])
    t_ns, values, covariance = track.t_ns[rows][reached], values[rows][reached], covariance[reached]
    if len(t_ns) < 2:
        return None
    t_s = (t_ns - t_ns[0]) * 1e-9
    edges = [0, *(np.flatnonzero(np.diff(t_s) > LONGEST_STEP_S) + 1), len(t_s)]
    pieces, driven_m = [], 0.0
    for number, (low, high) in enumerate(pairwise(edges)):
        piece = _stretch(number, driven_m, t_s[low:high], values[low:high], covariance[low:high], tuning, gravity_mps2)
        if piece is not None:
            pieces.append(piece)
            driven_m = float(piece.s_m[-1])
    return _joined(pieces)


def _stretch(
    number: int,
    driven_m: float,
    t_s: FloatArray,
    values: FloatArray,
    covariance: FloatArray,
    tuning: PathTuning,
    gravity_mps2: float,
) -> Path | None:
    vn, ve, vd = values[:, TRACK["vn_mps"] : TRACK["vd_mps"] + 1].T
    speed = np.hypot(vn, ve)
    moving = speed >= tuning.min_speed_mps
    both = moving[1:] & moving[:-1]
    step_s = np.diff(t_s)
    step_m = np.where(both, (speed[1:] + speed[:-1]) / 2 * step_s, 0.0)
    along = np.concatenate([[0.0], np.cumsum(step_m)])
    if along[-1] < 2 * STEP_M:
        return None
    kept = np.flatnonzero(moving)
    at = np.arange(0.0, along[-1], STEP_M)

    def sampled(series: FloatArray) -> FloatArray:
        return np.asarray(np.interp(at, along[kept], series[kept]))

    low, high = np.clip(at - tuning.window_m / 2, 0.0, None), np.clip(at + tuning.window_m / 2, None, along[-1])

    def mean_slope(integral: FloatArray) -> FloatArray:
        """Mean over the window of what was integrated along the way."""
        return np.asarray((np.interp(high, along, integral) - np.interp(low, along, integral)) / (high - low))

    course = np.unwrap(np.arctan2(ve, vn)[kept])
    forwards = np.where(np.cos(np.arctan2(ve, vn) - values[:, TRACK["yaw_rad"]]) >= 0.0, 1.0, -1.0)
    roll = forwards * values[:, TRACK["roll_rad"]]
    risen = np.concatenate([[0.0], np.cumsum(np.where(both, -(vd[1:] + vd[:-1]) / 2 * step_s, 0.0))])
    leant = np.concatenate([[0.0], np.cumsum((roll[1:] + roll[:-1]) / 2 * step_m)])
    turned = np.interp(np.arange(len(t_s)), kept, course)
    v = sampled(speed)
    k = tuning.roll_rad_per_mps2
    lateral = v * v * mean_slope(turned)
    share = 1.0 / (1.0 + k * gravity_mps2)
    course_at = sampled(turned)
    cos, sin = np.cos(course_at), np.sin(course_at)
    variance = np.stack([sampled(covariance[:, i, j]) for i in range(9) for j in range(9)], axis=-1).reshape(-1, 9, 9)
    roll_var = cos * cos * variance[:, 6, 6] + 2 * cos * sin * variance[:, 6, 7] + sin * sin * variance[:, 7, 7]
    return Path(
        stretch=np.full(len(at), number),
        s_m=driven_m + at,
        t_s=sampled(t_s),
        lat_rad=sampled(values[:, TRACK["lat_rad"]]),
        lon_rad=sampled(np.unwrap(values[:, TRACK["lon_rad"]])),
        alt_m=sampled(values[:, TRACK["alt_m"]]),
        course_rad=course_at,
        grade=mean_slope(risen),
        bank_rad=share * (mean_slope(leant) + k * lateral),
        lean_sd_rad=share * lateral * tuning.roll_sd_rad_per_mps2,
        var_h_m2=variance[:, :2, :2],
        var_alt_m2=variance[:, 2, 2],
        var_grade=variance[:, 5, 5] / (v * v) + tuning.body_sd_rad**2,
        var_bank_rad2=share**2 * (roll_var + tuning.body_sd_rad**2),
    )


def _joined(pieces: list[Path]) -> Path | None:
    if not pieces:
        return None
    return Path(**{name: np.concatenate([getattr(piece, name) for piece in pieces]) for name in Path.__slots__})
