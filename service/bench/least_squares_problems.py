"""Problems that minimisers are tested on: More, Garbow & Hillstrom (1981), and NIST's StRD with certified values."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from core.calibration.dogleg import Problem
from core.measurements import FloatArray

Model = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""From parameters (n,) and abscissae (m,) to values (m,) and their derivatives (n, m)."""


@dataclass(frozen=True, slots=True, eq=False)
class KnownProblem:
    """A problem with its start and its known minimum.

    Parameters
    ----------
    name : with its number in MGH, or NIST's own
    problem : residual and Jacobian
    start : (n,)
    sum_of_squares : at the minimum that a good minimiser reaches from this start
    solution : (n,); empty where the collection states none
    unit : (n,) what the variables are divided by for the minimiser; ones where the collection's own are to be used
    """

    name: str
    problem: Problem
    start: FloatArray
    sum_of_squares: float
    solution: FloatArray
    unit: FloatArray

    @property
    def scaled(self) -> Problem:
        """The problem in x / unit."""

        def in_units(u: FloatArray) -> tuple[FloatArray, FloatArray]:
            residual, jacobian = self.problem(u * self.unit)
            return residual, jacobian * self.unit

        return in_units


def _rosenbrock(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]), np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])


def _freudenstein_roth(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    a, b = x
    f = np.array([-13 + a + ((5 - b) * b - 2) * b, -29 + a + ((b + 1) * b - 14) * b])
    return f, np.array([[1.0, 10 * b - 3 * b * b - 2], [1.0, 3 * b * b + 2 * b - 14]])


def _powell_badly_scaled(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    f = np.array([1e4 * x[0] * x[1] - 1, math.exp(-x[0]) + math.exp(-x[1]) - 1.0001])
    return f, np.array([[1e4 * x[1], 1e4 * x[0]], [-math.exp(-x[0]), -math.exp(-x[1])]])


def _brown_badly_scaled(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.array([x[0] - 1e6, x[1] - 2e-6, x[0] * x[1] - 2]), np.array([[1.0, 0.0], [0.0, 1.0], [x[1], x[0]]])


def _beale(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    i = np.arange(1, 4)
    f = np.array([1.5, 2.25, 2.625]) - x[0] * (1 - x[1] ** i)
    return f, np.column_stack([-(1 - x[1] ** i), x[0] * i * x[1] ** (i - 1)])


def _jennrich_sampson(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    i = np.arange(1, 11)
    a, b = np.exp(i * x[0]), np.exp(i * x[1])
    return 2 + 2 * i - a - b, np.column_stack([-i * a, -i * b])


def _helical_valley(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    a, b, c = x
    turn = math.atan2(b, a) / (2 * math.pi)  # of (-1/4, 3/4], as MGH define it
    turn += 1.0 if turn <= -0.25 else 0.0
    r = math.hypot(a, b)
    f = np.array([10 * (c - 10 * turn), 10 * (r - 1), c])
    k = 100 / (2 * math.pi * r * r)
    return f, np.array([[k * b, -k * a, 10.0], [10 * a / r, 10 * b / r, 0.0], [0.0, 0.0, 1.0]])


def _box_3d(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    t = 0.1 * np.arange(1, 11)
    a, b, c = np.exp(-t * x[0]), np.exp(-t * x[1]), np.exp(-t) - np.exp(-10 * t)
    return a - b - x[2] * c, np.column_stack([-t * a, t * b, -c])


def _powell_singular(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    a, b, c, d = x
    r5, r10, s, t = math.sqrt(5), math.sqrt(10), b - 2 * c, a - d
    f = np.array([a + 10 * b, r5 * (c - d), s * s, r10 * t * t])
    rows = [[1, 10, 0, 0], [0, 0, r5, -r5], [0, 2 * s, -4 * s, 0], [2 * r10 * t, 0, 0, -2 * r10 * t]]
    return f, np.array(rows, dtype=float)


def _wood(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    a, b, c, d = x
    r90, r10 = math.sqrt(90), math.sqrt(10)
    f = np.array([10 * (b - a * a), 1 - a, r90 * (d - c * c), 1 - c, r10 * (b + d - 2), (b - d) / r10])
    rows = [
        [-20 * a, 10, 0, 0],
        [-1, 0, 0, 0],
        [0, 0, -2 * r90 * c, r90],
        [0, 0, -1, 0],
        [0, r10, 0, r10],
        [0, 1 / r10, 0, -1 / r10],
    ]
    return f, np.array(rows, dtype=float)


def _brown_dennis(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    t = np.arange(1, 21) / 5
    a, b = x[0] + t * x[1] - np.exp(t), x[2] + x[3] * np.sin(t) - np.cos(t)
    return a * a + b * b, np.column_stack([2 * a, 2 * a * t, 2 * b, 2 * b * np.sin(t)])


def _bard_model(x: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    v = 16 - u
    w = np.minimum(u, v)
    s = v * x[1] + w * x[2]
    return x[0] + u / s, np.stack([np.ones_like(u), -u * v / s**2, -u * w / s**2])


def _kowalik_osborne_model(x: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    top, bottom = u * (u + x[1]), u * (u + x[2]) + x[3]
    y = x[0] * top / bottom
    return y, np.stack([top / bottom, x[0] * u / bottom, -y * u / bottom, -y / bottom])


def _meyer_model(x: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    s = t + x[2]
    e = np.exp(x[1] / s)
    return x[0] * e, np.stack([e, x[0] * e / s, -x[0] * e * x[1] / s**2])


def _gaussian_model(x: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    off = t - x[2]
    e = np.exp(-0.5 * x[1] * off**2)
    return x[0] * e, np.stack([e, -0.5 * off**2 * x[0] * e, x[0] * x[1] * off * e])


def _saturating_model(x: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    e = np.exp(-x[1] * t)
    return x[0] * (1 - e), np.stack([1 - e, x[0] * t * e])


def _power_model(x: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    p = t ** x[1]
    return x[0] * p, np.stack([p, x[0] * p * np.log(t)])


def _logistic_model(x: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    e = np.exp(x[1] - x[2] * t)
    s = 1 / (1 + e)
    return x[0] * s, np.stack([s, -x[0] * e * s * s, x[0] * e * s * s * t])


def _richards_model(x: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    e = np.exp(x[1] - x[2] * t)
    p = (1 + e) ** (-1 / x[3])
    slope = -x[0] * p * e / (x[3] * (1 + e))
    return x[0] * p, np.stack([p, slope, -slope * t, x[0] * p * np.log1p(e) / x[3] ** 2])


def _peak_model(x: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    z = (t - x[2]) / x[1]
    y = x[0] / x[1] * np.exp(-0.5 * z * z)
    return y, np.stack([y / x[0], y * (z * z - 1) / x[1], y * z / x[1]])


def _rational_model(x: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    powers = np.stack([np.ones_like(t), t, t * t, t**3])
    top, bottom = x[:4] @ powers, 1 + x[4:] @ powers[1:]
    return top / bottom, np.vstack([powers / bottom, -top / bottom**2 * powers[1:]])


def _fit(model: Model, t: FloatArray, y: FloatArray) -> Problem:
    def problem(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        values, derivatives = model(x, t)
        return values - y, derivatives.T

    return problem


def _known(
    name: str,
    problem: Problem,
    start: tuple[float, ...],
    sum_of_squares: float,
    solution: tuple[float, ...] = (),
    unit: tuple[float, ...] = (),
) -> KnownProblem:
    units = np.array(unit) if unit else np.ones(len(start))
    return KnownProblem(name, problem, np.array(start), sum_of_squares, np.array(solution), units)


_BARD = _fit(
    _bard_model,
    np.arange(1.0, 16.0),
    np.array([0.14, 0.18, 0.22, 0.25, 0.29, 0.32, 0.35, 0.39, 0.37, 0.58, 0.73, 0.96, 1.34, 2.10, 4.39]),
)
_KOWALIK_OSBORNE = _fit(
    _kowalik_osborne_model,
    np.array([4.0, 2.0, 1.0, 0.5, 0.25, 0.167, 0.125, 0.1, 0.0833, 0.0714, 0.0625]),
    np.array([0.1957, 0.1947, 0.1735, 0.16, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246]),
)
_MEYER = _fit(
    _meyer_model,
    np.arange(50.0, 126.0, 5.0),
    np.array([34780, 28610, 23650, 19630, 16370, 13720, 11540, 9744, 8261, 7030, 6005, 5147, 4427, 3820, 3307, 2872]),
)
_HALF_BELL = (0.0009, 0.0044, 0.0175, 0.0540, 0.1295, 0.2420, 0.3521)
_GAUSSIAN = _fit(
    _gaussian_model, np.array([3.5 - 0.5 * i for i in range(15)]), np.array([*_HALF_BELL, 0.3989, *_HALF_BELL[::-1]])
)

MGH: Final = (
    _known("Rosenbrock (1)", _rosenbrock, (-1.2, 1.0), 0.0, (1.0, 1.0)),
    # The local minimum, to which every good minimiser comes from this start.
    _known("Freudenstein-Roth (2)", _freudenstein_roth, (0.5, -2.0), 48.98425, (11.4127790, -0.8968053)),
    _known("Powell badly scaled (3)", _powell_badly_scaled, (0.0, 1.0), 0.0, (1.0981593e-5, 9.1061467)),
    _known("Brown badly scaled (4)", _brown_badly_scaled, (1.0, 1.0), 0.0, (1e6, 2e-6)),
    _known("Beale (5)", _beale, (1.0, 1.0), 0.0, (3.0, 0.5)),
    _known("Jennrich-Sampson (6)", _jennrich_sampson, (0.3, 0.4), 124.36218, (0.2578252, 0.2578252)),
    _known("Helical valley (7)", _helical_valley, (-1.0, 0.0, 0.0), 0.0, (1.0, 0.0, 0.0)),
    _known("Bard (8)", _BARD, (1.0, 1.0, 1.0), 8.214877e-3, (0.0824106, 1.1330361, 2.3436952)),
    _known("Gaussian (9)", _GAUSSIAN, (0.4, 1.0, 0.0), 1.127933e-8, (0.3989561, 1.0000191, 0.0)),
    _known("Meyer (10)", _MEYER, (0.02, 4000.0, 250.0), 87.945855, (5.6096365e-3, 6181.34635, 345.223635)),
    _known("Box 3-D (12)", _box_3d, (0.0, 10.0, 20.0), 0.0, (1.0, 10.0, 1.0)),
    _known("Powell singular (13)", _powell_singular, (3.0, -1.0, 0.0, 1.0), 0.0, (0.0, 0.0, 0.0, 0.0)),
    _known("Wood (14)", _wood, (-3.0, -1.0, -3.0, -1.0), 0.0, (1.0, 1.0, 1.0, 1.0)),
    _known(
        "Kowalik-Osborne (15)",
        _KOWALIK_OSBORNE,
        (0.25, 0.39, 0.415, 0.39),
        3.0750560e-4,
        (0.19280693, 0.19128233, 0.12305651, 0.13606233),
    ),
    _known(
        "Brown-Dennis (16)",
        _brown_dennis,
        (25.0, 5.0, -5.0, -1.0),
        85822.2016,
        (-11.5944399, 13.2036301, -0.4034394, 0.2367788),
    ),
)
"""By their numbers in More, Garbow & Hillstrom (1981), at their standard starts, in their own variables."""

_MISRA1A = _fit(
    _saturating_model,
    np.array([77.6, 114.9, 141.1, 190.8, 239.9, 289.0, 332.8, 378.4, 434.8, 477.3, 536.8, 593.1, 689.1, 760.0]),
    np.array([10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02, 44.82, 50.76, 55.05, 61.01, 66.40, 75.47, 81.78]),
)
_DANWOOD = _fit(
    _power_model,
    np.array([1.309, 1.471, 1.490, 1.565, 1.611, 1.680]),
    np.array([2.138, 3.421, 3.597, 4.340, 4.882, 5.660]),
)
_BOXBOD = _fit(
    _saturating_model,
    np.array([1.0, 2.0, 3.0, 5.0, 7.0, 10.0]),
    np.array([109.0, 149.0, 149.0, 191.0, 213.0, 224.0]),
)
_RAT42 = _fit(
    _logistic_model,
    np.array([9.0, 14.0, 21.0, 28.0, 42.0, 57.0, 63.0, 70.0, 79.0]),
    np.array([8.93, 10.8, 18.59, 22.33, 39.35, 56.11, 61.73, 64.62, 67.08]),
)
# fmt: off
_RAT43 = _fit(
    _richards_model,
    np.arange(1.0, 16.0),
    np.array([16.08, 33.83, 65.80, 97.20, 191.55, 326.20, 386.87, 520.53, 590.03, 651.92, 724.93, 699.56, 689.96,
              637.56, 717.41]),
)
_ECKERLE4 = _fit(
    _peak_model,
    np.array([*np.arange(400.0, 436.0, 5.0), *np.arange(436.5, 464.0, 1.5), *np.arange(465.0, 501.0, 5.0)]),
    np.array([1.575e-4, 1.699e-4, 2.35e-4, 3.102e-4, 4.917e-4, 8.71e-4, 1.7418e-3, 4.64e-3, 6.5895e-3, 9.7302e-3,
              0.0149002, 0.023731, 0.0401683, 0.0712559, 0.1264458, 0.2073413, 0.2902366, 0.3445623, 0.3698049,
              0.3668534, 0.3106727, 0.2078154, 0.1164354, 0.0616764, 0.03372, 0.0194023, 0.0117831, 7.4357e-3,
              2.2732e-3, 8.8e-4, 4.579e-4, 2.345e-4, 1.586e-4, 1.143e-4, 7.1e-5]),
)
_THURBER = _fit(
    _rational_model,
    np.array([-3.067, -2.981, -2.921, -2.912, -2.840, -2.797, -2.702, -2.699, -2.633, -2.481, -2.363, -2.322, -1.501,
              -1.460, -1.274, -1.212, -1.100, -1.046, -0.915, -0.714, -0.566, -0.545, -0.400, -0.309, -0.109, -0.103,
              0.010, 0.119, 0.377, 0.790, 0.963, 1.006, 1.115, 1.572, 1.841, 2.047, 2.200]),
    np.array([80.574, 84.248, 87.264, 87.195, 89.076, 89.608, 89.868, 90.101, 92.405, 95.854, 100.696, 101.060,
              401.672, 390.724, 567.534, 635.316, 733.054, 759.087, 894.206, 990.785, 1090.109, 1080.914, 1122.643,
              1178.351, 1260.531, 1273.514, 1288.339, 1327.543, 1353.863, 1414.509, 1425.208, 1421.384, 1442.962,
              1464.350, 1468.705, 1447.894, 1457.628]),
)
# fmt: on

NIST: Final = (
    _known("Misra1a", _MISRA1A, (500.0, 1e-4), 1.2455138894e-1, (2.3894212918e2, 5.5015643181e-4), unit=(250.0, 5e-4)),
    _known("DanWood", _DANWOOD, (1.0, 5.0), 4.3173084083e-3, (7.6886226176e-1, 3.8604055871)),
    _known("BoxBOD", _BOXBOD, (100.0, 0.75), 1.1680088766e3, (2.1380940889e2, 5.4723748542e-1), unit=(200.0, 1.0)),
    _known(
        "Rat42",
        _RAT42,
        (100.0, 1.0, 0.1),
        8.0565229338,
        (7.2462237576e1, 2.6180768402, 6.7359200066e-2),
        unit=(100.0, 1.0, 0.1),
    ),
    _known(
        "Rat43",
        _RAT43,
        (700.0, 5.0, 0.75, 1.3),
        8.7864049080e3,
        (6.9964151270e2, 5.2771253025, 7.5962938329e-1, 1.2792483859),
        unit=(700.0, 5.0, 1.0, 1.0),
    ),
    _known(
        "Eckerle4",
        _ECKERLE4,
        (1.5, 5.0, 450.0),
        1.4635887487e-3,
        (1.5543827178, 4.0888321754, 4.5154121844e2),
        unit=(1.5, 5.0, 450.0),
    ),
    _known(
        "Thurber",
        _THURBER,
        (1000.0, 1000.0, 400.0, 40.0, 0.7, 0.3, 0.03),
        5.6427082397e3,
        (1288.1396800, 1491.0792535, 583.23836877, 75.416644291, 0.96629502864, 0.39797285797, 0.049727297349),
        unit=(1000.0, 1000.0, 400.0, 40.0, 0.7, 0.3, 0.03),
    ),
    _known(
        "MGH09",
        _KOWALIK_OSBORNE,
        (0.25, 0.39, 0.415, 0.39),
        3.0750560385e-4,
        (1.9280693458e-1, 1.9128232873e-1, 1.2305650693e-1, 1.3606233068e-1),
    ),
    _known(
        "MGH10",
        _MEYER,
        (0.02, 4000.0, 250.0),
        8.7945855171e1,
        (5.6096364710e-3, 6.1813463463e3, 3.4522363462e2),
        unit=(0.02, 4000.0, 250.0),
    ),
)
"""NIST Statistical Reference Datasets, nonlinear regression: certified to eleven digits; units of the size of a start
(NIST's second; its first of Misra1a, and MGH's own of the two that are theirs)."""
