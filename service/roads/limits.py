"""Legal limits: what OpenStreetMap's tags say in either direction, and a country's defaults where they say nothing."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Final

from service.errors import UsageError
from service.roads.protocol import RoadClass, Surroundings

Tags = Mapping[str, str]

RULES: Final = ("urban", "rural", "expressway", "motorway", "living_street")
"""Rules that a country's table may have."""
KMH_PER: Final = {"": 1.0, "km/h": 1.0, "kmh": 1.0, "kph": 1.0, "mph": 1.609344, "knots": 1.852}
WALKING_KMH: Final = 7.0
"""``maxspeed=walk``; German courts hold 4 to 7 km/h, and the most is what may be driven."""
PLAUSIBLE_KMH: Final = (4.0, 200.0)
"""A sign outside it is a slip of the mapper; the highest signs anywhere are of 150 to 160 km/h."""

_NUMBER: Final = re.compile(r"(\d+(?:\.\d+)?)\s*(km/h|kmh|kph|mph|knots)?")
_RULE: Final = re.compile(r"([A-Z]{2})(?:-[A-Z0-9]+)?:([a-z_]+):?(\d+)?")
_IMPLIED_BY: Final = ("maxspeed:type", "source:maxspeed", "zone:maxspeed", "zone:traffic")
"""Keys that name the rule by which a limit holds, where ``maxspeed`` itself is missing."""
_SAME_RULE: Final = {"nsl_single": "rural", "nsl_dual": "motorway", "trunk": "expressway"}
"""Other names of our rules: the British national limit on single and dual carriageways, trunk roads."""


@dataclass(frozen=True, slots=True)
class CountryLimits:
    """Default limits by country and rule, km/h."""

    by_country: Mapping[str, Mapping[str, float]]

    @classmethod
    def read(cls, own: Path | None = None) -> CountryLimits:
        """The project's table, with a user's own countries in place of its; raises UsageError."""
        table = _checked(tomllib.loads(resources.files(__package__).joinpath("limits.toml").read_text("utf-8")), "")
        if own is not None:
            try:
                table |= _checked(tomllib.loads(own.read_text("utf-8")), f"{own}: ")
            except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
                raise UsageError(f"{own}: no table of limits ({error}); expected TOML as [FI] urban = 50") from error
        return cls(table)

    def of(self, country: str | None, rule: str) -> float:
        """A country's limit by a rule, NaN where it is not known."""
        return self.by_country.get(country or "", {}).get(rule, math.nan)


def stated_limits(tags: Tags, defaults: CountryLimits) -> tuple[float, float]:
    """What the tags say along the way's own direction and against it, km/h; NaN where they say nothing that holds."""
    both = math.nan
    for key in ("maxspeed", *_IMPLIED_BY):
        if math.isnan(both):
            both = _stated(tags.get(key), defaults)
    forward, backward = (_stated(tags.get(f"maxspeed:{one}"), defaults) for one in ("forward", "backward"))
    return both if math.isnan(forward) else forward, both if math.isnan(backward) else backward


def assumed_rule(road_class: RoadClass, motorroad: bool, surroundings: Surroundings) -> str | None:
    """The rule by which a limit holds on a road without a sign; None where it cannot be told."""
    if road_class is RoadClass.MOTORWAY:
        return "motorway"
    if road_class is RoadClass.LIVING_STREET:
        return "living_street"
    if motorroad:
        return "expressway"
    return None if surroundings is Surroundings.UNKNOWN else surroundings.name.lower()


def stated_surroundings(tags: Tags) -> Surroundings:
    """What a way's own tags say of where it lies, by the names of the rules in them."""
    for key in ("maxspeed", "maxspeed:forward", *_IMPLIED_BY):
        named = _RULE.fullmatch(tags.get(key, ""))
        if named is not None and named[2] == "urban":
            return Surroundings.URBAN
        if named is not None and named[2] == "rural":
            return Surroundings.RURAL
    return Surroundings.UNKNOWN


def parse_maxspeed(text: str) -> float:
    """A number with its unit, ``none`` or ``walk``, in km/h; NaN for what is no limit that could hold.

    Of several (``50; 30``, ``80|100``) the highest is meant: nobody is to be told of speeding who was not.
    """
    values = []
    for part in re.split(r"[;|]", text):
        word = part.strip()
        if word == "none":
            return math.inf
        if word == "walk":
            values.append(WALKING_KMH)
        elif number := _NUMBER.fullmatch(word):
            kmh = float(number[1]) * KMH_PER[number[2] or ""]
            if PLAUSIBLE_KMH[0] <= kmh <= PLAUSIBLE_KMH[1]:
                values.append(round(kmh, 2))
    return max(values, default=math.nan)


def _stated(text: str | None, defaults: CountryLimits) -> float:
    if text is None:
        return math.nan
    named = _RULE.fullmatch(text.strip())
    if named is None:
        return parse_maxspeed(text)
    country, rule, figure = named.groups()
    if figure is not None or rule.startswith("zone"):
        return parse_maxspeed(figure or rule.removeprefix("zone"))
    return defaults.of(country, _SAME_RULE.get(rule, rule))


def _checked(table: Mapping[str, object], where: str) -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = {}
    for country, rules in table.items():
        if not (re.fullmatch(r"[A-Z]{2}", country) and isinstance(rules, dict)):
            raise UsageError(f"{where}[{country}]: expected a table by a country's two letters, such as [FI]")
        found[country] = {}
        for rule, kmh in rules.items():
            if rule == "source":
                continue
            if rule not in RULES:
                raise UsageError(f"{where}[{country}] {rule}: unknown rule; expected one of {', '.join(RULES)}")
            plausible = isinstance(kmh, (int, float)) and (kmh == math.inf or 4 <= kmh <= PLAUSIBLE_KMH[1])
            if not plausible or isinstance(kmh, bool):
                raise UsageError(f"{where}[{country}] {rule} = {kmh!r}: expected 4 to 200 km/h, or inf for none")
            found[country][rule] = float(kmh)
    return found
