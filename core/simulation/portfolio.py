"""A portfolio of simulated drivers whose true claim rates are known: what they are like, a year of records, claims.

The truth is of another form than the score model's, on purpose: distance to a power and not in bands, a smooth curve
over the hours and not a table, a bounded probit of what drivers are like and not an exponential of what is counted,
and a factor that no record shows. Claims are overdispersed. Every number is a choice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.special import expit, ndtr

from core.driving.exposure import Driven, Exposure, Facet
from core.driving.manoeuvres import Manoeuvre
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.risk.lookup import ROADS
from core.scoring.record import MASS_UNIT, BeliefSums, Record, SpeedingSums
from core.tunables import Tunables, tunable

IntArray = npt.NDArray[np.int64]

MONTH_DAYS: Final = (31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31)
KINDS: Final = tuple(kind.value for kind in Manoeuvre)
_HOURS: Final = np.arange(24.0)
_USUAL_KM: Final = 12_000.0
_SPEED_KMH: Final = 40.0
_TRIP_KM: Final = 11.0
_LIMITS_KNOWN, _LIMITS_CERTAIN = 0.9, 0.8
_THETA: Final = 0.03
_RATES: Final = np.array([0.5, 0.4, 0.4, 0.15])
"""Per 100 km of a driver with nothing to him, in the order of ``KINDS``."""
_ROAD_SHARE: Final = np.array([0.24, 0.10, 0.19, 0.16, 0.11, 0.07, 0.10, 0.01, 0.015, 0.005])
_URBAN: Final = np.array([-0.5, -0.4, -0.1, 0.0, 0.2, -0.3, 0.5, 0.6, 0.4, -0.5])
_ROAD_RISK: Final = np.array([0.55, 0.75, 1.0, 1.2, 1.3, 1.2, 1.5, 1.2, 1.4, 1.0])
"""True risk a km, in the order of ``ROADS``."""


@dataclass(frozen=True, slots=True)
class PortfolioTuning(Tunables):
    """What the truth is like."""

    claims_per_year: float = tunable(
        0.1, unit="1/year", low=0.001, high=10.0, source="choice: all claims, small ones too"
    )
    unobserved_sd: float = tunable(0.35, unit="1", low=0.0, high=2.0, source="choice: of ln rate; no record shows it")
    chance_shape: float = tunable(
        2.0, unit="1", low=0.1, high=1000.0, source="choice: Gamma of a year's luck, so claims are overdispersed"
    )
    cells: int = tunable(120, unit="1", low=10, high=10000, source="choice: cells that the portfolio drives in")
    cell_shape: float = tunable(3.0, unit="1", low=0.1, high=100.0, source="choice: Gamma of the true risk of cells")
    known_age: float = tunable(0.9, unit="1", low=0.0, high=1.0, source="choice: share of drivers who say their age")
    known_sex: float = tunable(0.8, unit="1", low=0.0, high=1.0, source="choice: share of drivers who say their sex")


@dataclass(frozen=True, slots=True, eq=False)
class Drivers:
    """n drivers as they are: long-run means of all that records show, and their true claims a year.

    Parameters
    ----------
    age, sex : None where not said
    annual_km, claims_per_year, over_share, excess_kmh, risk : (n,)
    hour_share, road_share, cell_share : (n, 24), (n, 10), (n, cells); rows sum to 1
    rate : (n, 4) manoeuvres per 100 km, in the order of ``KINDS``
    cell_risk : (cells,) true relative risk
    """

    age: tuple[int | None, ...]
    sex: tuple[str | None, ...]
    annual_km: FloatArray
    claims_per_year: FloatArray
    hour_share: FloatArray
    road_share: FloatArray
    cell_share: FloatArray
    rate: FloatArray
    over_share: FloatArray
    excess_kmh: FloatArray
    risk: FloatArray
    cell_risk: FloatArray
    tuning: PortfolioTuning

    def __len__(self) -> int:
        return len(self.annual_km)

    def claims(self, generator: np.random.Generator) -> IntArray:
        """Claims of one year, (n,): Poisson about the true rate and the year's luck."""
        luck = generator.gamma(self.tuning.chance_shape, 1.0 / self.tuning.chance_shape, len(self))
        return generator.poisson(self.claims_per_year * luck)


def cell_names(count: int) -> tuple[str, ...]:
    """Names of the simulated cells."""
    return tuple(f"cell{index:04d}" for index in range(count))


def drivers(generator: np.random.Generator, n: int, tuning: PortfolioTuning | None = None) -> Drivers:
    """Draw n drivers. The young are wilder and drive more by night, men a little too; the old see less and drive less.

    Raises
    ------
    InvalidInputError
        If n is not positive.
    """
    if n < 1:
        raise InvalidInputError(f"{n} drivers: expected one or more")
    tuning = tuning or PortfolioTuning()
    age = np.clip(np.rint(generator.normal(48.0, 16.0, n)), 18, 88)
    man = generator.random(n) < 0.52
    young, old = np.exp(-(age - 18.0) / 8.0), np.clip((age - 65.0) / 10.0, 0.0, None)
    z = generator.standard_normal((6, n))
    wild = 0.8 * z[0] + 0.8 * young + 0.15 * man
    fast = 0.4 * z[0] + 0.7 * z[1] + 0.4 * young + 0.1 * man
    late = 0.7 * z[2] + 0.6 * young - 0.3 * old
    urban = z[3]
    annual_km = _USUAL_KM * np.exp(0.5 * z[4] - 0.125 + 0.1 * man - 0.15 * old)
    day = 0.25 + np.exp(-(((_HOURS - 8.0) / 2.5) ** 2)) + 1.3 * np.exp(-(((_HOURS - 15.5) / 4.0) ** 2))
    day *= np.where((_HOURS < 5) | (_HOURS >= 22), 0.15, 1.0)
    at_night = np.where((_HOURS < 5) | (_HOURS >= 22), 1.0, np.where(_HOURS >= 19, 0.4, 0.0))
    hour_share = _shares(day * np.exp(np.outer(late, at_night)))
    road_share = _shares(_ROAD_SHARE * np.exp(np.outer(urban, _URBAN)))
    cell_risk = generator.gamma(tuning.cell_shape, 1.0 / tuning.cell_shape, tuning.cells)
    cell_share = _cell_shares(generator, n, tuning.cells)
    noise = generator.standard_normal((n, len(KINDS)))
    rate = _RATES * np.exp(0.6 * wild[:, None] + 0.4 * noise - 0.1)
    hour_risk = 0.8 + 2.6 * np.exp(-((np.minimum(np.abs(_HOURS - 2.5), 24.0 - np.abs(_HOURS - 2.5)) / 2.5) ** 2))
    hour_risk += 0.3 * np.exp(-(((_HOURS - 17.0) / 1.5) ** 2))
    behaviour = 0.5 + ndtr(0.7 * wild + 0.5 * fast - 0.3)
    place = (road_share @ _ROAD_RISK) * (0.4 + 0.6 * cell_share @ cell_risk)
    true = (0.25 + 0.75 * (annual_km / _USUAL_KM) ** 0.75) * (hour_share @ hour_risk) * place * behaviour
    true *= np.exp(tuning.unobserved_sd * z[5] + 0.3 * old)
    says_age, says_sex = generator.random(n) < tuning.known_age, generator.random(n) < tuning.known_sex
    return Drivers(
        age=tuple(int(one) if said else None for one, said in zip(age, says_age, strict=True)),
        sex=tuple(("M" if one else "F") if said else None for one, said in zip(man, says_sex, strict=True)),
        annual_km=annual_km,
        claims_per_year=true * (tuning.claims_per_year / true.mean()),
        hour_share=hour_share,
        road_share=road_share,
        cell_share=cell_share,
        rate=rate,
        over_share=expit(-2.7 + 0.7 * fast),
        excess_kmh=5.5 + 3.5 * np.exp(0.3 * fast),
        risk=expit(-2.6 + 0.4 * wild + 0.3 * fast),
        cell_risk=cell_risk,
        tuning=tuning,
    )


def a_year(generator: np.random.Generator, portfolio: Drivers) -> list[list[Record]]:
    """Records of a year's months: by driver, then by month."""
    n, months = len(portfolio), len(MONTH_DAYS)
    days = np.array(MONTH_DAYS, float)
    season = 1.0 + 0.12 * np.sin(2.0 * np.pi * (np.arange(months) - 3.0) / 12.0)
    km = portfolio.annual_km[:, None] * (days * season / (days @ season)) * generator.gamma(6.0, 1.0 / 6.0, (n, months))
    trips = generator.poisson(km / _TRIP_KM)
    hours = _by_trips(generator, trips, portfolio.hour_share)
    cells = _by_trips(generator, trips, portfolio.cell_share)
    roads = _shares(
        generator.gamma(np.maximum(60.0 * portfolio.road_share, 1e-3)[:, None, :].repeat(months, 1)) + 1e-12
    )
    mood = generator.gamma(4.0, 0.25, (n, months, 1))
    counts = generator.poisson(portfolio.rate[:, None, :] * km[..., None] / 100.0 * mood)
    over = _about(generator, portfolio.over_share, months, 80.0)
    excess = portfolio.excess_kmh[:, None] * generator.gamma(30.0, 1.0 / 30.0, (n, months))
    risk = _about(generator, portfolio.risk, months, 200.0)
    driven_days = np.minimum(np.rint(days * generator.beta(6.0, 2.0, (n, months))), trips)
    return [
        [
            _record(
                km[i, m],
                int(trips[i, m]),
                int(driven_days[i, m]),
                hours[i, m],
                roads[i, m],
                cells[i, m],
                counts[i, m],
                over[i, m],
                excess[i, m],
                risk[i, m],
            )
            for m in range(months)
        ]
        for i in range(n)
    ]


def long_run(portfolio: Drivers, years: float) -> list[Record]:
    """What each driver would show over very many years, without chance: the mean that a record is drawn about."""
    km = portfolio.annual_km * years
    counts = np.rint(portfolio.rate * km[:, None] / 100.0).astype(np.int64)
    return [
        _record(
            km[i],
            round(km[i] / _TRIP_KM),
            0,
            portfolio.hour_share[i],
            portfolio.road_share[i],
            portfolio.cell_share[i],
            counts[i],
            portfolio.over_share[i],
            portfolio.excess_kmh[i],
            portfolio.risk[i],
        )
        for i in range(len(portfolio))
    ]


def others_accidents(
    generator: np.random.Generator, portfolio: Drivers, years: float
) -> tuple[dict[str, Driven], dict[str, int]]:
    """Exposure and accidents by cell of so many other driver-years that drive alike: what places are learnt from."""
    share = portfolio.annual_km @ portfolio.cell_share
    share /= share.sum()
    accidents = generator.poisson(portfolio.tuning.claims_per_year * years * share * portfolio.cell_risk)
    names = cell_names(len(share))
    distance_mm = np.rint(share * years * portfolio.annual_km.mean() * 1e6).astype(np.int64)
    exposure = {name: Driven(mm, 0) for name, mm in zip(names, distance_mm.tolist(), strict=True)}
    return exposure, dict(zip(names, accidents.tolist(), strict=True))


def _record(
    km: float,
    trips: int,
    days: int,
    hours: FloatArray,
    roads: FloatArray,
    cells: FloatArray,
    counts: IntArray,
    over: float,
    excess_kmh: float,
    risk: float,
) -> Record:
    if not trips:
        return Record()
    total = _driven(km)
    known_ms = round(_LIMITS_KNOWN * total.time_ms)
    over_ms, certain_ms = round(over * known_ms), round(_LIMITS_CERTAIN * known_ms)
    instants = max(total.time_ms // 1000, 1)
    shares = np.array([0.0, 1.0 - 1.3 * risk, 0.6 * risk, 0.0, 0.7 * risk, 0.0, 0.0, 0.0]) * (1.0 - _THETA)
    shares[7] = _THETA
    return Record(
        trips=trips,
        days=days,
        exposure=Exposure(
            total,
            {
                Facet.HOUR: _split(total, hours, tuple(f"{hour:02d}" for hour in range(24))),
                Facet.ROAD_CLASS: _split(total, roads, ROADS),
            },
        ),
        cells=_split(total, cells, cell_names(len(cells))),
        manoeuvres={kind: int(count) for kind, count in zip(KINDS, counts, strict=True) if count},
        speeding=SpeedingSums(
            known_ms=known_ms,
            unknown_ms=total.time_ms - known_ms,
            over_ms=over_ms,
            certain_ms=certain_ms,
            certain_over_ms=round(over * certain_ms),
            excess_mm=round(over_ms * excess_kmh / 3.6),
        ),
        belief={"vehicle": BeliefSums(instants, tuple(round(one * instants / MASS_UNIT) for one in shares.tolist()))},
    )


def _driven(km: float) -> Driven:
    return Driven(round(km * 1e6), round(km / _SPEED_KMH * 3.6e6))


def _split(total: Driven, shares: FloatArray, names: tuple[str, ...]) -> dict[str, Driven]:
    """A total by shares, in whole numbers that sum to it: ends are rounded, not lengths."""
    ends = np.cumsum(shares) / shares.sum()
    ends[-1] = 1.0
    mm, ms = (np.diff(np.rint(ends * whole).astype(np.int64), prepend=0).tolist() for whole in total)
    return {name: Driven(*one) for name, *one in zip(names, mm, ms, strict=True) if one[0]}


def _by_trips(generator: np.random.Generator, trips: IntArray, shares: FloatArray) -> FloatArray:
    """Shares of so many trips by what each is drawn for, (n, months, k)."""
    drawn = generator.multinomial(trips, np.broadcast_to(shares[:, None, :], (*trips.shape, shares.shape[1])))
    return np.where(trips[..., None] > 0, drawn, shares[:, None, :])


def _about(generator: np.random.Generator, mean: FloatArray, months: int, size: float) -> FloatArray:
    """Shares about their mean, (n, months), as of so many draws."""
    return generator.beta(size * mean[:, None], size * (1.0 - mean[:, None]), (len(mean), months))


def _cell_shares(generator: np.random.Generator, n: int, cells: int) -> FloatArray:
    """About a home on a ring of cells, and a little everywhere, (n, cells)."""
    home = generator.integers(0, cells, n)
    away = np.abs(np.arange(cells)[None, :] - home[:, None])
    away = np.minimum(away, cells - away)
    reach = generator.uniform(1.0, 6.0, n)
    return 0.85 * _shares(np.exp(-0.5 * (away / reach[:, None]) ** 2)) + 0.15 / cells


def _shares(weights: FloatArray) -> FloatArray:
    return np.asarray(weights / weights.sum(axis=-1, keepdims=True))
