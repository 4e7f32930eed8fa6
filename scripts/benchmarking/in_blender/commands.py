"""The sub-commands that measure through Blender: their command lines, and what they call."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lib.command import UsageError
from rendering.request import parse_settings

NAMES = ("animation", "previews")
ANIMATION = """\
Measure how an animation spends its time, and whether its memory grows (needs bpy).

Frames are rendered by Blender as one animation with Persistent Data, as by render.py --frames. Told are median and sum
of the seconds of a frame: of reading the scene (export), of building (tree and uploads), of rendering, of all of
RayBatch, of Blender's own evaluation, and of the frame as a whole, its file written; the share of the whole that export
and build have; and resident memory after each tenth of the frames. The first frame, which reads and builds everything
and may load kernels, is told apart: it is part of the sums, not of the medians.

Without BLEND a scene is made in which a ball of 5,000 triangles flies over a landscape. --size large: a million
triangles; small: 18,000, and a cloth that a modifier waves, for memory over very many frames.
"""
PREVIEWS = """\
Measure how long Blender waits for previews of a material, a world and a light (needs bpy).

Each is asked for as Blender's panels do, once for what has to be loaded, then with another color each time. Previews
are always rendered on the CPU.
"""


def add_commands(command: Callable[[str, str], argparse.ArgumentParser]) -> None:
    """Add the sub-commands, each made by `command` of name and description."""
    animation = command("animation", ANIMATION)
    animation.add_argument("scene", type=Path, nargs="?", metavar="BLEND", help="a .blend to be measured instead")
    animation.add_argument(
        "--size", choices=("large", "small"), default="large", help="of the scene that is made (default: large)"
    )
    animation.add_argument("--frames", type=int, default=100, metavar="N", help="default: 100")
    animation.add_argument("--samples", type=int, default=4, metavar="N", help="per pixel (default: 4)")
    animation.add_argument("--threads", type=int, default=0, help="of the CPU; default: every core")
    previews = command("previews", PREVIEWS)
    previews.add_argument("--runs", type=int, default=20, help="previews of each kind after the first (default: 20)")


def measured(options: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """The report that was asked for, and the same in words; raises `RayBatchError`."""
    for name in ("frames", "samples", "runs"):
        if getattr(options, name, 1) < 1:
            raise UsageError(f"--{name} {getattr(options, name)} is not valid: it must be 1 or more")
    settings, resolution = parse_settings(options.set, options.preset)
    if options.command == "previews" and (settings or resolution or options.device != "AUTO"):
        raise UsageError("previews have settings of their own: --device, --preset and --set have no use here")
    path = getattr(options, "scene", None)
    if path is not None and not (path.is_file() and path.suffix == ".blend"):
        raise UsageError(f"{path} cannot be measured: give a .blend that is there, or nothing for a scene that is made")
    try:
        import bpy  # noqa: F401
    except ImportError:
        raise UsageError(
            f"{options.command} needs Blender's Python module bpy, which cannot be imported here"
        ) from None
    from benchmarking.in_blender.tables import animation_text, previews_text

    if options.command == "previews":
        from benchmarking.in_blender.previews import measure_previews

        report = measure_previews(options.runs)
        return report, previews_text(report)
    from benchmarking.in_blender.animation import AnimationRequest, measure_animation

    report = measure_animation(
        AnimationRequest(
            path=path,
            size=options.size,
            frames=options.frames,
            samples=options.samples,
            device=options.device,
            threads=options.threads,
            resolution=resolution,
            settings=settings,
        )
    )
    return report, animation_text(report)
