"""The panel Tune: the button, and a table of what was tried."""

from __future__ import annotations

import sys
from typing import Any

import bpy

from ...core.settings.settings import SETTINGS
from ..choices import short_text
from ..panel import LATER, EnginePanel, draw_lines
from .operators import RAYBATCH_OT_take_fastest, RAYBATCH_OT_tune


class RAYBATCH_RENDER_PT_tune(EnginePanel, bpy.types.Panel):
    """The fastest way to render this scene on this computer, by trial."""

    bl_label = "Tune"
    bl_parent_id = "RAYBATCH_RENDER_PT_performance"
    bl_order = LATER

    def draw(self, context):
        layout = self.layout
        layout.operator(RAYBATCH_OT_tune.bl_idname, text="Try What Is Fastest", icon="TIME")
        # brought in by the first render: drawing does not wait for the core
        tuning = sys.modules.get(f"{__package__.rpartition('.ui')[0]}.blender.tuning")
        found = tuning.last_tuned() if tuning is not None else None
        if found is None or found.scene != context.scene.name or not found.tuning.trials:
            return
        table = layout.column(align=True)
        for words in table_rows(found.tuning):
            row = table.split(factor=0.68)
            row.label(text=words[0], icon="CHECKMARK" if words[2] else "BLANK1")
            row.label(text=words[1])
        draw_lines(layout, context, notes(found.tuning))
        best = found.tuning.best
        if best is not None and best.changes and found.tuning.ended:
            layout.operator(RAYBATCH_OT_take_fastest.bl_idname, icon="CHECKMARK")


def change_text(changes: dict[str, Any]) -> str:
    """What is different, in few words: what was changed last."""
    if not changes:
        return "As set"
    name, value = list(changes.items())[-1]
    return f"{SETTINGS[name].label}: {short_text(SETTINGS[name], value)}"


def time_text(seconds: float) -> str:
    """A time of some digits."""
    return f"{seconds:.2f} s" if seconds >= 1 else f"{seconds * 1e3:.3g} ms"


def table_rows(tuning) -> list[tuple[str, str, bool]]:
    """What was tried, how long a sample took, and whether it is the best."""
    best = tuning.best
    return [
        (change_text(each.changes), time_text(each.seconds) if each.seconds is not None else _why(each), each is best)
        for each in tuning.trials
    ]


def _why(trial) -> str:
    return "slower" if trial.why == "slower" else "failed"


def notes(tuning) -> list[str]:
    """What is to know about the table."""
    count = f"{tuning.samples} sample{'s' if tuning.samples != 1 else ''}"
    lines = [
        f"Time of a sample of every pixel, from {count} by {tuning.tier.lower()} kernels. Rows build on the best above."
    ]
    differing = [each for each in tuning.trials if each.same_bits is False]
    if differing:
        lines.append(f"Not the same bits: {change_text(differing[0].changes)}. This is a fault of RayBatch: tell it")
    lines += [f"{change_text(each.changes)}: {each.why}" for each in tuning.trials if each.why not in ("", "slower")]
    if not tuning.ended:
        return [*lines, "It was stopped before all was tried."]
    if tuning.best is not None and not tuning.best.changes:
        lines.append("The settings are the fastest already.")
    return lines


def register() -> None:
    """Add the panel."""
    bpy.utils.register_class(RAYBATCH_RENDER_PT_tune)


def unregister() -> None:
    """Remove the panel."""
    bpy.utils.unregister_class(RAYBATCH_RENDER_PT_tune)
