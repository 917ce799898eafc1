"""Which aids are let in: in range, later than those before, near an inertial sample; and how far fixes are trusted."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from core.measurements import GNSS, FloatArray, TimeArray
from core.navigation.tuning import PARAMETER

_LAT, _LON, _ALT = GNSS["lat_rad"], GNSS["lon_rad"], GNSS["alt_m"]
_VN, _VE, _VD = GNSS["vn_mps"], GNSS["ve_mps"], GNSS["vd_mps"]
_SPEED, _COURSE = GNSS["speed_mps"], GNSS["course_rad"]
_SD_H, _SD_V, _SD_VEL = GNSS["sd_h_m"], GNSS["sd_v_m"], GNSS["sd_v_mps"]
_HDOP, _VDOP, _SATELLITES, _FIX = GNSS["hdop"], GNSS["vdop"], GNSS["satellites"], GNSS["fix"]
_P_SD_H = PARAMETER["gnss_sd_h_m"]
_P_UERE = PARAMETER["gnss_uere_m"]
_P_HEIGHT = PARAMETER["gnss_height_factor"]
_P_FLOOR = PARAMETER["gnss_sd_floor_m"]
_P_SATELLITES = PARAMETER["gnss_min_satellites"]

MAX_LATITUDE_RAD = math.radians(89.9)
"""Nearer to a pole north and east mean nothing; no road leads there."""
MAX_HEIGHT_M = 20_000.0
MAX_SPEED_MPS = 200.0
"""Beyond these a fix or wheel speed is damaged: above any road, and 720 km/h."""
MAX_SPREAD = 1_000.0
"""A fix with a spread (m, m/s) or dilution beyond this says nothing."""

PRESSURES_PA = (30_000.0, 110_000.0)
"""From above the highest road (5 900 m, 480 hPa) to the shore of the Dead Sea (1 070 hPa); a sensor's own range."""

MAX_FIELD_UT = 10_000.0
"""Beyond the end of a box's magnetometer, 4900 uT: a damaged sample."""

BoolArray = npt.NDArray[np.bool_]


@njit(cache=True, nogil=True)
def _usable_fix(fix: FloatArray, par: FloatArray) -> bool:
    if not (abs(fix[_LAT]) <= MAX_LATITUDE_RAD and abs(fix[_LON]) <= 2.0 * math.pi):
        return False
    if fix[_FIX] < 2.0 or fix[_SATELLITES] < par[_P_SATELLITES]:
        return False
    # Written so that what is missing, NaN, passes.
    if abs(fix[_ALT]) > MAX_HEIGHT_M or abs(fix[_SPEED]) > MAX_SPEED_MPS or math.isinf(fix[_COURSE]):
        return False
    if abs(fix[_VN]) > MAX_SPEED_MPS or abs(fix[_VE]) > MAX_SPEED_MPS or abs(fix[_VD]) > MAX_SPEED_MPS:
        return False
    if fix[_SD_H] > MAX_SPREAD or fix[_SD_V] > MAX_SPREAD or fix[_SD_VEL] > MAX_SPREAD:
        return False
    return not (fix[_HDOP] > MAX_SPREAD or fix[_VDOP] > MAX_SPREAD)


@njit(cache=True, nogil=True)
def usable_fixes(fixes: FloatArray, par: FloatArray) -> BoolArray:
    """Which rows of (n, len(GNSS_COLUMNS)) say where the vehicle is, with nothing beyond a road vehicle's reach."""
    usable = np.empty(fixes.shape[0], np.bool_)
    for k in range(fixes.shape[0]):
        usable[k] = _usable_fix(fixes[k], par)
    return usable


@njit(cache=True, nogil=True)
def position_sd_m(fix: FloatArray, par: FloatArray) -> tuple[float, float]:
    """Horizontal (per axis) and vertical sd of a fix: stated, else by HDOP and VDOP, else the default."""
    if fix[_SD_H] > 0.0:
        horizontal = fix[_SD_H]
    elif fix[_HDOP] > 0.0:
        horizontal = fix[_HDOP] * par[_P_UERE]
    else:
        horizontal = par[_P_SD_H]
    horizontal = max(horizontal, par[_P_FLOOR])
    if fix[_SD_V] > 0.0:
        vertical = max(fix[_SD_V], par[_P_FLOOR])
    elif fix[_VDOP] > 0.0:
        vertical = max(fix[_VDOP] * par[_P_UERE] * par[_P_HEIGHT], par[_P_FLOOR])
    else:
        vertical = par[_P_HEIGHT] * horizontal
    return horizontal, vertical


def usable_fields(magnetic_b_ut: FloatArray) -> BoolArray:
    """Which magnetometer samples (n, 3) a sensor can give."""
    return np.asarray((np.abs(magnetic_b_ut) <= MAX_FIELD_UT).all(axis=1))


def usable_speeds(speed_mps: FloatArray) -> BoolArray:
    """Which wheel speeds (n,) a vehicle can have; a wheel has no direction."""
    return (speed_mps >= 0.0) & (speed_mps <= MAX_SPEED_MPS)


def usable_pressures(pressure_pa: FloatArray) -> BoolArray:
    """Which air pressures (n,) there are on roads."""
    return (pressure_pa >= PRESSURES_PA[0]) & (pressure_pa <= PRESSURES_PA[1])


@njit(cache=True, nogil=True)
def thinned(t_ns: TimeArray, last_ns: int, interval_ns: int) -> tuple[BoolArray, int]:
    """Which times (n,) lie ``interval_ns`` after the one chosen before, from ``last_ns`` on; and the last chosen."""
    chosen = np.zeros(t_ns.shape[0], np.bool_)
    for k in range(t_ns.shape[0]):
        if t_ns[k] - last_ns >= interval_ns:
            chosen[k] = True
            last_ns = t_ns[k]
    return chosen, last_ns


def timely(
    t_ns: TimeArray, imu_t_ns: TimeArray, last_imu_ns: int, newest_ns: int, ahead_s: float, late_s: float
) -> tuple[BoolArray, int]:
    """Which times (n,) of a series are later than all before and neither too long before nor after a sample.

    Where the inertial samples have a hole, or before the first, there is nothing to aid: what came in would
    pile up, and a time far ahead would keep all after it out.

    Parameters
    ----------
    t_ns, imu_t_ns : (n,), (m,) times of the series and of the inertial samples that came with it
    last_imu_ns : the inertial sample before those, 0 if none
    newest_ns : the newest time of the series that was let in, 0 if none
    ahead_s : how far after an inertial sample
    late_s : how far before the last inertial sample that was taken in before

    Returns
    -------
    (n,) mask, and the newest time let in
    """
    sample_ns = np.concatenate([[last_imu_ns], imu_t_ns])[np.searchsorted(imu_t_ns, t_ns, side="right")]
    near = (sample_ns > 0) & (t_ns <= sample_ns + int(ahead_s * 1e9)) & (t_ns >= last_imu_ns - int(late_s * 1e9))
    before_ns = np.maximum.accumulate(np.concatenate([[newest_ns], np.where(near, t_ns, 0)]))
    return near & (t_ns > before_ns[:-1]), int(before_ns[-1])
