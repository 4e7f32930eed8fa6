#!/usr/bin/env python3
"""Measure RayBatch: whole renders, recording, viewports, animations, previews, and traversal alone. `benchmark.py
COMMAND --help` says how.
"""

from __future__ import annotations

import argparse
import functools
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarking.in_blender import commands as in_blender
from lib.command import UsageError, run_command
from lib.output import OutputFolders, leave, write_report
from rendering.request import RESOLUTION_DEFAULT, parse_settings

from raybatch_addon.core.settings.presets import PRESETS

RENDER_SAMPLES = 16
RENDER = """\
Measure whole renders of SCENE: a .blend (needs bpy), a .scene.npz or the geometry of an .npz (do not).

Runs of RayBatch and of Cycles alternate; medians are reported, with the spread (largest less smallest, over the
median). A whole render begins with the exported scene, and the tree is built anew each time. RayBatch's export from
Blender, and its first render, with compilation, are reported apart.

Cycles renders the same file on the same device, with the same samples, bounces and pixel filter, without adaptive
sampling, denoising, clamping or any other bias. Its time is that of the whole render call, its export included.

--equal-error: both engines are unbiased, so their error is noise. Each renders the picture twice more, with other
seeds and the samples of the timed runs. relMSE is half the squared difference of the two, divided by the pixel's
squared brightness (+ 0.01), cut at 10, and averaged over pixels and channels. Error and time are taken as inversely
proportional: what is compared is time x relMSE, and its inverse is reported as efficiency. Set-up counts as time, so
take samples enough that it does not matter; a few very bright samples can rule the figure, so take samples enough for
that too.

--samples 64,256: both counts are rendered in each run, and the line through their times gives what a sample takes and
what a render takes once (reading nothing from disk, but building trees, loading kernels, and whatever else an engine
does before and after). With --against cycles both engines are compared by the time of a sample, and by that time x
relMSE of the larger count. On a GPU Cycles is measured by OptiX and by CUDA, and the quicker is the peer; the report
says whether the device has ray-tracing cores, which only Cycles would use. The first render of each is reported apart.
With --against cycles on a GPU, where a first render may load kernels for longer than it samples, 64,256 is the default.
--resume leaves a scene out whose --json was made by the same command with the same code, so that a list of scenes goes
on where it was stopped.

--against memory: the same with --budgets of geometry on the device, beside all of it there (geometry_budget 0, batching
OFF). A budget is in bytes, or a share of what tree and triangles take in memory. Renders take turns; speed is that of a
render relative to the one in memory in the same turn, trees apart. --set and --preset hold for all of them. All films
are compared bit for bit; where one differs the report says so, and the exit code is 1. Stages are timed in renders of
their own, with counters (--no-counters leaves them out).
"""
RECORDING = """\
Measure what it costs to record a render of SCENE, a .blend (needs bpy), a .scene.npz or the geometry of an .npz (do
not).

It is rendered plain; recorded (a picture at 1, 2, 4, ... samples of every pixel, for which the render is cut into
rounds); and with error_estimate ON, in one round and recorded. Renders take turns. Times are of the processor, all
threads together (on CUDA: of rendering). The cost is the median over turns of what comes on top of the plain render's,
beside the two values between which half of the turns lie. Films are compared: where recording changes one the exit code
is 1.
"""
VIEWPORT = """\
Measure how soon a viewport shows an edit of SCENE, a .blend (needs bpy), a .scene.npz or the geometry of an .npz.

Edits of each kind are replayed through what renders viewports, without a window, while the picture before is still
being refined. Told is the time from an edit to the first picture that shows it, which has coarse pixels if need be; of
a .blend without Blender's own part. The first edit of a kind, which may load kernels, is reported apart.
"""
TRAVERSAL = """\
Measure how fast tracers find hits, all on the same rays of real paths.

FILE is geometry (.npz, arrays v, f and, if wanted, m), or a scene written by render.py --save-scene (.scene.npz). It is
rendered, in a frame of about as many pixels as rays of a kind are wanted, until there are enough rays of every kind, or
32 times as many camera rays: rays are taken in the order in which the integrator hands them to its tracer. Paths go no
farther than is asked for, and without Russian roulette. Where a scene has no light a sun is added, and where nothing
scatters light all becomes white.

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


def argument_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(prog="benchmark.py", description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)

    def command(name: str, description: str) -> argparse.ArgumentParser:
        added = commands.add_parser(
            name,
            help=description.splitlines()[0],
            description=description,
            allow_abbrev=False,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        added.add_argument("--device", default="AUTO", help="AUTO, cpu or cuda:N")
        added.add_argument(
            "--preset",
            metavar="NAME",
            help=f"set what a preset sets: {', '.join(PRESETS)}. --set then changes single settings of it",
        )
        added.add_argument(
            "--set",
            action="append",
            default=[],
            metavar="NAME=VALUE",
            help="change a render setting (may be repeated); render.py --help lists them",
        )
        added.add_argument(
            "--json",
            nargs="?",
            const="-",
            metavar="FILE",
            help="write the report as JSON; without FILE to standard output, and nothing else there",
        )
        added.add_argument(
            "--verbose", action="store_true", help="pass on what Blender and Warp print, to standard error"
        )
        return added

    def geometry_options(added: argparse.ArgumentParser) -> None:
        added.add_argument(
            "--grid",
            type=int,
            default=1,
            metavar="N",
            help="repeat the mesh N x N times as triangles of their own, seen from above",
        )
        added.add_argument(
            "--camera",
            metavar="EX,EY,EZ,TX,TY,TZ,FOV",
            help="of geometry: eye, target and field of view [degrees] (write --camera=-1,... for a negative first "
            "number); default: shows all of it",
        )
        added.add_argument("--up", choices=("y", "z"), help="of geometry: the axis that points up (default: z)")

    def whole_renders(name: str, description: str, samples: int, runs: int) -> argparse.ArgumentParser:
        added = command(name, description)
        added.add_argument("scene", type=Path, metavar="SCENE")
        geometry_options(added)
        added.add_argument(
            "--samples",
            type=sample_counts if name == "render" else int,
            default=None if name == "render" else samples,
            metavar="N[,N]" if name == "render" else "N",
            help=f"per pixel (default: {samples}"
            + ("; on a GPU --against cycles, without --equal-error: 64,256)" if name == "render" else ")"),
        )
        added.add_argument("--bounces", type=int, default=7, help="default: 7")
        added.add_argument(
            "--size",
            metavar="WxH",
            help=f"pixels; default: the file's; of geometry: {'x'.join(map(str, RESOLUTION_DEFAULT))}",
        )
        added.add_argument("--threads", type=int, default=0, help="of the CPU, for every engine; default: every core")
        added.add_argument("--runs", type=int, default=runs, help="timed runs (default: %(default)s)")
        return added

    render = whole_renders("render", RENDER, samples=RENDER_SAMPLES, runs=3)
    render.add_argument(
        "--against",
        choices=("cycles", "memory"),
        help="measure that engine, or all geometry in memory, beside RayBatch",
    )
    render.add_argument(
        "--budgets",
        metavar="BUDGET[,BUDGET]",
        help="with --against memory: geometry on the device at most, such as 1.5G,700M or 10%%,5%%",
    )
    render.add_argument(
        "--no-counters",
        action="store_true",
        help="with --against memory: leave out the time of stages, which costs a compilation and a render of each",
    )
    render.add_argument("--equal-error", action="store_true", help="compare at equal error too; see above")
    render.add_argument(
        "--resume",
        action="store_true",
        help="leave the scene out if --json holds the report of this very command, made by the same code",
    )
    render.add_argument("--picture", type=Path, metavar="FILE", help="save the picture as .png or .exr")

    whole_renders("recording", RECORDING, samples=64, runs=9)
    whole_renders("viewport", VIEWPORT, samples=64, runs=50)
    in_blender.add_commands(command)

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
        help="measure another scheme of tracing many rays too (may be repeated); docs/studies/rivals.md lists them",
    )
    traversal.add_argument(
        "--rays", default="primary,bounce1,bounce4,shadow1", metavar="KIND[,KIND]", help="default: %(default)s"
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
        "--nodes",
        choices=("resident", "paged"),
        help="with --budget: whether all nodes stay on the device (default: where they fit well)",
    )
    traversal.add_argument(
        "--ray-count",
        type=int,
        metavar="N",
        help="rays of each kind (default: 1,000,000 on the CPU, 4,000,000 on CUDA)",
    )
    return parser


def measured(options: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """The report that was asked for, and the same in words; raises `RayBatchError`."""
    if options.command in in_blender.NAMES:
        return in_blender.measured(options)
    from benchmarking.scenes import SceneRequest
    from benchmarking.tables import memory_text, recording_text, render_text, slopes_text, traversal_text, viewport_text

    counts: tuple[Any, int] = (getattr(options, "samples", None), 0)
    if options.command == "render":
        counts = options.samples or (RENDER_SAMPLES, 0)
    for name in ("runs", "ray_count", "samples"):
        value = counts[0] if name == "samples" else getattr(options, name, None)
        if value is not None and value < 1:
            raise UsageError(f"--{name.replace('_', '-')} {value} is not valid: it must be 1 or more")
    changes, resolution = parse_settings(options.set, options.preset)
    scene = SceneRequest(options.scene, options.grid, options.camera, options.up)
    if options.command in ("render", "recording", "viewport"):
        from benchmarking.recording import measure_recording
        from benchmarking.render import measure_render
        from benchmarking.whole_render import RenderRequest

        if options.size:
            resolution = parse_settings([f"resolution={options.size}"])[1]
        watched = RenderRequest(
            scene,
            device=options.device,
            samples=counts[0],
            bounces=options.bounces,
            threads=options.threads,
            runs=options.runs,
            size=resolution,
            settings=changes,
        )
        if options.command == "viewport":
            from benchmarking.viewport import measure_viewport

            report = measure_viewport(watched)
            return report, viewport_text(report)
        if options.command == "recording":
            if not options.samples > 1:
                raise UsageError(
                    f"--samples {options.samples} is not valid: it must be 2 or more, for a sample in either half"
                )
            report = measure_recording(watched)
            return report, recording_text(report)
        request = replace(
            watched,
            against=options.against,
            budgets=options.budgets,
            counters=not options.no_counters,
            equal_error=options.equal_error,
            picture=options.picture,
            samples_longer=counts[1],
            samples_given=options.samples is not None,
        )
        report = measure_render(request)
        text = slopes_text if "sample_counts" in report else memory_text if "memory" in report else render_text
        return report, text(report)

    from benchmarking.orders import parse_orders
    from benchmarking.rays import parse_ray_types
    from benchmarking.tracers.rivals.registry import parse_rivals
    from benchmarking.traversal import TraversalRequest, measure_traversal, parse_threads

    from raybatch_addon.core.settings.settings import parse_setting

    if resolution:
        raise UsageError(
            "--set resolution has no use here: the frame has about as many pixels as there are rays (--ray-count)"
        )
    traced = TraversalRequest(
        scene=scene,
        device=options.device,
        tracers=[name.strip() for name in options.tracers.split(",") if name.strip()],
        rivals=parse_rivals(options.rival),
        ray_types=parse_ray_types(options.rays),
        orders=parse_orders(options.orders),
        threads=parse_threads(options.threads),
        runs=options.runs,
        ray_count=options.ray_count,
        counters=not options.no_counters,
        nodes_resident={None: None, "resident": True, "paged": False}[options.nodes],
        budget=parse_setting("geometry_budget", options.budget),
        settings=changes,
    )
    report = measure_traversal(traced)
    return report, traversal_text(report)


def sample_counts(text: str) -> tuple[int, int]:
    """One or two counts, such as `16` or `64,256`; the second is 0 where there is one."""
    parts = [part.strip() for part in text.split(",")]
    if len(parts) > 2 or not all(part.lstrip("-").isdecimal() for part in parts):
        raise argparse.ArgumentTypeError(f"{text!r} is not valid: give one count of samples, or two such as 64,256")
    counts = [int(part) for part in parts]
    return counts[0], counts[1] if len(counts) == 2 else 0


def run(options: argparse.Namespace, folders: OutputFolders, standard_output: IO[str]) -> int:
    """The exit code; raises `RayBatchError`."""
    for target in (options.json if options.json != "-" else None, getattr(options, "picture", None)):
        if target:
            folders.prepare(Path(target).absolute())
    if options.command != "render":
        report, text = measured(options)
    else:
        asked = _asked(options)
        if options.resume and _is_done(options.json, asked):
            standard_output.write(f"{options.scene}: measured before, see {options.json}\n")
            return 0
        report, text = measured(options)
        report["asked"] = asked
    write_report(options.json, report, text, standard_output)
    if not report.get("films", {"equal": True})["equal"]:  # stands in the report, which is of use
        print(f"benchmark.py: error: films differ: {'; '.join(report['films']['differences'])}", file=sys.stderr)
        return 1
    return 0


def _asked(options: argparse.Namespace) -> dict[str, Any]:
    """What a report follows from: the command line, and the code."""
    from real_files.code import code_of

    apart = ("json", "resume", "picture", "verbose")
    return {
        "options": {name: str(value) for name, value in sorted(vars(options).items()) if name not in apart},
        "code": code_of("RAYBATCH"),
    }


def _is_done(json_file: str | None, asked: dict[str, Any]) -> bool:
    """Whether `json_file` holds the report of what is `asked`; raises `UsageError` where no file is named."""
    if json_file in (None, "-"):
        raise UsageError("--resume looks into the report of the time before: give --json FILE too")
    try:
        return json.loads(Path(json_file).read_text(encoding="utf-8")).get("asked") == asked
    except (OSError, ValueError):
        return False


def main(arguments: list[str] | None = None) -> int:
    """The exit code."""
    options = argument_parser().parse_args(arguments)
    return run_command("benchmark.py", options.verbose, functools.partial(run, options))


if __name__ == "__main__":
    leave(main())
