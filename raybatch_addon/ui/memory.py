"""The estimate of memory at the end of the panel Memory."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import bpy

from ..blender.devices import device_choices
from ..core.errors import SettingsError
from ..core.settings.settings import RenderSettings
from ..export.passes import wanted_passes
from ..export.settings import settings_from
from .choices import last_statistics

if TYPE_CHECKING:
    from ..core.bvh.memory import GeometrySize  # brings in Warp, which registering the add-on should not wait for
    from ..core.measure.memory import MemoryEstimate


def estimate_lines(context) -> list[str]:
    """The estimate for the context's scene and settings, in words. The last render of the scene makes it better."""
    try:
        settings = settings_from(context.scene)
    except SettingsError:
        return []  # said elsewhere
    statistics = last_statistics(context)
    is_cuda = _is_cuda(settings, statistics)
    if is_cuda is None:
        return ["Memory is estimated once the devices are known"]
    return _lines(_estimate(context, settings, statistics, is_cuda))


def _is_cuda(settings: RenderSettings, statistics: dict[str, Any] | None) -> bool | None:
    """Whether the render will be on a CUDA device; None as long as devices are looked for."""
    device = settings.device.lower().partition(",")[0].strip()
    if device in ("auto", "all"):
        if statistics is None:
            known = device_choices()
            return None if known is None else any(each.name.startswith("cuda") for each in known)
        device = statistics["device"]["alias"]
    return device != "cpu"


def _estimate(context, settings: RenderSettings, statistics: dict[str, Any] | None, is_cuda: bool) -> MemoryEstimate:
    from ..core.bvh.node import Layout
    from ..core.measure.memory import estimate_memory
    from ..core.wavefront.rays import bytes_per_path
    from ..core.wavefront.scheduler import paths_a_worker

    schedule = (
        statistics["schedule"] if statistics and statistics["device"]["alias"].startswith("cuda") == is_cuda else {}
    )
    workers = 1 if is_cuda else settings.thread_count or schedule.get("workers") or os.cpu_count() or 1
    alive = schedule.get("ray_count", 0) // len(statistics.get("devices") or [1]) if statistics and schedule else 0
    path_count = settings.ray_count or alive or workers * paths_a_worker(settings, workers, is_cuda)
    path_bytes = schedule.get("bytes_per_path") or bytes_per_path(_features(context))
    tree = statistics.get("tree") if statistics and schedule else None
    instances = statistics.get("instances", 0) if statistics and schedule else 0
    size = geometry_size(context.scene, tree["triangles"] if tree else None, instances)
    return estimate_memory(
        size,
        Layout.QUANTISED if is_cuda else Layout.BOXES,
        path_bytes,
        path_count,
        settings.geometry_budget,
        tree["bytes"] if tree else None,
    )


def _features(context):
    """Features of a scene that has what paths need most memory for."""
    from ..core.scene.description import ClosureKind, LightKind
    from ..core.scene.features import SceneFeatures

    return SceneFeatures(
        surfaces=True,
        lights=(LightKind.SUN,),
        closures=(ClosureKind.TRANSPARENT,),
        film_transparent=context.scene.render.film_transparent,
        passes=wanted_passes(context.view_layer),
    )


def geometry_size(scene: bpy.types.Scene, triangles: int | None, instances: int = 0) -> GeometrySize:
    """What the scene's meshes hold before modifiers, each counted once; `triangles` and `instances` as far as the last
    render knew better.
    """
    from ..core.bvh.memory import GeometrySize

    placed = [obj.data for obj in scene.objects if obj.type == "MESH" and not obj.hide_render]
    meshes, instances = set(placed), max(instances, len(placed))
    counts = [len(mesh.loops) - 2 * len(mesh.polygons) for mesh in meshes]
    counted, vertices = sum(counts), sum(len(mesh.vertices) for mesh in meshes)
    if triangles is None or triangles == counted:
        return GeometrySize(counted, vertices, max([0, *counts]), smooth=True, instances=instances)
    # a closed mesh has half as many vertices
    return GeometrySize(triangles, triangles // 2 + 1, triangles, smooth=True, instances=instances)


def _lines(estimate: MemoryEstimate) -> list[str]:
    from ..core.host_memory import size_text

    lines = [
        f"Rays: {estimate.path_count:,} x {estimate.path_bytes} bytes, {size_text(estimate.rays)}",
        f"Geometry: {size_text(estimate.geometry)}, trees: {size_text(estimate.tree)}",
    ]
    if estimate.behind:
        lines.append(
            f"Of the trees {size_text(estimate.resident)} on the device, {size_text(estimate.behind)} behind it"
        )
    return [*lines, f"On the device about {size_text(estimate.device)}"]
