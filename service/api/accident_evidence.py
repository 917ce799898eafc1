"""Evidence of an accident: curves, event recorder elements, the eCall data, a page to print, and the bundle itself."""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal

from fastapi import APIRouter, Depends, Query, Request, Response
from sqlalchemy import Connection

from schemas.evidence import Edr, Msd, Trace
from schemas.notifications import rfc3339
from schemas.problem import Problem
from service.api.accidents import AccidentPath, the_accident
from service.api.calibration_runs import REPORT_HEADERS
from service.api.conditional import answer, answer_content
from service.api.dependencies import Database, the_vehicle
from service.api.security import Principal, require
from service.errors import (
    EvidenceFailedError,
    EvidencePendingError,
    ForbiddenError,
    InvalidParameterError,
    NotFoundError,
)
from service.evidence.bundle import Bundle, from_bytes
from service.evidence.forms import PARTS, columns_of, edr_csv, edr_form, parts_for, to_csv
from service.evidence.msd import RECENT_S, minimum_set_of_data
from service.storage import evidence, reviews, trips
from service.storage.accidents import AccidentRow
from service.storage.database import read
from service.storage.evidence import EvidenceRow

router = APIRouter(tags=["accidents"])

RETRY_AFTER_S: Final = 10
CSV_MEDIA_TYPE: Final = "text/csv"
BUNDLE_MEDIA_TYPE: Final = "application/zip"
PLACE_WITHIN_NS: Final = 3_000_000_000
"""How old a place may be that stands for where the vehicle was at a time: three rows of the track."""

Reader = Annotated[Principal, Depends(require("accidents:read"))]
Format = Annotated[
    Literal["json", "csv"] | None,
    Query(description="Left out, what the header Accept prefers."),
]
Part = Annotated[
    list[Literal["samples", "states", "innovations", "gnss", "magnetometer", "wheel_speed", "barometer"]] | None,
    Query(description="One table or several; left out, all. As CSV one: left out, samples."),
]
_CSV: Final = {CSV_MEDIA_TYPE: {"schema": {"type": "string"}}}
NOT_YET: Final[dict[int | str, dict[str, Any]]] = {
    409: {"model": Problem, "description": "Not built yet (evidence_pending, with Retry-After), or it could not be"}
}


@router.get("/accidents/{accident_id}/trace", responses={200: {"model": Trace, "content": _CSV}, **NOT_YET})
def get_trace(
    request: Request,
    accident_id: AccidentPath,
    caller: Reader,
    engine: Database,
    part: Part = None,
    format: Format = None,
) -> Response:
    """Samples as measured and calibrated, fused states, and the innovations of every aid, 60 s before to 30 s after.

    Columns by which a way can be drawn (coordinates, velocities, headings, fixes) need positions:read as well.
    """
    accident, row = _built(engine, caller, accident_id)
    bundle = _bundle(row)
    places = caller.may("positions:read")
    allowed = parts_for(places)
    if part is not None and not set(part) <= set(allowed):
        raise ForbiddenError("this key lacks the scope positions:read, which the fixes need", scope="positions:read")
    if _wants_csv(request, format):
        if part is not None and len(part) > 1:
            raise InvalidParameterError(f"query.part: a CSV file is one table; ask for one of {', '.join(PARTS)}")
        name = "samples" if part is None else part[0]
        content = to_csv(columns_of(bundle, name, places=places))
        return _download(request, content, CSV_MEDIA_TYPE, f"{accident.id}-{name}.csv")
    body = {
        "accident_id": accident.id,
        "time": rfc3339(accident.t_ns),
        "status": row.status,
        "sha256": bundle.sha256,
        "covered": bundle.manifest["covered"],
        "replay": bundle.manifest["replay"],
        "parts": {name: columns_of(bundle, name, places=places) for name in (allowed if part is None else part)},
    }
    return answer(request, body)


@router.get("/accidents/{accident_id}/edr", responses={200: {"model": Edr, "content": _CSV}, **NOT_YET})
def get_edr(
    request: Request, accident_id: AccidentPath, caller: Reader, engine: Database, format: Format = None
) -> Response:
    """What an event data recorder would have kept: the elements of 49 CFR 563, those not recorded named as such."""
    accident, row = _built(engine, caller, accident_id)
    form = edr_form(_bundle(row))
    if _wants_csv(request, format):
        return _download(request, edr_csv(form), CSV_MEDIA_TYPE, f"{accident.id}-edr.csv")
    return answer(request, form)


@router.get("/accidents/{accident_id}/msd", response_model=Msd)
def get_msd(request: Request, accident_id: AccidentPath, caller: Reader, engine: Database) -> Response:
    """What an eCall would say (EN 15722, its names and units): there as soon as the accident is.

    The recent locations need positions:read.
    """
    with read(engine) as connection:
        accident = the_accident(connection, caller.tenant_id, accident_id)
        config = the_vehicle(connection, caller.tenant_id, accident.vehicle_id).ref.config
        recent = []
        for before_s in RECENT_S if caller.may("positions:read") else ():
            at_ns = accident.t_ns - round(before_s * 1e9)
            place = trips.position_before(connection, accident.vehicle_pk, at_ns, PLACE_WITHIN_NS)
            if place is None:
                break
            recent.append(place)
    return answer(request, minimum_set_of_data(accident, config, recent))


@router.get(
    "/accidents/{accident_id}/dossier",
    response_class=Response,
    responses={
        200: {"content": {"text/html": {"schema": {"type": "string"}}}, "description": "A page of its own"},
        **NOT_YET,
    },
)
def get_dossier(request: Request, accident_id: AccidentPath, caller: Reader, engine: Database) -> Response:
    """All that is known of an accident on one page to be printed: map, curves, figures, evidence, reviews.

    The way on the map needs positions:read.
    """
    # Here, not above: only this needs it, and it takes its time to import.
    from service.reports.dossier import Dossier

    with read(engine) as connection:
        accident, row = _built_in(connection, caller, accident_id)
        given = reviews.of(connection, accident.id)
    page = Dossier(accident, _bundle(row), row, given, places=caller.may("positions:read")).html()
    return answer_content(request, page.encode(), media_type="text/html; charset=utf-8", headers=REPORT_HEADERS)


@router.get(
    "/accidents/{accident_id}/evidence",
    response_class=Response,
    responses={
        200: {
            "content": {BUNDLE_MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}},
            "description": "A zip file that numpy.load opens; 'telefuse evidence verify FILE' checks its hash",
        },
        **NOT_YET,
    },
)
def get_evidence(
    request: Request,
    accident_id: AccidentPath,
    caller: Reader,
    engine: Database,
    _places: Annotated[Principal, Depends(require("positions:read"))],
) -> Response:
    """The bundle: packets as they came, the session's state before them, all tables, and a manifest that is hashed."""
    accident, row = _built(engine, caller, accident_id)
    assert row.bundle is not None
    headers = {"Evidence-SHA256": row.sha256 or ""}
    return _download(request, row.bundle, BUNDLE_MEDIA_TYPE, f"{accident.id}.npz", headers)


def _built(engine: Any, caller: Principal, accident_id: str) -> tuple[AccidentRow, EvidenceRow]:
    with read(engine) as connection:
        return _built_in(connection, caller, accident_id)


def _built_in(connection: Connection, caller: Principal, accident_id: str) -> tuple[AccidentRow, EvidenceRow]:
    """The accident with its evidence; raises where there is none, or not yet."""
    accident = the_accident(connection, caller.tenant_id, accident_id)
    row = evidence.find(connection, accident.id)
    if row is None:
        raise NotFoundError("there is no evidence of this accident: it is older than evidence is kept")
    if row.bundle is not None:
        return accident, row
    if row.status == "failed":
        raise EvidenceFailedError(f"the evidence of this accident could not be built: {row.reason}")
    raise EvidencePendingError(
        "the evidence of this accident is built once the 30 s after it have come in, or its vehicle has fallen silent",
        retry_after_s=RETRY_AFTER_S,
    )


def _bundle(row: EvidenceRow) -> Bundle:
    assert row.bundle is not None
    return from_bytes(row.bundle)


def _wants_csv(request: Request, format: str | None) -> bool:
    if format is not None:
        return format == "csv"
    accepted = [one.partition(";")[0].strip().lower() for one in request.headers.get("accept", "").split(",")]
    return CSV_MEDIA_TYPE in accepted and "application/json" not in accepted


def _download(
    request: Request, content: bytes, media_type: str, name: str, headers: dict[str, str] | None = None
) -> Response:
    shown = {"Content-Disposition": f'attachment; filename="{name}"', "Vary": "Authorization, Accept"}
    return answer_content(request, content, media_type=media_type, headers=shown | (headers or {}))
