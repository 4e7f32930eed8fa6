"""Write the tables of docs/experiments/rivals.md from docs/experiments/data/rivals-*-cpu.json, rivals-*-cuda.json and,
with --beyond, beyond-*.json, reports of `scripts/benchmark.py traversal --rival`:
python scripts/tables/rivals_table.py [--check]
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

sys.path[:0] = [str(folder) for folder in Path(__file__).resolve().parents[1:3]]

from tables.experiment_data import FOLDER, RAYS, cases, load, title
from tables.experiment_tables import table
from tables.marked_text import with_part, write_or_check

PAGE = FOLDER / "rivals.md"
CONTROL = "off"
# what stands in a table beside the rivals, in this order
OWN = {"off-plain": "off, plain", "off-sorted": "off, sorted", "on": "on", "ray-order": "ray order"}
Ratios = dict[str, dict[tuple[str, str, str], float]]  # of rates to the control's, by tracer; by scene, rays and order


def ratios(reports: dict[str, dict[str, Any]]) -> Ratios:
    """Each tracer's rates over those of the control in the same report; tracers of the longest report come first."""
    found: Ratios = {}
    for report in sorted(reports.values(), key=lambda report: -len(report["results"])):
        for (rays, order, _), by_name in cases(report).items():
            control = by_name[CONTROL]["mrays_per_s"]
            for name, result in by_name.items():
                if name != CONTROL:
                    found.setdefault(name, {})[title(report), rays, order] = result["mrays_per_s"] / control
    return found


def kind_of(name: str) -> str:
    """The rival without its parameters."""
    return name.partition(":")[0]


def _columns(found: dict[str, dict[tuple[str, str, str], Any]], order: str) -> list[tuple[str, str, str]]:
    kinds = list(RAYS)
    there = {case for by_case in found.values() for case in by_case if case[2] == order}
    return sorted(there, key=lambda case: (case[0], kinds.index(case[1])))


def _heads(columns: list[tuple[str, str, str]]) -> list[str]:
    return [f"{scene}, {RAYS.get(rays, rays)}" for scene, rays, _ in columns]


def best_table(found: Ratios, order: str) -> str:
    """Of each rival the best of its parameters, case by case; what is above the control is bold."""
    columns = _columns(found, order)
    kinds = [*OWN, *dict.fromkeys(kind_of(name) for name in found if name not in OWN)]
    rows = []
    for kind in kinds:
        tried = [by_case for name, by_case in found.items() if kind_of(name) == kind]
        best = [max((by_case[case] for by_case in tried if case in by_case), default=None) for case in columns]
        if any(ratio is not None for ratio in best):
            rows.append([OWN.get(kind, kind), *(_text(ratio) for ratio in best)])
    return table(["", *_heads(columns)], rows)


def all_table(found: Ratios, order: str) -> str:
    """Every rival with every parameter that was tried."""
    columns = _columns(found, order)
    rows = [
        [OWN.get(name, f"`{name}`"), *(_text(by_case.get(case)) for case in columns)]
        for name, by_case in found.items()
        if any(case in by_case for case in columns)
    ]
    return table(["", *_heads(columns)], rows)


def beyond_table(reports: dict[str, dict[str, Any]], order: str) -> str:
    """Rates over that of the control beyond memory, and where it was counted what was brought in for a ray [KB]."""
    found: dict[str, dict[tuple[str, str, str], str]] = {}
    for report in reports.values():
        for (rays, of, _), by_name in cases(report).items():
            control = by_name[CONTROL]["mrays_per_s"]
            for name, result in by_name.items():
                text = _text(result["mrays_per_s"] / control)
                if result["bytes_copied"] is not None:
                    text += f" ({result['bytes_copied'] / result['ray_count'] / 1e3:.2g})"
                found.setdefault(name, {})[title(report), rays, of] = text
    columns = _columns(found, order)
    rows = [[OWN.get(name, name), *(by_case.get(case, "") for case in columns)] for name, by_case in found.items()]
    return table(["", *_heads(columns)], rows)


def _text(ratio: float | None) -> str:
    if ratio is None:
        return ""
    text = f"{ratio:.2f}" if ratio >= 0.095 else f"{ratio:.2g}"
    return f"**{text}**" if float(text) > 1 else text


def updated(text: str) -> str:
    """The page with its tables made of the data."""
    for kind, suffix in (("cpu", ""), ("cuda", ", GPU")):
        found = ratios(load(f"rivals-*-{kind}.json"))
        for name, made in (
            ("natural", best_table(found, "natural")),
            ("shuffled", best_table(found, "shuffled")),
            ("all", all_table(found, "natural")),
            ("beyond", beyond_table(load(f"beyond-*-{kind}.json"), "natural")),
        ):
            text = with_part(text, f"<!-- {name}{suffix} -->", f"<!-- end of {name}{suffix} -->", made, PAGE)
    return text


def main(arguments: list[str]) -> int:
    """The exit code."""
    return write_or_check(PAGE, updated, "scripts/tables/rivals_table.py", arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
