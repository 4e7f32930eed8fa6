"""Which render is in which of Blender's slots; operators that render into the next one, and show one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import bpy
from bpy.app.handlers import persistent

from ...blender import reports
from ...convergence.run_texts import error_line
from ...core.settings.settings import SETTINGS
from ..choices import value_text
from ..panel import may_render, register_all, unregister_all

RESULT = "Render Result"


@dataclass(frozen=True)
class SlotRender:
    """The render in a slot."""

    number: int  # of the render, in the order of time
    title: str
    settings: dict[str, Any]


_renders: dict[int, SlotRender] = {}  # by the slot's index
_count = 0


def slots() -> Any | None:
    """Blender's slots of render results; None where there are none yet."""
    image = bpy.data.images.get(RESULT)
    return image.render_slots if image is not None and len(image.render_slots) else None


def known_renders() -> list[tuple[int, SlotRender]]:
    """The slots with renders of this engine, by their index, the newest first."""
    there = slots()
    found = [item for item in _renders.items() if there is not None and item[0] < len(there)]
    return sorted(found, key=lambda item: -item[1].number)


def slot_title(report: reports.RenderReport) -> str:
    """Seconds, samples and error of a render, in a line."""
    statistics = next(iter(report.statistics.values()))
    parts = [f"{statistics['seconds']['total']:.1f} s", error_line(statistics), statistics["device"]["alias"]]
    return ", ".join(part for part in parts if part)


def unlike(settings: dict[str, Any], others: dict[str, Any]) -> list[str]:
    """Titles and values of the settings that differ, as `settings` has them."""
    return [
        f"{SETTINGS[name].title} {value_text(SETTINGS[name], value)}"
        for name, value in settings.items()
        if name in SETTINGS and name in others and others[name] != value
    ]


@persistent
def note_render(*_: object) -> None:
    """A render is over, or was cancelled: note what is in its slot."""
    global _count
    there, report = slots(), reports.last()
    if there is None:
        return
    index = there.active_index
    if report is None or report.errors or not report.statistics:
        _renders.pop(index, None)
        return
    statistics = next(iter(report.statistics.values()))
    if any(each.settings is statistics.get("settings") for each in _renders.values()):
        _renders.pop(index, None)  # another engine's render: the last report is of an older one
        return
    _count += 1
    _renders[index] = SlotRender(_count, slot_title(report), statistics.get("settings", {}))


@persistent
def forget_slots(*_: object) -> None:
    """Another file was opened: its slots are empty."""
    _renders.clear()


def next_slot() -> int | None:
    """The slot for the next render: the first one without a render, else that of the oldest; None: there are none."""
    there = slots()
    if there is None:
        return None
    free = [index for index in range(len(there)) if index not in _renders]
    return free[0] if free else min(_renders, key=lambda index: _renders[index].number)


def take_next_slot() -> None:
    """The next render goes there."""
    there, index = slots(), next_slot()
    if there is not None and index is not None:
        there.active_index = index


class RAYBATCH_OT_render_in_new_slot(bpy.types.Operator):
    """Render into the next slot, so that the last pictures stay and can be compared. The slots are also in the image
    editor, where J shows the next one
    """

    bl_idname = "raybatch.render_in_new_slot"
    bl_label = "Render into New Slot"

    @classmethod
    def poll(cls, context):
        return may_render(cls, context)

    def invoke(self, _context, _event):
        take_next_slot()
        bpy.ops.render.render("INVOKE_DEFAULT")
        return {"FINISHED"}

    def execute(self, _context):
        take_next_slot()
        return bpy.ops.render.render()


class RAYBATCH_OT_show_slot(bpy.types.Operator):
    """Show this render in image editors"""

    bl_idname = "raybatch.show_slot"
    bl_label = "Show Slot"
    bl_options = {"INTERNAL"}

    slot: bpy.props.IntProperty(name="Slot", min=0)

    def execute(self, context):
        there = slots()
        if there is None or self.slot >= len(there):
            self.report({"ERROR"}, f"there is no slot {self.slot + 1}")
            return {"CANCELLED"}
        there.active_index = self.slot
        for window in context.window_manager.windows:
            for area in window.screen.areas:
                if area.type in ("IMAGE_EDITOR", "PROPERTIES"):
                    area.tag_redraw()
        return {"FINISHED"}


def _ends() -> tuple[list, list]:
    """Blender's handlers at the end of a render: what was done of one that was cancelled is in its slot too."""
    return bpy.app.handlers.render_complete, bpy.app.handlers.render_cancel


_classes = (RAYBATCH_OT_render_in_new_slot, RAYBATCH_OT_show_slot)


def register() -> None:
    """Add the operators, and have renders noted."""
    register_all(_classes)
    for handlers in _ends():
        handlers.append(note_render)
    bpy.app.handlers.load_pre.append(forget_slots)


def unregister() -> None:
    """Remove them."""
    bpy.app.handlers.load_pre.remove(forget_slots)
    for handlers in _ends():
        handlers.remove(note_render)
    forget_slots()
    unregister_all(_classes)
