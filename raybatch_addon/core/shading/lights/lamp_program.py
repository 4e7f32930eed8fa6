"""Programs of lights without mesh: the point of a lamp that they are run at, and the lamp's inputs.

A program multiplies the strength of its lamp. Its inputs follow Cycles: a lamp is an object; the point lies on its
shape, and the normal points away from it. `barycentric` holds coordinates on the lamp that `Parametric` shows: across
an area light, within the cone of a spot, around a point light by longitude and latitude, across a sun's disc. A sun is
infinitely far, and its point is the direction from which its light comes.
"""

import functools

import numpy as np
import warp as wp

from ...device.codegen.local_arrays import Unset
from ...float32 import LARGEST
from ...native.structs import Upload, upload_anew
from ...programs.inputs_data import InputData, inverses, upload_camera_inputs
from ...programs.op import NodeData
from ...programs.ops.values.finite import finite_or_zero
from ...programs.point import ShadingPoint
from ...programs.run import make_run
from ...programs.table import upload_programs
from ...scene.description import ClosureKind, LightKind, Scene
from ...scene.geometry import Geometry, mat34, transform_vector
from ...scene.program import ProgramFeatures
from ..bsdf.materials import RECORD_FLOATS, ClosureRecord, address_of
from ..images.textures import ImageTable
from .table import LightRecord, LightTable

_POINT = wp.constant(int(LightKind.POINT))
_SPOT = wp.constant(int(LightKind.SPOT))
_SUN = wp.constant(int(LightKind.SUN))
_EMISSION = int(ClosureKind.EMISSION)
# Largest value of a channel that a program may give
_RADIANCE_MOST = 1e30


def lamp_transforms(scene: Scene) -> np.ndarray:
    """Object to world of every light, float64, shape [n, 3, 4]."""
    matrices = [light.transform if light.object_transform is None else light.object_transform for light in scene.lights]
    return np.array(matrices, np.float64).reshape(-1, 3, 4)


def upload_lamp_programs(
    scene: Scene,
    features: ProgramFeatures,
    geometry: Geometry,
    images: ImageTable,
    device: wp.Device,
    upload: Upload = upload_anew,
) -> NodeData:
    """The programs of all lights of `scene`, each of their arrays copied by `upload`, and their inputs; empty where
    there are none.
    """
    if not features:
        return NodeData()
    inputs = upload_camera_inputs(scene, device)
    _upload_lamp_inputs(inputs, scene, device)
    programs = [light.program for light in scene.lights]
    return upload_programs(programs, features, scene, geometry, images, device, inputs=inputs, upload=upload)


def _upload_lamp_inputs(inputs: InputData, scene: Scene, device: wp.Device) -> None:
    """Fill in the inputs that ops read of objects, by light.

    Generated coordinates are those of the object, as there is no mesh; there is no UV map.
    """
    matrices = lamp_transforms(scene)
    count = len(matrices)
    inputs.to_world = wp.array(matrices.astype(np.float32), dtype=mat34, device=device)
    inputs.to_object = wp.array(inverses(matrices), dtype=mat34, device=device)
    info = np.array([light.info or (0.0,) * 6 for light in scene.lights], np.float32).reshape(-1, 6)
    inputs.info = wp.array(info, dtype=float, device=device)
    inputs.texture_scale = wp.full(count, wp.vec3(1.0), dtype=wp.vec3, device=device)
    inputs.texture_offset = wp.zeros(count, dtype=wp.vec3, device=device)
    inputs.uv_first = wp.full(count, -1, dtype=int, device=device)
    width = max((len(light.attributes) for light in scene.lights if light.attributes is not None), default=0)
    if width:
        values = np.zeros((count, width, 4), np.float32)
        for i, light in enumerate(scene.lights):
            if light.attributes is not None:
                values[i, : len(light.attributes)] = light.attributes
        inputs.object_attributes = wp.array(values, dtype=wp.vec4, device=device)


@wp.func
def sphere_coordinates(v: wp.vec3) -> wp.vec2:
    """Longitude and latitude of a direction, each in 0..1; 0 for a vector without direction."""
    across = wp.sqrt(v[0] * v[0] + v[1] * v[1])
    u = float(0.0)
    if across > 0.0:
        u = 0.5 - wp.atan2(v[0], v[1]) / wp.TAU
    latitude = float(0.0)
    if across > 0.0 or v[2] != 0.0:
        latitude = 1.0 - wp.acos(wp.clamp(v[2] / wp.length(v), -1.0, 1.0)) / wp.PI
    return wp.vec2(u, latitude)


@wp.func
def lamp_coordinates(
    light: LightRecord, to_object: mat34, position: wp.vec3, normal: wp.vec3, direction: wp.vec3
) -> wp.vec2:
    """Coordinates of a point on its lamp, 0..1 across the part that shines; the ray goes along `direction`."""
    if light.kind == _POINT:
        return sphere_coordinates(transform_vector(to_object, normal))
    if light.kind == _SPOT:
        local = transform_vector(to_object, -direction)
        # half the cotangent of half the cone's angle: a picture fills the cone
        half = 0.5 * light.cos_half / wp.sqrt(wp.max(1.0 - light.cos_half * light.cos_half, 1.0e-30))
        return wp.vec2(
            finite_or_zero(0.5 - half * local[0] / local[2]), finite_or_zero(0.5 - half * local[1] / local[2])
        )
    if light.kind == _SUN:
        result = wp.vec2(0.5, 0.5)
        if light.delta == 0:
            local = transform_vector(to_object, direction)
            scale = 0.5 / (wp.sqrt(0.5 * light.one_minus_cos) * wp.length(direction - light.axis))
            result += scale * wp.vec2(local[0], local[1])
        return result
    offset = position - light.position
    x = wp.clamp(0.5 * wp.dot(offset, light.axis_x) / light.half_x, -0.5, 0.5)
    y = wp.clamp(0.5 * wp.dot(offset, light.axis_y) / light.half_y, -0.5, 0.5)
    return wp.vec2(0.5 + x, 0.5 + y)


@wp.func
def lamp_point(
    light: LightRecord, to_object: mat34, lamp: int, position: wp.vec3, direction: wp.vec3, distance: float
) -> ShadingPoint:
    """The point of light number `lamp` at `position`, for programs.

    A ray along `direction` (unit) has come `distance` [m] to it.
    """
    point = ShadingPoint()
    point.position = position
    point.incoming = -direction
    point.normal = -direction
    point.ray_length = distance
    point.instance = lamp
    point.primitive = -1
    if light.kind == _SUN:
        point.position = -direction
        point.ray_length = LARGEST
    elif light.kind > _SUN:
        point.normal = light.axis
    elif light.sphere != 0:
        point.normal = wp.normalize(position - light.position)
    coordinates = lamp_coordinates(light, to_object, point.position, point.normal, direction)
    # weights of a triangle's second and third corner: `Parametric` shows those of the first and second
    point.barycentric = wp.vec2(coordinates[1], 1.0 - coordinates[0] - coordinates[1])
    if wp.dot(point.normal, point.incoming) < 0.0:
        point.normal = -point.normal
        point.backfacing = 1
    point.geometric_normal = point.normal
    return point


@functools.cache
def make_lamp_emission(programs: ProgramFeatures) -> wp.Function:
    """Function (nodes, table, lamp: int, position, direction, distance: float, bounce: int, passed: int) -> vec3.

    The result multiplies the lamp's strength. `position` is the point on the lamp that the ray along `direction` has
    come `distance` to; for suns neither counts. `bounce` and `passed` are those of `ShadingPoint`.
    """
    run = make_run(programs)

    @wp.func
    def lamp_emission(
        nodes: NodeData,
        table: LightTable,
        lamp: int,
        position: wp.vec3,
        direction: wp.vec3,
        distance: float,
        bounce: int,
        passed: int,
    ) -> wp.vec3:
        if nodes.program_first.shape[0] == 0:  # no program of a lamp has an instruction
            return wp.vec3(1.0)
        light = table.lights[lamp]
        point = lamp_point(light, nodes.inputs.to_object[lamp], lamp, position, direction, distance)
        point.bounce = bounce
        point.passed = passed
        stack = wp.zeros(wp.static(programs.register_count), dtype=float)
        records = wp.zeros(wp.static(programs.closure_count * RECORD_FLOATS), dtype=Unset)
        closures = wp.array(ptr=address_of(records), shape=(wp.static(programs.closure_count),), dtype=ClosureRecord)
        count = run(nodes, stack, nodes.program_first[lamp], point, closures)
        total = wp.vec3(0.0)
        for c in range(count):
            if closures[c].kind == wp.static(_EMISSION):
                total += closures[c].weight
        return wp.min(total, wp.vec3(wp.static(_RADIANCE_MOST)))

    return lamp_emission
