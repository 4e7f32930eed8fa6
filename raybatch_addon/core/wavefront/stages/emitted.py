"""Light that programs give: of the world in a direction, of a point on a surface."""

import functools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import warp as wp

from ...device.devices import load_module, worker_count
from ...device.kernel import kernel_options
from ...programs.point import ShadingPoint
from ...programs.run import make_run
from ...scene.description import ClosureKind
from ...scene.features import SceneFeatures
from ...scene.program import ProgramFeatures
from ...shading.bsdf.materials import ClosureRecord
from ...shading.lights.world import WorldTable, texel_direction
from ...shading.surface import make_surface
from ..scene.scene_data import SceneData
from .surface_program import make_surface_program, shading_point

# Points of a texel of the world, along either axis, whose mean is its brightness; one where texels are as many as an
# image's
_TEXEL_POINTS = 2
_FINE_WIDTH = 4096
# How long a ray into the world is, as Cycles has it: the largest float32
_FARTHEST = float(np.finfo(np.float32).max)
# Points of a triangle whose mean is its emission: rows of a grid
_TRIANGLE_ROWS = 4


@wp.func
def emission_of(closures: wp.array(dtype=ClosureRecord), count: int) -> wp.vec3:
    """Radiance of all emission closures [W/(m² sr)]."""
    radiance = wp.vec3(0.0)
    for c in range(count):
        if closures[c].kind == wp.static(int(ClosureKind.EMISSION)):
            radiance += closures[c].weight
    return radiance


@functools.cache
def make_world_emission(programs: ProgramFeatures) -> wp.Function:
    """Function (data, origin, direction, ray_kind: int, bounce: int, passed: int) -> vec3: the world's radiance."""
    run = make_run(programs)

    @wp.func
    def world_emission(
        data: SceneData, origin: wp.vec3, direction: wp.vec3, ray_kind: int, bounce: int, passed: int
    ) -> wp.vec3:
        point = ShadingPoint()
        point.position = origin
        point.incoming = -direction
        point.normal = -direction
        point.geometric_normal = -direction
        point.instance = -1
        point.ray_length = wp.static(_FARTHEST)
        point.ray_kind = ray_kind
        point.bounce = bounce
        point.passed = passed
        stack = wp.zeros(wp.static(programs.register_count), dtype=float)
        closures = wp.zeros(wp.static(programs.closure_count), dtype=ClosureRecord)
        return emission_of(closures, run(data.world_nodes, stack, data.world_nodes.program_first[0], point, closures))

    return world_emission


@functools.cache
def make_surface_emission(programs: ProgramFeatures, instancing: bool, smooth_normals: bool) -> wp.Function:
    """Function (data, instance: int, primitive: int, barycentric: vec2, incoming: vec3, distance: float, bounce: int,
    passed: int, history: int) -> vec3: radiance towards `incoming`; bounce, passed and history as `ShadingPoint` has
    them.
    """
    surface_point = make_surface(instancing, smooth_normals).point
    surface_closures = make_surface_program(programs)

    @wp.func
    def surface_emission(
        data: SceneData,
        instance: int,
        primitive: int,
        barycentric: wp.vec2,
        incoming: wp.vec3,
        distance: float,
        bounce: int,
        passed: int,
        history: int,
    ) -> wp.vec3:
        surface = surface_point(data.geometry, instance, primitive, barycentric)
        point = shading_point(surface, incoming, instance, primitive, barycentric, distance)
        point.bounce = bounce
        point.passed = passed
        point.history = history
        closures = wp.zeros(wp.static(programs.closure_count), dtype=ClosureRecord)
        return emission_of(closures, surface_closures(data, surface.material, point, closures))

    return surface_emission


@functools.cache
def world_texels_kernel(programs: ProgramFeatures) -> wp.Kernel:
    """Kernel (data, table, row_first, points, light): mean brightness of texels of rows from `row_first` on, `points`
    along either axis.
    """
    world_emission = make_world_emission(programs)

    @wp.kernel(**kernel_options(programs.apart))
    def world_texels(data: SceneData, table: WorldTable, row_first: int, points: int, light: wp.array(dtype=float)):
        i = row_first * table.width + wp.tid()
        row = i / table.width
        column = i % table.width
        total = float(0.0)
        for k in range(points * points):
            u = wp.vec2(float(k % points) + 0.5, float(k / points) + 0.5) / float(points)
            radiance = world_emission(data, wp.vec3(0.0), texel_direction(table, row, column, u), 0, 1, 0)
            total += (radiance[0] + radiance[1] + radiance[2]) * wp.static(1.0 / 3.0)
        light[i] = wp.min(total / float(points * points), wp.static(1e30))

    return world_texels


@functools.cache
def triangle_emission_kernel(programs: ProgramFeatures, instancing: bool, smooth_normals: bool) -> wp.Kernel:
    """Kernel (data, instance, primitive, radiance): mean radiance of triangles, seen from the front and from the
    back.
    """
    surface_emission = make_surface_emission(programs, instancing, smooth_normals)
    surface_point = make_surface(instancing, smooth_normals).point

    @wp.kernel(**kernel_options(programs.apart))
    def triangle_emission(
        data: SceneData,
        instance: wp.array(dtype=int),
        primitive: wp.array(dtype=int),
        radiance: wp.array(dtype=wp.vec3),
    ):
        i = wp.tid()
        total = wp.vec3(0.0)
        points = int(0)
        # rows and sides are variables: unrolled, the loops would hold 32 interpreters
        rows = int(_TRIANGLE_ROWS)
        sides = int(2)
        for row in range(rows):
            for column in range(rows - row):
                place = wp.vec2(float(row) + 0.33, float(column) + 0.33) / float(rows)
                normal = surface_point(data.geometry, instance[i], primitive[i], place).geometric_normal
                for _ in range(sides):
                    total += surface_emission(data, instance[i], primitive[i], place, normal, 1.0, 1, 0, 0)
                    normal = -normal
                    points += 1
        radiance[i] = wp.min(total / float(points), wp.vec3(1e30))

    return triangle_emission


def emission_of_triangles(
    data: SceneData, features: SceneFeatures, device: wp.Device, instance: np.ndarray, primitive: np.ndarray
) -> np.ndarray:
    """Mean radiance of triangles whose material is a program, float32, shape [n, 3]."""
    kernel = triangle_emission_kernel(features.programs, features.instancing, features.smooth_normals)
    radiance = wp.zeros(len(instance), dtype=wp.vec3, device=device)
    arrays = [wp.array(instance, dtype=int, device=device), wp.array(primitive, dtype=int, device=device), radiance]

    def launch(first: int, end: int) -> None:
        wp.launch(kernel, end - first, [data, *(each[first:end] for each in arrays)], device=device)

    _launch_in_parts(kernel, len(instance), device, launch)
    return radiance.numpy()


def world_texels(data: SceneData, features: SceneFeatures, width: int, device: wp.Device) -> np.ndarray:
    """Brightness of `width` texels around the world and half as many from pole to pole, float32."""
    table = WorldTable()
    table.width, table.height = width, max(1, width // 2)
    light = wp.zeros(table.width * table.height, dtype=float, device=device)
    kernel = world_texels_kernel(features.world_program)
    points = 1 if width >= _FINE_WIDTH else _TEXEL_POINTS

    def launch(first: int, end: int) -> None:
        wp.launch(kernel, (end - first) * table.width, [data, table, first, points, light], device=device)

    _launch_in_parts(kernel, table.height, device, launch)
    return light.numpy().reshape(table.height, table.width)


def _launch_in_parts(kernel: wp.Kernel, count: int, device: wp.Device, launch: Callable[[int, int], None]) -> None:
    """Call `launch(first, end)` for parts of `count` items, one for each thread: a launch on the CPU runs on one."""
    load_module(kernel, device)
    threads = max(1, min(worker_count(device, 0), count))
    ends = [count * i // threads for i in range(threads + 1)]
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(launch, ends[:-1], ends[1:]))
