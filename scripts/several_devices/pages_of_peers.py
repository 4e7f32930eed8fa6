#!/usr/bin/env python3
"""Measure geometry beyond memory on several GPUs: pages in host memory against pages in each other's memory.

    python scripts/several_devices/pages_of_peers.py SCENE.scene.npz --budget 0.1 --device ALL --json report.json

First the copies alone: how fast one device, and all at once, bring pages from pinned host memory, from the next
device's memory, and from their own. Then whole renders of SCENE with the same budget: geometry_store HOST and PEERS on
all devices, HOST on one, and with all of it in memory (batching OFF) where --memory says so. The first render of each
builds its pages and loads kernels; the others are timed. All films are compared bit for bit: where one differs the exit
code is 1.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

import warp as wp
from benchmarking.scenes import SceneRequest, load_benchmark_scene
from lib.films import differing_passes

from raybatch_addon.core.bvh.build.scene_tree import layout_for
from raybatch_addon.core.bvh.memory import GeometrySize
from raybatch_addon.core.bvh.pages.peers.access import let_read, why_apart
from raybatch_addon.core.bvh.pages.store import page_buffer, page_rows
from raybatch_addon.core.device.devices import copy_stream, find_devices
from raybatch_addon.core.film import Film
from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings

COPIED = 64 << 20  # a page [bytes]
COPIES = 64


def copy_rates(devices: list[wp.Device]) -> dict[str, dict[str, float]]:
    """GB/s of each device's copies into it, by where the pages lie: alone, and the least while all devices copy."""
    held = [page_rows(COPIED, device) for device in devices]
    pinned = [page_buffer(COPIED, pinned=True) for _ in devices]
    targets = [page_rows(COPIED, device).flatten() for device in devices]

    def source(place: int, kind: str) -> wp.array:
        if kind == "host":
            return pinned[place]
        owner = held[place if kind == "own" else (place + 1) % len(devices)]
        # the same address in the reader's name, as `PeerStore.view` has it
        return wp.array(ptr=owner.ptr, dtype=wp.uint8, shape=COPIED, device=devices[place])

    def rate(place: int, kind: str) -> float:
        stream, given = copy_stream(devices[place].alias, "pages"), source(place, kind)
        for count in (4, COPIES):
            wp.synchronize_stream(stream)
            start = time.perf_counter()
            for _ in range(count):
                wp.copy(targets[place], given, count=COPIED, stream=stream)
            wp.synchronize_stream(stream)
        return COPIES * COPIED / (time.perf_counter() - start) / 1e9

    for device in devices:
        wp.synchronize_device(device)
    found: dict[str, dict[str, float]] = {}
    for kind in ("host", "peer", "own"):
        with ThreadPoolExecutor(len(devices)) as pool:
            together = min(pool.map(lambda place, kind=kind: rate(place, kind), range(len(devices))))
        found[kind] = {"alone": round(rate(0, kind), 1), "together": round(together, 1)}
    return found


def measured(device: str, scene: Scene, settings: RenderSettings, runs: int) -> tuple[dict[str, Any], Film]:
    """Renders on `device`, and the last one's film."""
    session = Session(device)
    try:
        seconds, film = [], None
        for _ in range(1 + runs):
            start = time.perf_counter()
            film = session.render(scene, settings)
            seconds.append(round(time.perf_counter() - start, 3))
        found = film.statistics
        tree, batching = found["tree"] or {}, found["batching"] or {}
        names = ("store", "encoded", "page_bytes", "pages", "stored_bytes", "peer_bytes", "host_bytes")
        row = {
            "devices": len(found["devices"]),
            "seconds_first": seconds[0],
            "seconds": seconds[1:],
            "seconds_tree": tree.get("seconds"),
            **{name: tree.get(name) for name in (*names, "nodes_resident")},
            **{name: batching.get(name) for name in ("bytes_copied", "pages_loaded", "resident_peak", "steps")},
            "rays": found["rays"],
            "memory": found.get("memory"),
            "auto": batching.get("auto"),
            "warnings": found["warnings"],
        }
        return row, film
    finally:
        session.close()


def main() -> int:
    """See the file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--grid", type=int, default=1, help="of geometry: repeat it N x N times, as triangles")
    parser.add_argument("--budget", type=float, default=0.1, help="share of the tree's memory, or bytes from 2 on")
    parser.add_argument("--device", default="ALL")
    parser.add_argument("--pixels", type=int, default=1 << 20)
    parser.add_argument("--samples", type=int, default=32, help="so many that devices share: 2^24 paths at least")
    parser.add_argument("--bounces", type=int, default=4)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--memory", action="store_true", help="also with all of it in memory")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()

    made = load_benchmark_scene(SceneRequest(options.scene, options.grid), options.pixels)
    devices = find_devices(options.device)
    tree = GeometrySize.of(made.scene).tree_bytes_most(layout_for(devices[0]))
    budget = int(options.budget if options.budget >= 2 else options.budget * tree)
    settings = RenderSettings(
        sample_count=options.samples, bounce_max=options.bounces, batching="ON", geometry_budget=budget
    )
    cases = {
        "PEERS": (options.device, settings.replace(geometry_store="PEERS")),
        "HOST": (options.device, settings.replace(geometry_store="HOST")),
        "HOST, one device": (devices[0].alias, settings.replace(geometry_store="HOST")),
    }
    if options.memory:
        cases["in memory"] = (options.device, settings.replace(batching="OFF", geometry_budget=0))
    report: dict[str, Any] = {
        "scene": made.name,
        "triangles": made.triangle_count,
        "budget": budget,
        "tree_most": tree,
        "devices": [f"{each.alias}: {each.name}" for each in devices],
        "apart": why_apart(devices),
        "copies": {},
        "renders": {},
    }
    if devices[0].is_cuda and len(devices) > 1 and not report["apart"] and not let_read(devices):
        report["copies"] = copy_rates(devices)
        print(json.dumps(report["copies"]), flush=True)
    first, same = None, True
    for name, (device, its) in cases.items():
        row, film = measured(device, made.scene, its, options.runs)
        first = first or film
        row["same"] = not differing_passes(film.passes, first.passes)
        same = same and row["same"]
        report["renders"][name] = row
        print(name, json.dumps(row), flush=True)
        if options.json:  # what is done so far, should a later one end the run
            options.json.write_text(json.dumps(report, indent=1))
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
