"""Areas of administrative boundaries, also of those that an extract cuts off."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from service.roads.extract import Boundary, Extract, Line

_REACH_SHARE: Final = 0.25
"""How far a line that leaves the extract may end before its edge, as a share of the extract's diagonal."""
_ON_EDGE_DEG: Final = 1e-9


def areas_of(extract: Extract, boundaries: Sequence[Boundary]) -> dict[int, BaseGeometry]:
    """The area of each boundary of one level, by relation; those that cannot be told are left out.

    A boundary that goes on outside the extract cuts its box in two kinds of faces. Which ones are inside is told by
    the place that carries the boundary's name, or by the places of its neighbours, which are outside.
    """
    areas = {one.relation_id: area for one in boundaries if one.complete and (area := _whole(one)) is not None}
    labels = {one.relation_id: label for one in boundaries if (label := _label(extract, one)) is not None}
    for relation_id, area in areas.items():
        labels.setdefault(relation_id, area.representative_point())
    box = shapely.box(*extract.box_deg)
    for one in boundaries:
        if one.relation_id not in areas and (sides := _sides(one, box)) is not None:
            own = labels.get(one.relation_id)
            others = [label for relation_id, label in labels.items() if relation_id != one.relation_id]
            if (area := _inside(sides, own, others)) is not None:
                areas[one.relation_id] = area
    return areas


def _whole(one: Boundary) -> BaseGeometry | None:
    outer = _faces([run for role, line in one.lines if role != "inner" for run in _runs(line)])
    inner = _faces([run for role, line in one.lines if role == "inner" for run in _runs(line)])
    area = shapely.difference(shapely.union_all(outer), shapely.union_all(inner))
    return None if area.is_empty else area


def _faces(lines: Iterable[BaseGeometry]) -> list[BaseGeometry]:
    return list(shapely.get_parts(shapely.polygonize(shapely.get_parts(shapely.node(shapely.union_all(list(lines)))))))


def _runs(line: Line) -> list[BaseGeometry]:
    """The parts of a line whose nodes are there."""
    runs: list[list[tuple[float, float]]] = [[]]
    for node in line:
        if node is None:
            runs.append([])
        else:
            runs[-1].append(node)
    return [shapely.LineString(run) for run in runs if len(run) > 1]


def _label(extract: Extract, one: Boundary) -> BaseGeometry | None:
    for ref in one.centre_ids:
        if ref in extract.centres:
            return shapely.Point(extract.centres[ref])
    place = extract.places.get(one.name)
    return None if place is None else shapely.Point(place)


def _sides(one: Boundary, box: BaseGeometry) -> tuple[BaseGeometry, BaseGeometry] | None:
    """The two parts of the box that the lines divide, one of them inside; None where they divide nothing."""
    lines = [run for _, line in one.lines for run in _runs(line)]
    if not lines:
        return None
    merged = shapely.get_parts(shapely.line_merge(shapely.union_all(lines)))
    whole = shapely.intersection(shapely.union_all(_to_the_edge(merged, box)), box)
    faces = _faces([*shapely.get_parts(whole), box.exterior])
    side = [0] + [-1] * (len(faces) - 1)
    waiting = [0]
    while waiting:
        here = waiting.pop()
        for there, face in enumerate(faces):
            if there != here and shapely.length(shapely.intersection(faces[here], face)) > _ON_EDGE_DEG:
                if side[there] == -1:
                    side[there] = 1 - side[here]
                    waiting.append(there)
                elif side[there] == side[here]:
                    return None  # a line within one side: the boundary is not whole within the box
    if not {0, 1} <= set(side):
        return None
    first, second = ([face for face, which in zip(faces, side, strict=True) if which == part] for part in (0, 1))
    return shapely.union_all(first), shapely.union_all(second)


def _to_the_edge(lines: Iterable[BaseGeometry], box: BaseGeometry) -> list[BaseGeometry]:
    """Lines whose loose ends inside the box are drawn straight on to its edge, if it is near."""
    west, south, east, north = box.bounds
    reach = _REACH_SHARE * float(np.hypot(east - west, north - south))
    ends: dict[tuple[float, float], int] = {}
    all_coordinates = [shapely.get_coordinates(line) for line in lines]
    for line in all_coordinates:
        for end in (tuple(line[0]), tuple(line[-1])):
            ends[end] = ends.get(end, 0) + 1
    drawn = []
    for line in all_coordinates:
        points = line
        for flip in (False, True):
            points = points[::-1] if flip else points
            end, before = points[-1], points[-2]
            if ends[tuple(end)] == 1 and shapely.Point(end).within(box):
                ahead = end + (end - before) / np.hypot(*(end - before)) * reach
                points = np.vstack([points, ahead])
            points = points[::-1] if flip else points
        drawn.append(shapely.LineString(points))
    return drawn


def _inside(
    sides: tuple[BaseGeometry, BaseGeometry], own: BaseGeometry | None, others: Sequence[BaseGeometry]
) -> BaseGeometry | None:
    if own is not None:
        return next((side for side in sides if side.contains(own)), None)
    free = [side for side in sides if not any(side.contains(other) for other in others)]
    return free[0] if len(free) == 1 else None


def by_level(boundaries: Iterable[Boundary]) -> Mapping[int, list[Boundary]]:
    """Boundaries by their ``admin_level``."""
    levels: dict[int, list[Boundary]] = {}
    for one in boundaries:
        levels.setdefault(one.level, []).append(one)
    return levels
