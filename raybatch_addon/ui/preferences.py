"""The add-on's preferences: the general kernels, and the cluster."""

from __future__ import annotations

import bpy

from ..blender import general_kernels, warm_up
from .panel import ENGINE, register_all, unregister_all

PACKAGE = __package__.rpartition(".")[0]


class RAYBATCH_OT_compile_general_kernels(bpy.types.Operator):
    """Compiles the general kernels."""

    bl_idname = "raybatch.compile_general_kernels"
    bl_label = "Compile General Kernels"
    bl_description = (
        "Compile the general kernels in the background, two or three minutes of one processor and longer for a GPU: "
        "any scene can begin with them"
    )
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, _context):
        return not general_kernels.is_compiling()

    def execute(self, _context):
        _compile()
        return {"FINISHED"}


class RayBatchPreferences(bpy.types.AddonPreferences):
    """Shown where add-ons are enabled."""

    bl_idname = PACKAGE

    cluster_address: bpy.props.StringProperty(
        name="Scheduler",
        description="The Dask cluster that Render on Cluster uses: the address of its scheduler, as tcp://host:8786, "
        "or local:2 for two workers on this computer",
    )
    cluster_script: bpy.props.StringProperty(
        name="render.py",
        description="The command line that renders there: scripts/render.py of a folder with RayBatch's sources",
        subtype="FILE_PATH",
    )
    cluster_python: bpy.props.StringProperty(
        name="Python",
        description="What runs it: a Python with Blender's module bpy and with Dask. Nothing: that of the environment "
        ".venv in the same folder, which `make environment` makes",
        subtype="FILE_PATH",
    )

    def draw(self, _context):
        column = self.layout.column()
        column.label(text=f"General kernels: {general_kernels.state()}")
        column.operator(RAYBATCH_OT_compile_general_kernels.bl_idname)
        column.separator()
        column.label(text="Render on Cluster")
        for name in ("cluster_address", "cluster_script", "cluster_python"):
            column.prop(self, name)


def own_preferences() -> RayBatchPreferences | None:
    """Those of the add-on; None where it is registered without being enabled, as scripts do."""
    addon = bpy.context.preferences.addons.get(PACKAGE)
    return None if addon is None else addon.preferences


_classes = (RAYBATCH_OT_compile_general_kernels, RayBatchPreferences)


def register() -> None:
    """Add the preferences. What a first render needs is made while Blender evaluates its scene; where there is a
    window, once a scene is RayBatch's, and general kernels are compiled once the window is there.
    """
    register_all(_classes)
    bpy.app.handlers.render_init.append(_before_render)
    if not bpy.app.background and not bpy.app.module:
        bpy.app.timers.register(_compile, first_interval=1.0, persistent=True)
        bpy.app.timers.register(_warm_up, first_interval=1.0, persistent=True)


def unregister() -> None:
    """Remove them, and end what still compiles."""
    if _before_render in bpy.app.handlers.render_init:
        bpy.app.handlers.render_init.remove(_before_render)
    for timer in (_compile, _look, _warm_up):
        if bpy.app.timers.is_registered(timer):
            bpy.app.timers.unregister(timer)
    general_kernels.stop()
    warm_up.finish_warm_up()
    unregister_all(_classes)


def _compile() -> None:
    general_kernels.start()
    if not bpy.app.timers.is_registered(_look):
        bpy.app.timers.register(_look, first_interval=1.0, persistent=True)


def _warm_up() -> float | None:
    """Begin once a scene is RayBatch's; the seconds until the next look."""
    if all(scene.render.engine != ENGINE for scene in bpy.data.scenes):
        return 1.0
    warm_up.warm_up()
    return None


@bpy.app.handlers.persistent
def _before_render(scene: bpy.types.Scene, *_: object) -> None:
    """A render of `scene` was asked for: Blender evaluates the scene next, and leaves Python to others meanwhile."""
    if scene.render.engine == ENGINE:
        warm_up.warm_up()


def _look() -> float | None:
    """Show how far they are; the seconds until the next look."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "PREFERENCES":
                area.tag_redraw()
    return 1.0 if general_kernels.is_compiling() else None
