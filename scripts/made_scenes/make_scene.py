#!/usr/bin/env python3
"""Make a large scene by rule, for render.py, benchmark.py and check_schedules.py.

    python scripts/made_scenes/make_scene.py island -o island.scene.npz --instances 10000000
    python scripts/made_scenes/make_scene.py forest -o forest.scene.npz --instances 10000000
    python scripts/made_scenes/make_scene.py grid -o grid.scene.npz --mesh dragon.npz --copies 28

The same arguments make the same scene, byte for byte. island and forest place --instances instances of few meshes;
grid repeats a mesh N x N times as triangles of their own, of which a scene holds 2,147 million at most, and 715 million
where its trees are whole in memory.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

from benchmarking.scenes import SceneRequest, geometry_scene
from lib.command import UsageError, run_command
from rendering.request import parse_settings

from made_scenes.forest import forest
from made_scenes.island import island
from raybatch_addon.core.host_memory import host_memory_peak
from raybatch_addon.core.scene.archive import save_scene
from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.settings.settings import RenderSettings

MADE = {"forest": forest, "island": island}


def argument_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("kind", choices=("grid", *MADE))
    add("-o", "--out", type=Path, required=True, metavar="FILE.scene.npz")
    add("--instances", type=int, default=1_000_000, metavar="N", help="of island and forest (default: a million)")
    add("--terrain", type=int, default=2049, metavar="N", help="points along an edge of the ground (default: 2049)")
    add("--detail", type=int, default=1, metavar="N", help="how fine plants and rocks are, from 1 on (default: 1)")
    add("--seed", type=int, default=1, metavar="N")
    add("--mesh", type=Path, metavar="FILE.npz", help="of grid: the mesh, arrays v and f")
    add("--copies", type=int, default=2, metavar="N", help="of grid: copies along each of two axes (default: 2)")
    add("--up", choices=("y", "z"), help="of grid: the axis of the mesh that points up (default: z)")
    add("--size", default="1280x720", metavar="WIDTHxHEIGHT", help="of the picture (default: 1280x720)")
    add("--set", action="append", default=[], metavar="NAME=VALUE", help="a setting that the file has")
    return parser


def made_scene(options: argparse.Namespace) -> tuple[Scene, RenderSettings]:
    """What is asked for; raises `UsageError`."""
    for name, least in (("instances", 10), ("terrain", 2), ("detail", 1)):
        if getattr(options, name) < least:
            raise UsageError(f"--{name} {getattr(options, name)} is not valid: it must be {least} or more")
    changed, resolution = parse_settings([f"resolution={options.size}", *options.set])
    width, height = resolution
    if options.kind != "grid":
        make = MADE[options.kind]
        scene = make(options.instances, options.terrain, options.detail, options.seed, width, height)
    elif options.mesh is None:
        raise UsageError("a grid is made of a mesh: give it with --mesh FILE.npz")
    else:
        scene = geometry_scene(SceneRequest(options.mesh, options.copies, None, options.up), width, height)
    return scene, RenderSettings(**changed)


def main(arguments: list[str] | None = None) -> int:
    """See the file."""
    options = argument_parser().parse_args(arguments)

    def work(folders: Any, output: Any) -> int:
        if not options.out.name.endswith(".scene.npz"):
            raise UsageError(f"{options.out} is not a name of a scene: it must end in .scene.npz")
        start = time.perf_counter()
        scene, settings = made_scene(options)
        made = time.perf_counter()
        save_scene(options.out, scene, settings)
        report = {
            "instances": len(scene.instances),
            "meshes": len(scene.meshes),
            "triangles": sum(len(mesh.triangles) for mesh in scene.meshes),
            "triangles_placed": scene.triangles_placed,
            "file_bytes": options.out.stat().st_size,
            "seconds_made": round(made - start, 2),
            "seconds_written": round(time.perf_counter() - made, 2),
            "memory_peak": host_memory_peak(),
        }
        print(json.dumps(report), file=output)
        return 0

    return run_command("make_scene.py", False, work)


if __name__ == "__main__":
    sys.exit(main())
