"""Base of every panel of the engine, text broken into lines that fit, and how parts of the interface are added."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import ModuleType

import blf
import bpy

ENGINE = "RAYBATCH"
LATER = 1  # `bl_order` of panels behind those that come without one, as Simplify
# Sizes in Blender's interface, at scale 1 [pixels]
_LETTER_POINTS = 11
ICON_WIDTH = 20
# What a panel, and a box in it, keep free beside their text
_PANEL_MARGIN, _BOX_MARGIN = 48, 18
_LEAST_WIDTH = 60
# What a panel keeps free beside a name and its value, and the value's share of the rest
_SPLIT_MARGIN, VALUE_SHARE = 44, 0.6


class EnginePanel:
    """A panel of the Properties editor that is there while RayBatch is the engine."""

    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    COMPAT_ENGINES = {ENGINE}

    @classmethod
    def poll(cls, context):
        return context.engine in cls.COMPAT_ENGINES


class WorldPanel(EnginePanel):
    """A closed panel of the world's tab, where there is a world."""

    bl_context = "world"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return super().poll(context) and context.world is not None


def is_engine(context: bpy.types.Context) -> bool:
    """Whether RayBatch is the engine of the scene that is shown."""
    return context.scene is not None and context.engine == ENGINE


def may_render(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Whether `operator` may begin a render: RayBatch is the engine, and no render is under way, which its button says
    when it is pointed at.
    """
    if not is_engine(context):
        return False
    if bpy.app.is_job_running("RENDER"):
        operator.poll_message_set("A render is under way")
        return False
    return True


def split_layout(layout, animated: bool = False):
    """`layout` with names on the left and values on the right; `animated`: with the dots of keys."""
    layout.use_property_split = True
    layout.use_property_decorate = animated
    return layout


def choice_text(owner: bpy.types.bpy_struct, name: str) -> str:
    """What the enumeration `name` of `owner` is set to, as panels show it."""
    return bpy.types.UILayout.enum_item_name(owner, name, getattr(owner, name))


def register_all(parts: Sequence[type | ModuleType]) -> None:
    """Add `parts` in their order: classes of Blender's types, and modules by their own `register`."""
    for part in parts:
        if isinstance(part, ModuleType):
            part.register()
        else:
            bpy.utils.register_class(part)


def unregister_all(parts: Sequence[type | ModuleType]) -> None:
    """Remove what `register_all` added, the last first."""
    for part in reversed(parts):
        if isinstance(part, ModuleType):
            part.unregister()
        else:
            bpy.utils.unregister_class(part)


def label_width(text: str) -> float:
    """How wide Blender's interface shows `text`, at scale 1 [pixels]."""
    blf.size(0, _LETTER_POINTS)
    return blf.dimensions(0, text)[0]


def fitting_lines(text: str, width: float, width_of: Callable[[str], float] = label_width) -> list[str]:
    """`text` in lines that are at most `width` wide; a word that is wider is broken. There is one line at least."""
    lines, line = [], ""
    for word in text.split():
        longer = f"{line} {word}" if line else word
        if width_of(longer) <= width:
            line = longer
            continue
        if line:
            lines.append(line)
        while width_of(word) > width and len(word) > 1:
            fitting = next((end for end in range(len(word) - 1, 1, -1) if width_of(word[:end]) <= width), 1)
            lines.append(word[:fitting])
            word = word[fitting:]
        line = word
    return [*lines, line] if line or not lines else lines


def free_width(context, in_box: bool = False) -> float:
    """What is left for text in a panel, at scale 1 [pixels]."""
    width = context.region.width / context.preferences.system.ui_scale - _PANEL_MARGIN
    return max(_LEAST_WIDTH, width - (_BOX_MARGIN if in_box else 0))


def value_width(context) -> float:
    """What a value has beside its name in a panel, at scale 1 [pixels]."""
    width = context.region.width / context.preferences.system.ui_scale - _SPLIT_MARGIN
    return max(_LEAST_WIDTH, VALUE_SHARE * width)


def draw_below_name(layout, owner: bpy.types.bpy_struct, name: str, text: str) -> None:
    """A dropdown below its name `text`, where its choices are too long for a place beside names."""
    column = layout.column(align=True)
    column.use_property_split = False
    column.label(text=text)
    column.prop(owner, name, text="")


def draw_lines(layout, context, texts: list[str], icon: str = "NONE", in_box: bool = False) -> None:
    """Labels with `texts`, broken into lines where the panel ends, or its box; `icon` stands before the first line of
    each.
    """
    width = free_width(context, in_box) - (ICON_WIDTH if icon != "NONE" else 0)
    column = layout.column(align=True)
    column.scale_y = 0.8
    for text in texts:
        for i, line in enumerate(fitting_lines(text, width)):
            column.label(text=line, icon=icon if i == 0 or icon == "NONE" else "BLANK1")


def draw_why(layout, context, why: str) -> None:
    """Why what stands above is grey, grey as well; nothing where there is no reason."""
    if why:
        part = layout.column()
        part.active = False
        draw_lines(part, context, [why], "INFO")


def draw_box(layout, context, text: str, icon: str = "INFO", alert: bool = False) -> None:
    """A box with one text, in lines."""
    box = layout.box()
    box.alert = alert
    draw_lines(box, context, [text], icon, in_box=True)
