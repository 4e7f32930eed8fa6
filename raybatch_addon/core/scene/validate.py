"""Checks of a scene before it is rendered, whoever made it."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from ..device.bulk import column_bounds
from ..errors import SceneError
from .description import Camera, Frame, InstanceMaps, Instances, Light, LightKind, Mesh, Scene, World
from .frozen import fact
from .motion import map_sizes
from .notice import Notice, Weight, quoted
from .passes import PASSES, is_pass

# Largest coordinate; squares of larger ones leave float32
COORDINATE_MAX = 1e18
# Least size; areas of smaller things leave the normal numbers of float32
EXTENT_MIN = 1e-18
# The passes that a film can hold
PASS_NAMES = tuple(PASSES)


def checked_scene(scene: Scene) -> Scene:
    """`scene` without parts that cannot be rendered, each named in its warnings.

    Raises `SceneError` when the camera or the frame cannot be used.
    """
    _check_camera(scene.camera)
    _check_frame(scene.frame)
    _check_indices(scene)
    warnings = _unsupported_inputs(scene)
    meshes = tuple(_with_equal_steps([_checked_mesh(mesh, warnings) for mesh in scene.meshes], warnings))
    checked = dataclasses.replace(
        scene,
        meshes=meshes,
        instances=_checked_instances(dataclasses.replace(scene, meshes=meshes), warnings),
        lights=tuple(light for light in scene.lights if _is_usable(light, warnings)),
        world=_checked_world(scene.world, warnings),
    )
    if not warnings and checked.instances is scene.instances:
        return scene
    return dataclasses.replace(checked, warnings=(*scene.warnings, *warnings))


def _unsupported_inputs(scene: Scene) -> list[str]:
    """What programs ask for that this camera does not give, by name of the material."""
    if not scene.camera.kind.is_panorama:
        return []
    names = [m.name for m in scene.materials if m.program is not None and "window_coordinates" in m.program.ops]
    return [f"material “{name}”: window coordinates are not those of a panorama" for name in names]


def _check_camera(camera: Camera) -> None:
    numbers = [
        *np.ravel(camera.transform),
        *camera.window,
        camera.clip_start,
        camera.lens_radius,
        camera.focus_distance,
    ]
    if not np.all(np.isfinite(numbers)) or np.isnan(camera.clip_end):
        raise SceneError(
            "the camera's matrix or lens is not finite; reset its transform and check its constraints and drivers"
        )
    if np.abs(camera.transform).max() > COORDINATE_MAX:
        raise SceneError(
            f"the camera is more than {COORDINATE_MAX:g} m away from the origin; reset its location and check its "
            "constraints and drivers"
        )
    if abs(np.linalg.det(np.asarray(camera.transform, np.float64)[:, :3])) < 1e-3:
        raise SceneError("the camera's matrix is singular; set its scale (and its parents') to 1")
    if camera.lens_radius > 0 and not (camera.focus_distance > 0 and camera.lens_ratio > 0):
        raise SceneError(
            "the camera's focus distance or aperture ratio is 0; give it one above 0, or switch depth of field off"
        )
    if camera.kind.is_panorama and camera.panorama is not None:
        fields = dataclasses.astuple(camera.panorama)
        if not all(np.all(np.isfinite(value)) for value in fields) or not camera.panorama.focal_length > 0:
            raise SceneError("the camera's panorama is not finite or has a focal length of 0; reset its settings")
    for moved in (camera.motion, camera.window_motion, camera.shutter.times):
        if moved is not None and (len(moved) < 2 or not np.isfinite(moved).all()):
            raise SceneError("the camera's motion or shutter is not finite; check what it follows while it is open")
    if camera.stereo is not None and not (np.isfinite(camera.stereo.offset) and camera.stereo.convergence_distance > 0):
        raise SceneError("the camera's stereoscopy is not finite, or converges at 0; reset its distances")
    left, right, bottom, top = camera.window
    if not (left != right and bottom != top):
        raise SceneError("the camera's window has no area; check its focal length or orthographic scale")


def _check_frame(frame: Frame) -> None:
    x0, y0, x1, y1 = frame.region
    if not (0 <= x0 < x1 <= frame.width and 0 <= y0 < y1 <= frame.height):
        raise SceneError(
            f"the rendered region {frame.region} is not inside the frame of {frame.width} x {frame.height} pixels"
        )
    unknown = [name for name in frame.passes if not is_pass(name)]
    if unknown or "Combined" not in frame.passes:
        raise SceneError(
            f"the passes {', '.join(frame.passes)} cannot be rendered: choose Combined and any of "
            f"{', '.join(PASS_NAMES)}"
        )


def _check_indices(scene: Scene) -> None:
    """Raise `SceneError` for an index out of range: kernels trust indices, and a scene may be damaged or hand-made."""
    instances, slots = scene.instances, scene.slot_materials
    if len(instances) == 0:
        return
    if not _within(instances.mesh, len(scene.meshes)):
        raise SceneError("an instance names a mesh that does not exist; export the scene again")
    if not _within(slots, len(scene.materials)):
        raise SceneError("a material slot names a material that does not exist; export the scene again")
    slot_counts = np.array(
        [
            1 if mesh.triangle_slot is None or not len(mesh.triangle_slot) else fact(mesh.triangle_slot, _range)[1] + 1
            for mesh in scene.meshes
        ]
    )
    filled = np.array([len(mesh.triangles) > 0 for mesh in scene.meshes])
    needed = np.where(filled, slot_counts, 0)[instances.mesh]
    bad = np.flatnonzero((instances.slot_first < 0) | (instances.slot_first + needed > len(slots)))
    if len(bad):
        raise SceneError(
            f"object “{_object_name(scene, bad[0])}” has faces of a material slot that does not exist; export the "
            "scene again"
        )


def _within(indices: np.ndarray, count: int) -> bool:
    return not len(indices) or (int(indices.min()) >= 0 and int(indices.max()) < count)


def _object_name(scene: Scene, instance: int) -> str:
    index = int(scene.instances.object[instance]) if len(scene.instances.object) > instance else -1
    return scene.object_names[index] if 0 <= index < len(scene.object_names) else f"instance {instance}"


def _is_usable(light: Light, warnings: list[str]) -> bool:
    numbers = [
        *np.ravel(light.transform).tolist(),
        *light.emission,
        *light.size,
        *light.spot_scale,
        light.radius,
        light.angle,
        light.spread,
        light.blend,
    ]
    for asked in (light.object_transform, light.info, light.attributes):  # values that its program reads
        numbers += [] if asked is None else np.ravel(asked).tolist()
    if all(map(math.isfinite, numbers)) and min(light.emission) >= 0:
        return True
    warnings.append(
        f"light “{light.name}” has a place, size or power that is not finite, or a negative power: it is not rendered"
    )
    return False


def _checked_world(world: World, warnings: list[str]) -> World:
    usable = tuple(portal for portal in world.portals if _is_usable(portal, warnings))
    if len(usable) < len(world.portals):
        world = dataclasses.replace(world, portals=usable)
    for portal in usable:
        if portal.kind not in (LightKind.RECTANGLE, LightKind.ELLIPSE):
            raise SceneError(f"portal “{portal.name}” is a {portal.kind.name}: portals are rectangles or ellipses")
        if world.program is None:
            raise SceneError(f"portal “{portal.name}”: the world has no program, so its light is not sampled")
    if world.sun is not None:
        length = float(np.linalg.norm(world.sun.direction))
        if not (abs(length - 1.0) < 1e-3 and 0.0 < world.sun.size <= math.pi):
            raise SceneError("the sun of the world: its direction is no unit vector, or its size not within 0 to pi")
    if np.all(np.isfinite(world.radiance)) and min(world.radiance) >= 0:
        return world
    warnings.append("the world's colour or strength is negative or not finite: the world is rendered black")
    return dataclasses.replace(world, radiance=(0.0, 0.0, 0.0))


def _checked_mesh(mesh: Mesh, warnings: list[str]) -> Mesh:
    """`mesh`, or one without triangles in its place."""
    reason = None
    if len(mesh.triangles):
        first, last = fact(mesh.triangles, _range)
        if first < 0 or last >= len(mesh.positions):
            reason = "has faces with vertices that do not exist"
        elif not fact(mesh.positions, _is_finite):
            reason = "has vertices that are not finite"
        elif np.abs(fact(mesh.positions, box_of)).max() > COORDINATE_MAX:
            reason = f"has coordinates beyond {COORDINATE_MAX:g} m"
        elif mesh.triangle_slot is not None and (
            mesh.triangle_slot.shape != (len(mesh.triangles),) or fact(mesh.triangle_slot, _range)[0] < 0
        ):
            reason = "has material slots that do not belong to its faces"
        elif mesh.radii is not None and not (
            mesh.radii.shape == (len(mesh.positions),)
            and fact(mesh.radii, _is_finite)
            and 0 <= mesh.radii.min() <= mesh.radii.max() <= COORDINATE_MAX
        ):
            reason = "has radii that do not belong to its points, or are negative or not finite"
        elif mesh.corner_normals is not None and mesh.corner_normals.shape != (len(mesh.triangles), 3, 3):
            reason = "has normals that do not belong to its faces"
        elif not all(_belongs(attribute.values, len(mesh.triangles)) for attribute in mesh.attributes):
            reason = "has attributes that do not belong to its faces, or are not finite"
    if reason is None:
        return _with_usable_motion(mesh, warnings)
    warnings.append(f"mesh “{mesh.name}” {reason}: it is not rendered")
    return Mesh(mesh.name, np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))


def _with_usable_motion(mesh: Mesh, warnings: list[str]) -> Mesh:
    """`mesh`, which stands still where its vertices cannot be followed."""
    if mesh.motion is None:
        return mesh
    shape, normals = mesh.motion.shape, mesh.motion_normals
    good = len(shape) == 3 and shape[0] >= 2 and shape[1:] == mesh.positions.shape
    good = good and np.isfinite(mesh.motion).all() and np.abs(mesh.motion).max(initial=0) <= COORDINATE_MAX
    if normals is not None:
        good = good and mesh.corner_normals is not None and normals.shape == (shape[0], *mesh.corner_normals.shape)
    if good:
        return mesh
    warnings.append(f"mesh “{mesh.name}” moves to places that are not finite or not its own: it stands still")
    return dataclasses.replace(mesh, motion=None, motion_normals=None)


def _with_equal_steps(meshes: list[Mesh], warnings: list[str]) -> list[Mesh]:
    """`meshes`, of which those stand still that have not as many steps as most of those that move: kernels read the
    same number of all of them.
    """
    counts = [len(mesh.motion) for mesh in meshes if mesh.motion is not None]
    if len(set(counts)) < 2:
        return meshes
    usual = max(sorted(set(counts)), key=counts.count)
    result = []
    for mesh in meshes:
        if mesh.motion is not None and len(mesh.motion) != usual:
            warnings.append(
                f"mesh “{mesh.name}” moves in {len(mesh.motion)} steps where others have {usual}: it stands still"
            )
            mesh = dataclasses.replace(mesh, motion=None, motion_normals=None)
        result.append(mesh)
    return result


def _with_usable_maps(scene: Scene, warnings: list[str]) -> Instances:
    """The instances of `scene`, of which those stand still whose motion is not finite or comes too far."""
    instances = scene.instances
    for name, what in (("motion", "motion"), ("frames", "motion between frames")):
        moved = getattr(instances, name)
        if moved is None:
            continue
        if not _belong(moved, len(instances)):
            warnings.append(f"the {what} of objects does not belong to them: they stand still")
            instances = _with_maps(instances, name, None)
            continue
        with np.errstate(invalid="ignore"):
            good = (np.abs(moved.maps) <= COORDINATE_MAX).all((1, 2, 3))
        if not good.all():
            names = [_object_name(scene, i) for i in moved.instance[~good].tolist()]
            text = (
                f"objects {quoted(names)}: the {what} leads to places that are not finite or too far: they stand still"
            )
            warnings.append(Notice(text, Weight.REPAIRED, objects=dict.fromkeys(names)))
            kept = InstanceMaps(moved.instance[good], moved.maps[good])
            instances = _with_maps(instances, name, kept)
    return instances


def _with_regular_places(instances: Instances) -> Instances:
    """`instances`, of which those that move and have no inverse in the middle are where they have one, at the step that
    is nearest to it: what is asked of their place is finite. Their motion is as it was.
    """
    motion = instances.motion
    if motion is None or not len(motion.instance):
        return instances
    flat = np.flatnonzero(~_is_regular(instances.transform[motion.instance]))
    if not len(flat):
        return instances
    steps = motion.maps.shape[1]
    order = np.argsort(np.abs(np.arange(steps) - (steps - 1) / 2), kind="stable")
    usable = _is_regular(motion.maps[flat])[:, order]
    some = usable.any(1)
    transform = instances.transform.copy()
    transform[motion.instance[flat[some]]] = motion.maps[flat[some], order[usable[some].argmax(1)]]
    return dataclasses.replace(instances, transform=transform)


def _is_regular(maps: np.ndarray) -> np.ndarray:
    """Whether maps [..., 3, 4] are finite and have an inverse: bool, shape [...]."""
    finite, _, regular = map_sizes(maps)
    return finite & regular


def _with_maps(instances: Instances, name: str, maps: InstanceMaps | None) -> Instances:
    """`instances` whose field `name`, motion or frames, is `maps`."""
    changes: dict[str, Any] = {name: maps}
    return dataclasses.replace(instances, **changes)


def _belong(moved: InstanceMaps, count: int) -> bool:
    """Whether these are maps of some of `count` instances, at two times or more."""
    if not isinstance(moved, InstanceMaps):
        return False
    which, maps = moved.instance, moved.maps
    if which.ndim != 1 or maps.ndim != 4 or len(maps) != len(which) or maps.shape[1] < 2 or maps.shape[2:] != (3, 4):
        return False
    return bool((np.diff(which) > 0).all()) and (len(which) == 0 or 0 <= which[0] <= which[-1] < count)


def _belongs(values: np.ndarray, triangle_count: int) -> bool:
    """Whether an attribute's values are finite, one for each triangle or each of its corners, of 1 to 4 numbers."""
    shape = values.shape
    return shape[:-1] in ((triangle_count,), (triangle_count, 3)) and 1 <= shape[-1] <= 4 and fact(values, _is_finite)


def box_of(points: np.ndarray) -> np.ndarray:
    """Least and greatest coordinates of `points`, shape [n, 3] with n >= 1: shape [2, 3]."""
    return np.stack(column_bounds(points))


def _range(indices: np.ndarray) -> tuple[int, int]:
    return int(indices.min()), int(indices.max())


def _is_finite(values: np.ndarray) -> bool:
    return bool(np.isfinite(values).all())


def _checked_instances(scene: Scene, warnings: list[str]) -> Instances:
    if len(scene.instances) == 0:
        return scene.instances
    instances = _with_regular_places(_with_usable_maps(scene, warnings))
    finite, scales, regular = map_sizes(instances.transform)
    reach, size = (values[instances.mesh] for values in _mesh_extents(scene.meshes))
    near = (reach * scales[:, 0] <= COORDINATE_MAX) & (np.abs(instances.transform).max((1, 2)) <= COORDINATE_MAX)
    # in the world, and for meshes that stay in object space also there
    shared = np.bincount(instances.mesh)[instances.mesh] > 1
    extent = size * np.where(shared, np.minimum(scales[:, 0], 1), scales[:, 0])
    large = (extent >= EXTENT_MIN) | (size == 0)
    # ... and the scene's reach, seen from object space
    placed = finite & regular & near
    camera = float(np.abs(scene.camera.transform[:, 3]).max())
    scene_reach = max(
        camera,
        float((np.abs(instances.transform[placed, :, 3]).max(1) + (reach * scales[:, 0])[placed]).max(initial=0)),
    )
    with np.errstate(divide="ignore", over="ignore"):
        within = ~shared | (scene_reach / scales[:, 2] <= COORDINATE_MAX)
    keep = placed & large & within
    reasons = (
        (finite, "a matrix that is not finite"),
        (near, f"coordinates beyond {COORDINATE_MAX:g} m"),
        (regular, "a matrix that is flat or zero"),
        (large, f"an extent below {EXTENT_MIN:g} m"),
        (within, f"a scale so small that the scene reaches beyond {COORDINATE_MAX:g} m in its own space"),
    )
    for i in np.flatnonzero(~keep).tolist():
        why = next(why for good, why in reasons if not good[i])
        text = f"object “{_object_name(scene, i)}” has {why}: it is not rendered"
        if text not in warnings:
            warnings.append(text)
    return instances if keep.all() else kept_instances(instances, keep)


def kept_instances(instances: Instances, keep: np.ndarray) -> Instances:
    """Those of `instances` that are among `keep`, bool, shape [n]."""
    names = (field.name for field in dataclasses.fields(Instances))
    columns: dict[str, Any] = {name: _kept(getattr(instances, name), keep) for name in names}
    return Instances(**columns)


def _kept(column: np.ndarray | InstanceMaps | None, keep: np.ndarray) -> np.ndarray | InstanceMaps | None:
    """A column of `Instances` without the instances that are not among `keep`."""
    if isinstance(column, InstanceMaps):
        left = keep[column.instance]
        return InstanceMaps((np.cumsum(keep) - 1)[column.instance[left]].astype(np.int32), column.maps[left])
    return None if column is None else column[keep]


def _mesh_extents(meshes: tuple[Mesh, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Largest coordinate and longest side of the box of each mesh, float64; 0 where there are no triangles."""
    extents = np.zeros((2, len(meshes)))
    for index, mesh in enumerate(meshes):
        if len(mesh.triangles):
            low, high = fact(mesh.positions, box_of).astype(np.float64)
            extents[:, index] = np.abs([low, high]).max(), (high - low).max()
    return extents[0], extents[1]
