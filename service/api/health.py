"""Whether the service lives, whether it can work, and its metrics."""

from __future__ import annotations

import logging
from typing import Literal

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, Field
from sqlalchemy.exc import SQLAlchemyError

from service.api.dependencies import Database
from service.observability import METRICS_CONTENT_TYPE
from service.storage import schema
from service.storage.database import read

log = logging.getLogger(__name__)

router = APIRouter(tags=["operation"])


class Liveness(BaseModel):
    """The process answers."""

    status: Literal["ok"] = "ok"


class Readiness(BaseModel):
    """Whether the service can do its work, and what of it cannot; the reasons are in the log."""

    status: Literal["ready", "not_ready"]
    checks: dict[str, Literal["ok", "failed"]] = Field(examples=[{"database": "ok", "journal": "ok", "engine": "ok"}])


@router.get("/livez")
def get_liveness() -> Liveness:
    """Answers while the process lives; when it does not, restart it."""
    return Liveness()


@router.get("/readyz", response_model=Readiness, responses={503: {"model": Readiness, "description": "Not ready"}})
def get_readiness(request: Request, response: Response, engine: Database) -> Readiness:
    """Ready while database, journal and engine work; while it is not, send requests elsewhere or wait."""
    problems = {"database": _database_problem(engine), **request.app.state.runtime.problems()}
    for name, problem in problems.items():
        if problem is not None:
            log.warning("not ready", extra={"fields": {"check": name, "problem": problem}})
    ready = not any(problems.values())
    response.status_code = 200 if ready else 503
    return Readiness(
        status="ready" if ready else "not_ready",
        checks={name: "ok" if problem is None else "failed" for name, problem in problems.items()},
    )


@router.get(
    "/metrics",
    response_class=Response,
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}, "description": "Prometheus text"}},
)
def get_metrics(request: Request) -> Response:
    """Counters, gauges and histograms in the Prometheus text format."""
    return Response(request.app.state.runtime.metrics.exposition(), media_type=METRICS_CONTENT_TYPE)


def _database_problem(engine: Database) -> str | None:
    try:
        with read(engine) as connection:
            revision = schema.current(connection)
    except SQLAlchemyError as error:
        return str(error)
    newest = schema.newest()
    return None if revision == newest else f"the schema is at {revision}, expected {newest}: telefuse db upgrade"
