"""Surfaces of volumes apart from the trees that rays are traced in: which are around a point, and which of them lie so
close together that a ray passes them at once.

A ray that goes on behind a surface begins beyond the error of its point there, and meets nothing before. So it does not
meet the faces of other volumes that coincide with that surface, and they are looked for here.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import warp as wp

from ...float32 import UNIT_ROUNDOFF
from ...native.structs import to_numpy
from ...scene.description import Camera, CameraKind, Mesh, Scene
from ...scene.frozen import fact
from ...scene.geometry import Geometry, corners_of, mat34, transform_point, transform_vector
from ...scene.motion import apart
from ...scene.moved import inverse_at, motion_row, positions_at

# A direction that lies along no axis, in which surfaces around a point are looked for
AHEAD = (0.436, 0.218, 0.873)
# As far as anything is looked for, where nothing ends the way [m]
FARTHEST = 1e30
# Half the edge of a box around what moves [m], whose area is still a number of float32
_EVERYWHERE = 1e15
# Roundings of the distance between a point and a plane, and of carrying the point to the object
_ROUNDINGS = 16.0
# Cosine of the angle between faces that may coincide, at least
_PARALLEL = 0.1
# How many times as far as the next ray begins from a surface others belong to it
_REACHES = 2.0
# Enclosures that are looked up together
NEAR_MOST = 8
# Surfaces at most among which those near to others are looked for
_PAIRED_MOST = 4096


@wp.struct
class Enclosure:
    """The part of the surface of an instance that bounds one volume."""

    tree: wp.uint64  # `wp.Bvh` of its triangles, wherever they are while the shutter is open, in object space
    first: int  # of its triangles in `Enclosures.triangles`
    instance: int
    code: int  # see `MediaState.inside`
    to_object: mat34  # world to object, where it does not move


@wp.struct
class Enclosures:
    """Surfaces of volumes that may be around the camera, or may coincide with others."""

    of: wp.array(dtype=Enclosure)
    triangles: wp.array(dtype=int)  # primitives of their meshes
    tree: wp.uint64  # `wp.Bvh` of their boxes in the world
    touching: int  # 1: some may coincide


@wp.func
def _inverse_of(geometry: Geometry, enclosure: Enclosure, time: float) -> mat34:
    row = motion_row(geometry, enclosure.instance)
    if row >= 0:
        return inverse_at(geometry, row, time)
    return enclosure.to_object


@wp.func
def _corners_at(
    geometry: Geometry, triangles: wp.array(dtype=int), enclosure: Enclosure, item: int, origin: wp.vec3, time: float
) -> tuple[wp.vec3, wp.vec3, wp.vec3]:
    """Corners of a triangle as seen from `origin`, in object space [m]."""
    mesh = geometry.instance_mesh[enclosure.instance]
    triangle = geometry.mesh_triangle_first[mesh] + triangles[enclosure.first + item]
    a, b, c = positions_at(geometry, mesh, corners_of(geometry, triangle), time)
    return a - origin, b - origin, c - origin


@wp.func
def _side(a: wp.vec3, b: wp.vec3, c: wp.vec3, direction: wp.vec3) -> int:
    """1 and -1: a line through 0 passes a triangle from its front or back; 0: it does not. A line through an edge
    passes each of its triangles.
    """
    u = wp.dot(direction, wp.cross(a, b))
    v = wp.dot(direction, wp.cross(b, c))
    w = wp.dot(direction, wp.cross(c, a))
    if u >= 0.0 and v >= 0.0 and w >= 0.0 and u + v + w > 0.0:
        return -1
    if u <= 0.0 and v <= 0.0 and w <= 0.0 and u + v + w < 0.0:
        return 1
    return 0


@wp.func
def enclosures_near(enclosures: Enclosures, low: wp.vec3, high: wp.vec3, after: int, near: wp.array(dtype=int)) -> int:
    """Write the numbers of the enclosures whose boxes meet the box from `low` to `high` [m] to `near`, an array of
    `NEAR_MOST`: the least that are larger than `after`, ascending. How many there are.

    On CUDA a block has one stack for queries, so that none may be made while another goes on.
    """
    count = int(0)
    number = int(0)
    query = wp.bvh_query_aabb(enclosures.tree, low, high)
    while wp.bvh_query_next(query, number):
        at = int(-1)
        if number > after:
            at = wp.min(count, wp.static(NEAR_MOST - 1))
            if count == wp.static(NEAR_MOST) and number > near[at]:
                at = int(-1)
        if at >= 0:
            while at > 0 and near[wp.max(at - 1, 0)] > number:
                near[at] = near[at - 1]
                at = at - 1
            near[at] = number
            count = wp.min(count + 1, wp.static(NEAR_MOST))
    return count


@wp.func
def is_around(geometry: Geometry, enclosures: Enclosures, number: int, point: wp.vec3, time: float) -> bool:
    """Whether a point of the world is in a closed surface: a ray from there meets its back first."""
    enclosure = enclosures.of[number]
    to_object = _inverse_of(geometry, enclosure, time)
    origin = transform_point(to_object, point)
    ahead = wp.normalize(wp.vec3(wp.static(AHEAD[0]), wp.static(AHEAD[1]), wp.static(AHEAD[2])))
    direction = wp.normalize(transform_vector(to_object, ahead))
    nearest = float(wp.static(FARTHEST))
    inside = bool(False)
    item = int(0)
    query = wp.bvh_query_ray(enclosure.tree, origin, direction)
    while wp.bvh_query_next(query, item):
        a, b, c = _corners_at(geometry, enclosures.triangles, enclosure, item, origin, time)
        side = _side(a, b, c, direction)
        if side != 0:
            normal = wp.cross(b - a, c - a)
            t = wp.dot(normal, a) / wp.dot(normal, direction)
            if t >= 0.0 and t < nearest:
                nearest = t
                inside = side < 0
    return inside


@wp.func
def passed_at_once(
    geometry: Geometry,
    enclosures: Enclosures,
    number: int,
    point: wp.vec3,
    direction: wp.vec3,
    reach: float,
    time: float,
) -> wp.vec2i:
    """How many faces of an enclosure lie where a ray passes a surface at `point` of the world, and how many more of
    these it meets from the front than from the back.

    `direction`: unit, across the surface to the side where the ray goes on; `reach`: how far from it the next ray
    begins [m].
    """
    enclosure = enclosures.of[number]
    to_object = _inverse_of(geometry, enclosure, time)
    origin = transform_point(to_object, point)
    across = transform_vector(to_object, direction)
    length = wp.length(across)
    carried = float(0.0)
    for axis in range(3):
        size = wp.abs(to_object[axis, 3])
        for k in range(3):
            size += wp.abs(to_object[axis, k] * point[k])
        carried = wp.max(carried, size)
    window = wp.static(_REACHES) * reach * length + wp.static(_ROUNDINGS * UNIT_ROUNDOFF) * carried
    around = wp.vec3(window, window, window)
    found = wp.vec2i(0, 0)
    item = int(0)
    query = wp.bvh_query_aabb(enclosure.tree, origin - around, origin + around)
    while wp.bvh_query_next(query, item):
        a, b, c = _corners_at(geometry, enclosures.triangles, enclosure, item, origin, time)
        normal = wp.cross(b - a, c - a)
        size = wp.length(normal)
        facing = wp.dot(normal, across)
        if size > 0.0 and wp.abs(facing) > wp.static(_PARALLEL) * size * length:
            farthest = wp.max(wp.length(a), wp.max(wp.length(b), wp.length(c)))
            rounding = wp.static(_ROUNDINGS * UNIT_ROUNDOFF) * (carried + farthest) * size
            if wp.abs(wp.dot(normal, a)) <= wp.static(_REACHES) * reach * wp.abs(facing) + rounding:
                side = _side(a, b, c, across)
                if side != 0:
                    found += wp.vec2i(1, side)
    return found


# --- on the host


@dataclass
class UploadedEnclosures:
    """Surfaces of volumes, and what keeps them in memory."""

    data: Enclosures
    kept: list[wp.Bvh]


@dataclass(frozen=True)
class BoundedPart:
    """One volume of one instance, before it is uploaded."""

    instance: int
    volume: int
    moves: bool  # the instance or its vertices do
    box: np.ndarray  # in the world, around that of the mesh: two corners [m], float64, shape [2, 3]


def upload_enclosures(
    scene: Scene, volume_of: np.ndarray, volume_count: int, geometry: Geometry, device: wp.Device
) -> UploadedEnclosures:
    """Surfaces of the volumes of `scene` that may be around a point from which the camera looks, or touch another.

    `volume_of`: volume of each material, -1: none. `geometry`: that of `scene`.
    """
    slots = VolumeSlots(scene, volume_of)
    bounded = [each for instance in range(len(scene.instances)) for each in slots.of_instance(instance)]
    data = Enclosures()
    data.of = wp.zeros(0, dtype=Enclosure, device=device)
    if not bounded:
        return UploadedEnclosures(data, [])
    boxes = np.array([each.box for each in bounded])
    moves = np.array([each.moves for each in bounded])
    boxes[moves] = np.array([[-_EVERYWHERE], [_EVERYWHERE]])
    middle, reach = _camera_points(scene.camera)
    # for most, boxes of boxes show that they are alone
    for k in np.flatnonzero((_overlaps(boxes) | _around(boxes, middle, reach)) & ~moves):
        boxes[k] = slots.exact_box(bounded[k])
    touches = _overlaps(boxes) | np.array([slots.meets_itself(each) for each in bounded])
    needed = np.flatnonzero(touches | _around(boxes, middle, reach))
    if not len(needed):
        return UploadedEnclosures(data, [])
    # what is in world space already is placed by the identity
    placed = to_numpy(geometry.instance_transform)
    trees: dict[tuple[int, int], tuple[wp.Bvh, int]] = {}
    triangles: list[np.ndarray] = []
    table = np.zeros(len(needed), Enclosure.numpy_dtype())
    for row, each in zip(table, (bounded[k] for k in needed)):
        placing = np.asarray(placed[each.instance], np.float64)
        baked = not each.moves and np.array_equal(placing, np.eye(3, 4))
        key = (each.instance, each.volume) if baked else slots.key(each)
        if key not in trees:
            primitives = slots.triangles(each)
            low, high = slots.triangle_boxes(each, primitives, baked)
            tree = wp.Bvh(*(wp.array(corner, dtype=wp.vec3, device=device) for corner in (low, high)))
            trees[key] = tree, sum(map(len, triangles))
            triangles.append(primitives)
        tree, first = trees[key]
        row["tree"], row["first"], row["instance"] = tree.id, first, each.instance
        row["code"] = 1 + each.instance * volume_count + each.volume
        if abs(np.linalg.det(placing[:, :3])) > 0:
            inverse = np.linalg.inv(placing[:, :3])
            row["to_object"] = np.column_stack([inverse, -inverse @ placing[:, 3]])
    data.of = wp.array(table, dtype=Enclosure, device=device)
    data.triangles = wp.array(np.concatenate(triangles), dtype=int, device=device)
    low, high = (_rounded(boxes[needed, side], side) for side in (0, 1))
    whole = wp.Bvh(*(wp.array(corner, dtype=wp.vec3, device=device) for corner in (low, high)))
    data.tree = whole.id
    data.touching = int(touches.any())
    return UploadedEnclosures(data, [whole, *(tree for tree, _ in trees.values())])


class VolumeSlots:
    """Which triangles of meshes bound which volumes."""

    def __init__(self, scene: Scene, volume_of: np.ndarray):
        self._scene, self._volume_of = scene, volume_of
        self._moves = apart(scene) if len(scene.instances) else np.zeros(0, bool)
        self._slot_counts: dict[int, int] = {}  # by mesh
        self._meets: dict[int, bool] = {}  # by mesh
        self._boxes: dict[int, np.ndarray] = {}  # by instance

    def _mesh(self, instance: int) -> Mesh:
        return self._scene.meshes[int(self._scene.instances.mesh[instance])]

    def _volumes(self, instance: int) -> np.ndarray:
        """Volume of each material slot of an instance."""
        mesh, index = self._mesh(instance), int(self._scene.instances.mesh[instance])
        if index not in self._slot_counts:
            self._slot_counts[index] = 1 if mesh.triangle_slot is None else int(mesh.triangle_slot.max()) + 1
        first = int(self._scene.instances.slot_first[instance])
        return self._volume_of[self._scene.slot_materials[first : first + self._slot_counts[index]]]

    def of_instance(self, instance: int) -> list[BoundedPart]:
        """The volumes of an instance that some triangle bounds."""
        mesh = self._mesh(instance)
        if len(mesh.triangles) == 0 or mesh.radii is not None:
            return []
        volumes = self._volumes(instance)
        if (volumes < 0).all():
            return []
        used = volumes if mesh.triangle_slot is None else volumes[np.unique(mesh.triangle_slot)]
        box = self._placed(instance, fact(mesh.positions, box_corners))
        return [BoundedPart(instance, v, bool(self._moves[instance]), box) for v in sorted(set(used.tolist()) - {-1})]

    def exact_box(self, each: BoundedPart) -> np.ndarray:
        """The smallest box of an instance, as in `BoundedPart`."""
        if each.instance not in self._boxes:
            self._boxes[each.instance] = self._placed(each.instance, self._mesh(each.instance).positions)
        return self._boxes[each.instance]

    def _placed(self, instance: int, positions: np.ndarray) -> np.ndarray:
        """The box of `positions` of object space in the world."""
        transform = np.asarray(self._scene.instances.transform[instance], np.float64)
        placed = positions @ transform[:, :3].T + transform[:, 3]
        return np.stack([placed.min(0), placed.max(0)])

    def key(self, each: BoundedPart) -> tuple:
        """Equal for parts of instances that are the same triangles of one mesh."""
        return int(self._scene.instances.mesh[each.instance]), (self._volumes(each.instance) == each.volume).tobytes()

    def triangles(self, each: BoundedPart) -> np.ndarray:
        """Primitives of the mesh that bound a volume, int32."""
        mesh = self._mesh(each.instance)
        if mesh.triangle_slot is None:
            return np.arange(len(mesh.triangles), dtype=np.int32)
        of_triangle = self._volumes(each.instance)[mesh.triangle_slot]
        return np.flatnonzero(of_triangle == each.volume).astype(np.int32)

    def triangle_boxes(self, each: BoundedPart, primitives: np.ndarray, baked: bool) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest corners of triangles, in the world where they are `baked`: float32, shape [n, 3]."""
        mesh = self._mesh(each.instance)
        steps = [mesh.positions] if mesh.motion is None else list(mesh.motion)
        corners = np.concatenate([np.asarray(step, np.float64)[mesh.triangles[primitives]] for step in steps], 1)
        transform = np.asarray(self._scene.instances.transform[each.instance], np.float64)
        if baked:
            corners = corners @ transform[:, :3].T + transform[:, 3]
        return _rounded(corners.min(1), 0), _rounded(corners.max(1), 1)

    def meets_itself(self, each: BoundedPart) -> bool:
        """Whether some vertices of a mesh lie in one place, as where parts of it stand side by side."""
        index = int(self._scene.instances.mesh[each.instance])
        if index not in self._meets:
            self._meets[index] = fact(self._scene.meshes[index].positions, _share_places)
        return self._meets[index]


def box_corners(positions: np.ndarray) -> np.ndarray:
    """Corners of the box of `positions`, float64, shape [8, 3]."""
    low, high = positions.min(0).astype(np.float64), positions.max(0).astype(np.float64)
    return np.array(list(itertools.product(*zip(low, high))))


def _around(boxes: np.ndarray, middle: np.ndarray, reach: float) -> np.ndarray:
    """Whether each of `boxes` [n, 2, 3] may hold a point of a sphere: bool, shape [n]."""
    return ((boxes[:, 0] <= middle + reach) & (boxes[:, 1] >= middle - reach)).all(1)


def _share_places(positions: np.ndarray) -> bool:
    """Whether some of `positions`, float32, shape [n, 3], are the same."""
    rows = np.ascontiguousarray(positions + np.float32(0)).view("V12").ravel()  # -0 becomes 0
    return len(np.unique(rows)) < len(rows)


def _rounded(corners: np.ndarray, side: int) -> np.ndarray:
    """`corners` of boxes, a little farther out (`side` 0: the lower ones), float32."""
    away = np.where(side, 1.0, -1.0) * 8 * UNIT_ROUNDOFF * np.abs(corners)
    return (corners + away).astype(np.float32)


def _overlaps(boxes: np.ndarray) -> np.ndarray:
    """Whether each of `boxes` [n, 2, 3] touches another, to the rounding of its corners: bool, shape [n]."""
    if len(boxes) > _PAIRED_MOST:
        return np.ones(len(boxes), bool)
    margin = 64 * UNIT_ROUNDOFF * np.abs(boxes).max(1)
    low, high = boxes[:, 0] - margin, boxes[:, 1] + margin
    return np.array([np.count_nonzero(((low <= h) & (high >= lo)).all(1)) > 1 for lo, h in zip(low, high)], bool)


def _camera_points(camera: Camera) -> tuple[np.ndarray, float]:
    """A sphere that holds the origins of all rays of `camera`, whenever they start: its centre and radius [m]."""
    windows = np.array([camera.window, *(() if camera.window_motion is None else camera.window_motion)], np.float64)
    window = float(np.hypot(np.abs(windows[:, :2]).max(), np.abs(windows[:, 2:]).max()))
    reach = camera.lens_radius * max(1.0, 1.0 / camera.lens_ratio)
    if camera.kind == CameraKind.ORTHOGRAPHIC:
        reach += window + camera.clip_start
    else:
        reach += camera.clip_start * float(np.hypot(1.0, window))
    if camera.stereo is not None:
        reach += abs(camera.stereo.offset)
    steps = [camera.transform] if camera.motion is None else [camera.transform, *camera.motion]
    places = np.array(steps, np.float64)[:, :, 3]
    middle = places.mean(0)
    return middle, reach + float(np.linalg.norm(places - middle, axis=1).max())
