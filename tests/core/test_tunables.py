"""Every tunable number of the core says its unit, its range and its source."""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil

import pytest

import core
from core.errors import InvalidInputError
from core.tunables import Tunables, describe, tunable

MODULES_OF_TUNABLES = ("thresholds", "tuning")
"""Modules that hold nothing but tunables: no dataclass in them may go without."""


def core_modules():
    for info in pkgutil.walk_packages(core.__path__, "core."):
        yield importlib.import_module(info.name)


def all_tunables():
    modules = list(core_modules())
    found = {cls for cls in walk(Tunables) if cls.__module__.startswith("core.")}
    assert modules
    return sorted(found, key=lambda cls: cls.__qualname__)


def walk(cls):
    for sub in cls.__subclasses__():
        yield sub
        yield from walk(sub)


@pytest.mark.parametrize("cls", all_tunables(), ids=lambda cls: cls.__name__)
def test_each_tunable_has_unit_range_and_source(cls):
    groups = [field for field in dataclasses.fields(cls) if isinstance(field.default, Tunables)]
    assert describe(cls) or groups  # its own, or nothing but groups of them
    cls()
    assert cls.__dataclass_params__.frozen


def test_modules_of_tunables_hold_nothing_without_them():
    for module in core_modules():
        if module.__name__.rsplit(".", 1)[-1] in MODULES_OF_TUNABLES:
            for cls in vars(module).values():
                if isinstance(cls, type) and dataclasses.is_dataclass(cls) and cls.__module__ == module.__name__:
                    assert issubclass(cls, Tunables), f"{module.__name__}.{cls.__name__} is no Tunables"


def test_field_without_facts_is_refused():
    @dataclasses.dataclass(frozen=True)
    class Bare(Tunables):
        gate: float = 3.0

    with pytest.raises(InvalidInputError, match=r"Bare\.gate has no unit"):
        Bare()


@pytest.mark.parametrize(("unit", "source"), [("", "choice"), ("m", "")])
def test_field_with_empty_facts_is_refused(unit, source):
    @dataclasses.dataclass(frozen=True)
    class Empty(Tunables):
        gate: float = tunable(3.0, unit=unit, low=0.0, high=5.0, source=source)

    with pytest.raises(InvalidInputError, match="no unit or no source"):
        describe(Empty)


@pytest.mark.parametrize("value", [5.1, -0.1, float("nan"), float("inf")])
def test_value_out_of_range_is_refused_and_says_what_was_expected(value):
    @dataclasses.dataclass(frozen=True)
    class Gates(Tunables):
        gate: float = tunable(3.0, unit="m", low=0.0, high=5.0, source="choice")

    assert Gates(5.0).gate == 5.0
    with pytest.raises(InvalidInputError, match=r"Gates\.gate.*expected 0 to 5 m"):
        Gates(value)


def test_default_out_of_its_own_range_is_refused():
    @dataclasses.dataclass(frozen=True)
    class Wrong(Tunables):
        gate: float = tunable(9.0, unit="m", low=0.0, high=5.0, source="choice")

    with pytest.raises(InvalidInputError, match="outside its own range"):
        describe(Wrong)
