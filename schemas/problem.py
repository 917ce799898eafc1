"""Errors as callers get them: problem documents (RFC 9457) with a stable code."""

from __future__ import annotations

from typing import Final

from pydantic import BaseModel, ConfigDict, Field

PROBLEM_MEDIA_TYPE: Final = "application/problem+json"


class InvalidField(BaseModel):
    """One part of a request that is wrong."""

    location: str = Field(description="Where: body.config.detector, query.limit, header.if-match.")
    message: str


class Problem(BaseModel):
    """What went wrong. ``code`` is stable, for programs; ``detail`` is for people. Some codes add members."""

    model_config = ConfigDict(extra="allow")

    type: str = Field(default="about:blank", description="Always about:blank: code tells problems apart.")
    title: str = Field(description="The status in words.")
    status: int
    code: str
    detail: str = Field(description="What was wrong, what was expected, what to do.")
    instance: str | None = Field(default=None, description="The path that was asked for.")
    request_id: str | None = Field(default=None, description="To be quoted to the operator; it is in the log.")
    errors: list[InvalidField] | None = Field(default=None, description="With code invalid_request: each thing wrong.")
