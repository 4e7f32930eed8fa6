"""The sub-commands about rays alone: how fast tracers find their hits, and traces of them in files."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lib.command import UsageError
from rendering.request import parse_settings

NAMES = ("traversal", "record-rays", "check-rays", "compare-hits")
RAYS_DEFAULT = "primary,bounce1,bounce4,shadow1"
TRAVERSAL = """\
Measure how fast tracers find hits, all on the same rays of real paths.

FILE is geometry (.npz, arrays v, f and, if wanted, m), or a scene written by render.py --save-scene (.scene.npz). It is
rendered, in a frame of about as many pixels as rays of a kind are wanted, until there are enough rays of every kind, or
32 times as many camera rays: rays are taken in the order in which the integrator hands them to its tracer. Paths go no
farther than is asked for, and without Russian roulette. Where a scene has no light a sun is added, and where nothing
scatters light all becomes white.
With --rays-file nothing is rendered: rays are those of a trace by record-rays, or by another program.

rays     primary; bounceN: rays that go on from the Nth hit of a path; shadowN: its shadow rays (any hit)
orders   natural (the integrator's), shuffled, sorted (by octant and Morton code, before the clock starts)
tracers  off: RayBatch's own tree without queues; off-plain: the same tree, one ray after another a thread,
         without refill on CUDA; off-sorted: as off, and sorts its rays first; reference: Warp's tree; embree and
         embree-robust: Intel's Embree through the package embreex, on the CPU. Default: all of these that can be
         measured here.
         on: rays wait at treelets, or with --budget for pages of geometry; auto: what RayBatch chooses. Controls beyond
         memory: zero-copy (CUDA): off, its tree in pinned memory of the host, whole (zero-copy) and with only the
         triangles there (zero-copy-triangles); ray-order (CPU): the pages of on, brought in as rays need them in their
         order

Hits are compared before anything is timed; where tracers disagree, every triangle is asked in float64, and answers
beyond the error bound of float32 are reported as faults. Then tracers take turns, run by run. One CPU thread is
timed by its own clock, several by the wall's, CUDA devices by their events; tracers whose rays wait for pages by the
wall's.
Mrays/s are medians and include the time of sorting, queues and copies.
"""
RECORD = """\
Record the rays of a render of SCENE, geometry (.npz) or a saved scene (.scene.npz), in a file.

They are those that `traversal` measures, in the order in which the integrator hands them to its tracer, with the pixel,
the sample and the bounce of each; docs/ray-traces.md says what the file holds. The same command records the same rays.
--triangles writes the triangles that the rays can hit as well, in their places, for tracers that read no scenes.
"""
CHECK = """\
Check a trace of rays: that its arrays are there and have the right types and shapes, that values are finite, directions
have unit length, and limits, kinds and numbers are legal. With --scene also that its rays are of that geometry, and
that its hits name triangles that are there.
"""
COMPARE = """\
Compare the hits that another tracer found for the rays of TRACE with RayBatch's.

Hits are arrays of the trace itself, or of another file with an entry for each of its rays (docs/ray-traces.md). Where
they differ from RayBatch's by more than float32 rounds, every triangle of the scene is asked in float64, and answers
beyond the error bound of float32 are reported as faults, theirs and ours. The exit code is 1 if a fault is ours.
"""


def add_commands(
    command: Callable[[str, str], argparse.ArgumentParser], geometry_options: Callable[[argparse.ArgumentParser], None]
) -> None:
    """Add the sub-commands, each made by `command` of name and description."""
    traversal = command("traversal", TRAVERSAL)
    traversal.add_argument("--scene", type=Path, required=True, metavar="FILE")
    geometry_options(traversal)
    traversal.add_argument("--threads", default="1", metavar="T[,T]", help="threads of the CPU (default: 1)")
    traversal.add_argument("--tracers", default="", metavar="NAME[,NAME]")
    traversal.add_argument(
        "--rival",
        action="append",
        default=[],
        metavar="NAME[:PARAMETER=VALUE,...]",
        help="measure another scheme of tracing many rays too (may be repeated); docs/experiments/rivals.md lists them",
    )
    traversal.add_argument("--rays", metavar="KIND[,KIND]", help=f"default: {RAYS_DEFAULT}; of a trace all that it has")
    traversal.add_argument(
        "--rays-file", type=Path, metavar="TRACE", help="trace the rays of this file (docs/ray-traces.md)"
    )
    traversal.add_argument(
        "--orders", default="natural,shuffled,sorted", metavar="ORDER[,ORDER]", help="default: %(default)s"
    )
    traversal.add_argument(
        "--no-counters",
        action="store_true",
        help="leave out node steps and triangle tests, which cost a compilation and a run",
    )
    traversal.add_argument("--runs", type=int, default=5, help="timed runs (default: 5)")
    traversal.add_argument(
        "--budget",
        metavar="BYTES",
        default="0",
        help="geometry on the device at most, such as 1.5G, for on, auto and ray-order (default: all of it)",
    )
    traversal.add_argument(
        "--beyond",
        action="store_true",
        help="with --budget: off and rivals have no more there either: on the CPU pages of 64 KiB, which come when a "
        "ray runs into them, while the oldest go; on CUDA nothing, all is read from the host's memory",
    )
    traversal.add_argument(
        "--nodes",
        choices=("resident", "paged"),
        help="with --budget: whether all nodes stay on the device (default: where they fit well)",
    )
    traversal.add_argument(
        "--ray-count",
        type=int,
        metavar="N",
        help="rays of each kind (default: 1,000,000 on the CPU, 4,000,000 on CUDA; of a trace all)",
    )

    recorded = command("record-rays", RECORD)
    recorded.add_argument("scene", type=Path, metavar="SCENE")
    geometry_options(recorded)
    recorded.add_argument("--out", type=Path, required=True, metavar="TRACE", help="the file to write (.npz)")
    recorded.add_argument("--rays", default=RAYS_DEFAULT, metavar="KIND[,KIND]", help="default: %(default)s")
    recorded.add_argument("--ray-count", type=int, metavar="N", help="rays of each kind (default: 100,000)")
    recorded.add_argument(
        "--hits-of", metavar="TRACER", help="store what this tracer of `traversal` hits, such as off or reference"
    )
    recorded.add_argument("--triangles", type=Path, metavar="FILE", help="write the scene's triangles too (.npz)")

    checked = command("check-rays", CHECK)
    checked.add_argument("trace", type=Path, metavar="TRACE")
    checked.add_argument("--scene", type=Path, metavar="FILE", help="that it was recorded from")
    geometry_options(checked)

    compared = command("compare-hits", COMPARE)
    compared.add_argument("trace", type=Path, metavar="TRACE")
    compared.add_argument("--scene", type=Path, required=True, metavar="FILE")
    geometry_options(compared)
    compared.add_argument("--hits", type=Path, metavar="FILE", help="where the hits are (default: in TRACE)")
    compared.add_argument("--tracer", default="off", help="RayBatch's tracer (default: %(default)s)")
    compared.add_argument("--rays", metavar="KIND[,KIND]", help="default: all that are there")
    compared.add_argument("--ray-count", type=int, metavar="N", help="of each kind (default: all)")


def measured(options: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """The report that was asked for, and the same in words; raises `RayBatchError`."""
    for name in ("runs", "ray_count"):
        value = getattr(options, name, None)
        if value is not None and value < 1:
            raise UsageError(f"--{name.replace('_', '-')} {value} is not valid: it must be 1 or more")
    changes, resolution = parse_settings(options.set, options.preset)
    if resolution:
        raise UsageError(
            "--set resolution has no use here: the frame has about as many pixels as there are rays (--ray-count)"
        )
    if options.command == "traversal":
        return _traversal(options, changes)
    if changes and options.command != "record-rays":
        raise UsageError(f"--set and --preset have no use for {options.command}, which renders nothing")
    from benchmarking.rays import parse_ray_types
    from benchmarking.traces import text
    from benchmarking.traces.compare import check_trace, compare_hits
    from benchmarking.traces.record import RAY_COUNT, RecordRequest, record_trace

    if options.command == "check-rays":
        if options.device != "AUTO":
            raise UsageError("--device has no use for check-rays, which traces nothing")
        if options.scene is None and (options.grid != 1 or options.camera or options.up):
            raise UsageError("--grid, --camera and --up are of a scene: give --scene too")
        report = check_trace(options.trace, None if options.scene is None else _scene_of(options))
        return report, text.checked_text(report)
    types = parse_ray_types(options.rays) if options.rays else None
    if options.command == "compare-hits":
        report = compare_hits(
            options.trace,
            options.hits,
            _scene_of(options),
            options.device,
            options.tracer,
            types=types,
            ray_count=options.ray_count,
        )
        return report, text.compared_text(report)
    for path in (options.out, options.triangles):
        if path is not None and (path.suffix != ".npz" or path.resolve() == options.scene.resolve()):
            raise UsageError(f"{path} is no place for what is recorded: name a new file that ends in .npz")
    report = record_trace(
        RecordRequest(
            scene=_scene_of(options),
            out=options.out.absolute(),
            ray_types=types or [],
            device=options.device,
            ray_count=options.ray_count or RAY_COUNT,
            hits_of=options.hits_of,
            triangles=options.triangles and options.triangles.absolute(),
            settings=changes,
        )
    )
    return report, text.recorded_text(report)


def _scene_of(options: argparse.Namespace) -> Any:
    from benchmarking.scenes import SceneRequest

    return SceneRequest(options.scene, options.grid, options.camera, options.up)


def _traversal(options: argparse.Namespace, changes: dict[str, Any]) -> tuple[dict[str, Any], str]:
    from benchmarking.orders import parse_orders
    from benchmarking.rays import parse_ray_types
    from benchmarking.tables import traversal_text
    from benchmarking.tracers.rivals.registry import parse_rivals
    from benchmarking.traversal import TraversalRequest, measure_traversal, parse_threads
    from raybatch_addon.core.settings.settings import parse_setting

    types = parse_ray_types(options.rays or RAYS_DEFAULT) if options.rays or not options.rays_file else []
    traced = TraversalRequest(
        scene=_scene_of(options),
        device=options.device,
        tracers=[name.strip() for name in options.tracers.split(",") if name.strip()],
        rivals=parse_rivals(options.rival),
        ray_types=types,
        rays_file=options.rays_file,
        orders=parse_orders(options.orders),
        threads=parse_threads(options.threads),
        runs=options.runs,
        ray_count=options.ray_count,
        counters=not options.no_counters,
        nodes_resident={None: None, "resident": True, "paged": False}[options.nodes],
        budget=parse_setting("geometry_budget", options.budget),
        beyond=options.beyond,
        settings=changes,
    )
    report = measure_traversal(traced)
    return report, traversal_text(report)
