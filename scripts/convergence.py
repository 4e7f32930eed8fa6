#!/usr/bin/env python3
"""Show how the error of a render falls with its time, for settings beside each other. `convergence.py --help` says
how.
"""

from __future__ import annotations

import argparse
import functools
import shlex
import sys
from pathlib import Path
from typing import IO

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from lib.command import run_command
from lib.output import OutputFolders, leave, write_report, write_text
from rendering.request import RESOLUTION_DEFAULT, parse_settings

DESCRIPTION = """\
Render SCENE, a .blend (needs bpy), a .scene.npz or the geometry of an .npz (do not), several times with different
seeds, and report how the error falls with time: curves, their slope, the time to a target error, and efficiency.

--compare nee=ON,OFF    renders with each value, in turns; every combination where several settings are compared.
                        What is listed first is what the others are compared with. preset=AUTO,UNBATCHED
                        compares presets.
--against cycles        lets Cycles compete: renders at 1, 2, 4, ... samples, on the same device, without bias
--reference WHAT        what errors are measured against
    F.npz               a reference that --save-reference wrote, or a film of render.py --film
    raybatch            a render by RayBatch with another seed and many more samples (default)
    cycles              the same by Cycles, an implementation of its own; needs a .blend
    own                 each engine's own (default with --against cycles); how far the two are apart is reported
    halves              none: the error is estimated from two halves of each render, in which a bias is not seen
References that were made are kept for the next time, with their own noise, in the user's cache folder (or the folder
that the environment variable RAYBATCH_REFERENCES names).

Time is that of rendering alone, without trees and compilation; the report has the whole, too. docs/convergence.md says
how to read it all.
"""


def argument_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="convergence.py",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add = parser.add_argument
    add("scene", type=Path, metavar="SCENE")
    add("--compare", action="append", default=[], metavar="SETTING=A,B,C", help="settings to compare (may be repeated)")
    add("--against", choices=("cycles",), help="let that engine compete too; needs a .blend")
    add("--reference", metavar="WHAT", help="raybatch, cycles, own, halves, or a file; see above")
    add("--samples", type=int, metavar="N", help="per pixel of each run (default: 64, or what --seconds allows)")
    add("--seconds", type=float, metavar="S", help="of rendering of each run")
    add("--runs", type=int, default=3, metavar="N", help="of each setting, with different seeds (default: 3)")
    add(
        "--target",
        type=float,
        metavar="RELMSE",
        help="error whose time is reported (default: that of the first setting at its end)",
    )
    add(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="change a setting for all (may be repeated); render.py --help lists them",
    )
    add("--preset", metavar="NAME", help="set the whole schedule for all")
    add("--device", default=None, help="AUTO, cpu or cuda:N")
    add(
        "--size",
        metavar="WxH",
        help=f"pixels; default: the file's; of geometry: {'x'.join(map(str, RESOLUTION_DEFAULT))}",
    )
    add(
        "--camera",
        metavar="EX,EY,EZ,TX,TY,TZ,FOV",
        help="of geometry: eye, target and field of view [degrees] (write --camera=-1,... for a negative first number)",
    )
    add("--up", choices=("y", "z"), help="of geometry: the axis that points up (default: z)")
    add("--grid", type=int, default=1, metavar="N", help="of geometry: repeat it N x N times")
    add(
        "--reference-samples",
        type=int,
        metavar="N",
        help="of a reference that is made (default: 16 times those of a run)",
    )
    add("--new-reference", action="store_true", help="make the reference again though it is kept")
    add("--save-reference", type=Path, metavar="F.npz", help="write the reference that was made")
    add("--no-flip", action="store_true", help="leave FLIP out, which takes a while for large pictures")
    add(
        "--json",
        nargs="?",
        const="-",
        metavar="FILE",
        help="write the report as JSON; without FILE to standard output, and nothing else there",
    )
    add("--plot", type=Path, metavar="FILE", help="write the curves as .svg, .png or .pdf")
    add("--html", type=Path, metavar="FILE", help="write a page that stands alone: curves, figures, pictures, machine")
    add("--verbose", action="store_true", help="pass on what Blender and Warp print, to standard error")
    return parser


def request_from(options: argparse.Namespace):
    """The checked `ConvergenceRequest`; raises `RayBatchError`."""
    from benchmarking.scenes import SceneRequest
    from converging.request import ConvergenceRequest

    settings, resolution = parse_settings(options.set)
    if options.size:
        resolution = parse_settings([f"resolution={options.size}"])[1]
    device = options.device or settings.pop("device", "AUTO")
    settings.pop("device", None)
    return ConvergenceRequest(
        SceneRequest(options.scene, options.grid, options.camera, options.up),
        device=device,
        size=resolution,
        samples=options.samples,
        seconds=options.seconds,
        runs=options.runs,
        target=options.target,
        reference=options.reference,
        cycles=options.against == "cycles",
        reference_samples=options.reference_samples,
        new_reference=options.new_reference,
        save_reference=options.save_reference,
        flip=not options.no_flip,
        compare=tuple(options.compare),
        settings=settings,
        preset=options.preset,
    )


def run(options: argparse.Namespace, command: str, folders: OutputFolders, standard_output: IO[str]) -> int:
    """Measure, and write everything at the end; the exit code. Raises `RayBatchError`."""
    from converging.plots import require_plots, write_plot

    request = request_from(options)
    if options.plot or options.html:
        require_plots(options.plot)
    for target in (options.json if options.json != "-" else None, options.plot, options.html, options.save_reference):
        if target:
            folders.prepare(Path(target).absolute())

    from converging.json_report import json_report
    from converging.reference import write_reference
    from converging.study import measured
    from converging.summary import summarised, text_report

    if options.html:
        from converging.page import html_page  # before anything is measured, like all else that is needed behind it
    study = measured(request)
    summary = summarised(study, request.target)
    if options.html:
        page = html_page(summary, command)
    if options.save_reference:
        write_reference(options.save_reference.absolute(), study.opened, study.used[0])
    if options.plot:
        write_plot(options.plot.absolute(), summary)
    if options.html:
        write_text(options.html.absolute(), page)
    asked = {"command": command, "seconds": request.seconds, "runs": request.runs, "flip": study.flip_computed}
    write_report(options.json, json_report(summary, asked), text_report(summary), standard_output)
    return 0


def main(arguments: list[str] | None = None) -> int:
    """The exit code."""
    options = argument_parser().parse_args(arguments)
    command = shlex.join(["convergence.py", *(sys.argv[1:] if arguments is None else arguments)])
    return run_command("convergence.py", options.verbose, functools.partial(run, options, command))


if __name__ == "__main__":
    leave(main())
