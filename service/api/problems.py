"""Every error becomes a problem document here: one table from exception to status and code."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any, Final

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from sqlalchemy.exc import InterfaceError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError
from starlette.exceptions import HTTPException
from starlette.routing import Match

from core.errors import CoreError, InvalidInputError
from schemas.problem import PROBLEM_MEDIA_TYPE, Problem
from service.errors import ServiceError

log = logging.getLogger(__name__)

FOREIGN_ERRORS: Final[Mapping[type[Exception], tuple[int, str, str]]] = {
    InvalidInputError: (422, "invalid_input", ""),
    OperationalError: (503, "database_unavailable", "the database cannot be reached just now; try again"),
    InterfaceError: (503, "database_unavailable", "the database cannot be reached just now; try again"),
    PoolTimeoutError: (503, "database_busy", "too many requests wait for the database; try again"),
}
"""Errors of other layers: status, code and what the caller is told; empty where the error itself says it well.
The service's own errors carry theirs in their class."""

_CODES: Final[Mapping[int, str]] = {
    400: "bad_request",
    404: "not_found",
    405: "method_not_allowed",
    415: "unsupported_media_type",
}

_RETRY_AFTER_S: Final = 1


def problem_response(
    request_scope: Mapping[str, Any],
    status: int,
    code: str,
    detail: str,
    headers: Mapping[str, str] | None = None,
    **extra: object,
) -> Response:
    """A problem document; for code that answers requests outside FastAPI's endpoints too."""
    document = Problem(
        title=HTTPStatus(status).phrase,
        status=status,
        code=code,
        detail=detail,
        instance=request_scope.get("path"),
        request_id=request_scope.get("state", {}).get("request_id"),
        **extra,  # type: ignore[arg-type]
    ).model_dump(exclude_none=True)
    content = json.dumps(document, default=str).encode()
    more = {"Retry-After": str(_RETRY_AFTER_S)} if status == 503 else {}
    return Response(content, status, headers={**more, **(headers or {})}, media_type=PROBLEM_MEDIA_TYPE)


def service_problem(request: Request, error: Exception) -> Response:
    """The problem document of one of the service's own errors."""
    assert isinstance(error, ServiceError)
    return problem_response(request.scope, error.status, error.code, error.detail, error.headers, **error.extra)


def _foreign_problem(request: Request, error: Exception) -> Response:
    for kind in type(error).__mro__:
        if kind in FOREIGN_ERRORS:
            status, code, detail = FOREIGN_ERRORS[kind]
            if status >= 500:
                log.error("%s", error, extra={"fields": {"request_id": request.scope["state"].get("request_id")}})
            return problem_response(request.scope, status, code, detail or str(error))
    raise error


def _http_problem(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    details = {
        404: "there is nothing at this path; see /docs for what there is",
        405: f"{request.method} is not possible here",
    }
    headers = dict(error.headers or {})
    if error.status_code == 405:
        headers["Allow"] = ", ".join(_allowed(request))
    code = _CODES.get(error.status_code, HTTPStatus(error.status_code).name.lower())
    detail = details.get(error.status_code, str(error.detail))
    return problem_response(request.scope, error.status_code, code, detail, headers)


def _allowed(request: Request) -> list[str]:
    """What is possible at this path: the framework names only what the first of its routes can."""
    routes = request.app.router.routes
    return [
        method
        for method in ("GET", "PUT", "POST", "PATCH", "DELETE")
        if any(route.matches({**request.scope, "method": method})[0] is Match.FULL for route in routes)
    ]


def _validation_problem(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    first, *_ = found = error.errors()
    if first["type"] == "json_invalid":
        message = first.get("ctx", {}).get("error", "")
        return problem_response(request.scope, 400, "invalid_json", f"the body is not JSON: {message}".rstrip(": "))
    errors = [{"location": _location(each["loc"]), "message": each["msg"]} for each in found]
    detail = f"{errors[0]['location']}: {errors[0]['message']}"
    if len(errors) > 1:
        detail += f" (and {len(errors) - 1} more, see errors)"
    return problem_response(request.scope, 422, "invalid_request", detail, errors=errors)


def _location(parts: tuple[object, ...]) -> str:
    return ".".join(str(part) for part in parts)


def install(app: FastAPI) -> None:
    """Have errors answered by problem documents; what is not named here is ``middleware.RequestContext``'s."""
    app.add_exception_handler(ServiceError, service_problem)
    app.add_exception_handler(CoreError, _foreign_problem)
    for kind in FOREIGN_ERRORS:
        app.add_exception_handler(kind, _foreign_problem)
    app.add_exception_handler(RequestValidationError, _validation_problem)
    app.add_exception_handler(HTTPException, _http_problem)
