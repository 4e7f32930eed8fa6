"""The evaluated depsgraph of Blender as the core's `Scene`."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace

import bpy
import numpy as np

from ..core.scene.description import Camera, Frame, Scene
from ..core.scene.notice import Notice, Weight, by_weight
from ..core.scene.passes import CATCHER_PASS, CATCHER_SHADOWS
from ..core.shading.volumes.overlaps import crowded_volumes
from ..core.shading.volumes.portals import portals_in_volumes
from .camera import export_camera
from .drivers import failed_drivers
from .meshes.instances import Cancelled, collect_placements
from .meshes.placements import Placements
from .motion.shutter import Exposure, export_shutter, neighbours, open_time
from .motion.steps import CameraPlace, MotionSteps, camera_steps, with_frames
from .nodes.collections import occlusion_distance
from .passed_over.look import passed_over
from .passed_over.mirrors import lamps_hidden_from_mirrors
from .passes import LIGHT_PASS_PROPERTIES, MATTE_PROPERTIES, PASS_PROPERTIES, wanted_passes
from .view import View
from .world import export_world, with_portals

# What earlier exports left is there once, and a viewport may be read while a final render begins on another thread
reading = threading.RLock()
# Exponent of the share of mist, by Blender's name
_MIST_FALLOFFS = {"QUADRATIC": 2.0, "LINEAR": 1.0, "INVERSE_QUADRATIC": 0.5}


def export_scene(
    depsgraph: bpy.types.Depsgraph, *, cancelled: Callable[[], bool] | None = None, view: View = View()
) -> Scene | None:
    """The view layer of the depsgraph's scene, as its active camera sees it in `view`.

    Returns None if `cancelled()`, which is called at least once for each mesh, returned True. Raises `SceneError` for a
    scene that cannot be rendered: without a camera, or with one that cannot be used.
    """
    with reading:
        return _exported_in_time(depsgraph, cancelled or (lambda: False), view.holding(depsgraph.scene))


def _exported_in_time(depsgraph: bpy.types.Depsgraph, cancelled: Callable[[], bool], view: View) -> Scene | None:
    """The scene, with the times that it is read at."""
    scene = depsgraph.scene
    frame = export_frame(scene, depsgraph.view_layer, depsgraph.scene_eval.world)
    warnings: list[str] = []
    exposure = open_time(scene, depsgraph.view_layer, view, warnings)
    beside = neighbours(scene, depsgraph.view_layer, view, warnings)
    exposure = exposure or beside
    if exposure is None:
        return _exported(depsgraph, frame, view, cancelled, warnings)
    if exposure.middle != exposure.frame:
        exposure.go_to(0.0)
    try:
        return _exported(depsgraph, frame, view, cancelled, warnings, exposure, beside is not None)
    finally:
        exposure.go_back()


def _exported(
    depsgraph: bpy.types.Depsgraph,
    frame: Frame,
    view: View,
    cancelled: Callable[[], bool],
    warnings: list[str],
    exposure: Exposure | None = None,
    sharp: bool = False,
) -> Scene | None:
    """The scene as it is now, and what moves of it in the time of `exposure`; if it is `sharp`, for passes alone."""
    scene = depsgraph.scene
    camera = export_camera(scene, depsgraph, frame.width, frame.height, warnings, view)
    try:
        placements = collect_placements(depsgraph, cancelled, exposure is not None, None if sharp else exposure)
    except Cancelled:
        return None
    exported = assembled(depsgraph, camera, frame, placements, warnings, moves=exposure is not None and not sharp)
    warnings += (
        failed_drivers(depsgraph)
        + [Notice(line, Weight.MISSING) for line in _unsupported(scene, depsgraph.view_layer)]
        + passed_over(depsgraph, placements.originals)
    )
    if exposure is not None:
        steps = MotionSteps(exposure, placements, camera_steps(scene, view))

        def camera_now() -> CameraPlace:
            now = export_camera(scene, depsgraph, frame.width, frame.height, [], view)
            return now.transform, now.window

        if not steps.collect(depsgraph, camera_now, cancelled):
            return None
        moved = steps.camera(camera), steps.instances(exported.instances), steps.meshes()
        if sharp:
            moved = with_frames((camera, exported.instances, placements.meshes), moved)
        else:
            moved = replace(moved[0], shutter=export_shutter(scene)), *moved[1:]
        exported = replace(exported, camera=moved[0], instances=moved[1], meshes=tuple(moved[2]))
        warnings += steps.warnings
    warnings += crowded_volumes(exported) + portals_in_volumes(exported) + lamps_hidden_from_mirrors(exported)
    return replace(exported, warnings=tuple(by_weight(dict.fromkeys(warnings))))


def assembled(
    depsgraph: bpy.types.Depsgraph,
    camera: Camera,
    frame: Frame,
    placements: Placements,
    warnings: list[str],
    moves: bool = False,
) -> Scene:
    """The scene of `placements` as it is now; `warnings` gets those about its parts. `moves`: what is flat now may be
    so for a moment.
    """
    if placements.catches and CATCHER_PASS not in frame.passes:
        frame = replace(frame, passes=(*frame.passes, CATCHER_SHADOWS))
    collections = placements.materials.collections
    # evaluated: with the current values of drivers and keyframes
    shown = world_of(depsgraph.scene_eval, depsgraph.view_layer_eval)
    world = with_portals(export_world(shown, warnings, collections, placements.materials.kept), placements.portals)
    groups = [each.name for each in depsgraph.view_layer.lightgroups]
    if shown is not None and shown.lightgroup in groups:
        world = replace(world, light_group=groups.index(shown.lightgroup))
    instances = placements.instances("Object Index" in frame.passes, moves)
    warnings += placements.warnings + collections.warnings
    return Scene(
        camera=camera,
        frame=frame,
        meshes=tuple(placements.meshes),
        instances=instances,
        slot_materials=np.array(placements.slot_materials, np.int32),
        materials=tuple(placements.materials.materials),
        lights=tuple(placements.lights),
        world=world,
        images=tuple(collections.images),
        attributes=tuple(collections.attributes),
        object_names=tuple(placements.object_names),
        light_groups=tuple(groups),
        asset_names=tuple(placements.asset_names),
    )


def export_frame(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, world: bpy.types.World | None) -> Frame:
    """The picture that the render settings ask for: size, border, alpha and passes; with the mist of `world`,
    evaluated.
    """
    render = scene.render
    width = render.resolution_x * render.resolution_percentage // 100
    height = render.resolution_y * render.resolution_percentage // 100
    width, height = max(1, width), max(1, height)
    border = None
    if render.use_border:
        # float32 and truncated, as Blender sizes its own buffer
        border = (
            int(np.float32(render.border_min_x) * np.float32(width)),
            int(np.float32(render.border_min_y) * np.float32(height)),
            int(np.float32(render.border_max_x) * np.float32(width)),
            int(np.float32(render.border_max_y) * np.float32(height)),
        )
        if border == (0, 0, width, height):
            border = None
    passes, threshold = wanted_passes(view_layer), float(view_layer.pass_alpha_threshold)
    return Frame(
        width,
        height,
        border=border,
        transparent=bool(render.film_transparent),
        glass_roughness=_glass_roughness(scene),
        passes=passes,
        mist=_mist(world),
        alpha_threshold=threshold,
        occlusion_distance=occlusion_distance(scene, view_layer),
    )


def _glass_roughness(scene: bpy.types.Scene) -> float | None:
    """`Frame.glass_roughness`, as Cycles' settings have it."""
    own = getattr(scene, "cycles", None)  # there as long as that add-on is enabled
    if own is None or not (scene.render.film_transparent and own.film_transparent_glass):
        return None
    return float(own.film_transparent_roughness)


def _mist(world: bpy.types.World | None) -> tuple[float, float, float]:
    """`Frame.mist` as the world has it."""
    if world is None:
        return (0.0, 100.0, 1.0)  # as Cycles has it
    mist = world.mist_settings
    return float(mist.start), float(mist.depth), _MIST_FALLOFFS[mist.falloff]


def world_of(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> bpy.types.World | None:
    """The world that lights the view layer, unless it is hidden."""
    return (getattr(view_layer, "world_override", None) or scene.world) if view_layer.use_sky else None


def _unsupported(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> list[str]:
    """Settings of the scene and the view layer that are not rendered, by name."""
    lines = []
    # accuracy is no pass of its own
    known = {
        "use_pass_combined",
        "use_pass_cryptomatte_accurate",
        *PASS_PROPERTIES,
        *LIGHT_PASS_PROPERTIES,
        *MATTE_PROPERTIES,
    }
    asked = [
        p
        for p in view_layer.bl_rna.properties.keys()
        if p.startswith("use_pass_") and p not in known and getattr(view_layer, p) is True
    ]
    if asked:
        names = ", ".join(view_layer.bl_rna.properties[p].name for p in asked)
        lines.append(f"view layer “{view_layer.name}”: these passes are not supported yet and stay empty: {names}")
    return lines
