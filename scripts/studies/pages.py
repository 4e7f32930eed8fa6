"""Pages of studies: what is made from figures stands between marks, the text around it is written by hand."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lib.command import UsageError
from lib.output import write_text

from studies.study import Report, Row


def table(heads: Sequence[Any], rows: Sequence[Sequence[Any]]) -> str:
    """Rows as Markdown; None is an empty cell."""
    cells = [["" if cell is None else str(cell) for cell in row] for row in (heads, ["---"] * len(heads), *rows)]
    return "\n".join("| " + " | ".join(row) + " |" for row in cells)


def number(value: float | None, digits: int = 3, estimate: bool = False) -> str:
    """With so many digits, without exponents where they can be avoided; an estimate has a ~ before it."""
    if value is None:
        return ""
    text = f"{value:.{digits}g}"
    if "e" in text and 1e-4 <= abs(value) < 1e7:
        text = f"{value:,.0f}" if abs(value) >= 1 else f"{value:.6f}".rstrip("0")
    return f"~{text}" if estimate else text


def marks_of(name: str) -> tuple[str, str]:
    """The lines between which a page's fragment stands."""
    return f"<!-- {name}: made by scripts/study.py -->", f"<!-- end of {name} -->"


def put_fragment(page: Path, name: str, title: str, fragment: str) -> None:
    """Replace what stands between the marks of `page`; a page that is not there is begun. Raises `UsageError` for a
    page without marks.
    """
    first, last = marks_of(name)
    block = f"{first}\n\n{fragment.strip()}\n\n{last}"
    if page.exists():
        text = page.read_text(encoding="utf-8")
        pattern = re.compile(f"{re.escape(first)}.*?{re.escape(last)}", re.DOTALL)
        if len(pattern.findall(text)) != 1:
            raise UsageError(
                f"{page} has not one place between the lines {first} and {last}: put them where the tables shall stand"
            )
        text = pattern.sub(lambda found: block, text)
    else:
        text = f"# {title}\n\n{block}\n"
    page.parent.mkdir(parents=True, exist_ok=True)
    write_text(page, text)


def machine(report: Report) -> str:
    """One line on where and how a report was measured."""
    device, versions = report["device"], report["versions"]
    name = device.get("name") or device["alias"]
    kind = f"CUDA: {name}" if report["device_kind"] == "cuda" else f"CPU, {device['cores']} threads"
    quick = "; the quick study" if report["quick"] else ""
    codes = sorted({row["core"] for row in report["rows"] if "core" in row})
    code = f" (core {', '.join(codes)})" if codes else ""
    engine = f"RayBatch {versions.get('raybatch')}{code}, Warp {versions.get('warp')}"
    return f"{kind}; {engine}; {turns_of(report)}{quick}."


def turns_of(report: Report) -> str:
    """How often things were measured, in words."""
    counts = Counter(row["case"] for row in report["rows"])
    least, most = (min(counts.values()), max(counts.values())) if counts else (0, 0)
    if least != most:
        return f"medians of {least} to {most} turns"
    return f"medians of {most} turns" if most > 1 else "measured once"


def device_title(report: Report) -> str:
    """Short, for heads and legends."""
    return {"cuda": "GPU", "cpu": "CPU"}[report["device_kind"]]


def hits_line(rows: Sequence[Row]) -> str:
    """What the comparison of hits bit by bit came to: `wrong` of a row says how many rays met something else."""
    wrong = sorted({row["case"] for row in rows if row.get("wrong")})
    if wrong:
        return f"**Hits differ**, which must not be: {', '.join(wrong[:8])}."
    return "All found the same hits, bit for bit."


def films_line(wrong: Sequence[str], count: int) -> str:
    """What the comparison of films bit by bit came to."""
    if wrong:
        return f"**Films differ**, which must not be: {', '.join(wrong[:8])}."
    return (
        f"All {count:,} films that were rendered to their end are equal bit for bit, as they must be, within each "
        "scene and size."
    )
