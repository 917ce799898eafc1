"""A premium from relativities by a tariff, in exact decimals: every step stands in the quote and they sum to it."""

from __future__ import annotations

import decimal
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from typing import Any, Final

from core.errors import InvalidInputError
from core.scoring.numbers import Section, digest, text_of
from core.scoring.score import LONGEST_DAYS, Product, Score

ROUNDINGS: Final = {
    "half_even": decimal.ROUND_HALF_EVEN,
    "half_up": decimal.ROUND_HALF_UP,
    "down": decimal.ROUND_DOWN,
    "up": decimal.ROUND_UP,
}
_FACTOR: Final = Decimal("0.000001")
_PRO_RATA: Final = Decimal("0.0000000001")
_EXACT: Final = decimal.Context(prec=100, traps=[decimal.Inexact, decimal.InvalidOperation, decimal.Overflow])
"""Products and sums of a quote have some 50 digits at most."""
_ROUNDED: Final = decimal.Context(prec=28)


@dataclass(frozen=True, slots=True)
class Terms:
    """How a relativity enters: to the power of ``exponent``, from ``floor`` to ``cap``."""

    exponent: Decimal
    floor: Decimal
    cap: Decimal


@dataclass(frozen=True, slots=True)
class Tariff:
    """What a premium goes by; ``floor`` and ``cap`` are of all changes together."""

    name: str
    version: str
    sha256: str
    currency: str
    base: Decimal
    days: Decimal
    minor_units: int
    rounding: str
    products: Mapping[Product, Terms]
    floor: Decimal
    cap: Decimal


@dataclass(frozen=True, slots=True)
class Step:
    """One step: by what it multiplies (None where it does not), what it adds, and the amount then."""

    name: str
    text: str
    factor: Decimal | None
    change: Decimal
    amount: Decimal


@dataclass(frozen=True, slots=True)
class Quote:
    """A premium of a period; the steps' changes sum to it exactly."""

    premium: Decimal
    premium_minor: int
    currency: str
    days: float
    steps: tuple[Step, ...]
    tariff: str
    tariff_version: str
    tariff_sha256: str

    def to_json(self) -> dict[str, Any]:
        """As plain values; amounts and factors are decimal strings, since they are exact."""
        steps = [
            {
                "name": step.name,
                "text": step.text,
                "factor": None if step.factor is None else f"{step.factor:f}",
                "change": f"{step.change:f}",
                "amount": f"{step.amount:f}",
            }
            for step in self.steps
        ]
        return {
            "premium": f"{self.premium:f}",
            "premium_minor": self.premium_minor,
            "currency": self.currency,
            "days": self.days,
            "steps": steps,
            "tariff": self.tariff,
            "tariff_version": self.tariff_version,
            "tariff_sha256": self.tariff_sha256,
        }


def tariff_of(document: Mapping[str, Any]) -> Tariff:
    """The tariff that a TOML document says.

    Raises
    ------
    InvalidInputError
        That says what is wrong: a base that is not above 0, a cap below its floor, a product that is none, …
    """
    known = ("name", "version", "text", "currency", "premium", "products", "change")
    if unknown := [key for key in document if key not in known]:
        raise InvalidInputError(f"unknown key '{unknown[0]}': expected {', '.join(known)}")
    currency = text_of(document, "currency", "")
    if not (len(currency) == 3 and currency.isascii() and currency.isalpha() and currency.isupper()):
        raise InvalidInputError(f"currency is '{currency}': expected three letters of ISO 4217, such as EUR")
    premium = Section(document, "premium", ("base", "days", "minor_units", "rounding"))
    rounding = text_of(premium.content, "rounding", "premium.")
    if rounding not in ROUNDINGS:
        raise InvalidInputError(f"premium.rounding is '{rounding}': expected one of {', '.join(ROUNDINGS)}")
    minor_units = premium.number("minor_units")
    if minor_units not in range(5):
        raise InvalidInputError(f"premium.minor_units is {minor_units:g}: expected a whole number from 0 to 4")
    products = document.get("products", {})
    if not isinstance(products, Mapping):
        raise InvalidInputError(f"products is {products!r}: expected sections [products.payd] and so on")
    if strange := [name for name in products if name not in list(Product)]:
        raise InvalidInputError(f"products.{strange[0]} is no product: expected {', '.join(Product)}")
    floor, cap = _bounds(Section(document, "change", ("floor", "cap")))
    return Tariff(
        name=text_of(document, "name", ""),
        version=text_of(document, "version", ""),
        sha256=digest(document),
        currency=currency,
        base=_above_0(premium, "base"),
        days=_above_0(premium, "days"),
        minor_units=int(minor_units),
        rounding=rounding,
        products={product: _terms(document, product) for product in Product if product in products},
        floor=floor,
        cap=cap,
    )


def quote(tariff: Tariff, scores: Mapping[Product, Score], days: float) -> Quote:
    """The premium of a period of so many days: base, period, each product, limits, rounding.

    A product without a score changes nothing, and the step says why.

    Raises
    ------
    InvalidInputError
        If the period is none.
    """
    if not 0.0 < days <= LONGEST_DAYS:
        raise InvalidInputError(f"a premium for {days!r} days: expected more than 0, to {LONGEST_DAYS:.0f}")
    share = _ROUNDED.divide(_decimal(days), tariff.days).quantize(_PRO_RATA, context=_ROUNDED)
    per_year = f"base of {tariff.days.normalize():f} days"
    steps = [Step("base", per_year, None, tariff.base, tariff.base)]
    _multiply(steps, "period", f"{days:g} days of {tariff.days.normalize():f}", share)
    undiscounted = steps[-1].amount
    for product, terms in tariff.products.items():
        _multiply(steps, product.value, *_factor(terms, scores.get(product)))
    least, most = (_EXACT.multiply(undiscounted, bound) for bound in (tariff.floor, tariff.cap))
    if steps[-1].amount < least:
        _move(steps, "floor", f"at least {tariff.floor.normalize():f} of the base", least)
    elif steps[-1].amount > most:
        _move(steps, "cap", f"at most {tariff.cap.normalize():f} of the base", most)
    minor = Decimal(1).scaleb(-tariff.minor_units)
    premium = steps[-1].amount.quantize(minor, rounding=ROUNDINGS[tariff.rounding], context=_ROUNDED)
    _move(steps, "rounding", f"to {minor:f} {tariff.currency}, {tariff.rounding.replace('_', ' ')}", premium)
    return Quote(
        premium=premium,
        premium_minor=int(premium.scaleb(tariff.minor_units)),
        currency=tariff.currency,
        days=days,
        steps=tuple(steps),
        tariff=tariff.name,
        tariff_version=tariff.version,
        tariff_sha256=tariff.sha256,
    )


def _factor(terms: Terms, score: Score | None) -> tuple[str, Decimal]:
    if score is None or score.relativity is None:
        why = "not asked for" if score is None else score.reason
        return f"no score ({why}): as the portfolio", Decimal(1)
    powered = _ROUNDED.power(_decimal(score.relativity), terms.exponent)
    factor = min(max(powered.quantize(_FACTOR, context=_ROUNDED), terms.floor), terms.cap)
    told = f"relativity {score.relativity:.3f} to the power of {terms.exponent.normalize():f}"
    return f"{told}, from {terms.floor.normalize():f} to {terms.cap.normalize():f}", factor


def _multiply(steps: list[Step], name: str, text: str, factor: Decimal) -> None:
    before = steps[-1].amount
    amount = _EXACT.multiply(before, factor)
    steps.append(Step(name, text, factor, _EXACT.subtract(amount, before), amount))


def _move(steps: list[Step], name: str, text: str, amount: Decimal) -> None:
    steps.append(Step(name, text, None, _EXACT.subtract(amount, steps[-1].amount), amount))


def _terms(document: Mapping[str, Any], product: Product) -> Terms:
    section = Section(document, f"products.{product.value}", ("exponent", "floor", "cap"))
    exponent = _decimal(section.number("exponent"))
    if exponent < 0:
        raise InvalidInputError(f"{section.path}.exponent is {exponent:f}: expected 0 or more")
    return Terms(exponent, *_bounds(section))


def _bounds(section: Section) -> tuple[Decimal, Decimal]:
    floor, cap = _above_0(section, "floor"), _above_0(section, "cap")
    if cap < floor:
        raise InvalidInputError(f"{section.path}.cap is {cap:f}, below its floor {floor:f}: expected the floor or more")
    return floor, cap


def _above_0(section: Section, key: str) -> Decimal:
    value = _decimal(section.number(key))
    if not value > 0:
        raise InvalidInputError(f"{section.path}.{key} is {value:f}: expected more than 0")
    return value


def _decimal(value: float) -> Decimal:
    """As it is written: 0.1 is a tenth."""
    return Decimal(repr(value))
