"""Emissive triangles, and the choice among emitters."""

import dataclasses
import functools

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.traverse.reference import ReferenceTree, build_reference, make_reference
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.errors import SceneError
from raybatch_addon.core.scene.description import (
    Closure,
    ClosureKind,
    Instances,
    Light,
    LightKind,
    Material,
    Mesh,
    Visibility,
)
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import Geometry, upload_geometry
from raybatch_addon.core.shading.lights.choice import lit_point, packed_side
from raybatch_addon.core.shading.lights.emitters import find_emissive_triangles, scene_radius
from raybatch_addon.core.shading.lights.lights import LightFeatures, make_lights
from raybatch_addon.core.shading.lights.table import LightTable, upload_lights
from raybatch_addon.core.shading.lights.world import fixed_point_cdf
from tests.core.shading.lights.light_probe import (
    COUNT,
    DEVICES,
    UP,
    assert_mean,
    facing,
    polygon_irradiance,
    probe,
    scene_of,
)
from tests.support.under_test import BLOCK_DIM, DEVICE

LAMP = np.array([0.5, -0.3, 2.0])  # from the shaded point (the origin)


def quad(name="q", side=1.0):
    h = side / 2
    positions = np.array([[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0]], np.float32)
    return Mesh(name, positions, np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def mesh_scene():
    glow = Material("glow", (Closure(ClosureKind.EMISSION, (3.0, 2.0, 1.0)), Closure(ClosureKind.DIFFUSE, (1, 1, 1))))
    dull = Material("dull", (Closure(ClosureKind.DIFFUSE, (1, 1, 1)),))
    bright = Material("bright", (Closure(ClosureKind.EMISSION, (30.0, 20.0, 10.0)),))
    mixed = dataclasses.replace(quad("m", 0.4), triangle_slot=np.array([1, 0], np.int32))
    skew = np.array([[1.0, 0.3, 0, 0.2], [0, 0.5, 0.2, -0.4], [0.1, 0, -2, 2.0]], np.float32)
    mirror = np.array([[-0.5, 0, 0, -1.0], [0, 0.6, 0.3, 0.3], [0, 0.2, 1, 1.5]], np.float32)
    transform = np.array([[1, 0, 0, 0.7], [0, 1, 0, 0.8], [0, 0, 1, 1.2]], np.float32)
    instances = Instances(
        mesh=np.array([0, 1, 0, 1], np.int32),
        transform=np.stack([skew, transform, mirror, transform - 0.2]).astype(np.float32),
        slot_first=np.array([0, 1, 0, 3], np.int32),
        visibility=np.full(4, int(Visibility.ALL), np.int32),
        object=np.arange(4, dtype=np.int32),
    )
    slots = np.array([0, 1, 2, 1, 1], np.int32)
    return scene_of(
        meshes=(quad(), mixed),
        instances=instances,
        slot_materials=slots,
        materials=(glow, dull, bright),
        object_names=tuple("abcd"),
    )


def world_triangle(scene, instance, primitive):
    mesh = scene.meshes[scene.instances.mesh[instance]]
    m = scene.instances.transform[instance].astype(float)
    return mesh.positions[mesh.triangles[primitive]] @ m[:, :3].T + m[:, 3]


@pytest.mark.parametrize("device", DEVICES)
def test_irradiance_under_emissive_triangles(device):
    scene = mesh_scene()
    emissive = find_emissive_triangles(scene)
    assert emissive.instance.tolist() == [0, 0, 1, 2, 2] and emissive.primitive.tolist() == [0, 1, 0, 0, 1]
    assert emissive.instance_first.tolist() == [0, 2, 3, 5, 5]
    expected = 0.0
    for k, (i, p) in enumerate(zip(emissive.instance, emissive.primitive)):
        corners = world_triangle(scene, i, p)
        assert emissive.area[k] == pytest.approx(
            np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0])) / 2, rel=1e-5
        )
        expected += polygon_irradiance(corners, UP, emissive.radiance[k, 0])
    r = probe(scene, device=device)
    assert_mean(r.irradiance_by_lights()[:, 0], expected)
    # the same density when a ray hits the triangle, and the point lies on it
    np.testing.assert_allclose(r.again, r.pdf, rtol=1e-4)
    for i, p in zip(emissive.instance, emissive.primitive):
        mine = (r.triangle == [i, p]).all(1)
        a, b, c = world_triangle(scene, i, p)
        points = r.direction[mine] * r.distance[mine, None]
        bary = np.linalg.lstsq(np.column_stack([b - a, c - a]), (points - a).T, rcond=None)[0]
        assert (bary > -1e-5).all() and (bary.sum(0) < 1 + 1e-5).all()
        np.testing.assert_allclose((np.column_stack([b - a, c - a]) @ bary).T + a, points, atol=1e-5)
        assert mine.any()


def test_mixed_emitters_add_up():
    light = Light("l", LightKind.SPOT, facing(LAMP, -LAMP), (3, 2, 1), angle=1.0)
    scene = dataclasses.replace(
        mesh_scene(),
        lights=(
            light,
            Light("dark", LightKind.POINT, facing(LAMP, -UP), (0, 0, 0)),
            Light("s", LightKind.SUN, facing(LAMP, -LAMP), (3, 2, 1)),
        ),
    )
    emissive = find_emissive_triangles(scene)
    expected = (3 / (LAMP @ LAMP) + 3) * LAMP[2] / np.sqrt(LAMP @ LAMP)
    for i, p, radiance in zip(emissive.instance, emissive.primitive, emissive.radiance):
        expected += polygon_irradiance(world_triangle(scene, i, p), UP, radiance[0])
    assert_mean(probe(scene).irradiance_by_lights()[:, 0], expected, 1e-3)


def test_invisible_emissive_instances_are_not_asked():
    scene = mesh_scene()
    visibility = np.array([int(Visibility.CAMERA), *[int(Visibility.ALL)] * 3], np.int32)
    scene = dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, visibility=visibility))
    assert 0 not in find_emissive_triangles(scene).instance


def test_materials_that_light_is_not_aimed_at_have_no_emitters():
    scene = mesh_scene()
    everything = find_emissive_triangles(scene)
    shining = next(i for i, material in enumerate(scene.materials) if material.closures)
    materials = list(scene.materials)
    materials[shining] = dataclasses.replace(materials[shining], aimed=False)
    fewer = find_emissive_triangles(dataclasses.replace(scene, materials=tuple(materials)))
    dark = dataclasses.replace(scene.materials[shining], closures=())
    materials[shining] = dark
    expected = find_emissive_triangles(dataclasses.replace(scene, materials=tuple(materials)))
    assert len(fewer) < len(everything)
    for name in ("instance", "primitive", "radiance", "area", "program", "instance_first"):
        np.testing.assert_array_equal(getattr(fewer, name), getattr(expected, name))


@pytest.mark.parametrize("count", [1, 2, 3, 1000])
def test_selection_probabilities_sum_to_exactly_one(count):
    rng = np.random.default_rng(count)
    for power in (
        np.zeros(count),
        np.ones(count),
        10.0 ** rng.uniform(-30, 30, count),
        np.r_[1e30, np.full(count - 1, 1e-30)],
        np.full(count, 1e300),
    ):
        first = fixed_point_cdf(power)
        width = np.diff(np.append(first.astype(np.uint64), 2**32))
        assert first[0] == 0 and width.min() >= 1 and int(width.sum()) == 2**32
        if power.sum() > 0 and np.isfinite(power.sum()):
            np.testing.assert_allclose(width / 2.0**32, power / power.sum(), atol=(count + 1) * 2.0**-32)


def test_millions_of_emitters_have_a_probability():
    power = np.random.default_rng(0).uniform(size=3_000_000)
    width = np.diff(np.append(fixed_point_cdf(power).astype(np.uint64), 2**32))
    assert width.min() >= 1 and int(width.sum()) == 2**32
    np.testing.assert_allclose(width, power / power.sum() * 2**32, atol=4)


def test_emission_that_is_not_finite_is_named():
    with pytest.raises(SceneError, match="Lamp"):
        upload_lights(
            scene_of(Light("Lamp", LightKind.POINT, facing(LAMP, -UP), (np.nan, 1, 1))), wp.get_device(DEVICE)
        )
    glow = Material("Glow", (Closure(ClosureKind.EMISSION, (np.inf, 0, 0)),))
    with pytest.raises(SceneError, match="Glow"):
        upload_lights(dataclasses.replace(mesh_scene(), materials=(glow,) * 3), wp.get_device(DEVICE))


def test_lights_of_an_unknown_kind_are_refused():
    unknown = Light("l", 99, facing(LAMP, -LAMP), (1, 1, 1))
    with pytest.raises(ValueError, match="no strength of lights of kind 99"):
        upload_lights(scene_of(unknown), wp.get_device(DEVICE))


def test_scene_radius():
    assert scene_radius(scene_of()) == 1.0
    scene = mesh_scene()
    corners = np.concatenate([world_triangle(scene, i, p) for i in range(4) for p in range(2)])
    exact = np.linalg.norm(corners.max(0) - corners.min(0)) / 2
    assert exact - 1e-6 <= scene_radius(scene) < 1.5 * exact


@functools.cache
def shadow_kernel():
    sample = make_lights(LightFeatures(mesh_lights=True)).sample
    closest = make_reference(True).closest

    @wp.kernel(**KERNEL_OPTIONS)
    def aim(
        table: LightTable,
        geometry: Geometry,
        tree: ReferenceTree,
        position: wp.array(dtype=wp.vec3),
        found: wp.array(dtype=wp.vec3),
        same: wp.array(dtype=int),
    ):
        i = wp.tid()
        r = wp.rand_init(5, i)
        point = lit_point(position[i], packed_side(wp.vec3(0.0, 0.0, 1.0), True))
        s = sample(table, geometry, point, wp.randf(r), wp.vec2(wp.randf(r), wp.randf(r)))
        hit = closest(tree, position[i], s.direction, 2.0 * s.distance, 31)
        found[i] = wp.vec3(s.distance, s.distance_error, hit.t)
        same[i] = wp.where(s.pdf > 0.0 and hit.instance == s.instance and hit.primitive == s.primitive, 1, 0)

    return aim


@pytest.mark.parametrize("far, sliver", [(0.0, 1.0), (1e4, 1.0), (10.0, 1e-4)])
def test_a_shadow_ray_ends_before_the_light_that_it_aims_at(far, sliver):
    """No hit of the aimed triangle is nearer than the stated error, however far from the origin.

    The error is small.
    """
    rng = np.random.default_rng(0)
    scene = mesh_scene()
    corners = rng.normal(size=(3, 3))
    corners[2] = corners[1] + (corners[2] - corners[1]) * sliver
    mesh = Mesh("t", (corners + far * rng.normal(size=3)).astype(np.float32), np.array([[0, 1, 2]], np.int32))
    matrix = np.concatenate([rng.normal(size=(2, 3, 3)), far * rng.normal(size=(2, 3, 1))], 2).astype(np.float32)
    none = np.zeros(2, np.int32)
    instances = Instances(none, matrix, none, np.full(2, 31, np.int32), np.arange(2, dtype=np.int32))
    scene = dataclasses.replace(scene, meshes=(mesh,), instances=instances)
    device = wp.get_device(DEVICE)
    flat = flatten(scene)
    geometry = upload_geometry(flat, scene, device)
    lights = upload_lights(scene, device, geometry=geometry)
    built = build_reference(flat, instances.visibility, True, device)
    position = (world_triangle(scene, 0, 0).mean(0) + 3 * rng.normal(size=(COUNT, 3))).astype(np.float32)
    found, same = wp.zeros(COUNT, dtype=wp.vec3, device=device), wp.zeros(COUNT, dtype=int, device=device)
    inputs = [lights.table, geometry, built.tree, wp.array(position, dtype=wp.vec3, device=device)]
    wp.launch(shadow_kernel(), COUNT, inputs, [found, same], device=device, block_dim=BLOCK_DIM)
    distance, error, t = found.numpy()[same.numpy() > 0].astype(float).T
    assert len(t) > COUNT / 2
    assert (distance - t <= error).all()
    assert np.median(error / (distance + far)) < 1e-4, "beside coordinates, which are rounded"


def one_triangle(corners):
    """A scene with one emissive triangle, relative to the shaded point (the origin)."""
    scene = mesh_scene()
    mesh = Mesh("t", np.asarray(corners, np.float32), np.array([[0, 1, 2]], np.int32))
    none = np.zeros(1, np.int32)
    instances = Instances(none, np.eye(3, 4, dtype=np.float32)[None], none, np.full(1, 31, np.int32), none)
    return dataclasses.replace(scene, meshes=(mesh,), instances=instances, object_names=("t",))


def solid_angle(corners) -> float:
    a, b, c = (np.asarray(corner, float) / np.linalg.norm(corner) for corner in corners)
    return 2 * np.arctan2(abs(a @ np.cross(b, c)), 1 + a @ b + b @ c + c @ a)


@pytest.mark.parametrize(
    "corners",
    [
        [(-1, -1, 1), (1, -1, 1), (0, 1, 1)],
        [(-5, -4, 0.1), (6, -4, 0.1), (0, 7, 0.1)],  # nearly the half sphere
        [(0.1, 0, 0.01), (30, 0.5, 0.2), (0.1, 20, 3)],  # one corner near, two far
        [(-1, 0, 0.3), (1, 0, 0.3), (0, 0.3, 0.3)],  # long ones, begun at each corner
        [(1, 0, 0.3), (0, 0.3, 0.3), (-1, 0, 0.3)],
        [(0, 0.3, 0.3), (-1, 0, 0.3), (1, 0, 0.3)],
        [(-0.5, 0, 0.1), (2, 0, 0.4), (2, 0.1, 0.4)],
        [(2, 0.1, 0.4), (-0.5, 0, 0.1), (2, 0, 0.4)],
    ],
)
def test_near_triangles_are_sampled_by_solid_angle(corners):
    r = probe(one_triangle(corners))
    expected = solid_angle(corners)
    assert (r.pdf > 0).all()
    np.testing.assert_allclose(r.pdf, 1 / expected, rtol=2e-4)
    np.testing.assert_allclose(r.again, r.pdf, rtol=1e-4)
    radiance = 3.0
    assert_mean(r.irradiance_by_lights()[:, 0], polygon_irradiance(np.asarray(corners, float), UP, radiance), 1e-3)
    # evenly: each half of the triangle is met as often as it is large
    a, b, c = np.asarray(corners, float)
    for first, second, third in ((a, b, c), (b, c, a), (c, a, b)):
        middle = (second + third) / 2
        side = np.cross(first, middle) @ second
        inside = ((r.direction @ np.cross(first, middle)) * side > 0).mean()
        share = solid_angle([first, second, middle]) / expected
        assert abs(inside - share) < 4 * np.sqrt(0.25 / COUNT) + 1e-3


def test_triangles_around_the_point_give_no_invalid_numbers():
    for corners in (
        [(0, 0, 0), (1, 0, 0), (0, 1, 0)],  # the point is a corner
        [(-1, -1, 0), (1, -1, 0), (0, 1, 0)],  # and lies within the triangle
        [(1, 0, 0), (2, 0, 0), (3, 0, 1e-20)],  # edge-on
        [(-1, -1, 1e-6), (1, -1, 1e-6), (0, 1, 1e-6)],
        [(-1e15, -1e15, 1e3), (1e15, -1e15, 1e3), (0, 1e15, 1e3)],
        [(-1e-12, -1e-12, 1e-13), (1e-12, -1e-12, 1e-13), (0, 1e-12, 1e-13)],
    ):
        r = probe(one_triangle(corners), count=4096)
        assert np.isfinite(r.pdf).all() and (r.pdf >= 0).all()
        assert np.isfinite(r.direction[r.pdf > 0]).all() and np.isfinite(r.distance[r.pdf > 0]).all()
