"""Estimates of a scene on its device."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import warp as wp

from ...device.bulk import in_slices
from ...device.devices import load_module, worker_count
from ...native.structs import to_numpy
from ...scene.description import Scene, SkySun
from ...scene.features import SceneFeatures
from ...shading.lights.emitters import scene_radius
from ...shading.lights.table import LightTable
from ...shading.lights.world_sun import directions_within
from ..scene.shading_data import SceneData
from .kernels import estimate_kernel
from .triangles import TRIANGLE_POINTS
from .work import Estimate, EstimateWork

# Directions in which all points of a triangle are looked at; runs of programs for all triangles together, about: in
# fewer directions than a triangle has points a point each is looked at
_DIRECTIONS_MOST = 256
_TRIANGLE_RUNS = 2**17
# Points of a texel of the world, along either axis, whose mean is its brightness where that differs from the texels
# around it by more than a share of itself, or of all texels' mean if that is larger; elsewhere, and where texels are as
# many as an image's, one. What is smaller than a texel and lies between such points stays unseen.
_TEXEL_POINTS = 2
_TEXEL_DIFFERENCE = 0.2
_FINE_WIDTH = 4096
# Directions within a sky's sun, of which the mean counts
_SUN_DIRECTIONS = 256
# Points of each lamp, of which the mean counts
_LAMP_POINTS = 96
# Brightness of a lamp's program that was black at all points: it may shine elsewhere
_UNSEEN = 0.01


def emission_of_triangles(
    data: SceneData, features: SceneFeatures, device: wp.Device, instance: np.ndarray, primitive: np.ndarray
) -> np.ndarray:
    """Radiance that triangles count for whose material is a program, float32, shape [n, 3] (`triangles.py`)."""
    directions = min(_DIRECTIONS_MOST, _TRIANGLE_RUNS // (2 * TRIANGLE_POINTS * max(len(instance), 1)))
    radiance = wp.zeros(len(instance), dtype=wp.vec3, device=device)
    instance, primitive = (wp.array(each, dtype=int, device=device) for each in (instance, primitive))

    def work_of(first: int, end: int) -> tuple[EstimateWork, int]:
        work = EstimateWork()
        work.instance, work.primitive = instance[first:end], primitive[first:end]
        work.radiance = radiance[first:end]
        work.points, work.every_point = max(directions, TRIANGLE_POINTS), int(directions >= TRIANGLE_POINTS)
        return work, end - first

    _launch_in_parts(Estimate.TRIANGLES, data, features, device, len(instance), work_of)
    return to_numpy(radiance)


def world_texels(data: SceneData, features: SceneFeatures, width: int, device: wp.Device) -> np.ndarray:
    """Brightness of `width` texels around the world and half as many from pole to pole, float32."""
    height = max(1, width // 2)
    texels = wp.zeros(width * height, dtype=float, device=device)

    def work_of(first: int, end: int) -> tuple[EstimateWork, int]:
        work = EstimateWork()
        work.world.width, work.world.height = width, height
        work.row_first, work.texels, work.points = first, texels, 1
        return work, (end - first) * width

    _launch_in_parts(Estimate.WORLD, data, features, device, height, work_of)
    light = to_numpy(texels).reshape(height, width)
    rough = np.flatnonzero(_is_rough(light)).astype(np.int32) if width < _FINE_WIDTH else np.zeros(0, np.int32)
    if len(rough) == 0:
        return light
    listed = wp.array(rough, dtype=int, device=device)

    def work_of_rough(first: int, end: int) -> tuple[EstimateWork, int]:
        work, _ = work_of(0, 0)
        work.listed, work.points = listed[first:end], _TEXEL_POINTS
        return work, end - first

    _launch_in_parts(Estimate.WORLD, data, features, device, len(rough), work_of_rough)
    return to_numpy(texels).reshape(height, width)


def sun_brightness(data: SceneData, features: SceneFeatures, sun: SkySun, device: wp.Device) -> float:
    """Mean brightness of the world within its sun [W/(m² sr)]."""
    work = EstimateWork()
    work.directions = wp.array(directions_within(sun, _SUN_DIRECTIONS), dtype=wp.vec3, device=device)
    work.texels = wp.zeros(_SUN_DIRECTIONS, dtype=float, device=device)
    _launch_in_parts(Estimate.WORLD, data, features, device, 1, lambda first, end: (work, _SUN_DIRECTIONS))
    return float(to_numpy(work.texels).mean(dtype=np.float64))


def _is_rough(light: np.ndarray) -> np.ndarray:
    """Whether texels [height, width] differ from those around them by so much that a point does not show their mean."""
    around = np.pad(light, ((1, 1), (0, 0)), "edge")
    around = np.stack([around[:-2], around[1:-1], around[2:]])
    low, high = around.min(0), around.max(0)
    low = np.minimum(low, np.minimum(np.roll(low, 1, 1), np.roll(low, -1, 1)))
    high = np.maximum(high, np.maximum(np.roll(high, 1, 1), np.roll(high, -1, 1)))
    return high - low > _TEXEL_DIFFERENCE * np.maximum(light, light.mean(dtype=np.float64))


def brightness_of_lamps(
    scene: Scene, data: SceneData, features: SceneFeatures, device: wp.Device, table: LightTable
) -> np.ndarray:
    """Estimated factor by which programs change the brightness of each light of `scene`; float64, shape [n].

    It is 1 for a light without program, and 0 for a program that never shines and for no other.
    """
    result = np.ones(len(scene.lights))
    lamps = np.array([i for i, light in enumerate(scene.lights) if light.program is not None], np.int32)
    if not len(lamps):
        return result
    work = EstimateWork()
    work.estimate, work.points = int(Estimate.LAMPS), _LAMP_POINTS
    work.lamps, work.lights = wp.array(lamps, dtype=int, device=device), table
    work.scene_radius = scene_radius(scene)
    work.brightness = wp.zeros(len(lamps), dtype=wp.float64, device=device)
    kernel = estimate_kernel(features, Estimate.LAMPS)
    load_module(kernel, device)
    wp.launch(kernel, len(lamps), [data, work], device=device)
    for i, mean in zip(lamps, to_numpy(work.brightness)):
        result[i] = (mean if mean > 0 else _UNSEEN) if scene.lights[i].program.may_emit else 0.0
    return result


def _launch_in_parts(
    estimate: Estimate,
    data: SceneData,
    features: SceneFeatures,
    device: wp.Device,
    count: int,
    work_of: Callable[[int, int], tuple[EstimateWork, int]],
) -> None:
    """Launch `work_of(first, end)` with its number of items, for parts of `count`, one for each thread: a launch on the
    CPU runs on one.
    """
    kernel = estimate_kernel(features, estimate)
    load_module(kernel, device)

    def launch(part: slice) -> None:
        work, items = work_of(part.start, part.stop)
        work.estimate = int(estimate)
        wp.launch(kernel, items, [data, work], device=device)

    in_slices(count, launch, -(-count // worker_count(device, 0)))
