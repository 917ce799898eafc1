"""``/docs``: the OpenAPI document as one page of plain HTML, which needs nothing from anywhere else."""

from __future__ import annotations

import json
from collections.abc import Iterator
from html import escape
from typing import Any, Final

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

router = APIRouter(include_in_schema=False)

_HEADERS: Final = {"Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'"}

_STYLE: Final = """
:root { color-scheme: light dark; --line: color-mix(in srgb, currentColor 18%, transparent); }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
code, pre { font: 14px/1.45 ui-monospace, monospace; }
pre { overflow-x: auto; padding: .75rem; border: 1px solid var(--line); border-radius: .4rem; }
details { border: 1px solid var(--line); border-radius: .4rem; margin: .5rem 0; padding: .4rem .8rem; }
summary { cursor: pointer; } summary b { display: inline-block; min-width: 4.5rem; }
table { border-collapse: collapse; width: 100%; } td, th { text-align: left; vertical-align: top;
padding: .25rem .75rem .25rem 0; border-top: 1px solid var(--line); }
"""

_METHODS: Final = ("get", "put", "post", "patch", "delete")


@router.get("/docs", response_class=HTMLResponse)
def get_docs(request: Request) -> HTMLResponse:
    """The reference of this service's HTTP interface."""
    return HTMLResponse(page(request.app.openapi()), headers=_HEADERS)


def page(document: dict[str, Any]) -> str:
    """The document as HTML."""
    info = document["info"]
    return "".join(
        [
            "<!doctype html><html lang=en><meta charset=utf-8>",
            "<meta name=viewport content='width=device-width'>",
            f"<title>{escape(info['title'])}</title><style>{_STYLE}</style>",
            f"<h1>{escape(info['title'])} {escape(info['version'])}</h1>",
            f"<div>{_prose(info['description'])}</div>",
            "<p>For machines: <a href=/openapi.json>openapi.json</a>.</p>",
            *_sections(document),
            "<h2>Schemas</h2>",
            *(
                f"<details id='{escape(name)}'><summary><code>{escape(name)}</code> "
                f"{escape(_first_line(schema.get('description', '')))}</summary>{_json(schema)}</details>"
                for name, schema in sorted(document["components"]["schemas"].items())
            ),
            "</html>",
        ]
    )


def _sections(document: dict[str, Any]) -> Iterator[str]:
    operations = [
        (method, path, operations[method])
        for path, operations in document["paths"].items()
        for method in _METHODS
        if method in operations
    ]
    for tag in document["tags"]:
        mine = [each for each in operations if tag["name"] in each[2].get("tags", ())]
        if mine:
            yield f"<h2>{escape(tag['name'])}</h2><p>{escape(tag['description'])}</p>"
            yield from (_operation(*each) for each in mine)


def _operation(method: str, path: str, operation: dict[str, Any]) -> str:
    parts = [
        f"<details><summary><b>{method.upper()}</b> <code>{escape(path)}</code> ",
        f"{escape(operation['summary'])}</summary>",
        _prose(operation.get("description", "")),
    ]
    rows = [
        f"<tr><td><code>{escape(each['name'])}</code><td>{each['in']}<td>{escape(each.get('description', ''))}"
        for each in operation.get("parameters", ())
    ]
    if rows:
        parts.append(f"<table><tr><th>Parameter<th>In<th>What{''.join(rows)}</table>")
    for media_type, media in operation.get("requestBody", {}).get("content", {}).items():
        parts.append(f"<p>Body: <code>{escape(media_type)}</code> {_schema(media.get('schema', {}))}")
    for status, response in operation["responses"].items():
        contents = " ".join(
            f"<code>{escape(media_type)}</code> {_schema(media.get('schema', {}))}"
            for media_type, media in response.get("content", {}).items()
        )
        parts.append(f"<p><b>{escape(status)}</b> {escape(response.get('description', ''))} {contents}")
    return "".join([*parts, "</details>"])


def _schema(schema: dict[str, Any]) -> str:
    name = schema.get("$ref", "").rpartition("/")[2]
    if name:
        return f"<a href='#{escape(name)}'>{escape(name)}</a>"
    return _json(schema) if schema else ""


def _json(value: object) -> str:
    return f"<pre>{escape(json.dumps(value, indent=2, ensure_ascii=False))}</pre>"


def _first_line(text: str) -> str:
    return text.partition("\n")[0]


def _prose(text: str) -> str:
    return "".join(f"<p>{escape(each)}" for each in text.replace("\n- ", "\n\n- ").split("\n\n"))
