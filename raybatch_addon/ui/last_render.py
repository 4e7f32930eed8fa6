"""Panel of the last render: errors, warnings, how long it took and what its rays cost."""

from __future__ import annotations

import os
from typing import Any

import bpy

from ..blender import reports
from ..convergence.run_texts import error_line
from ..core.measure.parts import PARTS
from .panel import LATER, EnginePanel, draw_box, draw_lines


class RAYBATCH_RENDER_PT_last_render(EnginePanel, bpy.types.Panel):
    """Errors and warnings of the last render."""

    bl_label = "Last Render"
    bl_order = LATER

    @classmethod
    def poll(cls, context):
        return super().poll(context) and reports.last() is not None

    def draw_header(self, _context):
        report = reports.last()
        assert report is not None  # as `poll` found
        if report.errors or report.warnings:
            self.layout.label(text="", icon="ERROR" if report.errors else "INFO")

    def draw(self, context):
        report = reports.last()
        assert report is not None  # as `poll` found
        draw_lines(self.layout, context, [f"{report.scene}, frame {report.frame}", *report_lines(report)])
        for icon, texts in (("ERROR", report.errors), ("INFO", report.warnings)):
            for text in texts:
                draw_box(self.layout, context, text, icon)
        if report.errors or report.warnings:
            return
        if report.statistics:
            self.layout.label(text="No warnings", icon="CHECKMARK")
        else:
            is_rendered = bpy.app.is_job_running("RENDER")
            self.layout.label(text="Being rendered" if is_rendered else "No picture was finished", icon="SORTTIME")


def report_lines(report: reports.RenderReport) -> list[str]:
    """Lines about each view layer: device, seconds and their parts, rays a second, samples and error, which kernels
    rendered, its tree, what was counted, samples that had to be repaired.
    """
    lines = []
    for name, statistics in report.statistics.items():
        seconds = statistics["seconds"]
        rays = statistics["rays"]["total"] / seconds["render"] / 1e6 if seconds.get("render") else 0.0
        parts = [
            f"{name}: {seconds['total']:.2f} s on {statistics['device']['alias']}",
            f"{rays:.2f} Mrays/s",
            error_line(statistics),
        ]
        lines.append(", ".join(part for part in parts if part))
        lines += [_parts_line(seconds), _kernels_line(statistics["kernels"])]
        lines += (
            _tree_lines(statistics.get("tree"))
            + _batching_lines(statistics.get("batching"))
            + _counter_lines(statistics.get("counters"))
            + _checkpoint_lines(statistics.get("checkpoint"))
        )
        if statistics["invalid_samples"]:
            lines.append(f"{name}: {statistics['invalid_samples']:,} samples were not finite and count as black")
    return lines


def _checkpoint_lines(checkpoint: dict[str, Any] | None) -> list[str]:
    """What was there of the film before the render, and where the film is kept."""
    if checkpoint is None:
        return []
    before = f"went on from {checkpoint['samples_before']:.5g} samples; " if checkpoint["samples_before"] else ""
    size = f", {checkpoint['bytes'] / 1e6:.1f} MB" if checkpoint["bytes"] else ""
    return [f"Checkpoint: {before}{os.path.basename(checkpoint['file'])}{size}"]


def _parts_line(seconds: dict[str, float]) -> str:
    """The parts of the time that a reader would miss if they were not named: a hundredth of it or more."""
    named = [part for part in PARTS if seconds.get(part, 0.0) >= max(seconds["total"] / 100, 0.005)]
    return "Seconds: " + ", ".join(f"{part} {seconds[part]:.2f}" for part in named)


def _kernels_line(kernels: dict[str, Any]) -> str:
    """Which kernels rendered, and why these."""
    if (after := kernels["specialised_after"]) is not None:
        return f"Kernels: general ones, and after {after:.1f} s specialised ones"
    after = "; specialised ones are compiled for the next render" if kernels["compiled_for_next"] else ""
    return f"Kernels: {kernels['tier'].lower()} ones; {kernels['why']}{after}"


def _tree_lines(tree: dict[str, Any] | None) -> list[str]:
    """How large the tree is, and what was done for it; nothing of Warp's."""
    if tree is None:
        return []
    if "pages" in tree:  # beyond memory
        written = "found again" if tree["reused"] else f"written in {tree['seconds']:.2f} s"
        return [
            f"Tree: {_short(tree['triangles'])} triangles, {tree['bytes'] / 1e6:.1f} MB in {tree['pages']:,} pages, "
            f"{written}"
        ]
    done = [f"{tree[what]} {what}" for what in ("built", "refitted") if tree[what]]
    if len(done) == 1 and tree["trees"] == 1:
        done = [done[0].removeprefix("1 ")]
    work = f"{', '.join(done)} in {tree['seconds']:.2f} s" if done else "kept"
    return [
        f"Tree: {_short(tree['triangles'])} triangles, {_short(tree['nodes'])} nodes, {tree['bytes'] / 1e6:.1f} MB, "
        f"{work}"
    ]


def _batching_lines(batching: dict[str, Any] | None) -> list[str]:
    """How often rays waited, and what was copied for them; nothing where nothing batched."""
    if batching is None:
        return []
    lines = [
        f"Batched: {batching['treelet_visits_per_ray']:.1f} treelets, {batching['rays_queued_per_ray']:.1f} times "
        "queued a ray"
    ]
    if batching["blocks_short"]:
        lines.append(
            f"The {_short(batching['block_count'])} blocks of queues ran out {_short(batching['blocks_short'])} times"
        )
    if batching["pages_loaded"]:
        copied = f"{_short(batching['pages_loaded'])} pages, {batching['bytes_copied'] / 1e9:.2f} GB"
        lines.append(
            f"Geometry on the device {batching['resident_peak'] / 1e6:,.0f} MB at most; brought there: {copied}"
        )
    return lines


def _counter_lines(counters: dict[str, Any] | None) -> list[str]:
    """Work of a ray, and the shares of the stages in the time; nothing without counters."""
    if counters is None:
        return []
    lines = []
    rays = _total(counters["rays"])
    if rays and isinstance(counters["node_steps"], dict):
        steps, tests = (_total(counters[name]) / rays for name in ("node_steps", "triangle_tests"))
        lines.append(f"{steps:.1f} node steps, {tests:.1f} triangle tests a ray")
    seconds = counters["seconds"]
    stages = sorted((stage for stage in seconds if seconds[stage] > 0), key=lambda stage: -seconds[stage])
    shares = {stage: round(100 * seconds[stage] / sum(seconds.values())) for stage in stages}
    if shares:
        lines.append("Time: " + ", ".join(f"{stage} {share} %" for stage, share in shares.items() if share))
    return lines


def _total(by_kind: dict[str, list[int]]) -> int:
    return sum(sum(by_bounce) for by_bounce in by_kind.values())


def _short(number: int) -> str:
    """`number` with two or three digits."""
    if number < 10_000:
        return f"{number:,}"
    scaled, letter = (number / 1e6, "M") if number >= 1e6 else (number / 1e3, "k")
    return f"{scaled:,.{0 if scaled >= 100 else 1}f} {letter}"


@bpy.app.handlers.persistent
def _show_at_end(*_) -> None:
    # the end of a render alone does not make Blender draw the Properties editor again
    for manager in bpy.data.window_managers:
        for window in manager.windows:
            for area in window.screen.areas:
                if area.type == "PROPERTIES":
                    area.tag_redraw()


def register() -> None:
    """Add the panel."""
    bpy.utils.register_class(RAYBATCH_RENDER_PT_last_render)
    for handlers in (bpy.app.handlers.render_complete, bpy.app.handlers.render_cancel):
        handlers.append(_show_at_end)


def unregister() -> None:
    """Remove the panel."""
    for handlers in (bpy.app.handlers.render_complete, bpy.app.handlers.render_cancel):
        handlers.remove(_show_at_end)
    bpy.utils.unregister_class(RAYBATCH_RENDER_PT_last_render)
