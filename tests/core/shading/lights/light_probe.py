"""Kernel of the light tests: it samples lights from one point, and looks along rays."""

import dataclasses
import functools

import numpy as np
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.programs.op import NodeData
from raybatch_addon.core.scene.description import Camera, CameraKind, Frame, Light, LightKind, Scene
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import Geometry, upload_geometry
from raybatch_addon.core.shading.lights.choice import lit_point, packed_side
from raybatch_addon.core.shading.lights.hits import LightHitFeatures, make_light_hits
from raybatch_addon.core.shading.lights.lights import LightFeatures, make_lights
from raybatch_addon.core.shading.lights.table import LightTable, upload_lights
from raybatch_addon.core.shading.sampling import bitangent_of, sample_cone, tangent_of, to_world
from tests.support.under_test import BLOCK_DIM, DEVICE

DEVICES = [DEVICE]
COUNT = 2**15
UP = np.array([0.0, 0.0, 1.0])


def facing(position, direction) -> np.ndarray:
    """Light to world: at `position`, shining along `direction`, rotated about it by an arbitrary angle."""
    z = -np.asarray(direction, float) / np.linalg.norm(direction)
    x = np.cross([0.3, 0.8, -0.52], z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z, position]).astype(np.float32)


def scene_of(*lights: Light, **rest) -> Scene:
    camera = Camera(CameraKind.PERSPECTIVE, np.eye(3, 4, dtype=np.float32), (-1, 1, -1, 1))
    return Scene(camera=camera, frame=Frame(8, 8), lights=lights, **rest)


ALL = LightFeatures(lights=tuple(LightKind), light_sphere=True, mesh_lights=True)


@wp.struct
class Query:
    """Input of the test kernel: it samples lights from a point, and looks along rays in a cone."""

    position: wp.vec3
    normal: wp.vec3
    both_sides: int
    cone_axis: wp.vec3
    cone: float  # 1 - cos of the cone's half angle
    seed: int
    visibility: int
    t_min: float
    t_max: float


@wp.struct
class Answers:
    radiance: wp.array(dtype=wp.vec3)
    direction: wp.array(dtype=wp.vec3)
    info: wp.array(dtype=wp.vec4)  # pdf, distance, delta, cosine to the normal
    triangle: wp.array(dtype=wp.vec2i)
    again: wp.array(dtype=float)  # hit_pdf of a sampled triangle
    met: wp.array(dtype=wp.vec3)  # along the sampled direction, with the sampler's density as the BSDF's
    cone_direction: wp.array(dtype=wp.vec3)
    cone_met: wp.array(dtype=wp.vec3)  # along a direction in the cone, weight 1
    cone_weighted: wp.array(dtype=wp.vec3)  # along a direction in the cone, with the cone's density as the BSDF's


@functools.cache
def kernel_for(features: LightFeatures):
    sample, hit_pdf = make_lights(features)
    intersect, miss, _ = make_light_hits(
        LightHitFeatures(features.lights, features.light_sphere, features == ALL, mesh_lights=features.mesh_lights)
    )

    @wp.kernel(**KERNEL_OPTIONS)
    def probe(table: LightTable, nodes: NodeData, geometry: Geometry, query: Query, answers: Answers):
        i = wp.tid()
        r = wp.rand_init(query.seed, i)
        choice = float(wp.randi(r) & 16777215) / 16777216.0
        u = wp.vec2(float(wp.randi(r) & 16777215) / 16777216.0, float(wp.randi(r) & 16777215) / 16777216.0)
        point = lit_point(query.position, packed_side(query.normal, query.both_sides != 0))
        s = sample(table, geometry, point, choice, u)
        answers.radiance[i] = s.radiance
        answers.direction[i] = s.direction
        answers.info[i] = wp.vec4(s.pdf, s.distance, float(s.delta), wp.dot(s.direction, query.normal))
        answers.triangle[i] = wp.vec2i(s.instance, s.primitive)
        if s.pdf > 0.0 and s.instance >= 0:
            answers.again[i] = hit_pdf(table, geometry, s.instance, s.primitive, point, s.direction, s.distance)
        met = intersect(table, nodes, point, s.direction, query.t_min, query.t_max, query.visibility, s.pdf, 0, 0)
        answers.met[i] = met + miss(table, nodes, point, s.direction, query.visibility, s.pdf, 0, 0)

        local = sample_cone(wp.vec2(wp.randf(r), wp.randf(r)), query.cone)
        d = to_world(local, tangent_of(query.cone_axis), bitangent_of(query.cone_axis), query.cone_axis)
        density = 1.0 / (wp.TAU * query.cone)
        answers.cone_direction[i] = d
        met = intersect(table, nodes, point, d, query.t_min, query.t_max, query.visibility, 0.0, 0, 0)
        answers.cone_met[i] = met + miss(table, nodes, point, d, query.visibility, 0.0, 0, 0)
        met = intersect(table, nodes, point, d, query.t_min, query.t_max, query.visibility, density, 0, 0)
        answers.cone_weighted[i] = met + miss(table, nodes, point, d, query.visibility, density, 0, 0)

    return probe


@dataclasses.dataclass
class Result:
    radiance: np.ndarray
    direction: np.ndarray
    pdf: np.ndarray
    distance: np.ndarray
    delta: np.ndarray
    cosine: np.ndarray
    triangle: np.ndarray
    again: np.ndarray
    met: np.ndarray
    cone_direction: np.ndarray
    cone_met: np.ndarray
    cone_weighted: np.ndarray
    cone_solid_angle: float

    def irradiance_by_lights(self):
        """Estimates of irradiance from light samples, shape [n, 3]."""
        with np.errstate(divide="ignore", invalid="ignore"):
            value = self.radiance * (np.maximum(self.cosine, 0) / self.pdf)[:, None]
        return np.where(self.pdf[:, None] > 0, value, 0)

    def mis_irradiance(self, normal):
        """Light samples and cone samples, each with its power-heuristic weight."""
        weight = np.where(self.delta > 0, 1, 1 / (1 + (1 / (self.cone_solid_angle * np.maximum(self.pdf, 1e-37))) ** 2))
        cosine = np.maximum(self.cone_direction @ normal, 0)
        return (
            self.irradiance_by_lights() * weight[:, None]
            + self.cone_weighted * (cosine * self.cone_solid_angle)[:, None]
        )


def probe(
    scene,
    position=(0, 0, 0),
    normal=UP,
    cone_axis=UP,
    cone=1.0,
    device=DEVICE,
    features=ALL,
    visibility=1,
    t_min=0.0,
    t_max=1e30,
    count=COUNT,
    both_sides=False,
):
    geometry = upload_geometry(flatten(scene), scene, wp.get_device(device))
    uploaded = upload_lights(scene, wp.get_device(device), geometry=geometry)
    answers = Answers()
    for name, kind in (
        ("radiance", wp.vec3),
        ("direction", wp.vec3),
        ("info", wp.vec4),
        ("triangle", wp.vec2i),
        ("again", float),
        ("met", wp.vec3),
        ("cone_direction", wp.vec3),
        ("cone_met", wp.vec3),
        ("cone_weighted", wp.vec3),
    ):
        setattr(answers, name, wp.zeros(count, dtype=kind, device=device))
    query = Query()
    query.position, query.normal, query.cone_axis = wp.vec3(*position), wp.vec3(*normal), wp.vec3(*cone_axis)
    query.both_sides = int(both_sides)
    query.cone, query.seed, query.visibility, query.t_min, query.t_max = cone, 7, visibility, t_min, t_max
    kernel = kernel_for(features)
    wp.launch(kernel, count, [uploaded.table, NodeData(), geometry, query, answers], device=device, block_dim=BLOCK_DIM)
    info = answers.info.numpy().astype(float)
    return Result(
        radiance=answers.radiance.numpy().astype(float),
        direction=answers.direction.numpy().astype(float),
        pdf=info[:, 0],
        distance=info[:, 1],
        delta=info[:, 2],
        cosine=info[:, 3],
        triangle=answers.triangle.numpy(),
        again=answers.again.numpy().astype(float),
        met=answers.met.numpy().astype(float),
        cone_direction=answers.cone_direction.numpy().astype(float),
        cone_met=answers.cone_met.numpy().astype(float),
        cone_weighted=answers.cone_weighted.numpy().astype(float),
        cone_solid_angle=2 * np.pi * cone,
    )


def assert_mean(estimates, expected, relative=2e-4):
    """The mean is `expected` within 4 standard errors and rounding."""
    estimates = np.asarray(estimates, float)
    error = estimates.std() / np.sqrt(len(estimates))
    assert abs(estimates.mean() - expected) <= 4 * error + relative * abs(expected), (estimates.mean(), expected, error)


def polygon_irradiance(corners, normal, radiance=1.0):
    """Lambert's formula for a polygon above the horizon, corners relative to the shaded point."""
    total = 0.0
    for a, b in zip(corners, np.roll(corners, -1, 0)):
        cross = np.cross(a, b)
        length = np.linalg.norm(cross)
        if length > 0:
            total += np.arctan2(length, a @ b) * (cross @ normal) / length
    return abs(total) / 2 * radiance
