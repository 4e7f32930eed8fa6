"""What every panel of the engine shares."""

from __future__ import annotations

ENGINE = "RAYBATCH"


class EnginePanel:
    """A panel of the Properties editor that is there while RayBatch is the engine."""

    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    COMPAT_ENGINES = {ENGINE}

    @classmethod
    def poll(cls, context):
        return context.engine in cls.COMPAT_ENGINES
