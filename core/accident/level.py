"""The last seconds of a vehicle's motion in a level frame, free of gravity: what the detectors look back on."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
import numpy.typing as npt
from numba import njit

from core.accident.events import VehicleMotion
from core.accident.thresholds import LevelThresholds
from core.measurements import FloatArray, TimeArray

A_X, A_Y, A_Z, V_X, V_Y, V_Z, SPEED, YAW_RATE, ROLL_RATE, PITCH_RATE = range(10)
FORCE, UPRIGHT, REST_S, SLOW_X, SLOW_Y, ROUGH, CLIP_S, HEADING_COS, HEADING_SIN = range(10, 19)
COLUMNS: Final = 19
"""Columns of ``LevelMotion.x``. ``A`` is acceleration, m/s2, gravity removed, in the level frame: z down, x along the
vehicle's heading when the series began, so that a spinning car's change of velocity adds up. ``V`` is its integral,
m/s. ``SPEED`` is the fused speed, ``YAW_RATE``, ``ROLL_RATE`` and ``PITCH_RATE`` are the rates about the body's axes,
rad/s, ``FORCE`` is the length of the specific force. ``UPRIGHT`` is the cosine between the vertical and where it
usually is in the body, ``REST_S`` for how long the vehicle has stood, s. ``SLOW`` is the horizontal acceleration of
the last ``slow_s``, what brakes, engine and steering do; ``ROUGH`` the mean square of the vertical one over
``rough_s``. ``CLIP_S`` is for how long an axis has read its full scale, s; ``HEADING`` is the vehicle's in the level
frame."""

CLIPPED: Final = 1
"""Bit of ``LevelMotion.flags``: the accelerometer read its full scale in the horizontal plane."""
GAP: Final = 2
"""The samples before are missing: no change of velocity is known across."""
LEVELLED: Final = 4
"""The filter had no attitude: the vertical is from gyroscope and gravity alone."""

KEPT_NS: Final = 2_500_000_000
"""How long rows are kept, ns: the longest window a detector may ask for (1 s), the time it may take to decide, and
the length of a pulse, with room to spare. A choice; it changes no result."""

Flags = npt.NDArray[np.uint8]


class LevelMotion:
    """Folds ``VehicleMotion`` into level rows and keeps the last ``KEPT_NS`` of them.

    Samples that are not finite or not later than the one before are left out. Where the filter has no
    attitude (``down_b`` NaN), the vertical is carried on by the gyroscopes and drawn to the measured specific force
    while that is near 1 g: a complementary filter (Mahony, Hamel & Pflimlin 2008, IEEE TAC 53(5)) with the gain
    1 / ``levelling_s``.

    Attributes
    ----------
    t_ns : (n,) int64
    x : (n, COLUMNS) float64
    flags : (n,) uint8
    """

    def __init__(self, thresholds: LevelThresholds) -> None:
        self._thresholds = thresholds
        self._down_b: FloatArray = np.full((2, 3), np.nan)
        self.t_ns: TimeArray = np.empty(0, dtype=np.int64)
        self.x: FloatArray = np.empty((0, COLUMNS))
        self.flags: Flags = np.empty(0, dtype=np.uint8)

    def extend(self, motion: VehicleMotion) -> int:
        """Take the next samples; return the first new row."""
        n = motion.t_ns.shape[0]
        kept = int(np.searchsorted(self.t_ns, self.t_ns[-1] - KEPT_NS)) if self.t_ns.size else 0
        old = self.t_ns.shape[0] - kept
        t_ns, x = np.empty(old + n, dtype=np.int64), np.empty((old + n, COLUMNS))
        flags = np.empty(old + n, dtype=np.uint8)
        t_ns[:old], x[:old], flags[:old] = self.t_ns[kept:], self.x[kept:], self.flags[kept:]
        limits = self._thresholds
        rows = _extend(
            np.ascontiguousarray(motion.t_ns, dtype=np.int64),
            np.ascontiguousarray(motion.f_b, dtype=np.float64),
            np.ascontiguousarray(motion.omega_b, dtype=np.float64),
            np.ascontiguousarray(motion.down_b, dtype=np.float64),
            np.ascontiguousarray(motion.speed_mps, dtype=np.float64),
            np.ascontiguousarray(motion.saturated, dtype=np.uint8),
            motion.gravity_mps2,
            limits.gap_s,
            limits.levelling_s,
            limits.levelling_band_mps2,
            limits.clipped_from_mps2,
            np.array(
                [
                    limits.usual_s,
                    limits.standing_mps,
                    limits.slow_s,
                    limits.rough_s,
                    limits.parks_s,
                    math.cos(math.radians(limits.slope_deg)),
                ]
            ),
            self._down_b,
            old,
            t_ns,
            x,
            flags,
        )
        self.t_ns, self.x, self.flags = t_ns[:rows], x[:rows], flags[:rows]
        return int(old)

    def turn(self, C_new_from_old: FloatArray) -> None:
        """Take samples in other body axes from now on: only the carried verticals are in them, rows are level."""
        self._down_b = np.array([np.sum(C_new_from_old * down_b, axis=1) for down_b in self._down_b])

    def state(self) -> dict[str, npt.NDArray[np.generic]]:
        """Arrays from which ``load`` goes on."""
        kept = int(np.searchsorted(self.t_ns, self.t_ns[-1] - KEPT_NS)) if self.t_ns.size else 0
        return {
            "level.t_ns": self.t_ns[kept:],
            "level.x": self.x[kept:],
            "level.flags": self.flags[kept:],
            "level.down_b": self._down_b,
        }

    def load(self, arrays: Mapping[str, npt.NDArray[np.generic]]) -> None:
        """Go on from a ``state``."""
        self.t_ns = np.array(arrays["level.t_ns"], dtype=np.int64)
        self.x = np.array(arrays["level.x"], dtype=np.float64)
        self.flags = np.array(arrays["level.flags"], dtype=np.uint8)
        self._down_b = np.array(arrays["level.down_b"], dtype=np.float64)


@njit(cache=True, nogil=True)
def _extend(
    in_t_ns: TimeArray,
    f_b: FloatArray,
    omega_b: FloatArray,
    down_b: FloatArray,
    speed_mps: FloatArray,
    saturated: FloatArray,
    gravity_mps2: float,
    gap_s: float,
    levelling_s: float,
    band_mps2: float,
    clipped_from_mps2: float,
    context: FloatArray,
    downs: FloatArray,
    row: int,
    t_ns: TimeArray,
    x: FloatArray,
    flags: Flags,
) -> int:
    """Fill rows from ``row`` on; return the row after the last.

    ``downs`` (2, 3) are the carried vertical and where it usually is, kept up. ``context`` (6,): the time over which
    the usual one follows, s, below which speed a vehicle stands, m/s, the times of the two means, s, how long the usual
    one follows at once after a vehicle stopped, s, and up to which cosine.
    """
    down, usual = downs[0], downs[1]
    usual_s, standing_mps, slow_s, rough_s, parks_s, slope_cos = context
    for i in range(in_t_ns.shape[0]):
        fx, fy, fz = f_b[i, 0], f_b[i, 1], f_b[i, 2]
        p, q, r = omega_b[i, 0], omega_b[i, 1], omega_b[i, 2]
        if not math.isfinite(fx + fy + fz + p + q + r):
            continue
        first = row == 0
        if not first and in_t_ns[i] <= t_ns[row - 1]:
            continue
        dt = 0.0 if first else (in_t_ns[i] - t_ns[row - 1]) * 1e-9
        flag = GAP if first or dt > gap_s else 0

        dx, dy, dz = down_b[i, 0], down_b[i, 1], down_b[i, 2]
        if not math.isfinite(dx + dy + dz):
            flag |= LEVELLED
            force = math.sqrt(fx * fx + fy * fy + fz * fz)
            off = abs(force - gravity_mps2)
            dx, dy, dz = down[0], down[1], down[2]
            if not math.isfinite(dx):
                if off > band_mps2:
                    continue  # nothing says yet where down is
                dx, dy, dz = -fx / force, -fy / force, -fz / force
            else:
                step = min(dt, gap_s)
                pull = min(1.0, step / levelling_s) * max(0.0, 1.0 - off / band_mps2) / max(force, 1e-3)
                ex = dx + step * (dy * r - dz * q) - pull * (fx + force * dx)
                ey = dy + step * (dz * p - dx * r) - pull * (fy + force * dy)
                ez = dz + step * (dx * q - dy * p) - pull * (fz + force * dz)
                norm = max(math.sqrt(ex * ex + ey * ey + ez * ez), 1e-9)
                dx, dy, dz = ex / norm, ey / norm, ez / norm
        down[0], down[1], down[2] = dx, dy, dz

        # Forward: body x laid into the level plane, or body z where x is the vertical itself (mounting not known yet).
        ax, ay, az = fx + gravity_mps2 * dx, fy + gravity_mps2 * dy, fz + gravity_mps2 * dz
        a_down = ax * dx + ay * dy + az * dz
        plane2 = 1.0 - dx * dx
        if plane2 > 1e-6:
            scale = 1.0 / math.sqrt(plane2)
            a_forward = (ax - dx * a_down) * scale
            a_right = (ay * dz - az * dy) * scale
        else:
            a_forward, a_right = az, -dx * ay
        if first:
            cos, sin = 1.0, 0.0
        else:
            turn = (p * dx + q * dy + r * dz) * min(dt, gap_s)
            c, s = x[row - 1, HEADING_COS], x[row - 1, HEADING_SIN]
            ct, st = math.cos(turn), math.sin(turn)
            cos, sin = c * ct - s * st, s * ct + c * st
            norm = 1.0 / math.sqrt(cos * cos + sin * sin)
            cos, sin = cos * norm, sin * norm
        x[row, A_X] = a_forward * cos - a_right * sin
        x[row, A_Y] = a_forward * sin + a_right * cos
        x[row, A_Z] = a_down
        if saturated[i] != 0 and a_forward * a_forward + a_right * a_right >= clipped_from_mps2 * clipped_from_mps2:
            flag |= CLIPPED
        if first:
            x[row, V_X], x[row, V_Y] = 0.0, 0.0
        else:
            half = 0.5 * min(dt, gap_s)
            x[row, V_X] = x[row - 1, V_X] + half * (x[row, A_X] + x[row - 1, A_X])
            x[row, V_Y] = x[row - 1, V_Y] + half * (x[row, A_Y] + x[row - 1, A_Y])
        step = min(dt, gap_s)
        x[row, V_Z] = 0.0 if first else x[row - 1, V_Z] + 0.5 * step * (x[row, A_Z] + x[row - 1, A_Z])
        x[row, SPEED], x[row, YAW_RATE], x[row, ROLL_RATE], x[row, PITCH_RATE] = speed_mps[i], r, p, q
        force = math.sqrt(fx * fx + fy * fy + fz * fz)
        x[row, FORCE] = force
        if not math.isfinite(usual[0]):
            usual[0], usual[1], usual[2] = dx, dy, dz
        x[row, UPRIGHT] = usual[0] * dx + usual[1] * dy + usual[2] * dz
        # While it stands, a car that is lifted or carried leans against how it stood: on a slope, it may be.
        stands = speed_mps[i] < standing_mps
        parks = stands and not first and x[row - 1, REST_S] < parks_s and x[row, UPRIGHT] > slope_cos
        if x[row, UPRIGHT] > 0.9 and abs(force - gravity_mps2) < band_mps2 and (parks or not stands):
            share = step / ((1.0 if parks else usual_s) + step)
            ex = usual[0] + share * (dx - usual[0])
            ey = usual[1] + share * (dy - usual[1])
            ez = usual[2] + share * (dz - usual[2])
            norm = max(math.sqrt(ex * ex + ey * ey + ez * ez), 1e-9)
            usual[0], usual[1], usual[2] = ex / norm, ey / norm, ez / norm
        if first:
            x[row, SLOW_X], x[row, SLOW_Y], x[row, ROUGH] = 0.0, 0.0, 0.0
        else:
            slow, rough = step / (slow_s + step), step / (rough_s + step)
            x[row, SLOW_X] = x[row - 1, SLOW_X] + slow * (x[row, A_X] - x[row - 1, SLOW_X])
            x[row, SLOW_Y] = x[row - 1, SLOW_Y] + slow * (x[row, A_Y] - x[row - 1, SLOW_Y])
            x[row, ROUGH] = x[row - 1, ROUGH] + rough * (x[row, A_Z] * x[row, A_Z] - x[row - 1, ROUGH])
        # A car that cruises on a smooth road feels like one that stands: only the filter's speed tells.
        x[row, CLIP_S] = x[row - 1, CLIP_S] + dt if saturated[i] != 0 and not first else 0.0
        x[row, REST_S] = x[row - 1, REST_S] + dt if stands and not first else 0.0
        x[row, HEADING_COS], x[row, HEADING_SIN] = cos, sin
        t_ns[row], flags[row] = in_t_ns[i], flag
        row += 1
    return row
