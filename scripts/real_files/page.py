"""The comparison as one HTML page that stands alone, with the pictures of each file."""

from __future__ import annotations

import base64
import html
from typing import Any

from real_files.pictures import GAIN, png, where_both_are
from real_files.records import Record
from real_files.rows import DIFFERS, FAILED
from real_files.tables import (
    EXPLAINED,
    HEADS,
    SUMMARY_HEADS,
    cells,
    counted,
    how_rendered,
    notes_of_old,
    remarks,
    summary_rows,
)

_STYLE = """
:root { color-scheme: light dark; --bad: #b3261e; --line: #8884 }
@media (prefers-color-scheme: dark) { :root { --bad: #ff8a80 } }
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 82rem; padding: 0 1rem; background: Canvas;
  color: CanvasText }
h1 { font-size: 1.5rem } h2 { font-size: 1.1rem; margin-top: 2rem }
table { border-collapse: collapse; font-variant-numeric: tabular-nums } .wide { overflow-x: auto }
th, td { text-align: right; padding: .25rem .7rem; border-bottom: 1px solid var(--line); white-space: nowrap }
th:first-child, td:first-child { text-align: left }
img { width: 100%; max-width: 60rem; image-rendering: pixelated } .bad { color: var(--bad); font-weight: 600 }
.soft { opacity: .75 }
"""


def html_page(report: dict[str, Any], records: list[Record], command: str) -> str:
    """The whole page; `command` is how it was made."""
    pictures = {record.name: record for record in records}
    machine = ", ".join(f"{name} {value}" for name, value in report["versions"].items())
    request = report["request"]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
        f'content="width=device-width"><title>Real files: Cycles and RayBatch</title><style>{_STYLE}</style></head><body>\n'
        f"<h1>Real files by Cycles and by RayBatch</h1>\n<p>{_text(counted(report['summary']))}; {request['width']} "
        f"pixels wide, {request['samples']} samples, on the CPU, {how_rendered(request.get('defaults', False))}. {_text(machine)}.</p>\n"
        f'<div class="wide">{_table(SUMMARY_HEADS, summary_rows(report["summary"]))}</div>\n'
        + "".join(f"<p>{_text(reported)}</p>\n" for reported in notes_of_old(report))
        + f'<h2>Files</h2>\n<div class="wide">{_table(HEADS, [cells(row) for row in report["files"]])}</div>\n'
        f'<p class="soft">{_text(EXPLAINED.replace("*", ""))}</p>\n'
        f"<p>Pictures: Cycles, RayBatch, and their absolute difference {GAIN} times as bright.</p>\n"
        + "".join(_section(row, pictures.get(row["name"])) for row in report["files"])
        + f'<p class="soft">{_text(command)}</p>\n</body></html>\n'
    )


def _text(text: str) -> str:
    return html.escape(text, quote=True)


def _table(heads: tuple[str, ...], rows: list[list[str]]) -> str:
    lines = []
    for row in rows:
        of_row = [f"<td{' class=bad' if cell in (DIFFERS, FAILED) else ''}>{_text(cell)}</td>" for cell in row]
        lines.append(f"<tr>{''.join(of_row)}</tr>")
    return f"<table><tr>{''.join(f'<th>{_text(head)}</th>' for head in heads)}</tr>{''.join(lines)}</table>"


def _section(row: dict[str, Any], record: Record | None) -> str:
    lines = [f"<h2>{_text(row['name'])}: {_text(row['verdict'])}</h2>"]
    picture = where_both_are(record.pair("CYCLES"), record.pair("RAYBATCH")) if record else None
    if picture is not None:
        encoded = base64.b64encode(png(picture)).decode()
        lines.append(f'<img alt="{_text(row["name"])}" src="data:image/png;base64,{encoded}">')
    reported = "".join(
        f"<li{' class=bad' if kind == 'error' else ''}>{_text(kind)}: {_text(text)}</li>" for kind, text in remarks(row)
    )
    return "\n".join(lines) + (f"<ul>{reported}</ul>\n" if reported else "\n")
