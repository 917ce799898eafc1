"""The road that a drive went along: its line in three dimensions and its profile, over repeated passes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from core.earth import STANDARD_GRAVITY_MPS2, ecef_from_geodetic, matrix_e_from_n, radii_m
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.navigation.road_path import STEP_M, Path, PathTuning, path_of
from core.navigation.solution import Solution
from core.tunables import Tunables, tunable

SPACING_M: Final = 5.0
LEAST_SPACING_M: Final = 1.0
MOST_SPACING_M: Final = 1000.0


@dataclass(frozen=True, slots=True)
class ProfileTuning(Tunables):
    """When two passes are of the same road, and how far their errors are one."""

    across_m: float = tunable(
        8.0, unit="m", low=1, high=50, source="choice: two lanes each way are 7 m between outer lanes' middles"
    )
    most_across_m: float = tunable(
        20.0, unit="m", low=1, high=100, source="choice: with a larger spread, a parallel road could be meant"
    )
    height_m: float = tunable(
        10.0, unit="m", low=0.5, high=50, source="single-frequency heights drift by metres; stacked roads are rare"
    )
    parallel_rad: float = tunable(
        math.radians(30.0), unit="rad", low=0.05, high=1.5, source="choice: side roads leave at 45 degrees and more"
    )
    again_m: float = tunable(
        50.0, unit="m", low=10, high=1000, source="choice: what was driven so much before is another pass"
    )
    shortest_m: float = tunable(
        25.0, unit="m", low=0, high=1000, source="choice: for less, a road is not taken as left or met again"
    )
    correlation_s: float = tunable(
        200.0, unit="s", low=1, high=1e5, source="GNSS errors of ionosphere, orbit and multipath: minutes"
    )
    crossfall: float = tunable(
        0.025, unit="1", low=0, high=0.2, source="usual cross slope of a carriageway 2.5 %: lanes differ in height"
    )


@dataclass(frozen=True, slots=True, eq=False)
class RoadLine:
    """A piece of road in the direction in which it was first driven; (n,) each.

    ``chainage_m`` is the distance along it; ``grade_rad`` is positive uphill and ``bank_rad`` where the road falls to
    the right, both that way. ``passes`` are all and ``opposite`` those the other way.
    """

    chainage_m: FloatArray
    lat_rad: FloatArray
    lon_rad: FloatArray
    alt_m: FloatArray
    grade_rad: FloatArray
    bank_rad: FloatArray
    sd_n_m: FloatArray
    sd_e_m: FloatArray
    sd_alt_m: FloatArray
    sd_grade_rad: FloatArray
    sd_bank_rad: FloatArray
    passes: npt.NDArray[np.int64]
    opposite: npt.NDArray[np.int64]


_FUSED: Final = tuple(name for name in RoadLine.__slots__ if name not in ("chainage_m", "passes", "opposite"))
"""What ``_fused`` gives, in its order."""


def profile_of(
    solution: Solution,
    spacing_m: float = SPACING_M,
    mount_roll_sd_rad: float = 0.0,
    tuning: ProfileTuning | None = None,
    path_tuning: PathTuning | None = None,
) -> list[RoadLine]:
    """Lines of the roads of a solution, each with two points or more, in the order driven.

    Every road gets its points when it is first driven. Whatever comes by later, near, at the same height and parallel,
    is another pass of it, whether the same way or the opposite one; a new line begins where no road is known. Standing
    still adds no points, and a hole in the solution ends a line.

    At each point a pass counts once, by its value where it goes by. So n passes lower the sd by up to the root of n,
    and points or samples of one pass do not lower it, since their errors are one. Passes weigh by their inverse
    variance; their errors hang together by ``correlation_s``; and where they differ by more than they
    state, the sd is widened by how much (Birge ratio). Height, grade and bank are of all passes, grade and bank of
    opposite ones turned; the line across is of the passes its own way, since opposite lanes lie apart. The roll of the
    box in the car is an error common to all, which only passes of both ways take out; likewise that of the springs.

    Parameters
    ----------
    solution : its position, velocity and attitude with their covariance
    spacing_m : distance between points
    mount_roll_sd_rad : how well the roll of the sensors' axes in the vehicle is known

    Raises
    ------
    InvalidInputError
        If the spacing is out of range.
    """
    if not LEAST_SPACING_M <= spacing_m <= MOST_SPACING_M:
        raise InvalidInputError(
            f"spacing of the profile is {spacing_m:g} m: expected {LEAST_SPACING_M:g} to {MOST_SPACING_M:g} m"
        )
    chosen = tuning or ProfileTuning()
    path = path_of(solution, path_tuning or PathTuning(), STANDARD_GRAVITY_MPS2)
    if path is None:
        return []
    found = _Passes(path, chosen)
    lines = []
    for samples in _points(path, found, spacing_m, chosen):
        if len(samples) > 1:
            near = [found.at(i) for i in samples]
            fused = [_fused(path, i, one, mount_roll_sd_rad, chosen) for i, one in zip(samples, near, strict=True)]
            fields = dict(zip(_FUSED, np.array(fused).T, strict=True))
            fields["chainage_m"] = path.s_m[samples] - path.s_m[samples[0]]
            passes = np.array([(len(one.way), np.count_nonzero(one.way < 0)) for one in near])
            lines.append(RoadLine(**fields, passes=passes[:, 0], opposite=passes[:, 1]))
    return lines


@dataclass(frozen=True, slots=True, eq=False)
class _Near:
    """Samples of the path beside one of it: indices, how far along and across, and +1 the same way, -1 opposite."""

    sample: npt.NDArray[np.int64]
    along_m: FloatArray
    across_m: FloatArray
    way: FloatArray


class _Passes:
    """Finds what of the path is the road at one of its samples."""

    def __init__(self, path: Path, tuning: ProfileTuning) -> None:
        self._path, self._tuning = path, tuning
        places = zip(path.lat_rad, path.lon_rad, path.alt_m, strict=True)
        self._place_e = np.array([ecef_from_geodetic(*place) for place in places])
        self._tree = KDTree(self._place_e)

    def near(self, i: int) -> _Near:
        """Samples within a step along the road, on the same road."""
        path, t = self._path, self._tuning
        j = np.array(sorted(self._tree.query_ball_point(self._place_e[i], 2 * t.most_across_m)), np.int64)
        C_e_from_n = matrix_e_from_n(path.lat_rad[i], path.lon_rad[i])
        north, east, down = ((self._place_e[j] - self._place_e[i]) @ C_e_from_n).T
        cos, sin = math.cos(path.course_rad[i]), math.sin(path.course_rad[i])
        along, across = cos * north + sin * east, cos * east - sin * north
        way = np.cos(path.course_rad[j] - path.course_rad[i])
        right = np.array([-sin, cos])
        across_sd = np.sqrt(right @ (path.var_h_m2[j] + path.var_h_m2[i]) @ right)
        height_sd = np.sqrt(path.var_alt_m2[j] + path.var_alt_m2[i])
        on = np.abs(along) <= STEP_M
        on &= np.abs(across) <= np.minimum(t.across_m + 2 * across_sd, t.most_across_m)
        on &= np.abs(down) <= t.height_m + 2 * height_sd
        on &= np.abs(way) >= math.cos(t.parallel_rad)
        return _Near(j[on], along[on], across[on], np.sign(way[on]))

    def known(self, i: int) -> bool:
        """Whether this was driven before."""
        return bool(np.any(self._path.s_m[self.near(i).sample] <= self._path.s_m[i] - self._tuning.again_m))

    def at(self, i: int) -> _Near:
        """The nearest sample of every pass."""
        near = self.near(i)
        begins = np.diff(self._path.s_m[near.sample], prepend=-np.inf) > self._tuning.again_m / 2
        best = [
            run[np.argmin(np.abs(near.along_m[run]))]
            for run in np.split(np.arange(len(begins)), np.flatnonzero(begins)[1:])
        ]
        return _Near(near.sample[best], near.along_m[best], near.across_m[best], near.way[best])


def _points(path: Path, passes: _Passes, spacing_m: float, tuning: ProfileTuning) -> list[npt.NDArray[np.int64]]:
    """Samples of the path that become points, a list for each line."""
    stride = max(round(spacing_m / STEP_M), 1)
    lines = []
    for number in np.unique(path.stretch):
        samples = np.flatnonzero(path.stretch == number)[::stride]
        known = np.array([passes.known(int(i)) for i in samples])
        edges = [0, *(np.flatnonzero(np.diff(known)) + 1), len(samples)]
        taken: list[list[int]] = []
        was_known = True
        for low, high in pairwise(edges):
            short = (high - low) * spacing_m < tuning.shortest_m and low > 0
            is_known = was_known if short else bool(known[low])
            if not is_known:
                if was_known:
                    taken.append([])
                taken[-1] += samples[low:high].tolist()
            was_known = is_known
        lines += [np.array(line) for line in taken]
    return lines


def _fused(path: Path, i: int, near: _Near, mount_roll_sd_rad: float, tuning: ProfileTuning) -> tuple[float, ...]:
    """One point of all passes, as ``_FUSED`` says."""
    j, way = near.sample, near.way
    t_s = path.t_s[j]
    cos, sin = math.cos(path.course_rad[i]), math.sin(path.course_rad[i])
    ahead, right = np.array([cos, sin]), np.array([-sin, cos])
    along_var, across_var = ahead @ path.var_h_m2[j] @ ahead, right @ path.var_h_m2[j] @ right
    grade = way * path.grade[j]

    same = way > 0
    across, across_var_m2 = _mean(near.across_m[same], across_var[same], t_s[same], tuning)
    height_var = path.var_alt_m2[j] + (path.grade[j] ** 2) * along_var
    height_var = height_var + np.where(same, 0.0, (tuning.crossfall * near.across_m) ** 2)
    alt, alt_var = _mean(path.alt_m[j] - grade * near.along_m, height_var, t_s, tuning)
    slope, slope_var = _mean(grade, path.var_grade[j], t_s, tuning)
    of_all = np.stack([way * mount_roll_sd_rad, way * path.lean_sd_rad[j]])
    bank, bank_var = _mean(way * path.bank_rad[j], path.var_bank_rad2[j], t_s, tuning, of_all)

    lat, lon = float(path.lat_rad[i]), float(path.lon_rad[i])
    meridian, transverse = radii_m(lat)
    horizontal = float(ahead @ path.var_h_m2[i] @ ahead) * np.outer(ahead, ahead)
    horizontal += across_var_m2 * np.outer(right, right)
    return (
        lat + across * right[0] / (meridian + alt),
        lon + across * right[1] / ((transverse + alt) * math.cos(lat)),
        alt,
        math.atan(slope),
        bank,
        *np.sqrt(np.diag(horizontal)),
        math.sqrt(alt_var),
        math.sqrt(slope_var),
        math.sqrt(bank_var),
    )


def _mean(
    values: FloatArray,
    variance: FloatArray,
    t_s: FloatArray,
    tuning: ProfileTuning,
    of_all: FloatArray | None = None,
) -> tuple[float, float]:
    """Best mean of passes and its variance.

    ``variance`` is of errors that hang together over time; it weighs as if they did not, so no weight is negative.
    Each row of ``of_all`` is one error that all passes have, as one sd of it shows in each.
    """
    shared = np.zeros((0, len(values))) if of_all is None else of_all
    spread = np.diag(variance) + shared.T @ shared
    weight = np.linalg.solve(spread, np.ones(len(values)))
    weight /= weight.sum()
    mean = float(weight @ values)
    together = np.exp(-np.abs(t_s[:, None] - t_s) / tuning.correlation_s)
    own = weight * np.sqrt(variance)
    mean_var = float(own @ together @ own) + float(np.sum((shared @ weight) ** 2))
    if len(values) > 1:
        off = values - mean
        mean_var *= max(1.0, float(off @ np.linalg.solve(spread, off)) / (len(values) - 1))
    return mean, mean_var
