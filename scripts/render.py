#!/usr/bin/env python3
"""Render a scene file with RayBatch, without a window. `render.py --help` says how."""

from __future__ import annotations

import argparse
import contextlib
import functools
import sys
from pathlib import Path
from typing import IO

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from lib.held import HeldSignals

held = HeldSignals() if __name__ == "__main__" else None  # until all is imported

from lib.command import CommandParser, UsageError, run_command
from lib.output import OutputFolders, leave
from rendering.cluster import check_cluster, open_session, refuse_own_device
from rendering.request import (
    ARCHIVE,
    INTERVAL_DEFAULT,
    NPZ,
    PASS_NAMES,
    Request,
    kind_of,
    parse_frames,
    parse_heat_map,
    parse_pass,
    parse_sample,
    parse_seconds,
    parse_settings,
)

from raybatch_addon.core.scene.passes import COST_PASSES, MATTE_KINDS, MATTE_PASSES
from raybatch_addon.core.settings.presets import PRESETS
from raybatch_addon.core.settings.settings import SETTINGS

DESCRIPTION = """\
Render a scene file with RayBatch.

FILE is one of
  .blend              a Blender file: the same render as `blender -b FILE -E RAYBATCH -o OUT -f N`
  .obj .ply .gltf .glb  geometry, read by Blender's importers
  .npz                geometry as NumPy arrays v [n,3], f [k,3] and, if wanted, m [k]; needs no Blender
  .scene.npz          a scene written by --save-scene; needs no Blender, and gives the same film bit for bit

Geometry gets a default light (a sun and a pale blue sky), and a camera that shows all of it unless --camera is given.
Nothing is written to standard output but the statistics, for `--json -`. Progress and errors go to standard error.
The exit code is 0, or 1 with one line that says what was wrong (2: an option that there is not; 3: --strict
refuses to render; 130: stopped by Ctrl-C or SIGTERM, with statistics of what was done, and no picture).
"""
OUT_HELP = """\
where the picture goes. A name with a picture's extension (.png .exr .jpg .tif ...) is that file, in that format;
a run of # in it stands for the frame's number, and with --frames and no # the number comes before the extension.
Any other name is taken as Blender's own -o does: the frame's number (#### if there is no #) and the extension of
the file's output format are added, and // at the start is the .blend's folder. Folders are made as needed.
Without Blender (.npz, .scene.npz): .png, in sRGB without a view transform, or .exr, linear with every pass.
"""
STRICT_WEIGHTS, STRICT_ALONE = ("missing", "replaced", "setting"), "replaced"
SETTINGS_HELP = "\n".join(
    [
        "settings of --set (docs/tuning.md has more; bytes may end in K, M, G, T, of 1000, or in Ki, Mi, Gi, Ti, of "
        "1024):",
        *(f"  {info.name} ({info.range_text()}): {info.description}" for info in SETTINGS.values()),
        "presets:",
        *(f"  {name}: {preset.description}" for name, preset in PRESETS.items()),
    ]
)


def with_weight(arguments: list[str]) -> list[str]:
    """`arguments` with the weight that a `--strict` alone stands for, where FILE is what follows it."""
    following = [*arguments, ""][1:]
    return [
        f"{argument}={STRICT_ALONE}" if argument == "--strict" and after not in STRICT_WEIGHTS else argument
        for argument, after in zip(arguments, following, strict=True)
    ]


def argument_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = CommandParser(
        prog="render.py",
        description=DESCRIPTION,
        formatter_class=argparse.RawTextHelpFormatter,
        allow_abbrev=False,
        epilog=SETTINGS_HELP,
        settings=SETTINGS,
    )
    add = parser.add_argument
    add("file", nargs="?", type=Path, metavar="FILE", help="what to render")
    add("-o", "--out", metavar="OUT", help=OUT_HELP)
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--frame", type=int, metavar="N", help="the frame to render (default: the file's current one)")
    which.add_argument("--frames", metavar="A..B", help="the frames to render, both ends included, such as 1..24")
    add(
        "--view-layer",
        action="append",
        default=[],
        metavar="NAME",
        help="render this view layer only (may be repeated)",
    )
    add(
        "--multilayer",
        action="store_true",
        help="let -o be OpenEXR MultiLayer files: all passes of all view layers, as compositors take them (without\n"
        "it a .exr of a .blend has the picture alone, unless the file is set to MultiLayer)",
    )
    add(
        "--preset",
        metavar="NAME",
        help=f"{', '.join(PRESETS)}: set samples, noise, bounces and denoising, or the whole schedule (all that\n"
        "changes only how long a render takes, but for the device).\n"
        "--set then changes single settings of it",
    )
    add(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="change a setting (may be repeated); see below. resolution=160x120 sets the picture's size",
    )
    add(
        "--settings-from",
        choices=("cycles", "eevee"),
        help="take over that engine's settings of the .blend (samples, bounces, clamping, filter and others; eevee:\n"
        "also the materials' outputs for it), and report what changed. --preset and --set then change single settings",
    )
    add(
        "--strict",
        choices=STRICT_WEIGHTS,
        metavar="[missing|replaced|setting]",
        help="do not render what would lack something, and end with exit code 3: if a part is missing, if something\n"
        "else stands in for it (--strict alone), or if a setting of Cycles is not heard either",
    )
    add(
        "--device",
        metavar="DEVICE",
        help="AUTO, cpu, cuda:N, several with commas between, or ALL; the same as --set device=DEVICE",
    )
    add(
        "--cluster",
        metavar="ADDRESS",
        help="render on a Dask cluster: the address of its scheduler, as tcp://host:8786, or local:N for N workers on "
        "this\nmachine (docs/cluster.md)",
    )
    add(
        "--json",
        metavar="FILE",
        help="write statistics; - is standard output. An object, or a list when several frames or view layers are "
        "rendered",
    )
    add(
        "--passes",
        metavar="NAMES",
        help="passes to render beside those of the file, with commas between: "
        f"{', '.join(name for name in PASS_NAMES[1:] if name not in MATTE_PASSES)};\n"
        f"{', '.join(MATTE_KINDS)}, with 00 to 07 behind: two levels of Cryptomatte each.\n"
        f"{', '.join(COST_PASSES)} show what a pixel costs, as the mean over its samples, and make the render slower",
    )
    add(
        "--heat-map",
        action="append",
        default=[],
        metavar="PASS=FILE.png",
        help="write a picture of a pass that has one value a pixel, black where it is 0 and bright where it is "
        "largest\n"
        "(may be repeated; of the first view layer; frames are numbered as with -o)",
    )
    add(
        "--film",
        metavar="FILE.npz",
        help="write the linear passes: name -> float32 [height, width, channels], bottom row first.\n"
        "Passes of the second view layer on are called LAYER/PASS (of stereo LAYER/VIEW/PASS); frames are\n"
        "numbered as with -o",
    )
    add(
        "--checkpoint",
        metavar="FILE",
        help="keep the film in FILE while it is rendered, and go on from there if FILE is of the same scene and\n"
        "settings: after a stop (Ctrl-C, SIGTERM), a kill or a crash, or with a larger sample_count. The film is that\n"
        "of one render, bit for bit. Frames are numbered as with -o (docs/checkpoints.md)",
    )
    add(
        "--checkpoint-interval",
        metavar="SECONDS",
        help=f"how often FILE is written (default: {INTERVAL_DEFAULT:g}; less often where that would take more than a "
        "twentieth of the time)",
    )
    add(
        "--sample-first",
        metavar="N",
        help="render sample_count samples of each pixel from sample N on (default: 0). merge.py merges checkpoints of\n"
        "ranges that adjoin",
    )
    add(
        "--camera",
        metavar="EX,EY,EZ,TX,TY,TZ,FOV",
        help="for geometry: eye, target and field of view of the longer side [degrees],\nin the file's own coordinates "
        "(write --camera=-1,... when the first number is negative)",
    )
    add(
        "--up",
        choices=("y", "z"),
        help="for geometry: the axis that points up (default: z for .npz and .ply, y for .obj; glTF is y)",
    )
    add(
        "--save-scene",
        metavar="FILE.scene.npz",
        help="write the scene and its settings, to render elsewhere; alone, nothing is rendered",
    )
    add(
        "--prewarm",
        action="store_true",
        help="compile ahead what any scene can begin with, and stop; takes no FILE.\n"
        "The cache is that of the installed Blender extension, if there is one",
    )
    add("--verbose", action="store_true", help="pass on what Blender and Warp print, to standard error")
    return parser


def request_from(options: argparse.Namespace) -> Request:
    """The checked request; raises `RayBatchError`."""
    if options.file is None:
        raise UsageError("name the FILE to render (or --prewarm); --help says more")
    if not any(getattr(options, name) for name in ("out", "film", "json", "save_scene", "heat_map", "checkpoint")):
        raise UsageError(
            "nothing would be written: give at least one of -o, --film, --heat-map, --json, --checkpoint, --save-scene"
        )
    if options.multilayer and not options.out:
        raise UsageError("--multilayer says what file -o is: give -o FILE.exr too")
    if options.checkpoint_interval and not options.checkpoint:
        raise UsageError("--checkpoint-interval says how often a checkpoint is written: give --checkpoint FILE too")
    assignments = options.set + ([] if options.device is None else [f"device={options.device}"])
    if options.cluster:
        refuse_own_device(assignments)
    settings, resolution = parse_settings(assignments, options.preset)
    for name, option, ending in ((options.film, "--film", ".npz"), (options.save_scene, "--save-scene", ".scene.npz")):
        if name and not name.lower().endswith(ending):
            raise UsageError(f"{option} {name}: name it with the ending {ending}, by which it is known later")
    heat_maps = tuple(parse_heat_map(text) for text in options.heat_map)
    asked = {parse_pass(name) for name in (options.passes or "").split(",") if name.strip()} | {
        name for name, _ in heat_maps
    }
    frames = (options.frame,) if options.frame is not None else parse_frames(options.frames) if options.frames else None
    return Request(
        source=options.file,
        kind=kind_of(options.file),
        out=options.out,
        frames=frames,
        view_layers=tuple(options.view_layer),
        settings=settings,
        resolution=resolution,
        passes=tuple(name for name in PASS_NAMES if name in asked),
        film=options.film,
        heat_maps=heat_maps,
        json=options.json,
        save_scene=options.save_scene,
        checkpoint=options.checkpoint,
        checkpoint_interval=parse_seconds("--checkpoint-interval", options.checkpoint_interval, INTERVAL_DEFAULT),
        sample_first=parse_sample("--sample-first", options.sample_first),
        camera=options.camera,
        up=options.up,
        cluster=check_cluster(options.cluster) if options.cluster else "",
        multilayer=options.multilayer,
        settings_from=(options.settings_from or "").upper(),
        strict=(options.strict or "").upper(),
    )


def prewarm(device: str | None) -> None:
    """Compile ahead what any scene can begin with."""
    from raybatch_addon.blender.kernel_cache import kernel_cache_folder
    from raybatch_addon.core.device.kept_kernels import keep_or_fail
    from raybatch_addon.core.session import Session
    from raybatch_addon.core.settings.settings import RenderSettings

    keep_or_fail()
    folder = kernel_cache_folder()
    session = Session(settings=RenderSettings(device="AUTO" if device is None else device), cache_folder=folder)
    names = session.prewarm(
        on_progress=lambda done, total: print(f"compiled {done} of {total} modules", file=sys.stderr)
    )
    session.close()
    print(f"{len(names)} modules are ready in {folder}", file=sys.stderr)


def render(request: Request, folders: OutputFolders, standard_output) -> None:
    """Do what was asked; raises `RayBatchError`."""
    from rendering.progress import ProgressBar

    for target in (request.json if request.json != "-" else None, request.save_scene):
        if target:
            folders.prepare(Path(target).absolute())
    if not request.source.is_file():
        raise UsageError(f"there is no file {request.source}")
    with contextlib.ExitStack() as stack:
        opened = None
        if request.cluster and request.renders:
            opened = functools.partial(open_session, stack, request.cluster)
        if request.kind in (ARCHIVE, NPZ):
            from rendering.standalone import render_standalone

            render_standalone(request, folders, ProgressBar(), standard_output, opened)
        else:
            _render_by_blender(request, folders, standard_output, opened)


def _render_by_blender(request: Request, folders: OutputFolders, standard_output, opened) -> None:
    """The same by Blender's module; what `opened` returns for its settings, if it is given, renders instead of this
    process.
    """
    from rendering.progress import ProgressBar

    with HeldSignals():
        try:
            import bpy  # noqa: F401
        except ImportError:
            raise UsageError(
                f"{request.source} needs Blender's Python module bpy, which cannot be imported here; .npz and "
                ".scene.npz do without"
            ) from None
        from rendering.blender import BlenderRender

        from raybatch_addon.blender import sessions

    try:
        BlenderRender(request, folders, ProgressBar(), standard_output, opened).run()
    finally:
        sessions.instead = None


def run(options: argparse.Namespace, folders: OutputFolders, standard_output: IO[str]) -> int:
    """The exit code; raises `RayBatchError`."""
    if held is not None:
        held.release()
    if options.prewarm:
        if options.file is not None:
            raise UsageError("--prewarm takes no FILE: it compiles what any scene can begin with")
        prewarm(options.device)
    else:
        render(request_from(options), folders, standard_output)
    return 0


def main(arguments: list[str] | None = None) -> int:
    """The exit code."""
    options = argument_parser().parse_args(with_weight(sys.argv[1:] if arguments is None else arguments))
    return run_command("render.py", options.verbose, functools.partial(run, options))


if __name__ == "__main__":
    leave(main())
