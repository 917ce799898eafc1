"""Aids from the Earth's fields: heading by the magnetometer, height by the barometer."""

from __future__ import annotations

import math

from core.compiled import compiled
from core.measurements import FloatArray, TimeArray
from core.navigation.correction import Work, correct, count, record
from core.navigation.kalman import project_six, update
from core.navigation.mechanization import matrix_of
from core.navigation.state import (
    A_BAROMETER,
    A_MAGNETOMETER,
    ATT,
    BARO_BIAS,
    FUSED,
    POS,
    REJECTED_GATE,
    REJECTED_RANGE,
    X_ALT,
    X_BARO_BIAS,
    X_DR,
    X_FIELD,
    X_Q,
)
from core.navigation.tuning import PARAMETER

_P_GATE = PARAMETER["gate_scalar"]
_P_MAGNETIC = PARAMETER["magnetic_sd_rad"]
_P_MAGNETIC_CORRELATION = PARAMETER["magnetic_correlation_s"]
_P_MAGNETIC_INTERVAL = PARAMETER["magnetic_interval_s"]
_P_BARO = PARAMETER["baro_sd_m"]

EARTH_FIELD_UT = (20.0, 75.0)
"""The Earth's field is 22-67 uT (IGRF-13); what is outside is the car's iron."""
FIELD_CHANGE = 0.15
"""Share by which the field may differ from what was usual: a bridge, a tram, a lorry beside."""
FIELD_LEARN_SHARE = 0.02
"""Share by which the usual magnitude follows each sample used: some 50 s at 1 Hz."""


@compiled()
def fuse_magnetic(
    x: FloatArray,
    ti: TimeArray,
    p: FloatArray,
    t_ns: int,
    field_b_ut: tuple[float, float, float],
    par: FloatArray,
    work: Work,
) -> None:
    """Heading from the magnetic field: levelled by the attitude, its horizontal part points north.

    The iron of the car and the declination make one error that turns with the vehicle over minutes, so a sample a
    second must not add up: its variance is that of the error times the samples within its correlation time.
    """
    n, dx, ph = work[0], work[1], work[2]
    fx, fy, fz = field_b_ut
    magnitude = math.sqrt(fx * fx + fy * fy + fz * fz)
    usual = x[X_FIELD] if x[X_FIELD] > 0.0 else magnitude
    if (
        not EARTH_FIELD_UT[0] <= magnitude <= EARTH_FIELD_UT[1]
        or abs(magnitude - usual) > FIELD_CHANGE * usual
    ):  # fmt: skip
        count(ti, A_MAGNETOMETER, REJECTED_RANGE)
        record(ti, work, t_ns, A_MAGNETOMETER, 0, math.nan, math.nan, math.nan, REJECTED_RANGE)
        if EARTH_FIELD_UT[0] <= magnitude <= EARTH_FIELD_UT[1]:
            x[X_FIELD] = usual + FIELD_LEARN_SHARE * (magnitude - usual)
        return
    x[X_FIELD] = usual + FIELD_LEARN_SHARE * (magnitude - usual)
    c = matrix_of(x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3])
    mn = c[0] * fx + c[1] * fy + c[2] * fz
    me = c[3] * fx + c[4] * fy + c[5] * fz
    md = c[6] * fx + c[7] * fy + c[8] * fz
    horizontal_sq = max(mn * mn + me * me, 1.0)
    nu = -math.atan2(me, mn)
    # d(angle) = phi_d - m_d (m_n phi_n + m_e phi_e) / h^2, of m_n(true) = m_n + phi x m_n
    row = (-md * mn / horizontal_sq, -md * me / horizontal_sq, 1.0, 0.0, 0.0, 0.0)
    at = (ATT, ATT + 1, ATT + 2, ATT, ATT, ATT)
    samples = max(1.0, par[_P_MAGNETIC_CORRELATION] / par[_P_MAGNETIC_INTERVAL])
    single = project_six(p, n, at, row, ph)
    ratio = nu * nu / (par[_P_GATE] * (single + par[_P_MAGNETIC] ** 2))
    s = single + par[_P_MAGNETIC] ** 2 * samples
    outcome = FUSED if ratio <= 1.0 else REJECTED_GATE
    if outcome == FUSED:
        update(p, n, ph, s, nu, dx)
        correct(x, dx)
    count(ti, A_MAGNETOMETER, outcome)
    record(ti, work, t_ns, A_MAGNETOMETER, 0, nu, single + par[_P_MAGNETIC] ** 2, ratio, outcome)


@compiled()
def fuse_barometer(
    x: FloatArray, ti: TimeArray, p: FloatArray, t_ns: int, height_m: float, par: FloatArray, work: Work
) -> None:
    """Height in the standard atmosphere: the ellipsoidal one plus a bias of weather and geoid, a state."""
    n, dx, ph = work[0], work[1], work[2]
    nu = height_m - (x[X_ALT] - x[X_DR + 2]) - x[X_BARO_BIAS]
    at = (POS + 2, BARO_BIAS, POS, POS, POS, POS)
    s = project_six(p, n, at, (-1.0, 1.0, 0.0, 0.0, 0.0, 0.0), ph) + par[_P_BARO] ** 2
    ratio = nu * nu / (par[_P_GATE] * s)
    outcome = FUSED if ratio <= 1.0 else REJECTED_GATE
    if outcome == FUSED:
        update(p, n, ph, s, nu, dx)
        correct(x, dx)
    else:
        # A window opened, a tunnel's piston of air: believed bit by bit if it stays.
        p[BARO_BIAS * n + BARO_BIAS] += 0.25 * nu * nu / par[_P_GATE]
    count(ti, A_BAROMETER, outcome)
    record(ti, work, t_ns, A_BAROMETER, 0, nu, s, ratio, outcome)
