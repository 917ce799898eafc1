"""Conditional requests (RFC 9110): a read that repeats costs no body, a change meets what its author knew."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import Header, Request, Response
from pydantic import BaseModel

from service.errors import PreconditionFailedError

IfMatch = Annotated[
    str | None, Header(description="ETag that the thing to be changed must still have, or * for any; else 412.")
]
IfNoneMatch = Annotated[str | None, Header(description="* : only if there is nothing yet; else 412.")]


def etag_of(content: bytes) -> str:
    """A strong validator: the same bytes, the same tag."""
    return f'"{hashlib.sha256(content).hexdigest()[:32]}"'


def to_json(body: BaseModel | Mapping[str, Any]) -> bytes:
    """A body as it goes out."""
    if isinstance(body, BaseModel):
        return body.model_dump_json().encode()
    return json.dumps(body, separators=(",", ":"), allow_nan=False).encode()


def answer(
    request: Request,
    body: BaseModel | Mapping[str, Any],
    *,
    status: int = 200,
    media_type: str = "application/json",
    headers: Mapping[str, str] | None = None,
) -> Response:
    """The response with its ETag, or 304 without a body where the caller has it already."""
    return answer_content(request, to_json(body), status=status, media_type=media_type, headers=headers)


def answer_content(
    request: Request,
    content: bytes,
    *,
    media_type: str,
    status: int = 200,
    headers: Mapping[str, str] | None = None,
) -> Response:
    """The same of a body that is no JSON."""
    tag = etag_of(content)
    # What a key may see is that key's: shared caches keep out, one's own asks each time.
    all_headers = {"ETag": tag, "Cache-Control": "private, no-cache", "Vary": "Authorization", **(headers or {})}
    if request.method in ("GET", "HEAD") and _is_listed(tag, request.headers.get("if-none-match")):
        return Response(status_code=304, headers=all_headers)
    return Response(content, status, all_headers, media_type)


def check_preconditions(current: BaseModel | None, if_match: str | None, if_none_match: str | None) -> None:
    """Raise PreconditionFailedError unless what is there (None: nothing) meets the caller's conditions."""
    tag = None if current is None else etag_of(to_json(current))
    if if_match is not None and (tag is None or not _is_listed(tag, if_match, strong=True)):
        raise PreconditionFailedError("If-Match: this was changed meanwhile; read it again and decide anew", etag=tag)
    if if_none_match is not None and tag is not None and _is_listed(tag, if_none_match):
        raise PreconditionFailedError("If-None-Match: this is there already", etag=tag)


def _is_listed(tag: str, header: str | None, *, strong: bool = False) -> bool:
    if header is None:
        return False
    listed = [each.strip() for each in header.split(",")]
    if not strong:
        listed = [each.removeprefix("W/") for each in listed]
    return "*" in listed or tag in listed
