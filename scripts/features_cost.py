#!/usr/bin/env python3
"""The cost of features to a scene that has none of them. `features_cost.py --help` says how."""

from __future__ import annotations

import argparse
import functools
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import IO, Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from lib.command import run_command
from lib.output import OutputFolders, leave, write_json

from raybatch_addon.core.errors import RayBatchError

DESCRIPTION = """\
Compile and render a plain scene (a matt ball and floor under a sun and a pale sky) with kernels of its own, and with
kernels that have every feature: all closures, all ops of shader graphs, all lights, and the rest. Kernels are compiled
into an empty folder, in a process of their own, the two in turns. Also reported: what the statistics list as left
out, and which functions of closures, ops and lights are in the plain scene's modules.
"""


def argument_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="features_cost.py",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add = parser.add_argument
    add("--device", default="cpu", help="AUTO, cpu or cuda:N")
    add("--repeats", type=int, default=3, metavar="N", help="renders and compilations of each kind; the fastest counts")
    add("--samples", type=int, default=64, metavar="N", help="samples a pixel of the renders")
    add(
        "--json",
        nargs="?",
        const="-",
        metavar="FILE",
        help="write the figures as JSON; without FILE to standard output",
    )
    add("--worker", choices=("plain", "all"), help=argparse.SUPPRESS)
    return parser


def plain_scene() -> Any:
    """A matt ball and floor under a sun and a pale sky."""
    from raybatch_addon.core.scene.description import Frame
    from tests.support import scenes

    objects = [
        (scenes.sphere(), scenes.IDENTITY, scenes.diffuse(0.7)),
        (scenes.plane(size=8.0), scenes.translation(0, 0, -1), scenes.diffuse(0.5)),
    ]
    view = scenes.camera(eye=(0, -5, 1.5), half_width=0.6)
    return scenes.scene(objects, view=view, frame=Frame(192, 192), lights=[scenes.sun(2.0, 0.1)], world=0.5)


def _all_ops() -> dict[str, Any]:
    from raybatch_addon.core.programs.op import op_named, op_names

    return {name: op_named(name) for name in op_names()}


def every_feature(features: Any) -> Any:
    """`features`, and all others that a scene can have with them."""
    import dataclasses

    from raybatch_addon.core.scene.description import ClosureKind, LightKind
    from raybatch_addon.core.scene.program import ProgramFeatures

    ops = _all_ops()
    materials = ProgramFeatures(tuple(sorted(ops)), 64, 8)
    world = ProgramFeatures(
        tuple(sorted(name for name, op in ops.items() if not op.makes_closures or name in ("emission", "background"))),
        64,
        4,
    )
    flags = {field.name: True for field in dataclasses.fields(features) if field.type == "bool"}
    more = {
        "programs": materials,
        "world_program": world,
        "lamp_program": world,
        "closures": tuple(sorted(ClosureKind)),
        "lights": tuple(sorted(LightKind)),
    }
    # a transparent film and clamping change the picture, and instancing the trees
    same = {name: getattr(features, name) for name in ("film_transparent", "clamping", "instancing", "depth_of_field")}
    return dataclasses.replace(features, **flags | more | same)


def features_without_data(features: Any) -> Any:
    """The features of `every_feature` whose kernels can render a scene that has none of them: the others read tables
    that are not there.
    """
    import dataclasses

    every = every_feature(features)
    return dataclasses.replace(features, closures=every.closures, programs=every.programs, lights=every.lights)


def compile_once(kind: str, device: str) -> dict[str, float]:
    """Seconds in which the kernels of one kind are compiled, in this process, from nothing."""
    from raybatch_addon.core.scene.features import derive_features
    from raybatch_addon.core.session import Session

    with tempfile.TemporaryDirectory() as folder:
        session = Session(device, cache_folder=folder)
        features = derive_features(plain_scene(), session.settings)
        if kind == "all":
            features = every_feature(features)
        started, used = time.perf_counter(), time.process_time()
        modules = session.prewarm([features])
        return {
            "seconds": time.perf_counter() - started,
            "processor_seconds": time.process_time() - used,
            "modules": len(modules),
        }


def render_times(device: str, samples: int, repeats: int) -> dict[str, Any]:
    """Seconds of tracing and shading with both kinds of kernels, in turns; and the plain render's statistics."""
    import numpy as np

    import raybatch_addon.core.session as door
    from raybatch_addon.core.session import Session
    from raybatch_addon.core.settings.settings import RenderSettings

    derive = door.derive_features
    session = Session(device)
    settings = RenderSettings(device=device, sample_count=samples)
    scene = plain_scene()
    found: dict[str, list[float]] = {"plain": [], "all": []}
    films = {}
    try:
        for _ in range(repeats + 1):  # the first warms up
            for kind in found:
                door.derive_features = (
                    derive if kind == "plain" else lambda *given: features_without_data(derive(*given))
                )
                films[kind] = session.render(scene, settings)
                found[kind].append(films[kind].statistics["seconds"]["render"])
    finally:
        door.derive_features = derive
    pictures = [films[kind].passes["Combined"] for kind in found]
    return {
        "seconds": {kind: min(times[1:]) for kind, times in found.items()},
        "largest_difference": float(np.abs(pictures[0] - pictures[1]).max()),
        "left_out": films["plain"].statistics["left_out"],
    }


def functions_of(features: Any, device: str) -> dict[str, set[str]]:
    """Functions that a render's modules hold, by module: places and names, as in `shading.nodes.mixing.mix`."""
    import warp as wp

    from raybatch_addon.core.device.declared import declare_all
    from raybatch_addon.core.device.devices import find_device
    from raybatch_addon.core.wavefront.kernels import StageKernels

    found = {}
    for kernel in StageKernels.choose(features, find_device(device)).all():
        options = {**kernel.module.options, "block_dim": 1, "mode": "release"}
        declare_all(kernel.module)
        builder = wp._src.context.ModuleBuilder(
            kernel.module, options, target="cuda" if find_device(device).is_cuda else "cpu"
        )
        found[kernel.key] = {name_of(function) for function in builder.functions}
    return found


def name_of(function: Any) -> str:
    """`function`, of Warp, by its place in the core and name."""
    return f"{function.func.__module__.removeprefix('raybatch_addon.core.')}.{function.func.__name__}"


def functions_report(device: str) -> dict[str, Any]:
    """What the plain scene's modules hold of what closures, ops and lights are made of."""
    from raybatch_addon.core.scene.features import derive_features
    from raybatch_addon.core.settings.settings import RenderSettings

    features = derive_features(plain_scene(), RenderSettings())
    plain = set().union(*functions_of(features, device).values())
    every = set().union(*functions_of(every_feature(features), device).values())
    ops = {name_of(op.function) for op in _all_ops().values()}
    return {
        "functions": {"plain": len(plain), "all": len(every)},
        "only_with_features": sorted(every - plain),
        "ops_in_plain": sorted(plain & ops),
    }


def run(options: argparse.Namespace, folders: OutputFolders, standard_output: IO[str]) -> int:
    """The exit code; raises `RayBatchError`."""
    if options.json and options.json != "-":
        folders.prepare(Path(options.json).absolute())
    if options.worker:
        write_json("-", [compile_once(options.worker, options.device)], standard_output)
        return 0
    compiled: dict[str, list[dict]] = {"plain": [], "all": []}
    for _ in range(options.repeats):
        for kind, times in compiled.items():
            times.append(_worker(kind, options.device))
            print(
                f"{kind}: {times[-1]['modules']:.0f} modules compiled in {times[-1]['seconds']:.1f} s "
                f"({times[-1]['processor_seconds']:.1f} s of processors)",
                file=sys.stderr,
            )
    best = {kind: {key: min(each[key] for each in times) for key in times[0]} for kind, times in compiled.items()}
    report = {
        "compile": best,
        "render": render_times(options.device, options.samples, options.repeats),
        "source": functions_report(options.device),
    }
    for key in ("seconds", "processor_seconds"):
        print(
            f"compile, {key.replace('_', ' ')}: {best['plain'][key]:.1f} plain, {best['all'][key]:.1f} all, "
            f"{best['all'][key] / best['plain'][key]:.2f} times",
            file=sys.stderr,
        )
    seconds = report["render"]["seconds"]
    print(
        f"render: {seconds['plain']:.3f} s plain, {seconds['all']:.3f} s all, {seconds['all'] / seconds['plain']:.2f} "
        "times",
        file=sys.stderr,
    )
    print(f"left out: {', '.join(report['render']['left_out'])}", file=sys.stderr)
    print(
        f"functions in modules: {report['source']['functions']}; of ops in the plain ones: "
        f"{report['source']['ops_in_plain'] or 'none'}",
        file=sys.stderr,
    )
    if options.json:
        write_json(options.json, [report], standard_output)
    return 0


def _worker(kind: str, device: str) -> dict[str, float]:
    import json

    command = [sys.executable, str(Path(__file__).resolve()), "--worker", kind, "--device", device]
    done = subprocess.run(command, capture_output=True, text=True, env=dict(os.environ))
    if done.returncode:
        raise RayBatchError(
            f"the kernels of {kind} cannot be compiled: {(done.stderr.strip().splitlines() or ['?'])[-1]}"
        )
    return json.loads(done.stdout)


def main(arguments: list[str] | None = None) -> int:
    """The exit code."""
    options = argument_parser().parse_args(arguments)
    return run_command("features_cost.py", False, functools.partial(run, options))


if __name__ == "__main__":
    leave(main())
