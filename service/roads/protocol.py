"""What a road matcher takes and tells; whoever uses roads knows this module and no other of the package."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, Final, Protocol

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

NO_WAY: Final = 0
"""The way of a point that lies on no known road; OpenStreetMap counts ways from 1."""
NO_NAME: Final = -1
"""Index of a name that is not known."""


class RoadClass(IntEnum):
    """OpenStreetMap's classes of roads for cars, the most important first; links belong to their class."""

    UNKNOWN = 0
    MOTORWAY = 1
    TRUNK = 2
    PRIMARY = 3
    SECONDARY = 4
    TERTIARY = 5
    UNCLASSIFIED = 6
    RESIDENTIAL = 7
    LIVING_STREET = 8
    SERVICE = 9
    TRACK = 10


class Surroundings(IntEnum):
    """Whether a road lies in a built-up area, which default limits and risk tables ask."""

    UNKNOWN = 0
    URBAN = 1
    RURAL = 2


class Certainty(IntEnum):
    """How a legal limit is known."""

    UNKNOWN = 0
    ASSUMED = 1
    """By the country's default for the road's class and surroundings."""
    TAGGED = 2
    """The map says it, as a number or by the name of a rule (``RO:urban``)."""


@dataclass(frozen=True, slots=True, eq=False)
class MatchedPoints:
    """The road under each of n points, in their order.

    Parameters
    ----------
    way_id : (n,) int64
        OpenStreetMap's id of the way, ``NO_WAY`` where no road was found.
    lat_deg, lon_deg : (n,) float64
        The point on the road; NaN without one.
    distance_m : (n,) float64
        From the point given to the one on the road; NaN without one.
    confidence : (n,) float64
        From 0 to 1: how well the position, by its standard deviation, speaks for this road against the others
        near it; 0 without a road.
    road_class, surroundings : (n,) int64
        Of ``RoadClass`` and ``Surroundings``.
    limit_kmh : (n,) float64
        Legal limit in the direction driven, km/h; infinite where the law knows none, NaN where it is not known.
    limit_certainty : (n,) int64
        Of ``Certainty``.
    tunnel : (n,) bool
    street_index, district_index : (n,) int64
        Into ``streets`` and ``districts``; ``NO_NAME`` where not known. A district is known without a road, too.
    failed : (n,) bool
        Looking it up failed, as the process that matches died or did not answer: unknown for now, not for good.
    streets, districts : tuple of str
        The names that occur, each once.
    """

    way_id: IntArray
    lat_deg: FloatArray
    lon_deg: FloatArray
    distance_m: FloatArray
    confidence: FloatArray
    road_class: IntArray
    surroundings: IntArray
    limit_kmh: FloatArray
    limit_certainty: IntArray
    tunnel: BoolArray
    street_index: IntArray
    district_index: IntArray
    failed: BoolArray
    streets: tuple[str, ...]
    districts: tuple[str, ...]

    def __len__(self) -> int:
        return self.way_id.size

    def street(self, index: int) -> str | None:
        """Name of the street under a point, or its number where it has no name."""
        named = int(self.street_index[index])
        return None if named == NO_NAME else self.streets[named]

    def district(self, index: int) -> str | None:
        """Name of the district around a point."""
        named = int(self.district_index[index])
        return None if named == NO_NAME else self.districts[named]

    def at(self, rows: IntArray) -> MatchedPoints:
        """Some of the points, by their indices, which may repeat."""
        names = [name for name in self.__slots__ if name not in ("streets", "districts")]
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

    @classmethod
    def joined(cls, parts: Sequence[MatchedPoints]) -> MatchedPoints:
        """All points of some parts, one after the other."""
        columns = {
            name: np.concatenate([getattr(one, name) for one in parts])
            for name in cls.__slots__
            if not name.startswith(("street", "district"))
        }
        street_index, streets = _joined_names([(one.street_index, one.streets) for one in parts])
        district_index, districts = _joined_names([(one.district_index, one.districts) for one in parts])
        return cls(
            **columns,
            street_index=street_index,
            district_index=district_index,
            streets=streets,
            districts=districts,
        )

    @classmethod
    def unknown(cls, n: int, *, failed: bool = False) -> MatchedPoints:
        """Nothing known of n points."""
        return cls(
            way_id=np.full(n, NO_WAY, np.int64),
            lat_deg=np.full(n, np.nan),
            lon_deg=np.full(n, np.nan),
            distance_m=np.full(n, np.nan),
            confidence=np.zeros(n),
            road_class=np.full(n, int(RoadClass.UNKNOWN), np.int64),
            surroundings=np.full(n, int(Surroundings.UNKNOWN), np.int64),
            limit_kmh=np.full(n, np.nan),
            limit_certainty=np.full(n, int(Certainty.UNKNOWN), np.int64),
            tunnel=np.zeros(n, np.bool_),
            street_index=np.full(n, NO_NAME, np.int64),
            district_index=np.full(n, NO_NAME, np.int64),
            failed=np.full(n, failed, np.bool_),
            streets=(),
            districts=(),
        )


def _joined_names(parts: Sequence[tuple[IntArray, tuple[str, ...]]]) -> tuple[IntArray, tuple[str, ...]]:
    names: dict[str, int] = {}
    indices = []
    for index, own in parts:
        places = np.array([*(names.setdefault(name, len(names)) for name in own), NO_NAME], np.int64)
        indices.append(places[index])  # NO_NAME is the last one
    return np.concatenate(indices) if indices else np.empty(0, np.int64), tuple(names)


@dataclass(frozen=True, slots=True)
class RoadPlace:
    """The road at one place: what ``MatchedPoints`` says of a point; None, NaN or UNKNOWN where not known."""

    way_id: int | None
    street: str | None
    district: str | None
    road_class: RoadClass
    surroundings: Surroundings
    limit_kmh: float
    limit_certainty: Certainty
    tunnel: bool
    distance_m: float
    confidence: float

    def json(self) -> dict[str, Any]:
        """As it goes into answers and files; what is not known is null."""
        return {
            "way_id": self.way_id,
            "street": self.street,
            "district": self.district,
            "road_class": self.road_class.name.lower(),
            "surroundings": self.surroundings.name.lower(),
            "limit_kmh": self.limit_kmh if np.isfinite(self.limit_kmh) else None,
            "limit_certainty": self.limit_certainty.name.lower(),
            "tunnel": self.tunnel,
            "distance_m": round(self.distance_m, 2) if np.isfinite(self.distance_m) else None,
            "confidence": round(self.confidence, 3),
        }

    @classmethod
    def of(cls, matched: MatchedPoints, index: int) -> RoadPlace:
        """One of matched points."""
        way = int(matched.way_id[index])
        return cls(
            way_id=None if way == NO_WAY else way,
            street=matched.street(index),
            district=matched.district(index),
            road_class=RoadClass(int(matched.road_class[index])),
            surroundings=Surroundings(int(matched.surroundings[index])),
            limit_kmh=float(matched.limit_kmh[index]),
            limit_certainty=Certainty(int(matched.limit_certainty[index])),
            tunnel=bool(matched.tunnel[index]),
            distance_m=float(matched.distance_m[index]),
            confidence=float(matched.confidence[index]),
        )


class RoadMatcher(Protocol):
    """Finds the roads under a drive. A call may take as long as a packet's second: none belongs on the hot path."""

    @property
    def known(self) -> bool:
        """Whether there are roads at all; without, everything is answered as unknown."""
        ...

    def match(
        self,
        t_ns: IntArray,
        lat_deg: FloatArray,
        lon_deg: FloatArray,
        sd_m: FloatArray,
        heading_deg: FloatArray | None = None,
    ) -> MatchedPoints:
        """The roads under points of one drive, in increasing time; points at NaN, in gaps or off the map are unknown.

        ``sd_m`` is the horizontal standard deviation an axis; a heading of NaN is not known.
        """
        ...


class NullMatcher:
    """No roads: everything is unknown."""

    known = False

    def match(
        self,
        t_ns: IntArray,
        lat_deg: FloatArray,
        lon_deg: FloatArray,
        sd_m: FloatArray,
        heading_deg: FloatArray | None = None,
    ) -> MatchedPoints:
        """As many unknown points as were given."""
        return MatchedPoints.unknown(t_ns.size)
