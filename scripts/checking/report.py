"""The report as a person reads it."""

from __future__ import annotations

from typing import Any

from benchmarking.tables import table


def report_text(report: dict[str, Any]) -> str:
    """The report of check_tracing.py."""
    lines = [
        f"{report['scene']}, {report['triangles']:,} triangles, on {report['device']['name']}: {report['rays']:,} rays "
        f"in {report['seconds']:.0f} s",
        "",
    ]
    rows = [
        [
            name,
            "",
            *(f"{figures[key]:,}" for key in ("rays", "hits", "disagreements", "own_faults", "reference_faults")),
        ]
        for name, figures in report["kinds"].items()
    ]
    lines += [table(["rays", "", "count", "hits", "Warp differs", "own faults", "Warp's faults"], rows), ""]
    rows = [[name, "", f"{check['rays']:,}", f"{check['failures']:,}"] for name, check in report["checks"].items()]
    for leak in report["leaks"]["meshes"] if report["leaks"] else []:
        rows.append(
            [
                f"no escape from {leak['mesh']}, {leak['triangles']:,} triangles",
                "",
                f"{leak['rays']:,}",
                f"{leak['escapes']:,}",
            ]
        )
    lines.append(table(["check", "", "rays", "failures"], rows))
    for leak in report["leaks"]["meshes"] if report["leaks"] else []:
        lines.append(
            f"Warp's tree: {leak['reference_escapes']:,} of {leak['reference_rays']:,} rays escape from {leak['mesh']}"
        )
    for name, check in report["checks"].items():
        for example in check["examples"][:1]:
            lines.append(
                f"{name}: ray {example['number']:,} ({example['kind']}) from {example['origin']} along "
                f"{example['direction']}"
            )
    lines.append(f"own faults: {report['own_faults']:,}; Warp's faults: {report['reference_faults']:,}")
    return "\n".join(lines)
