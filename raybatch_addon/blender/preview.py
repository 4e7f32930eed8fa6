"""Previews of materials, worlds and lights: small renders that Blender asks for while somebody looks at its panels."""

from __future__ import annotations

import sys
import traceback

import bpy

from ..core.errors import RayBatchError
from ..core.settings.settings import RenderSettings
from ..export.meshes.kept_meshes import aside
from ..export.scene import export_scene, reading
from ..export.settings import exposure_of
from . import finals
from .result import ResultWriter
from .sessions import preview_session

# The general kernels of CPUs come with RayBatch, so that no preview waits for a compiler; nor does it take memory of a
# GPU, or wait for one. Few samples: somebody turns a slider meanwhile.
PREVIEW_SETTINGS = RenderSettings(
    device="cpu", kernel_tier="GENERAL", batching="OFF", sample_count=128, time_limit=0.5, bounce_max=8, denoise="OFF"
)


def render_preview(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> None:
    """Render Blender's scene of a preview into the engine's result. No report of a render is made, and no error gets
    further: Blender would show a list of errors for a list of materials.
    """
    try:
        with finals.under_way():
            _render(engine, depsgraph)
    except RayBatchError as error:
        print(f"RayBatch: no preview: {' '.join(str(error).split())}", file=sys.stderr)
    except Exception:
        traceback.print_exc(file=sys.stderr)


def _render(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> None:
    def is_stopped() -> bool:
        return engine.test_break() or finals.have_to_end()

    with reading, aside():
        scene = export_scene(depsgraph, cancelled=is_stopped)
    if scene is None:
        return
    writer = ResultWriter(
        engine, depsgraph.view_layer.name, scene.frame.region[:2], exposure=exposure_of(depsgraph.scene)
    )
    with preview_session(PREVIEW_SETTINGS, is_stopped) as session:
        if session is not None:
            session.render(scene, PREVIEW_SETTINGS, on_tile=writer.write, cancelled=is_stopped)
