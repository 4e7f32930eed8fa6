"""Reports as a person reads them."""

from __future__ import annotations

from typing import Any

from benchmarking.in_blender.animation import FRAME_PARTS
from benchmarking.tables import table

_NAMES = {
    "export": "reading the scene",
    "build": "building: tree, uploads",
    "render": "rendering",
    "raybatch": "all of RayBatch",
    "evaluation": "Blender's evaluation",
    "whole": "the frame, its file written",
}


def animation_text(report: dict[str, Any]) -> str:
    """The report of `benchmark.py animation`."""
    size, times = report["frame"], report["seconds"]
    rows = [
        [
            _NAMES[part],
            "",
            f"{report['first_frame'][part]:.3f}",
            f"{times[part]['median']:.4f}",
            f"{times[part]['sum']:.2f}",
        ]
        for part in FRAME_PARTS
    ]
    trees = report["trees"]
    return "\n".join(
        [
            f"{report['scene']}: {report['frames']} frames, {report['triangles']:,} triangles, "
            f"on {report['device']['name']}",
            f"{size['width']} x {size['height']} pixels, {report['samples_per_pixel']} samples a pixel, Persistent "
            "Data",
            "",
            table(["seconds", "", "first frame", "median of the others", "sum"], rows),
            f"export and build: {report['export_and_build_share']:.1%} of the time of all frames, "
            f"{report['export_and_build_share_after_first']:.1%} without the first",
            f"after the first frame {trees['built']} trees were built, {trees['refitted']} refitted",
            "resident memory [MiB] after frames: "
            + ", ".join(f"{each['after_frames']}: {each['mib']:,.1f}" for each in report["resident"]),
        ]
    )


def previews_text(report: dict[str, Any]) -> str:
    """The report of `benchmark.py previews`."""
    rows = [
        [each["of"], "x".join(map(str, each["pixels"])), *(f"{each[name]:.3f}" for name in ("first", "median", "most"))]
        for each in report["previews"]
    ]
    bound = "within" if report["within_bound"] else "BEYOND"
    return "\n".join(
        [
            f"previews on {report['device']}: {report['samples_per_pixel']} samples a pixel, "
            f"{report['time_limit_seconds']:g} s of sampling at most",
            table(["seconds", "pixels", "first", "median", "most"], rows),
            f"warm previews are {bound} {report['bound_seconds']:g} s",
        ]
    )
