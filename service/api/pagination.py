"""Lists by cursor: a page says where the next one begins, in its body and in its Link header."""

from __future__ import annotations

import base64
import binascii
import json
from dataclasses import dataclass
from typing import Annotated, Any, Final
from urllib.parse import urlencode

from fastapi import Depends, Query, Request

from service.errors import InvalidParameterError

DEFAULT_LIMIT: Final = 100
MAX_LIMIT: Final = 1000

_SAFE_INTEGER: Final = 2**63 - 1


class CursorError(InvalidParameterError):
    """A cursor that this list did not give out."""

    code = "invalid_cursor"


@dataclass(frozen=True, slots=True)
class PageRequest:
    """Which page is asked for: ``limit`` items after the position ``cursor``."""

    limit: int
    cursor: str | None

    def after(self, *kinds: type) -> tuple[Any, ...] | None:
        """The position that the cursor stands for, values of these types; None for the first page."""
        if self.cursor is None:
            return None
        try:
            values = json.loads(base64.urlsafe_b64decode(self.cursor + "=" * (-len(self.cursor) % 4)))
        except (binascii.Error, ValueError):
            values = None
        if not isinstance(values, list) or [type(value) for value in values] != list(kinds):
            raise CursorError("cursor: not one that this list gave out; begin again without it")
        if any(isinstance(value, int) and abs(value) > _SAFE_INTEGER for value in values):
            raise CursorError("cursor: not one that this list gave out; begin again without it")
        if any(isinstance(value, str) and "\0" in value for value in values):
            raise CursorError("cursor: not one that this list gave out; begin again without it")
        return tuple(values)


def page_request(
    limit: Annotated[int, Query(ge=1, le=MAX_LIMIT, description="Items a page.")] = DEFAULT_LIMIT,
    cursor: Annotated[
        str | None, Query(max_length=500, description="Where the page begins: next_cursor of the one before.")
    ] = None,
) -> PageRequest:
    """Dependency: the page that is asked for."""
    return PageRequest(limit, cursor)


Page = Annotated[PageRequest, Depends(page_request)]


def encode_cursor(*values: object) -> str:
    """A position in a list as text that callers need not understand."""
    return base64.urlsafe_b64encode(json.dumps(values, separators=(",", ":")).encode()).rstrip(b"=").decode()


def link_next(request: Request, next_cursor: str | None) -> dict[str, str]:
    """The Link header to the next page (RFC 8288), relative, so that it holds behind a proxy too."""
    if next_cursor is None:
        return {}
    kept = [(name, value) for name, value in request.query_params.multi_items() if name != "cursor"]
    return {"Link": f'<{request.url.path}?{urlencode([*kept, ("cursor", next_cursor)])}>; rel="next"'}
