"""Results as one HTML page that stands alone, readable in light and in dark."""

from __future__ import annotations

import html
import math
from typing import Any

from stability_report.report import number, used, verdict
from tests.stability.cases import Result

_STYLE = """
:root { color-scheme: light dark; --good: #2a7f3a; --bad: #c22; --line: #8884; --soft: #8882 }
@media (prefers-color-scheme: dark) { :root { --good: #6c6; --bad: #f66 } }
body { font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 78rem; padding: 0 1rem }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums }
th, td { text-align: right; padding: .25rem .6rem; border-bottom: 1px solid var(--line); white-space: nowrap }
th:first-child, td:first-child, td.note { text-align: left; white-space: normal }
tr.failed td { color: var(--bad); font-weight: 600 } tr.skipped td { opacity: .6 }
details > p { margin: .2rem 0 .2rem 1rem; font-size: .92em; font-weight: 400; color: CanvasText } summary { cursor: pointer }
.bar { background: var(--soft); width: 8rem; height: .7rem; display: inline-block; vertical-align: middle }
.bar i { display: block; height: 100%; background: var(--good) } .failed .bar i { background: var(--bad) }
.counts b { font-size: 1.6rem } .bad { color: var(--bad) }
"""


def _share(result: Result) -> float:
    """Share of the tolerance that the error took, 0..1."""
    outcome = result.outcome
    if outcome is None or outcome.measured == outcome.expected:
        return 0.0 if result.passed else 1.0
    error = abs(outcome.measured - outcome.expected)
    if not math.isfinite(error) or outcome.tolerance <= 0:
        return 1.0
    return min(1.0, error / outcome.tolerance)


def _row(result: Result) -> str:
    outcome, case = result.outcome, result.case
    numbers = [number(x) for x in (outcome.measured, outcome.expected, outcome.tolerance)] if outcome else ["", "", ""]
    note = f"<p>{html.escape(result.note)}</p>" if result.note else ""
    about = (
        f"<details><summary>{html.escape(case.name)}{' · quick' if case.quick else ''}</summary><p>{html.escape(case.about)}</p>"
        f"<p>Bound: {html.escape(case.bound)}</p>{note}</details>"
    )
    bar = (
        f'<span class="bar"><i style="width:{100 * _share(result):.1f}%"></i></span> {used(result)}' if outcome else ""
    )
    cells = [
        about,
        result.tracer,
        verdict(result),
        *numbers,
        bar,
        f"{result.invalid_samples:,}",
        f"{result.samples:,}",
        f"{result.seconds:.1f}",
    ]
    return f'<tr class="{verdict(result).lower()}">' + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"


def html_page(results: list[Result], device: dict[str, Any], versions: dict[str, str], seconds: float) -> str:
    """The page."""
    families: dict[str, list[Result]] = {}
    for result in results:
        families.setdefault(result.case.family, []).append(result)
    heads = (
        "case",
        "tracer",
        "",
        "measured",
        "expected",
        "tolerance",
        "of the tolerance",
        "invalid",
        "samples",
        "seconds",
    )
    head = "".join(f"<th>{name}</th>" for name in heads)
    tables = "".join(
        f"<h2>{html.escape(family)}</h2><table><thead><tr>{head}</tr></thead><tbody>{''.join(map(_row, rows))}</tbody></table>"
        for family, rows in families.items()
    )
    passed, failed = sum(r.passed for r in results), sum(r.failed for r in results)
    invalid, samples = sum(r.invalid_samples for r in results), sum(r.samples for r in results)
    where = f"{device['name']} ({device['alias']}), {device['cores']} cores"
    machine = " · ".join([where, *(f"{name} {version}" for name, version in versions.items())])
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>Stability of RayBatch</title><style>{_STYLE}</style></head><body><h1>Stability on stiff and extreme "
        "cases</h1>"
        f"<p>{html.escape(machine)}</p>"
        f'<p class="counts"><b>{passed}</b> passed · <b class="{"bad" if failed else ""}">{failed}</b> failed · '
        f"<b>{len(results) - passed - failed}</b> skipped · {invalid:,} of {samples:,} samples invalid · {seconds:.0f} "
        "s</p>"
        "<p>Tracer <em>off</em> is the control, in which each ray visits the whole tree at once; with <em>on</em> rays "
        "wait at small treelets; "
        "<em>-</em> is run once, with none or with several of its own. A case opens to what it does, and why its "
        "tolerance is what it is.</p>"
        f"{tables}</body></html>\n"
    )
