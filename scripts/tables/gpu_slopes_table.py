#!/usr/bin/env python3
"""Make the table of docs/studies/equal-error.md for GPUs from reports of benchmark.py:

    python scripts/tables/gpu_slopes_table.py [REPORT.json...]

Each REPORT is what `benchmark.py render FILE --device cuda:0 --samples A,B --against cycles --json REPORT.json` wrote.
A FILE of docs/real-files.json that lies where compare.py finds it is called as there. Figures are kept in
docs/studies/data/equal-error-gpu.json, where a REPORT takes the place of an older one of its file; without a REPORT
the tables are made from that.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

from lib.output import json_text, write_text
from real_files.listing import name_of, read_listing
from real_files.measures import Spread

from tables.equal_error_table import LISTING, PAGE, known_to_differ, row
from tables.marked_text import with_part, write_or_check

DATA = ROOT / "docs" / "studies" / "data" / "equal-error-gpu.json"
MARKS = "<!-- equal error on a GPU: made by scripts/tables/gpu_slopes_table.py -->", "<!-- end of the GPU's -->"
KINDS = ("OPTIX", "CUDA")
SLOPE, VARIANCE, EQUAL, FIXED = (
    "slope_raybatch_over_cycles",
    "variance_raybatch_over_cycles",
    "equal_error_raybatch_over_cycles",
    "fixed_raybatch_over_cycles",
)
_FACTS = ("scene", "device", "versions", "frame", "sample_counts", "ray_tracing_cores", "raybatch", "cycles", "peer")
_KEPT = (*_FACTS, SLOPE, VARIANCE, EQUAL, FIXED, "mean_ratio")
HEADS = ("file", "RayBatch [ms]", *(f"Cycles, {kind} [ms]" for kind in KINDS), "time of a sample", "variance")
HEADS += ("equal error", "fixed [s]", "RayBatch's export [s]", "first render [s]", "brightness")
MORE = "Files that ask for volumes, hair or motion blur:"
EXPORT = "export_s"  # of RayBatch, from Blender [s]; None where it was not kept


def kept(report: dict[str, Any]) -> dict[str, Any]:
    """What is kept of a report; raises `KeyError` where it is not one of two sample counts against Cycles."""
    return {name: report[name] for name in _KEPT} | {"scene": _listed_name(report), EXPORT: report.get(EXPORT)}


def _listed_name(report: dict[str, Any]) -> str:
    """The name by which the list of real files has what was rendered, which no other file has; else that of the
    report.
    """
    path = report.get("asked", {}).get("options", {}).get("scene", "")
    for entry in read_listing(LISTING):
        name = name_of(entry)
        if path.endswith((f"/{name}", f"/{entry['repository'].replace('/', '+')}/{entry['path']}")):
            return name
    return report["scene"]


def by_features(data: list[dict[str, Any]]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Files that have surfaces alone, and files that ask for more, by the list of real files."""
    asking = {name_of(entry) for entry in read_listing(LISTING) if entry.get("asks")}
    return [each for each in data if each["scene"] not in asking], [each for each in data if each["scene"] in asking]


def tables(data: list[dict[str, Any]]) -> str:
    """The table of files that have surfaces alone, and that of files that ask for more."""
    plain, more = by_features(data)
    return f"{table(plain)}\n\n{MORE}\n\n{table(more)}" if more else table(plain)


def table(data: list[dict[str, Any]]) -> str:
    """A line about the runs, each file, and the medians; files whose pictures differ are below, apart from them."""
    first = data[0]
    frame = first["frame"]
    counts = ", or ".join(dict.fromkeys("{} and {}".format(*each["sample_counts"]) for each in data))
    cores = "with" if first["ray_tracing_cores"] else "without"
    size, versions = f"{frame['width']} x {frame['height']} pixels", first["versions"]
    about = (
        f"{first['device']['name']} ({cores} ray-tracing cores), {size}, {counts} samples, "
        f"{first['raybatch']['runs']} turns; Blender {versions['blender']}, Warp {versions['warp']}. "
        "Pairs of seconds are RayBatch's / Cycles'."
    )
    about += " -: an export that was not kept." * any(each.get(EXPORT) is None for each in data)
    lines = [about, "", row(HEADS), row(["---"] * len(HEADS))]
    differing = known_to_differ()
    same = [each for each in data if each["scene"] not in differing]
    lines += _file_rows(same)
    spreads = [Spread.of({each["scene"]: each[name] for each in same}) for name in (SLOPE, VARIANCE, EQUAL)]
    medians = [f"{each.median:.2f} ({each.low:.2f} to {each.high:.2f})" for each in spreads if each is not None]
    assert len(medians) == len(spreads), "a table without scenes"
    worst = [f"{max(each[name] for each in same):.3g}" for name in (SLOPE, VARIANCE, EQUAL)]
    lines += [row(["**median**", "", "", "", *medians, *[""] * 4]), row(["**worst**", "", "", "", *worst, *[""] * 4])]
    lines += _file_rows([each for each in data if each["scene"] in differing], " (differs)")
    return "\n".join(lines)


def _file_rows(reports: list[dict[str, Any]], remark: str = "") -> list[str]:
    lines = []
    for each in sorted(reports, key=lambda found: found["scene"].lower()):
        own, peer = each["raybatch"], each["cycles"][each["peer"]]
        slopes = [f"{each['cycles'][kind]['ms_a_sample']:.3g}" if kind in each["cycles"] else "-" for kind in KINDS]
        ratios = [f"{each[name]:.3g}" for name in (SLOPE, VARIANCE, EQUAL)]
        fixed = f"{own['fixed_seconds']:.2f} / {peer['fixed_seconds']:.2f}"
        first = [each["scene"] + remark, f"{own['ms_a_sample']:.3g}"]
        export = "-" if each.get(EXPORT) is None else f"{each[EXPORT]:.2f}"
        began = f"{own['first_seconds']:.2f} / {peer['first_seconds']:.2f}"
        cells = [*slopes, *ratios, fixed, export, began, f"{each['mean_ratio']:.3f}"]
        lines.append(row([*first, *cells]))
    return lines


def updated(text: str) -> str:
    """The page with the table as it is now."""
    return with_part(text, *MARKS, tables(json.loads(DATA.read_text(encoding="utf-8"))), PAGE)


def main(arguments: list[str]) -> int:
    """The exit code."""
    reports = [Path(each) for each in arguments if each != "--check"]
    if reports:
        found = [kept(json.loads(path.read_text(encoding="utf-8"))) for path in reports]
        new = {each["scene"] for each in found}
        known = json.loads(DATA.read_text(encoding="utf-8")) if DATA.exists() else []
        older = [each for each in known if each["scene"] not in new]
        write_text(DATA, json_text([*older, *found]) + "\n")
    return write_or_check(PAGE, updated, "scripts/tables/gpu_slopes_table.py", arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
