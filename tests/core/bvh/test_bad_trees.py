"""Trees over bad and extreme meshes, and what is said where they do not fit."""

import dataclasses

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh import memory
from raybatch_addon.core.bvh.build.cpu import build as build_sah
from raybatch_addon.core.bvh.build.cuda import build as build_cuda
from raybatch_addon.core.bvh.build.scene_tree import build_scene_tree
from raybatch_addon.core.bvh.memory import GeometrySize, check_counts, check_memory
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.traverse.options import TraceOptions
from raybatch_addon.core.errors import OutOfMemoryError, SceneError
from raybatch_addon.core.rays import RayList
from raybatch_addon.core.scene.description import Frame, Mesh
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import upload_geometry
from raybatch_addon.core.scene.validate import COORDINATE_MAX, EXTENT_MIN, checked_scene
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.rays import allocate_rays
from raybatch_addon.core.wavefront.scene import scene_cache, shown_instances
from raybatch_addon.core.wavefront.tracers.unbatched import trace_stage
from tests.support import scenes

SETTINGS = RenderSettings(sample_count=1, bounce_max=1)
# layout, spatial splits, built where rays are traced
KINDS = {
    "boxes": (Layout.BOXES, False, False),
    "boxes-splits": (Layout.BOXES, True, False),
    "quantised": (Layout.QUANTISED, False, False),
    "quantised-splits": (Layout.QUANTISED, True, False),
    "device": (Layout.QUANTISED, False, True),
}


@pytest.fixture(params=KINDS)
def kind(request, device):
    layout, _, on_device = KINDS[request.param]
    if device != "cpu" and layout is Layout.BOXES:
        pytest.skip("boxes are for CPUs")
    if device != "cpu" and not on_device:
        pytest.skip("needs a compiler for the CPU")
    return KINDS[request.param]


def hits(kind, device, positions, triangles, origin, direction) -> tuple[np.ndarray, np.ndarray]:
    """Triangle (-1: none) and distance that each ray finds."""
    layout, splits, on_device = kind
    device = wp.get_device(device)
    scene = scenes.scene(
        [(Mesh("mesh", np.float32(positions), np.int32(triangles)), scenes.IDENTITY, scenes.diffuse())]
    )
    flat = flatten(scene)
    built = build_scene_tree(
        flat,
        upload_geometry(flat, scene, device),
        scene.instances.visibility,
        False,
        device,
        layout,
        splits,
        False,
        on_device,
    )
    rays = allocate_rays(len(origin), device)
    rays.origin.assign(np.float32(origin))
    rays.direction.assign(np.float32(direction))
    rays.t_max.fill_(np.inf)
    rays.visibility.fill_(1)
    slots = wp.array(np.arange(len(origin), dtype=np.int32), device=device)
    listed = RayList(slots, wp.array([len(origin)], dtype=int, device=device), len(origin))
    trace_stage(layout, TraceOptions(any_hit=False, instancing=False)).launch(built.tree, rays, listed, None)
    return np.where(rays.hit_instance.numpy() >= 0, rays.hit_primitive.numpy(), -1), rays.hit_t.numpy()


def directions(count: int) -> np.ndarray:
    made = np.random.default_rng(1).normal(size=(count, 3))
    return made / np.linalg.norm(made, axis=1, keepdims=True)


# --- few triangles, and such as cannot be met


def test_one_triangle(kind, device):
    corners = [[0, 0, 0], [2, 0, 0], [0, 2, 0]]
    origin = [[0.5, 0.5, 3], [1.5, 1.5, 3], [0.5, 0.5, -3], [0, 0, 5], [5, 0.5, 0]]
    direction = [[0, 0, -1], [0, 0, -1], [0, 0, 2], [0, 0, -1], [-1, 0, 0]]
    found, t = hits(kind, device, corners, [[0, 1, 2]], origin, direction)
    assert found.tolist() == [0, -1, 0, 0, -1] and t[[0, 2, 3]].tolist() == [3, 1.5, 5]


def test_triangles_without_area_alone(kind, device):
    """Points, and lines along axes and aslant, of which some are many times the same."""
    generator = np.random.default_rng(2)
    points = generator.uniform(-1, 1, (50, 3))
    triangles = [[i, i, i] for i in range(20)] + [[i, i + 1, i] for i in range(20, 40)] + [[7, 7, 7]] * 20
    middle = len(points)
    positions = np.concatenate([points, [[0, 0, 0], [1, 0, 0], [2, 0, 0]]])
    triangles += [[middle, middle + 1, middle + 2]] * 3
    target = positions[generator.integers(0, len(positions), 500)]
    origin = np.concatenate([target - 2 * directions(500), np.tile([[-1.0, 0, 0]], (10, 1))])
    direction = np.concatenate([directions(500), np.tile([[1.0, 0, 0]], (10, 1))])
    found, _ = hits(kind, device, positions, triangles, origin, direction)
    assert (found == -1).all()


@pytest.mark.parametrize("scale", [2e-18, 1e-10, 1e10, 2e17])
def test_a_closed_mesh_of_any_allowed_size_is_closed(kind, device, scale):
    ball = scenes.sphere(radius=scale)
    origin = np.random.default_rng(3).uniform(-0.5, 0.5, (2000, 3)) * scale
    found, t = hits(kind, device, ball.positions, ball.triangles, origin, directions(2000))
    assert (found >= 0).all()
    place = np.linalg.norm(
        np.float32(origin).astype(np.float64) + t[:, None] * np.float32(directions(2000)).astype(np.float64), axis=1
    )
    assert place.min() > 0.98 * scale and place.max() < 1.0001 * scale


# --- sizes that are refused


def placed(mesh, *matrices):
    return checked_scene(scenes.scene([(mesh, matrix, scenes.diffuse()) for matrix in matrices]))


def test_what_is_too_small_is_named_with_the_limit():
    tiny = scenes.sphere("ball", radius=1e-19)
    scene = placed(tiny, scenes.IDENTITY)
    assert (
        scene.warnings == ("object “object 0” has an extent below 1e-18 m: it is not rendered",)
        and len(scene.instances) == 0
    )
    assert placed(tiny, scenes.translation(0, 0, 0, 100.0)).warnings == ()
    assert len(placed(scenes.sphere(), scenes.translation(0, 0, 0, 1e-19)).warnings) == 1
    # the size of shared meshes in object space counts too
    assert len(placed(tiny, *[scenes.translation(i, 0, 0, 100.0) for i in range(2)]).warnings) == 2
    assert placed(scenes.sphere(radius=EXTENT_MIN), scenes.IDENTITY).warnings == ()


def test_what_is_too_large_is_named_with_the_limit():
    scene = placed(scenes.sphere("ball"), scenes.translation(0, 0, 0, 2e18))
    assert scene.warnings == ("object “object 0” has coordinates beyond 1e+18 m: it is not rendered",)
    beyond = placed(scenes.sphere("ball", radius=2e18), scenes.IDENTITY)
    assert beyond.warnings == ("mesh “ball” has coordinates beyond 1e+18 m: it is not rendered",)
    assert placed(scenes.sphere(radius=0.99 * COORDINATE_MAX), scenes.IDENTITY).warnings == ()


def test_shared_meshes_must_not_be_so_small_that_the_scene_is_endless_for_them():
    """Rays are carried to object space, where their coordinates have squares too."""
    ball = scenes.sphere(radius=1e15)
    near, far = scenes.translation(0, 0, 0, 1e-15), scenes.translation(1e6, 0, 0, 1e-15)
    assert placed(ball, near, near).warnings == ()
    warnings = placed(ball, near, far).warnings
    assert len(warnings) == 2 and "“object 1” has a scale so small that the scene reaches beyond 1e+18 m" in warnings[1]
    assert placed(ball, far).warnings == ()


def test_vertices_that_are_not_finite_are_named(session):
    mesh = scenes.plane("broken")
    positions = mesh.positions.copy()
    positions[0, 1] = np.nan
    scene = scenes.scene(
        [(dataclasses.replace(mesh, positions=positions), scenes.IDENTITY, scenes.diffuse())],
        frame=Frame(4, 4),
        world=0.5,
    )
    film = session.render(scene, SETTINGS)
    assert "“broken” has vertices that are not finite" in film.statistics["warnings"][0]
    assert (film.passes["Combined"][..., 0] == 0.5).all()


# --- memory


def huge_mesh(count: int) -> Mesh:
    """A mesh of so many triangles, all of them the same memory."""
    return Mesh("huge", scenes.plane().positions, np.broadcast_to(np.array([[0, 1, 2]], np.int32), (count, 3)))


def lit(*objects):
    return scenes.scene([(mesh, scenes.IDENTITY, scenes.diffuse()) for mesh in objects], frame=Frame(8, 8), world=0.5)


def assert_usable(session, before):
    assert np.array_equal(session.render(lit(scenes.sphere()), SETTINGS).passes["Combined"], before.passes["Combined"])


def test_a_mesh_of_2_28_triangles_on_a_small_device(session, monkeypatch):
    before = session.render(lit(scenes.sphere()), SETTINGS)
    with monkeypatch.context() as small:
        small.setattr(memory, "total_memory", lambda device: 8 * 10**9)
        small.setattr(shown_instances, "flatten", lambda *of: pytest.fail("memory was asked for"))
        with pytest.raises(
            OutOfMemoryError,
            match=r"268,435,456 triangles need at least \d\d\.\d\d GB with their trees, "
            r"and .* has 8\.00 GB in all; use fewer",
        ):
            session.render(lit(huge_mesh(2**31 // 8)), SETTINGS.replace(batching="OFF"))
    assert_usable(session, before)


def test_more_than_is_free_is_refused_before_anything_is_uploaded(session, monkeypatch):
    before = session.render(lit(scenes.sphere()), SETTINGS)
    with monkeypatch.context() as small:
        small.setattr(memory, "free_memory", lambda device: 10**5)
        small.setattr(scene_cache, "upload_geometry", lambda *_: pytest.fail("memory was asked for"))
        with pytest.raises(
            OutOfMemoryError,
            match=r"10,000 triangles need at least 0\.00 GB with their trees, and .* has 0\.00 GB free",
        ):
            session.render(lit(huge_mesh(10_000)), SETTINGS)
    assert_usable(session, before)


def test_more_than_indices_name():
    size = GeometrySize.of(lit(huge_mesh(2**29), huge_mesh(2**29), scenes.plane()))
    assert size == GeometrySize(2**30 + 2, 12, 2**30 + 2, False, instances=3)
    with pytest.raises(
        SceneError, match="1,073,741,826 triangles, and a scene holds 715,827,882; use fewer, or instances"
    ):
        check_counts(size)
    check_counts(size, paged=True)
    with pytest.raises(SceneError, match="holds 715,827,882; use fewer, .*, or flat shading"):
        check_counts(dataclasses.replace(size, smooth=True), paged=True)
    with pytest.raises(SceneError, match="2,147,483,648 triangles, and a scene holds 2,147,483,647"):
        check_counts(dataclasses.replace(size, triangles=2**31), paged=True)
    with pytest.raises(SceneError, match="2,147,483,648 vertices"):
        check_counts(GeometrySize(1, 2**31, 1, False))


def test_more_than_indices_name_at_the_steps_of_what_moves():
    plane = scenes.plane()
    motion = np.broadcast_to(np.float32(0), (2**29, *plane.positions.shape))
    normals = np.broadcast_to(np.float32(0), (2**29, 3 * len(plane.triangles), 3))
    size = GeometrySize.of(lit(dataclasses.replace(plane, motion=motion)))
    assert (size.step_vertices, size.step_triangles, size.step_normals) == (2**31, 2**30, 0)
    with pytest.raises(SceneError, match="2,147,483,652 vertices at all steps .*; use fewer, or fewer steps"):
        check_counts(size)
    fewer = dataclasses.replace(size, step_vertices=0)
    check_counts(fewer)
    with pytest.raises(SceneError, match="1,073,741,826 triangles at all steps"):
        check_counts(fewer, corners=True)
    size = GeometrySize.of(lit(dataclasses.replace(plane, motion=motion, motion_normals=normals)))
    with pytest.raises(SceneError, match="triangles at all steps"):
        check_counts(size)


def test_sizes_count_shared_meshes_once():
    shared, single, hidden = scenes.sphere(), scenes.box(), scenes.plane()
    scene = scenes.scene([(mesh, scenes.IDENTITY, scenes.diffuse()) for mesh in (shared, shared, single, hidden)])
    scene.instances.visibility[3] = 1
    count = len(shared.triangles)
    assert GeometrySize.of(scene) == GeometrySize(
        count + 14, len(shared.positions) + len(single.positions) + 4, count, False, instances=4, entries=2
    )
    assert GeometrySize.of(scenes.scene()).triangles == 0


def test_instances_need_memory(device, monkeypatch):
    """Ten million of a box, which itself needs none to speak of."""
    box, count = scenes.box(), 10_000_000
    size = GeometrySize.of(scenes.scene([(box, scenes.IDENTITY, scenes.diffuse())] * 2))
    size = dataclasses.replace(size, instances=count, entries=count)
    monkeypatch.setattr(memory, "free_memory", lambda _: 10**9)
    with pytest.raises(
        OutOfMemoryError, match=r"10,000,000 instances need at least .* has 1\.00 GB free; use fewer in"
    ):
        check_memory(size, Layout.BOXES, wp.get_device(device), all_of_it=False)
    monkeypatch.setattr(memory, "free_memory", lambda _: 10**10)
    check_memory(size, Layout.BOXES, wp.get_device(device), all_of_it=False)


@pytest.mark.parametrize("where", ["geometry", "builder", "trees"])
def test_a_build_that_runs_out_of_memory(session, device, monkeypatch, where):
    """Free memory was misjudged. The session renders the next scene, and this one when there is room."""
    if where == "builder" and device != "cpu":
        pytest.skip("the host's builder is not used")
    ball = scenes.sphere(segments=64)
    before, whole = session.render(lit(scenes.sphere()), SETTINGS), session.render(lit(ball), SETTINGS)
    session.render(lit(scenes.box()), SETTINGS)

    class FullNumpy:
        def __getattr__(self, name):
            return getattr(np, name)

        def empty(self, *_arguments):
            raise MemoryError("Unable to allocate 33 GiB")

    def refuse(*_arguments, **_options):
        if where == "geometry":
            raise MemoryError("Unable to allocate 33 GiB")
        raise RuntimeError("Failed to allocate 33554432 bytes on device 'cuda:0'")

    message = r"triangles need at least .* GB with their trees, and .* GB free; use fewer"
    with monkeypatch.context() as full:
        if where == "geometry":
            full.setattr(shown_instances, "flatten", refuse)
        elif where == "builder":
            full.setattr(build_sah, "np", FullNumpy())
            message = r"the tree over \d,\d\d\d triangles could not get \d[\d,]+ bytes beside 0 that it has; close"
        else:
            full.setattr(wp, "empty", refuse)
        with pytest.raises(OutOfMemoryError, match=message):
            session.render(lit(ball), SETTINGS)
    assert_usable(session, before)
    assert np.array_equal(session.render(lit(ball), SETTINGS).passes["Combined"], whole.passes["Combined"])


def test_other_failures_of_a_build_are_not_hidden(session, monkeypatch):
    def broken(*_arguments, **_options):
        raise RuntimeError("the moon is missing")

    monkeypatch.setattr(scene_cache, "build_scene_tree", broken)
    with pytest.raises(RuntimeError, match="moon"):
        session.render(lit(scenes.sphere(segments=20)), SETTINGS)


def test_the_build_itself_refuses_what_is_not_free(device, monkeypatch):
    """Who builds trees without a session is told too."""
    for module in (build_cuda, build_sah):
        monkeypatch.setattr(module, "free_memory", lambda device: 1000)
    scene = lit(scenes.sphere())
    flat = flatten(scene)
    geometry = upload_geometry(flat, scene, wp.get_device(device))
    for layout, splits, on_device in KINDS.values() if device == "cpu" else [KINDS["device"]]:
        with pytest.raises(OutOfMemoryError, match="triangles"):
            build_scene_tree(
                flat,
                geometry,
                scene.instances.visibility,
                False,
                wp.get_device(device),
                layout,
                splits,
                False,
                on_device,
            )


def test_instances_need_memory_beside_a_budget(device, monkeypatch):
    """Where geometry is in pages the message counts them, and names the budget."""
    size = GeometrySize(1000, 600, 1000, False, instances=10_000_000, entries=10_000_000)
    on, budget = wp.get_device(device), 10**8
    needed = size.needed_paged(Layout.BOXES, on, budget)
    assert needed >= budget + 60 * size.instances
    monkeypatch.setattr(memory, "free_memory", lambda _: needed - 1)
    with pytest.raises(OutOfMemoryError, match=r"10,000,000 instances .* with a geometry budget of 0\.10 GB, and .*"):
        check_memory(size, Layout.BOXES, on, all_of_it=False, budget=budget)
    monkeypatch.setattr(memory, "free_memory", lambda _: needed)
    check_memory(size, Layout.BOXES, on, all_of_it=False, budget=budget)
