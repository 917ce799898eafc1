"""What was detected as a hazard and explains a vehicle's braking: others' accidents ahead, potholes that it struck.

Others are vehicles of the same tenant; a parked car that was hit is no hazard, as it stands beside the road. It follows
from stored rows, in whichever order they came: where an accident is told, or taken back, after somebody's trip was
assessed, ``mark_due`` has that trip assessed anew.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final

from sqlalchemy import Connection

from core.accident.events import Kind, NoAccident
from core.driving.hazards import Braking, HazardTuning, accident_explains, pothole_explains
from core.driving.manoeuvres import Manoeuvre
from service.accidents.reviewing import ACCIDENT
from service.storage import accidents, candidates, manoeuvres, trips
from service.storage.accidents import AccidentRow
from service.storage.manoeuvres import HAZARD, ManoeuvreRow
from service.storage.places import Box, WhereAndWhen

TUNING: Final = HazardTuning()
PLACED_NS: Final = 2_000_000_000
"""A braking with no position so shortly before it has no place; rows come once a second."""
LONGEST_NS: Final = 60_000_000_000
"""No braking lasts longer; a choice."""


def explaining(connection: Connection, rows: Iterable[ManoeuvreRow]) -> dict[str, str | None]:
    """By those manoeuvres that a hazard explains, the id of the candidate or accident that it is.

    What explained one before stays where it cannot be looked at any more: candidates, tracks and what others had erased
    go sooner than what was made of them, and nobody is to pay for that. None where not even its id is left.
    """
    found: dict[str, str | None] = {}
    for row in rows:
        if row.kind != Manoeuvre.BRAKING:
            continue
        braking = _braking(connection, row)
        hazard_id = _pothole(connection, row, braking) or _accident(connection, row, braking)
        if hazard_id is not None:
            found[row.id] = hazard_id
        elif row.excused == HAZARD and _stays(connection, row, braking):
            found[row.id] = row.excused_by
    return found


def mark_due(connection: Connection, told: Iterable[AccidentRow], now_ns: int) -> None:
    """Have the trips of others assessed anew on which these accidents, as they are now, explain another braking than
    they did."""
    for accident in told:
        if accident.kind == Kind.PARKED_HIT:
            continue
        box = _around(accident.lat_deg, accident.lon_deg)
        times = accident.t_ns - LONGEST_NS, accident.t_ns + round(1e9 * TUNING.lasts_s)
        for row in manoeuvres.perhaps_because_of(
            connection, accident, str(Manoeuvre.BRAKING), WhereAndWhen(box, *times)
        ):
            was = row.excused_by if row.excused == HAZARD else None
            is_open = row.verdict is None and row.excused in (None, HAZARD)
            if is_open and explaining(connection, [row]).get(row.id) != was:
                trips.mark_due(connection, row.vehicle_pk, row.start_ns, row.start_ns, now_ns)


def _braking(connection: Connection, row: ManoeuvreRow) -> Braking:
    at = trips.position_before(connection, row.vehicle_pk, row.start_ns, PLACED_NS)
    if at is None:
        return Braking(row.start_ns, row.end_ns)
    course_rad = math.atan2(at.ve_mps, at.vn_mps)
    return Braking(row.start_ns, row.end_ns, math.radians(at.lat_deg), math.radians(at.lon_deg), course_rad)


def _pothole(connection: Connection, row: ManoeuvreRow, braking: Braking) -> str | None:
    until_ns = row.end_ns + round(1e9 * TUNING.after_s)
    struck = candidates.between(connection, row.vehicle_pk, row.start_ns, until_ns, str(NoAccident.POTHOLE))
    were_none = (one for one in struck if one.verdict != ACCIDENT)
    return next((one.id for one in were_none if pothole_explains(braking, one.t_ns, TUNING)), None)


def _accident(connection: Connection, row: ManoeuvreRow, braking: Braking) -> str | None:
    box = _around(math.degrees(braking.lat_rad), math.degrees(braking.lon_rad))
    if box is None:
        return None
    when = row.start_ns - round(1e9 * TUNING.lasts_s), row.end_ns
    for one in accidents.of_others(connection, row.tenant_id, row.vehicle_pk, WhereAndWhen(box, *when)):
        if one.kind == Kind.PARKED_HIT or one.lat_deg is None or one.lon_deg is None:
            continue
        if accident_explains(braking, one.t_ns, math.radians(one.lat_deg), math.radians(one.lon_deg), TUNING):
            return one.id
    return None


def _stays(connection: Connection, row: ManoeuvreRow, braking: Braking) -> bool:
    """Whether what explained a manoeuvre is not there to be looked at, or the place of the manoeuvre is not."""
    if row.excused_by is None:
        return True
    accident = accidents.find(connection, row.tenant_id, row.excused_by)
    if accident is not None:
        return math.isnan(braking.lat_rad) and not accident.is_none
    return candidates.find(connection, row.tenant_id, row.excused_by) is None


def _around(lat_deg: float | None, lon_deg: float | None) -> Box | None:
    """All that a braking for an accident at a place, or the other way round, may be away from it."""
    if lat_deg is None or lon_deg is None or math.isnan(lat_deg + lon_deg):
        return None
    # A manoeuvre's stored place is that of its peak, which may lie as far ahead again of its beginning.
    return Box.around(lat_deg, lon_deg, 2.0 * max(TUNING.ahead_m, TUNING.beside_m))
