"""The HTTP application: routes, errors and headers over one running service."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import version
from typing import Any

from fastapi import APIRouter, FastAPI
from fastapi.routing import APIRoute

from service.api import (
    accident_candidates,
    accident_evidence,
    accidents,
    calibration_runs,
    calibrations,
    docs,
    erasure_requests,
    events,
    health,
    manoeuvres,
    problems,
    rating,
    reviews,
    scores,
    trips,
    vehicles,
    webhook_endpoints,
)
from service.api.middleware import BodyLimit, RequestContext
from service.api.openapi import document
from service.api.security import Authenticator
from service.ingest.http import ingest_routes
from service.ingest.http_openapi import ingest_paths
from service.runtime import Runtime
from service.settings import Settings
from service.storage import tenants
from service.storage.database import write


def create_app(settings: Settings, runtime: Runtime | None = None) -> FastAPI:
    """The application; it starts and stops ``runtime``. Without one it can only describe itself."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        assert runtime is not None, "an application without a runtime serves nothing"
        try:
            await runtime.start()
        except Exception as error:
            app.state.startup_error = error
            raise
        try:
            app.state.authenticator = Authenticator(runtime.database, required=settings.auth == "on")
            if settings.auth == "off":
                with write(runtime.database) as connection:
                    tenants.ensure(connection, tenants.DEFAULT_TENANT)
            yield
        finally:
            await runtime.stop()

    app = FastAPI(
        title="telefuse",
        version=version("telefuse"),
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        generate_unique_id_function=_operation_id,
    )
    app.state.settings = settings
    app.state.runtime = runtime
    # The last one added is the outermost.
    app.add_middleware(BodyLimit)
    app.add_middleware(RequestContext, metrics=None if runtime is None else runtime.metrics)
    problems.install(app)

    v1 = APIRouter(prefix="/v1")
    for module in (
        vehicles,
        calibrations,
        calibration_runs,
        trips,
        manoeuvres,
        accidents,
        accident_candidates,
        accident_evidence,
        reviews,
        erasure_requests,
        events,
        scores,
        rating,
        webhook_endpoints,
    ):
        v1.include_router(module.router)
    app.include_router(v1)
    app.include_router(health.router)
    app.include_router(docs.router)
    app.router.routes.extend(ingest_routes())
    _describe_by(app)
    return app


def _operation_id(route: APIRoute) -> str:
    return route.name


def _describe_by(app: FastAPI) -> None:
    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = document(app, ingest_paths())
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]
