"""One self-contained HTML page: sections of text, tables and plots; nothing is fetched, no other script can run."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from typing import Any, Final

from service.reports.plots import Plot

_HERE: Final = files("service.reports")


@dataclass(frozen=True, slots=True)
class Table:
    """Rows under a header, if it has one; ``folded`` is opened by the reader, ``prose`` ends with a column of text."""

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    folded: bool = False
    prose: bool = False


@dataclass(frozen=True, slots=True)
class Section:
    """A heading with paragraphs and what follows them; ``beside`` in two columns where there is room, and in print."""

    title: str
    paragraphs: Sequence[str] = ()
    parts: Sequence[Table | Plot] = ()
    beside: bool = False


def page(title: str, sections: Sequence[Section], *, compact: bool = False) -> str:
    """The whole document; ``compact`` prints small. Every text is escaped here and nowhere else."""
    scripts = [_plotly(), (_HERE / "page.js").read_text(encoding="utf-8")]
    allowed = " ".join(f"'sha256-{_sha256(script)}'" for script in scripts)
    policy = f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:"
    links = "".join(f'<li><a href="#s{i}">{escape(s.title)}</a></li>' for i, s in enumerate(sections))
    body = "\n".join(_section(index, section) for index, section in enumerate(sections))
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{escape(title)}</title>
<link rel="icon" href="data:,">
<style>
{(_HERE / "page.css").read_text(encoding="utf-8")}</style>
</head>
<body{' class="compact"' if compact else ""}>
<a class="skip" href="#s0">Skip to the contents</a>
<header><h1>{escape(title)}</h1><nav aria-label="Sections"><ul>{links}</ul></nav></header>
<main>
<noscript><p class="note">Plots need JavaScript; texts and tables are complete without it.</p></noscript>
{body}
</main>
<script>{scripts[0]}</script>
<script>{scripts[1]}</script>
</body>
</html>
"""


def _section(index: int, section: Section) -> str:
    lines = [f'<section id="s{index}" aria-labelledby="h{index}">', f'<h2 id="h{index}">{escape(section.title)}</h2>']
    lines += [f"<p>{escape(text)}</p>" for text in section.paragraphs]
    parts = [
        _table(part) if isinstance(part, Table) else _plot(part, f"p{index}-{number}")
        for number, part in enumerate(section.parts)
    ]
    lines += ['<div class="beside">', *(f"<div>{part}</div>" for part in parts), "</div>"] if section.beside else parts
    return "\n".join([*lines, "</section>"])


def _table(table: Table) -> str:
    head = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in table.header)
    rows = "\n".join(
        "<tr>" + "".join(f"<{_tag(i)}>{escape(cell)}</{_tag(i)[:2]}>" for i, cell in enumerate(row)) + "</tr>"
        for row in table.rows
    )
    caption = escape(table.caption)
    head = f"<thead><tr>{head}</tr></thead>" if table.header else ""
    kind = ' class="prose"' if table.prose else ""
    inner = (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{caption}"><table{kind}>'
        f"<caption>{caption}</caption>{head}\n<tbody>\n{rows}\n</tbody></table></div>"
    )
    return f"<details><summary>{caption}</summary>{inner}</details>" if table.folded else inner


def _tag(column: int) -> str:
    return 'th scope="row"' if column == 0 else "td"


def _plot(plot: Plot, name: str) -> str:
    spec = {"data": list(plot.data), "layout": dict(plot.layout), "timed": plot.timed}
    return (
        f'<figure aria-labelledby="{name}-title"><h3 id="{name}-title">{escape(plot.title)}</h3>'
        f'<div class="plot" id="{name}" tabindex="0" role="group" aria-roledescription="plot"'
        f' aria-labelledby="{name}-title" aria-describedby="{name}-text" style="height:{plot.height_px}px"></div>'
        f'<script type="application/json" id="{name}-spec">{_script_json(spec)}</script>'
        f'<figcaption id="{name}-text">{escape(plot.text)}</figcaption></figure>'
    )


def _script_json(value: Any) -> str:
    """JSON that cannot end the element it stands in."""
    return json.dumps(value, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _plotly() -> str:
    # Here, not above: only a report needs it, and it takes its time to import.
    from plotly.offline import get_plotlyjs

    text: str = get_plotlyjs()
    return text.replace("\r\n", "\n").replace("</script", "<\\/script")


def _sha256(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
