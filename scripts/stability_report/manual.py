"""The tables of all cases in docs/stability.md, with the errors of stored runs.

Results are kept in docs/stability/results.json: for each case, tracer and device what the last report has. A family is
a table with a short row for each case; what the cases do, and why their bounds, unfolds below it. A passage that
several cases of a family share is printed once, with a letter that stands for it elsewhere.
"""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from tables.marked_text import list_item, with_part, wrapped

from raybatch_addon.core.errors import RayBatchError
from stability_report.report import json_number
from tests.stability.case import Case

MARKS = ("<!-- cases: made by scripts/stability.py --table -->", "<!-- end of cases -->")
_SHARED_MIN = 60  # characters from which a passage that several cases share is printed once
_SENTENCE = re.compile(r"(?<=\.)\s+(?=[A-Z\d])")  # between sentences
_LETTERS = "abcdefghijklmnopqrstuvwxyz"
Results = list[dict[str, Any]]  # of each run of a case: name, tracer, device, passed, error, bound


def manual(root: Path) -> Path:
    """The manual in the repository at `root`."""
    return root / "docs/stability.md"


def results_file(root: Path) -> Path:
    """The errors that the manual shows."""
    return root / "docs/stability/results.json"


def read_results(root: Path) -> Results:
    """Stored runs; none where there is no file."""
    path = results_file(root)
    return json.loads(path.read_text(encoding="utf-8"))["runs"] if path.exists() else []


def results_of(report: dict[str, Any]) -> Results:
    """Runs of a report by `json_report`, as they are stored."""
    runs = []
    for each in report["cases"]:
        known = all(each[name] is not None for name in ("measured", "expected"))
        error = abs(each["measured"] - each["expected"]) if known else math.nan
        runs.append(
            {
                "name": each["name"],
                "tracer": each["tracer"],
                "device": report["device"],
                "passed": each["passed"],
                "error": json_number(error),
                "bound": each["tolerance"],
            }
        )
    return runs


def merged(earlier: Results, new: Results) -> Results:
    """`new`, and the runs of `earlier` of which `new` has none, by case, device and tracer."""
    runs = {(each["name"], each["device"], each["tracer"]): each for each in [*earlier, *new]}
    return [runs[key] for key in sorted(runs)]


def results_text(runs: Results) -> str:
    """`runs` as the file that is stored: a line for each."""
    return '{"runs": [\n' + ",\n".join(json.dumps(each, ensure_ascii=False) for each in runs) + "\n]}\n"


def _used(run: dict[str, Any]) -> float:
    """The error in units of the bound."""
    if not run["passed"] or run["error"] is None or run["bound"] is None:
        return math.inf
    return run["error"] / run["bound"] if run["bound"] else 0.0


def _measured(runs: Results) -> tuple[str, str]:
    """The worst error of `runs`, and its bound."""
    if not runs:
        return "not stored", ""
    worst = max(runs, key=_used)
    if math.isinf(_used(worst)):
        return "**failed**", ""
    return f"{worst['error']:.2g}", f"{worst['bound']:.2g}" if worst["bound"] else "exact"


def _passages(cases: Sequence[Case]) -> dict[str, str]:
    """Letters of the sentences that several of `cases` share, by sentence, in the order of their first use."""
    sentences = [sentence for each in cases for text in (each.about, each.bound) for sentence in _SENTENCE.split(text)]
    often = Counter(sentences)
    shared = [one for one in dict.fromkeys(sentences) if often[one] > 1 and len(one) >= _SHARED_MIN]
    return dict(zip(shared, _LETTERS, strict=False))


def _short(text: str, letters: dict[str, str]) -> str:
    """`text` with letters in place of shared sentences."""
    return " ".join(f"({letters[one]})" if one in letters else one for one in _SENTENCE.split(text))


def _table(cases: Sequence[Case], results: Results) -> list[str]:
    lines = ["| case | tracers | quick | error | bound |", "|---|---|---|---|---|"]
    for each in cases:
        error, bound = _measured([run for run in results if run["name"] == each.name])
        cells = (
            each.name.replace("|", "\\|"),
            ", ".join(each.tracers) if each.traces else "any",
            "yes" if each.quick else "",
            error,
            bound,
        )
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _descriptions(cases: Sequence[Case]) -> list[str]:
    letters = _passages(cases)
    lines = ["<details><summary>What each case does, and why its bound</summary>", ""]
    if letters:
        lines += ["What several cases say:", ""]
        for sentence, letter in letters.items():
            lines += list_item(f"({letter}) {sentence}")
        lines += ["", "The cases:", ""]
    for each in cases:
        lines += list_item(f"**{each.name}.** {_short(each.about, letters)}")
        lines += wrapped(f"*Bound:* {_short(each.bound, letters)}", "  ", "  ")
    return [*lines, "", "</details>"]


def cases_tables(cases: Iterable[Case], results: Results) -> str:
    """A section for each family: its table, and what its cases do."""
    families: dict[str, list[Case]] = {}
    for each in cases:
        families.setdefault(each.family, []).append(each)
    devices = sorted({run["device"] for run in results})
    lines = wrapped(
        "*Error* is the worst of the runs that are stored in [stability/results.json](stability/results.json)"
        + (f" ({', '.join(devices)})" if devices else "")
        + ", *bound* what the case allows, in the same unit; *exact*: any error fails.",
        "",
        "",
    )
    for family, some in families.items():
        lines += ["", f"### {family.capitalize()}", "", *_table(some, results), "", *_descriptions(some)]
    return "\n".join(lines)


def with_table(text: str, cases: Iterable[Case], results: Results | None = None) -> str:
    """The manual `text` with the tables as they are now, of the stored results if none are given; raises
    `RayBatchError` where a mark is missing.
    """
    results = read_results(Path(__file__).resolve().parents[2]) if results is None else results
    try:
        return with_part(text, *MARKS, cases_tables(cases, results), "the manual")
    except ValueError as error:
        raise RayBatchError(str(error)) from None
