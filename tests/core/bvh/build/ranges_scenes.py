"""Things that move far while the shutter is open, and rays through the trees that they have in ranges of time."""

from dataclasses import replace

import numpy as np
import warp as wp

from raybatch_addon.core.bvh.build.scene_tree import BuiltTree, build_scene_tree
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.traverse.counts import counts_of
from raybatch_addon.core.bvh.traverse.options import TraceOptions
from raybatch_addon.core.device.devices import load_kernels
from raybatch_addon.core.rays import RayList
from raybatch_addon.core.scene.description import Frame, Mesh, Scene, Visibility
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import upload_geometry
from raybatch_addon.core.scene.motion import KEY_FLOATS, instance_maps, maps_at
from raybatch_addon.core.scene.moved import with_motion
from raybatch_addon.core.wavefront.rays import RayNeeds, allocate_rays
from raybatch_addon.core.wavefront.tracers.unbatched import trace_stage
from tests.support import scenes
from tests.support.paged_scenes import strands

RAYS = 3000
BALL = scenes.sphere(segments=12, rings=6)


def _scene(objects: list) -> Scene:
    view = scenes.camera(eye=(0, -4, 1.5), target=(0, 0, 0))
    return scenes.scene(objects, view=view, frame=Frame(16, 12), world=0.5)


def moved_by(scene: Scene, ways: np.ndarray) -> Scene:
    """`scene` with instances that move by `ways`, float, shape [n, steps, 3, 4]."""
    ways = ways.astype(np.float32)
    return replace(
        scene,
        instances=replace(scene.instances, motion=instance_maps(ways), transform=ways[:, ways.shape[1] // 2].copy()),
    )


def flying(count: int = 60, far: float = 1.0, ball: Mesh = BALL) -> Scene:
    """Balls that fly `far` times ten of their sizes, each in a direction of its own, and turn."""
    rng = np.random.default_rng(1)
    small = replace(ball, positions=0.05 * ball.positions)
    made = _scene([(small, scenes.IDENTITY, scenes.diffuse(0.6))] * count)
    ways = np.zeros((count, 3, 3, 4))
    way = rng.normal(size=(count, 1, 3))
    way *= far / np.linalg.norm(way, axis=2, keepdims=True)
    ways[..., 3] = rng.uniform(-1, 1, (count, 1, 3)) + np.array([-0.5, 0.0, 0.5])[:, None] * way
    for step, angle in enumerate((0.0, 0.9, 2.0)):
        cos, sin = np.cos(angle), np.sin(angle)
        ways[:, step, :, :3] = [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]
    return moved_by(made, ways)


def swaying(steps: int = 4, segments: bool = False) -> Scene:
    """A crowd of small triangles, or strands, that sways by more than its size; and one that is placed twice."""
    rng = np.random.default_rng(2)
    if segments:
        mesh = strands("Strands", 80)
    else:
        foot = rng.uniform(-1, 1, (800, 1, 3)) * [1, 1, 0.5]
        corners = (foot + rng.normal(size=(800, 3, 3)) * 0.03).reshape(-1, 3).astype(np.float32)
        mesh = replace(BALL, positions=corners, triangles=np.arange(2400, dtype=np.int32).reshape(-1, 3))
    at = mesh.positions
    swing = np.stack([np.sin(3 * at[:, 1]), np.cos(2 * at[:, 0]), 0 * at[:, 0]], 1)
    ways = [at + np.float32(0.5 * np.sin(2.5 * time)) * swing for time in np.linspace(-0.5, 0.5, steps)]
    moving = replace(mesh, motion=np.stack(ways).astype(np.float32))
    objects = [(moving, scenes.translation(-0.7, 0, 0), scenes.diffuse(0.6))]
    objects += [(moving, scenes.translation(0.7, 0.3, 0), scenes.diffuse(0.6))]
    objects += [(scenes.plane(size=4.0), scenes.translation(0, 0, -0.8), scenes.diffuse(0.5))]
    return _scene(objects)


def crossing(count: int = 400) -> Scene:
    """One ball that moves among many that stand still."""
    rng = np.random.default_rng(4)
    small = replace(BALL, positions=0.1 * BALL.positions)
    made = _scene([(small, scenes.IDENTITY, scenes.diffuse(0.6))] * count)
    ways = np.zeros((count, 3, 3, 4))
    ways[..., :3] = np.eye(3)
    ways[..., 3] = rng.uniform(-3, 3, (count, 1, 3))
    ways[0, :, 0, 3] = (-1, 0, 1)
    return moved_by(made, ways)


def tree_of(scene: Scene, layout: Layout, range_count: int | None) -> BuiltTree:
    """The trees of `scene` on the CPU."""
    device, flat = wp.get_device("cpu"), flatten(scene)
    geometry = upload_geometry(with_motion(flat), scene, device)
    return build_scene_tree(flat, geometry, scene.instances.visibility, True, device, layout, range_count=range_count)


def times_of(count: int) -> np.ndarray:
    """Times all over the shutter, the ends of ranges and the floats beside them among them."""
    ends = np.arange(9, dtype=np.float32) / 8
    beside = [np.nextafter(ends, np.float32(side)) for side in (-1, 2)]
    exact = np.clip(np.concatenate([ends, *beside]), 0, 1)
    found = np.random.default_rng(6).random(count, np.float32)
    found[: count // 2] = np.resize(exact, count // 2)
    return found


def rays_through(built: BuiltTree, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions of rays between points in the scene's box; half of them, where things move as a whole, go
    to where one of these is at the ray's time, from close by.
    """
    rng = np.random.default_rng(5)
    low, high = np.maximum(built.box[0], -3), np.minimum(built.box[1], 3)
    aim, origin = (low + rng.uniform(-0.1, 1.1, (RAYS, 3)) * (high - low) for _ in range(2))
    if built.tree.motion_keys.size:
        keys = built.tree.motion_keys.numpy().reshape(-1, built.tree.motion_steps, KEY_FLOATS)
        near = np.arange(0, RAYS, 2)
        for i in near:
            place = maps_at(keys[i % len(keys)][None], time[i : i + 1])[0, 0, :, 3]
            aim[i], origin[i] = place + 0.02 * rng.normal(size=3), place + 0.3 * rng.normal(size=3)
    return origin.astype(np.float32), (aim - origin).astype(np.float32)


def traced(built: BuiltTree, counted: bool = False, any_hit: bool = False) -> dict[str, np.ndarray]:
    """Hits of rays (`rays_through`), and with `counted` nodes and triangles met."""
    device = wp.get_device("cpu")
    time = times_of(RAYS)
    rays = allocate_rays(RAYS, device, RayNeeds(time=True))
    for array, values in zip((rays.origin, rays.direction, rays.time), (*rays_through(built, time), time), strict=True):
        array.assign(values)
    rays.t_max.fill_(np.inf)
    rays.visibility.fill_(int(Visibility.ALL))
    listed = RayList(
        wp.array(np.arange(RAYS), dtype=int, device=device), wp.array([RAYS], dtype=int, device=device), RAYS
    )
    counts = counts_of(RAYS, device)
    curves = bool(np.isnan(built.tree.triangles.numpy()).any())
    options = TraceOptions(any_hit=any_hit, instancing=True, motion=True, counters=counted, curves=curves)
    stage = trace_stage(built.layout, options)
    load_kernels(list(stage.kernels), device, lambda *_: None)
    stage.launch(built.tree, rays, listed, counts if counted else None)
    names = ("hit_instance",) if any_hit else ("hit_t", "hit_instance", "hit_primitive", "hit_uv")
    found = {name: getattr(rays, name).numpy().copy() for name in names}
    if counted:
        found |= {name: getattr(counts, name).numpy() for name in ("node_steps", "triangle_tests")}
    return found
