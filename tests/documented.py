"""What the OpenAPI document promises of an answer, for tests that look at more of it than its status."""

from __future__ import annotations

from functools import cache
from typing import Any

import jsonschema_rs

from service.app import create_app
from service.settings import Settings


@cache
def _validator(schema: str) -> Any:
    components = create_app(Settings()).openapi()["components"]
    root = {"$schema": "https://json-schema.org/draft/2020-12/schema", "$ref": f"#/components/schemas/{schema}"}
    return jsonschema_rs.validator_for(root | {"components": components})


def conforms(schema: str, body: Any) -> None:
    """Raise where a body is not what the document says of this schema."""
    _validator(schema).validate(body)
