"""Scores of a vehicle: how much, how and where it was driven, with reasons."""

from __future__ import annotations

import time
from typing import Annotated

from fastapi import APIRouter, Depends, Query, Request, Response

from core.scoring.premium import quote
from core.scoring.score import Product
from schemas.scores import DrivenRecord, PremiumQuote, ProductScore, ProductScores
from service.api.conditional import answer
from service.api.dependencies import Database, VehiclePath, the_vehicle
from service.api.security import Principal, require
from service.rating.period import Asked
from service.rating.scoring import Reading, Scored, recorded, scored
from service.rating.telling import quoted, shown, told_record
from service.storage.database import read

router = APIRouter(tags=["scores"])

Reader = Annotated[Principal, Depends(require("scores:read"))]


async def asked(
    from_: Annotated[
        str | None,
        Query(alias="from", description="Trips that began at this RFC 3339 time or local date, or later."),
    ] = None,
    to: Annotated[
        str | None,
        Query(description="Trips that began before this RFC 3339 time or local date; left out, the day of the last."),
    ] = None,
    month: Annotated[
        str | None, Query(description="A calendar month, such as 2026-10, instead of from and to.")
    ] = None,
    days: Annotated[
        int | None, Query(ge=1, le=3660, description="So many days up to the end, instead of from; 365 if left out.")
    ] = None,
) -> Asked:
    """The period in a query."""
    return Asked(from_, to, month, days)


PeriodAsked = Annotated[Asked, Depends(asked)]


async def reading(request: Request) -> Reading:
    """What tenants rate by."""
    found: Reading = request.app.state.runtime.reading
    return found


RatingRead = Annotated[Reading, Depends(reading)]


@router.get("/vehicles/{vehicle_id}/scores", response_model=ProductScores)
def get_scores(
    request: Request,
    vehicle_id: VehiclePath,
    caller: Reader,
    engine: Database,
    rates: RatingRead,
    period: PeriodAsked,
) -> Response:
    """All three scores of a vehicle over a period: by default the year up to the day of its last trip."""
    found = _scored(vehicle_id, caller, engine, rates, period, tuple(Product))
    places = caller.may("positions:read")
    told = {product.value: shown(vehicle_id, found, product, places=places) for product in Product}
    return answer(request, ProductScores(vehicle_id=vehicle_id, scores=told))


@router.get("/vehicles/{vehicle_id}/scores/{product}", response_model=ProductScore)
def get_score(
    request: Request,
    vehicle_id: VehiclePath,
    product: Product,
    caller: Reader,
    engine: Database,
    rates: RatingRead,
    period: PeriodAsked,
) -> Response:
    """A score with its 95 % interval and its contributions, which sum to it, each with what it rests on.

    Where nothing was driven there is no score, and `reason` says why. A key without positions:read is told of
    neighbourhoods together.
    """
    found = _scored(vehicle_id, caller, engine, rates, period, (product,))
    return answer(request, shown(vehicle_id, found, product, places=caller.may("positions:read")))


@router.get("/vehicles/{vehicle_id}/record", response_model=DrivenRecord)
def get_record(
    request: Request, vehicle_id: VehiclePath, caller: Reader, engine: Database, period: PeriodAsked
) -> Response:
    """What scores are made from: all that was driven in a period, in whole numbers.

    `telefuse scores score` makes the same scores of it, by any model; `scores fit` learns a portfolio's usual values
    from many. Cells are there only for keys with positions:read.
    """
    cells = caller.may("positions:read")
    with read(engine) as connection:
        ref = the_vehicle(connection, caller.tenant_id, vehicle_id, with_calibrations=False).ref
        found, record = recorded(connection, ref, period, time.time_ns(), cells=cells)
    return answer(request, told_record(vehicle_id, found, record, cells=cells))


@router.get("/vehicles/{vehicle_id}/quote", response_model=PremiumQuote)
def get_quote(
    request: Request,
    vehicle_id: VehiclePath,
    caller: Reader,
    engine: Database,
    rates: RatingRead,
    period: PeriodAsked,
    premium_days: Annotated[
        float | None,
        Query(
            gt=0, le=3660, allow_inf_nan=False, description="For how many days; left out, those of the tariff's base."
        ),
    ] = None,
) -> Response:
    """A premium by the tenant's tariff and the scores of a period, with every step from the base to it.

    A product without a score changes nothing, and its step says why.
    """
    found = _scored(vehicle_id, caller, engine, rates, period, tuple(Product))
    with read(engine) as connection:
        tariff = rates.tariff(connection, caller.tenant_id)
    premium = quote(tariff, found.scores, float(tariff.days) if premium_days is None else premium_days)
    return answer(request, quoted(vehicle_id, found, premium))


def _scored(
    vehicle_id: str,
    caller: Principal,
    engine: Database,
    rates: Reading,
    period: Asked,
    products: tuple[Product, ...],
) -> Scored:
    with read(engine) as connection:
        ref = the_vehicle(connection, caller.tenant_id, vehicle_id, with_calibrations=False).ref
        return scored(connection, rates, ref, products, period, time.time_ns())
