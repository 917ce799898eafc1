"""The OpenAPI document: what FastAPI finds, the plain telemetry routes, and problems in place of its own errors."""

from __future__ import annotations

from typing import Any, Final

import yaml
from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from schemas.geojson import GEOJSON_MEDIA_TYPE
from schemas.problem import PROBLEM_MEDIA_TYPE, Problem
from service.api.security import SCOPES

DESCRIPTION: Final = """\
Black boxes send packets; the service fuses them and finds accidents; insurers read what came of it.

Callers show an API key, `Authorization: Bearer tf_...`, which belongs to one tenant and holds scopes:

{scopes}

Errors are problem documents (RFC 9457) with a stable `code`. Lists page by `cursor`, and say where they go on in
`next_cursor` and in the `Link` header. Reads carry an `ETag`: sent back as `If-None-Match`, it gets 304 while nothing
has changed. Times are RFC 3339, UTC.
"""

TAGS: Final = [
    {"name": "telemetry", "description": "Packets from black boxes"},
    {"name": "vehicles", "description": "Register, look, follow"},
    {"name": "calibration", "description": "What is known of a box's sensors, and finding it from a recording"},
    {"name": "trips", "description": "Trips and tracks"},
    {"name": "accidents", "description": "Accidents with their places"},
    {"name": "scores", "description": "Scores, what they rest on, quotes, and what rates them"},
    {"name": "events", "description": "What happened, to be caught up with"},
    {"name": "webhooks", "description": "Events pushed, signed"},
    {"name": "operation", "description": "For whoever runs the service"},
]

_PROBLEM: Final = {
    "description": "A problem",
    "content": {PROBLEM_MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
}
_IF_NONE_MATCH: Final = {
    "name": "If-None-Match",
    "in": "header",
    "required": False,
    "schema": {"type": "string"},
    "description": "ETag of what the caller has: 304 while it is still the same.",
}


def document(app: FastAPI, extra_paths: dict[str, Any]) -> dict[str, Any]:
    """The whole document; ``extra_paths`` are those of routes that FastAPI does not know."""
    scopes = "\n".join(f"- `{name}`: {text}" for name, text in SCOPES.items())
    found = get_openapi(
        title=app.title,
        version=app.version,
        summary="Streaming telematics: fusion, accidents, webhooks",
        description=DESCRIPTION.format(scopes=scopes),
        routes=app.routes,
        tags=TAGS,
    )
    found["paths"] = dict(sorted({**found["paths"], **extra_paths}.items()))
    schemas = found.setdefault("components", {}).setdefault("schemas", {})
    problem = Problem.model_json_schema(ref_template="#/components/schemas/{model}")
    schemas.update(problem.pop("$defs"))
    schemas["Problem"] = problem
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    for path, operations in found["paths"].items():
        for method, operation in operations.items():
            _complete(operation, is_read=method == "get" and path.startswith("/v1/"))
    return found


def to_yaml(content: dict[str, Any]) -> str:
    """The document as it is committed."""
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120)


class _Dumper(yaml.SafeDumper):
    """Longer texts as they read, and nothing by reference."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _text(dumper: _Dumper, text: str) -> yaml.ScalarNode:
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style="|" if "\n" in text else None)


_Dumper.add_representer(str, _text)


def _complete(operation: dict[str, Any], *, is_read: bool) -> None:
    """Say what is the same everywhere: errors are problems, reads are conditional, a query has no null."""
    first, _, rest = operation.get("description", operation["summary"]).partition("\n\n")
    operation["summary"] = first.replace("\n", " ")
    if rest:
        operation["description"] = rest
    else:
        operation.pop("description", None)
    for parameter in operation.get("parameters", ()):
        schema = parameter["schema"]
        kinds = [kind for kind in schema.pop("anyOf", []) if kind != {"type": "null"}]
        for kind in kinds:
            schema.update(kind)
        schema.pop("title", None)
        schema.pop("description", None)
    responses = operation["responses"]
    responses.pop("422", None)
    for status, response in list(responses.items()):
        content = response.get("content", {})
        if content.get(GEOJSON_MEDIA_TYPE) == {}:
            content[GEOJSON_MEDIA_TYPE] = content.pop("application/json")
        named = [media.get("schema", {}).get("$ref", "") for media in content.values()]
        if status.startswith(("4", "5")) and any(ref.endswith("/Problem") for ref in named):
            responses[status] = {**_PROBLEM, "description": response["description"]}
    responses["default"] = _PROBLEM
    if is_read:
        responses["304"] = {"description": "Not modified: the caller has it"}
        responses["200"].setdefault("headers", {})["ETag"] = {"schema": {"type": "string"}}
        operation.setdefault("parameters", []).append(_IF_NONE_MATCH)
