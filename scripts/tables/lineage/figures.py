"""Figures of the table, made of the data of experiments and studies: ranges over scenes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from statistics import median
from typing import Any

from studies.rows import medians, ratios_in_turns

from tables.experiment_data import FOLDER, cases, load
from tables.rivals_table import CONTROL, kind_of, ratios

STUDIES = FOLDER.parent / "studies"
KINDS = {"primary": "camera", "bounce1": "bounce 1", "bounce4": "bounce 4"}


def extent(values: Iterable[float]) -> str:
    """The least and the largest, with two digits; one of them where they are alike, a dash where there is none."""
    texts = list(dict.fromkeys(f"{value:.2f}" if value >= 0.095 else f"{value:.2g}" for value in sorted(values)))
    return "–" if not texts else texts[0] if len(texts) == 1 else f"{texts[0]}–{texts[-1]}"


def by_kind(value_of: Callable[[str], Iterable[float]]) -> str:
    """Ranges for rays of each kind, such as `camera 0.50–2.00, bounce 1 0.40`."""
    found = {name: extent(value_of(kind)) for kind, name in KINDS.items()}
    return ", ".join(f"{name} {text}" for name, text in found.items() if text != "–") or "–"


def _is_like(tracer: str, rival: str) -> bool:
    """Whether `tracer` is the rival with some parameters, and traces as the control does."""
    return kind_of(tracer) == rival and "traversal=plain" not in tracer


def on_both(text_of: Callable[[str], str]) -> str:
    """What a CPU's data say and, where there are such, a GPU's: `cpu` and `cuda`."""
    cpu, gpu = text_of("cpu"), text_of("cuda")
    return cpu if gpu == "–" else f"GPU: {gpu}" if cpu == "–" else f"CPU: {cpu}; GPU: {gpu}"


def rival_in_memory(name: str, device: str) -> str:
    """Rates over those of `off`, of the best parameters, rays in their natural order."""
    found = ratios(load(f"rivals-*-{device}.json"))
    tried = [by_case for each, by_case in found.items() if _is_like(each, name)]
    there = {case for by_case in tried for case in by_case if case[2] == "natural"}

    def best(kind: str) -> list[float]:
        return [max(by[case] for by in tried if case in by) for case in there if case[1] == kind]

    return by_kind(best)


def rival_beyond(name: str, device: str) -> str:
    """Rates over those of `off` beyond memory."""

    def values(kind: str) -> list[float]:
        found = []
        for report in load(f"beyond-*-{device}.json").values():
            for (rays, _, _), by_name in cases(report).items():
                mine = [result["mrays_per_s"] for each, result in by_name.items() if _is_like(each, name)]
                if rays == kind and mine:
                    found.append(max(mine) / by_name[CONTROL]["mrays_per_s"])
        return found

    return by_kind(values)


def hardware(policy: str, cache: str, bytes_of: str) -> str:
    """Bytes over those of the plain machine, queues included, at the fourth bounce."""
    rows = [row for row in _rows("hardware-cpu.json") if row.get("kind") == "bounce4" and row.get("cache") == cache]
    plain = {row["scene"]: row[bytes_of] for row in rows if row["policy"] == "plain"}
    mine = {row["scene"]: row[bytes_of] for row in rows if row["policy"] == policy}
    if not mine:
        raise ValueError(f"the data of the hardware study has no policy {policy!r}")
    return extent(mine[scene] / plain[scene] for scene in mine)


def hardware_in_memory(policy: str) -> str:
    """From the second-level cache, where that holds the scene."""
    return f"bytes from the L2 {hardware(policy, 'large', 'l2_bytes')}"


def hardware_beyond(policy: str) -> str:
    """From memory, where the caches are small."""
    return f"bytes from memory {hardware(policy, 'small', 'memory_bytes')}"


def schedule_in_memory(name: str, device: str) -> str:
    """Rates over those of unbatched rays."""
    return by_kind(lambda kind: _schedule_rates(name, device, "memory", kind))


def schedule_beyond(name: str, device: str) -> str:
    """Rates over those of rays that bring in their pages in their own order, on a GPU of all that is read from the
    host's memory.
    """
    return by_kind(lambda kind: _schedule_rates(name, device, "beyond", kind))


def _schedule_rates(name: str, device: str, place: str, kind: str) -> list[float]:
    rows = _rows(f"schedulers-{device}.json")
    seconds, groups = medians(rows), {f"{row['scene']} {place} {kind}" for row in rows}
    found = [(seconds.get(f"{group} unbatched"), seconds.get(f"{group} {name}")) for group in groups]
    return [base / mine for base, mine in found if base and mine]


def top_level_nodes(way: str) -> str:
    """Nodes that emulated warps read, over those of NAIVE, with sweeps."""
    rows = [row for row in _rows("top-level-cpu.json") if row["selection"] == "ALL"]

    def values(kind: str) -> list[float]:
        read = {(row["scene"], row["way"]): row["fetches"] for row in rows if row["kind"] == kind}
        return [read[scene, way] / read[scene, "NAIVE"] for scene, its in read if its == way]

    return f"nodes that warps read, of NAIVE: {by_kind(values)}"


def top_level_rates(way: str) -> str:
    """Rates on a GPU over those of NAIVE, with sweeps."""
    rows = _rows("top-level-cuda.json")
    scenes = sorted({row["scene"] for row in rows})

    def values(kind: str) -> list[float]:
        found = [ratios_in_turns(rows, f"{each} {kind} ALL {way}", f"{each} {kind} ALL NAIVE") for each in scenes]
        return [median(each) for each in found if each]

    return f"rates of sweeps on a GPU, over NAIVE's: {by_kind(values)}"


def streaming(device: str) -> str:
    """Rates of whole renders by the streaming schedule over those of the wavefront whose rays do not wait."""
    rows = _rows(f"streaming-{device}.json")
    scenes = sorted({row["scene"] for row in rows})

    def rates(batching: str) -> str:
        found = [ratios_in_turns(rows, f"{each} {batching} STREAMING", f"{each} OFF WAVEFRONT") for each in scenes]
        return extent(median(each) for each in found if each)

    return f"whole renders, batching OFF {rates('OFF')}, ON {rates('ON')}"


def _rows(name: str) -> list[dict[str, Any]]:
    return json.loads((STUDIES / "data" / name).read_text(encoding="utf-8"))["rows"]
