"""What was simulated, as tables of Markdown and as a plot."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from studies.hardware.cases import KINDS, L2_SIZES, POLICIES, SCENES
from studies.pages import number, table
from studies.study import Report, Row

TITLES = {"small": "a second-level cache of 1 MB", "large": "a second-level cache of 256 MB, which holds the scene"}


def is_beyond(row: Row) -> bool:
    """Whether queues and buffers lie beyond the second-level cache: those in memory, but the large one holds them."""
    return row["queues_in_memory"] and row["cache"] != "large"


def from_memory(row: Row, queues: bool = True) -> float:
    """Bytes of a ray, with what queues in memory take or without."""
    own = (row["queue_written"] + row["queue_read"]) * (is_beyond(row) and queues)
    return (row["memory_bytes"] + own) / row["rays"]


def from_l2(row: Row, queues: bool = True) -> float:
    """Bytes of a ray, with what queues on the chip take or without."""
    own = (row["queue_written"] + row["queue_read"]) * (not is_beyond(row) and queues)
    return (row["l2_bytes"] + own) / row["rays"]


def found(report: Report) -> dict[tuple[str, str, str, str], Row]:
    """Rows by scene, kind of rays, cache and policy."""
    return {(row["scene"], row["kind"], row["cache"], row["policy"]): row for row in report["rows"]}


def fragment(reports: dict[str, Report]) -> str:
    """Tables of the CPU's report, which has all there is; the simulation knows no device."""
    report = reports.get("cpu") or next(iter(reports.values()))
    rows = found(report)
    parts = [_plain(rows)]
    for cache, title in TITLES.items():
        for scene in SCENES:
            if any((scene, kind, cache, POLICIES[0].name) in rows for kind in KINDS):
                parts += [f"**{scene}**, {title}", _policies(rows, scene, cache)]
    if any(kind == "bounce4" for _, kind, _, _ in rows):
        parts += ["**Requests, queues, prefetching, time**: bounce4, the small cache", _details(rows)]
    parts += ["**For a profiler**: single rays, caches of the H100's sizes", _checked(report)]
    return "\n\n".join(parts)


def _plain(rows: dict[tuple[str, str, str, str], Row]) -> str:
    lines: list[list[Any]] = []
    for scene in SCENES:
        for kind in KINDS:
            small, large = (rows.get((scene, kind, cache, POLICIES[0].name)) for cache in L2_SIZES)
            if small and large:
                figures = [small["items"] / small["rays"], small["l1_requests"] / small["rays"]]
                figures += [from_l2(small), from_memory(small), from_memory(large)]
                size = f"{small['tree_bytes'] / 1e6:.0f} MB"
                lines.append([scene, size, kind, f"{small['rays']:,}", *(number(each) for each in figures)])
    heads = ["scene", "tree", "rays", "number", "nodes and triangles", "lines asked for", "bytes from the L2"]
    heads += ["from memory, 1 MB", "from memory, 256 MB"]
    return "**Plain**, a ray\n\n" + table(heads, lines)


def _ratio(row: Row, base: Row, of: Any) -> str:
    whole, without = of(row) / of(base), of(row, False) / of(base)
    return f"{whole:.2f}" if abs(whole - without) < 0.005 else f"{whole:.2f} ({without:.2f})"


def _policies(rows: dict[tuple[str, str, str, str], Row], scene: str, cache: str) -> str:
    lines = []
    for policy in POLICIES:
        cells = [policy.name]
        for of in (from_memory, from_l2):
            for kind in KINDS:
                row, base = (rows.get((scene, kind, cache, each.name)) for each in (policy, POLICIES[0]))
                cells.append(_ratio(row, base, of) if row and base else "")
        lines.append(cells)
    heads = [f"{words}, {kind}" for words in ("memory", "L2") for kind in KINDS]
    return table(["policy", *heads], lines)


def _details(rows: dict[tuple[str, str, str, str], Row]) -> str:
    lines = []
    for policy in POLICIES:
        cells: list[str] = [policy.name]
        for scene in SCENES:
            row, base = (rows.get((scene, "bounce4", "small", each.name)) for each in (policy, POLICIES[0]))
            if row and base:
                cells.append(f"{row['l1_requests'] / base['l1_requests']:.2f}")
                cells.append(f"{row['l1_hits'] / row['l1_requests']:.2f}")
                cells.append(number(row["queued"] / row["rays"]) if row["queued"] else "")
                share = row["prefetched_used"] / row["prefetched"] if row["prefetched"] else None
                cells.append(f"{row['prefetched'] / row['rays']:.0f}, {share:.2f}" if share is not None else "")
                cells.append(f"{row['cycles'] / base['cycles']:.2f}")
        lines.append(cells)
    words = ("requests", "hits", "waits a ray", "prefetched a ray, used", "time")
    present = [scene for scene in SCENES if (scene, "bounce4", "small", POLICIES[0].name) in rows]
    return table(["policy", *(f"{scene}: {word}" for scene in present for word in words)], lines)


def _checked(report: Report) -> str:
    lines = []
    for row in report["rows"]:
        if row["cache"] == "gpu":
            figures = from_l2(row), from_memory(row), row["l1_hits"] / row["l1_requests"]
            name = f"{row['scene']}, {row['kind']}, {row['order']}"
            lines.append([name, f"{row['rays']:,}", *(number(each) for each in figures)])
    return table(["rays", "number", "bytes of a ray from the L2", "from memory", "hits of the L1"], lines)


RATIO_TICKS = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20)


def draw(reports: dict[str, Report], folder: Path) -> None:
    """Bytes from memory and from the L2 over those of plain, by policy, of bounce4 with the small cache."""
    from studies import plots

    rows = found(reports.get("cpu") or next(iter(reports.values())))
    figure, axes = plots.panels(2)
    present = [scene for scene in SCENES if (scene, "bounce4", "small", POLICIES[0].name) in rows]
    names = [policy.name for policy in POLICIES]
    for axis, of, title in zip(axes, (from_memory, from_l2), ("memory", "L2"), strict=True):
        for i, scene in enumerate(present):
            base = rows[scene, "bounce4", "small", names[0]]
            values = [of(rows[scene, "bounce4", "small", name]) / of(base) for name in names]
            places = [j + 0.25 * (i - 1) for j in range(len(names))]
            axis.barh(places, values, height=0.25, color=plots.COLORS[i], label=scene)
        axis.axvline(1.0, color="#888888", linewidth=0.8)
        axis.set_xscale("log")
        low, high = axis.get_xlim()
        ticks = [tick for tick in RATIO_TICKS if low <= tick <= high]
        axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axis.minorticks_off()
        axis.set_xlabel(f"bytes from {title} over those of plain, bounce4")
        axis.set_yticks(range(len(names)), names if of is from_memory else [""] * len(names), fontsize=6)
        axis.invert_yaxis()
    axes[0].legend(fontsize=7)
    plots.save(figure, folder, "hardware")
