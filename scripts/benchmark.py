#!/usr/bin/env python3
"""Measure RayBatch: whole renders, recording, viewports, animations, previews, and traversal alone, on rays that can
be kept in files. `benchmark.py COMMAND --help` says how.
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
from benchmarking.traces import commands as traces
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

--against devices: --device names several, such as ALL; the same with the first of them alone, with two, four, and so
on. Renders take turns, and speedup is that over one device in the same turn: of rendering, and of whole renders with
trees. Idle is the share of all devices' time of rendering in which they were not at a tile, most of it at the end. All
films are compared bit for bit. A device renders alone what is too small to be shared; the report has who took part.
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


def argument_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(prog="benchmark.py", description=" ".join(__doc__.split()))
    commands = parser.add_subparsers(dest="command", required=True)

    def command(name: str, description: str) -> argparse.ArgumentParser:
        added = commands.add_parser(
            name,
            help=" ".join(description.split()).partition(". ")[0].removesuffix(".") + ".",
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
        choices=("cycles", "memory", "devices"),
        help="measure that engine, all geometry in memory, or fewer devices, beside RayBatch",
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

    traces.add_commands(command, geometry_options)
    return parser


def measured(options: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """The report that was asked for, and the same in words; raises `RayBatchError`."""
    if options.command in in_blender.NAMES:
        return in_blender.measured(options)
    if options.command in traces.NAMES:
        return traces.measured(options)
    from benchmarking.scenes import SceneRequest
    from benchmarking.tables import devices_text, memory_text, recording_text, render_text, slopes_text, viewport_text

    counts: tuple[Any, int] = (getattr(options, "samples", None), 0)
    if options.command == "render":
        counts = options.samples or (RENDER_SAMPLES, 0)
    for name in ("runs", "samples"):
        value = counts[0] if name == "samples" else getattr(options, name, None)
        if value is not None and value < 1:
            raise UsageError(f"--{name.replace('_', '-')} {value} is not valid: it must be 1 or more")
    changes, resolution = parse_settings(options.set, options.preset)
    scene = SceneRequest(options.scene, options.grid, options.camera, options.up)
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
    texts = {"sample_counts": slopes_text, "memory": memory_text, "several": devices_text}
    text = next((each for key, each in texts.items() if key in report), render_text)
    return report, text(report)


def sample_counts(text: str) -> tuple[int, int]:
    """One or two counts, such as `16` or `64,256`; the second is 0 where there is one."""
    parts = [part.strip() for part in text.split(",")]
    if len(parts) > 2 or not all(part.lstrip("-").isdecimal() for part in parts):
        raise argparse.ArgumentTypeError(f"{text!r} is not valid: give one count of samples, or two such as 64,256")
    counts = [int(part) for part in parts]
    return counts[0], counts[1] if len(counts) == 2 else 0


def run(options: argparse.Namespace, folders: OutputFolders, standard_output: IO[str]) -> int:
    """The exit code; raises `RayBatchError`."""
    files = [getattr(options, name, None) for name in ("picture", "out", "triangles")]
    for target in (options.json if options.json != "-" else None, *files):
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
    if report.get("own_faults"):
        print(
            f"benchmark.py: error: {report['own_faults']} of RayBatch's own hits are wrong; see the report",
            file=sys.stderr,
        )
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
