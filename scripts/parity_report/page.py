"""docs/parity.md: tables of features with figures and sheets of pictures, and the same as JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tables.marked_text import list_item

from parity_report.sheets import GAIN, slug

MEAN_NOISE, REL_NOISE = "mean's noise", "relMSE's noise"

_HEAD = """\
# Parity with Cycles

`scripts/parity.py` makes this page. Each feature of Blender's materials, textures, lamps and worlds is built as a small
scene and rendered by Cycles and by RayBatch on the CPU. A feature is a node or a picture:

- A **node** alone is emitted by planes of 32 x 32 points, with coordinates that are the same bits for both. Its
  *difference* is the largest one, absolute below 1 and relative above, over all points, outputs and variants; the bound
  is {node:g}.
- A **picture** is rendered twice by each engine, with different seeds and Cycles made unbiased. Its *difference* is the
  largest relative one of a channel's mean (bound {mean:.0%}), with its standard error; σ is the largest one in standard
  errors. *relMSE* is the mean of squared relative differences, less what the noise of both makes of it (bound
  {rel_mse:g}), with its standard error. *spp* are the samples of a pixel: {spp} at first, and more where their noise is
  too large to compare difference and relMSE with their bounds.

The *verdict* is one of these:

- `ok`: the difference is within its bound, and so is relMSE for a picture.
- `differs`: one of them is beyond its bound.
- `not supported`: RayBatch warns that it does not support something, or one is beyond its bound and RayBatch warns why.
- `too noisy`: they are within their bounds, but the noise is too large to be sure of it.
- `failed`: there was nothing to compare, for example because a render failed.

A feature that is approximated or not supported stays in its table, with its figures. # is the number of its pictures on
the sheet below the table: Cycles, RayBatch, and the absolute difference {gain} times as bright.
"""


def earlier_results(file: Path) -> list:
    """Results in a report by `json_report`, of features that are still there; without pictures. None without the
    file.
    """
    from tests.blender.features.registry import all_features
    from tests.blender.features.runner import Result

    if not file.exists():
        return []
    by_name = {each.name: each for each in all_features()}
    rows = json.loads(file.read_text(encoding="utf-8"))["features"]
    return [
        Result(by_name[row["name"]], row["status"], row["figures"], row["note"], seconds=row["seconds"])
        for row in rows
        if row["name"] in by_name
    ]


def together(earlier: list, new: list) -> list:
    """`new`, and those of `earlier` that it has not, in the order of the registry."""
    from tests.blender.features.registry import all_features

    results = {result.feature.name: result for result in [*earlier, *new]}
    return [results[each.name] for each in all_features() if each.name in results]


def _figures(result: Any) -> tuple[str, str, str, str]:
    """Difference, σ, relMSE and samples, as the table has them."""
    figures = result.figures
    if not figures:
        return "", "", "", ""
    if result.feature.kind == "node":
        beyond = figures.get("points beyond the bound, %")
        return f"{figures['error']:.1e}" + (f"; {beyond:.3g} % of points beyond" if beyond else ""), "", "", ""
    return (
        f"{figures['mean']:.2%} ± {figures[MEAN_NOISE]:.2%}",
        f"{figures['deviations']:.1f}",
        f"{figures['relMSE']:.1e} ± {figures[REL_NOISE]:.0e}",
        f"{figures['samples']:.0f}",
    )


def _row(cells: tuple[str, ...]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def counts(results: list) -> dict[str, tuple[int, int]]:
    """By family, and of all: (within bounds, features)."""
    from tests.blender.features.registry import FAMILIES

    made = {}
    for family in FAMILIES:
        some = [result for result in results if result.feature.family == family]
        if some:
            made[family] = (sum(result.ok for result in some), len(some))
    made["all"] = (sum(result.ok for result in results), len(results))
    return made


def _family(name: str, results: list, numbers: dict[str, int]) -> list[str]:
    """The section of a family: its table, notes, and its sheet of pictures."""
    lines = ["", f"## {name}", "", _row(("#", "feature", "verdict", "difference", "σ", "relMSE", "spp"))]
    lines.append("|---|---|---|---|---|---|---|")
    for result in results:
        number = numbers.get(result.feature.name)
        lines.append(_row((str(number or ""), result.feature.name, result.status, *_figures(result))))
    if noted := [result for result in results if result.note]:
        lines += ["", "Notes of RayBatch:", ""]
        for result in noted:
            lines += list_item(f"**{result.feature.name}**: {result.note}")
    if found := [result for result in results if result.feature.finding and not result.ok]:
        lines += ["", "Who is right:", ""]
        for result in found:
            lines += list_item(f"**{result.feature.name}**: {result.feature.finding}")
    if any(result.feature.name in numbers for result in results):
        lines += ["", f"![{name}: Cycles, RayBatch and their difference, by number](parity/{slug(name)}.png)"]
    return lines


def page(results: list, numbers: dict[str, int], versions: dict[str, str]) -> str:
    """The Markdown text; `numbers` are those of the features' pictures on the sheets in the folder parity/ beside it."""
    from tests.blender.features.registry import FAMILIES, SAMPLES, all_features
    from tests.blender.features.runner import MEAN_TOLERANCE, REL_MSE_TOLERANCE, TOLERANCE

    bounds = dict(node=TOLERANCE, mean=MEAN_TOLERANCE, rel_mse=REL_MSE_TOLERANCE)
    lines = [_HEAD.format(**bounds, spp=2 * SAMPLES, gain=GAIN)]
    lines += [", ".join(f"{name} {version}" for name, version in versions.items()) + ".", ""]
    if missing := len(all_features()) - len(results):
        lines += [f"**{missing} of {len(all_features())} features are not in this table yet.**", ""]
    lines += ["| family | within bounds | of | share |", "|---|---|---|---|"]
    # nothing but all of them is 100%
    lines += [f"| {name} | {ok} | {total} | {100 * ok // total}% |" for name, (ok, total) in counts(results).items()]
    for family in FAMILIES:
        if some := [result for result in results if result.feature.family == family]:
            lines += _family(family, some, numbers)
    return "\n".join(lines) + "\n"


def json_report(results: list, versions: dict[str, str], seconds: float) -> dict[str, Any]:
    """Everything but the pictures."""
    return {
        "versions": versions,
        "seconds": round(seconds, 1),
        "counts": {name: {"ok": ok, "total": total} for name, (ok, total) in counts(results).items()},
        "features": [
            {
                "name": result.feature.name,
                "family": result.feature.family,
                "kind": result.feature.kind,
                "quick": result.feature.quick,
                "status": result.status,
                "figures": result.figures,
                "note": result.note,
                "seconds": round(result.seconds, 2),
            }
            for result in results
        ],
    }
