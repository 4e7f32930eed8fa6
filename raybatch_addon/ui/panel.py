"""Base of every panel of the engine, and text broken into its lines."""

from __future__ import annotations

import textwrap

ENGINE = "RAYBATCH"
# Mean width of a letter of Blender's interface [pixels at scale 1], for breaking lines
_LETTER_WIDTH = 6.5


class EnginePanel:
    """A panel of the Properties editor that is there while RayBatch is the engine."""

    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    COMPAT_ENGINES = {ENGINE}

    @classmethod
    def poll(cls, context):
        return context.engine in cls.COMPAT_ENGINES


def draw_lines(layout, context, texts: list[str], icon: str = "NONE") -> None:
    """Labels with `texts`, broken into lines where the panel ends; `icon` stands before the first line of each."""
    letters = max(20, int(context.region.width / (_LETTER_WIDTH * context.preferences.system.ui_scale)))
    column = layout.column(align=True)
    for text in texts:
        for i, line in enumerate(textwrap.wrap(text, letters) or [""]):
            column.label(text=line, icon=icon if i == 0 or icon == "NONE" else "BLANK1")
