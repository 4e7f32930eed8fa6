"""A frame in which other instances are shown than in the one before: trees over all others are kept.

That is for renders too short for a tree of their own, as viewports have after an edit: what came later has trees of its
own beside those that were there, and what went leaves its triangles in them, all in one point, where no ray meets them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from ...bvh.build.mesh_tree import mesh_parts
from ...bvh.build.scene_tree import BuiltTree
from ...bvh.build.shown import follow_shown
from ...host_memory import Room
from ...scene.description import Scene
from ...scene.flatten import FlatGeometry, flatten
from ...scene.frozen import is_frozen
from ...scene.geometry import Geometry, update_instances, upload_geometry
from ...scene.grouping.following import followed, needs_refit, placed_at, refitted, with_same_members
from ...scene.grouping.groups import Group, groups_of, mesh_key
from .kept_bakes import KeptBakes

# Meshes with more triangles than these in all have no keys: to hash them takes longer than what is won
_KEYED_MOST = 1 << 23
# Trees of more than a share of all triangles are not built beside others: then all are built anew
_BUILT_SHARE = 0.5


@dataclass(frozen=True)
class ShownInstances:
    """What a frame shows, by what trees are over."""

    groups: tuple[Group, ...]
    shared: tuple[bytes, ...]  # keys of the meshes that are placed more than once, in the order of their trees

    @staticmethod
    def of(scene: Scene, keyed: bool) -> ShownInstances:
        """What `scene` shows, by itself; meshes can be told from each other if `keyed`, where that takes little."""
        keyed = keyed and _has_keys(scene)
        return ShownInstances(groups_of(scene, keyed), _shared_keys(scene) if keyed else ())

    @property
    def is_follower(self) -> bool:
        """Whether something is grouped as it is because of a frame before."""
        return any(group.is_late or not all(group.is_there) for group in self.groups)

    def refitted(self) -> ShownInstances:
        """The same after trees were refitted."""
        return ShownInstances(refitted(self.groups), self.shared)

    def at(self, transform: np.ndarray) -> ShownInstances:
        """The same after instances have moved to `transform`."""
        return ShownInstances(placed_at(self.groups, transform), self.shared)


def _has_keys(scene: Scene) -> bool:
    """Whether meshes can be told from each other for little."""
    if sum(len(mesh.triangles) for mesh in scene.meshes) > _KEYED_MOST or scene.instances.motion is not None:
        return False
    for mesh in scene.meshes:
        arrays = mesh.positions, mesh.triangles, mesh.corner_normals, mesh.triangle_slot
        if mesh.radii is not None or mesh.motion is not None:
            return False
        if not all(each is None or is_frozen(each) for each in arrays):
            return False
    return True


def _shared_keys(scene: Scene) -> tuple[bytes, ...]:
    uses = np.bincount(scene.instances.mesh, minlength=len(scene.meshes)).tolist()
    return tuple(mesh_key(m) for m, count in zip(scene.meshes, uses, strict=True) if count > 1 and len(m.triangles))


def grouped(
    scene: Scene,
    before: ShownInstances | None = None,
    *,
    bakes: KeptBakes,
    follows: bool = False,
    keyed: bool = True,
    room: Room = np.empty,
) -> tuple[ShownInstances, FlatGeometry]:
    """What `scene` shows and its geometry, grouped as in the frame `before` if it shows the same objects, or if it can
    follow one that shows others (`follows`). `keyed`: a later frame may follow this one. `room`: as for `flatten`.
    """
    now = ShownInstances.of(scene, keyed)
    groups: Sequence[Group] | None = None
    if before is not None:
        groups = with_same_members(before.groups, now.groups)
        if groups is None and follows and all(each.mesh for group in now.groups for each in group.members):
            groups = followed(before.groups, now.groups)
    if groups is not None:
        now = ShownInstances(tuple(groups), now.shared)
    bakes.begin()
    return now, flatten(scene, now.groups, bakes.get, room)


def show(
    before: ShownInstances,
    now: ShownInstances,
    built: BuiltTree,
    geometry: Geometry,
    flat: FlatGeometry,
    scene: Scene,
    device: wp.Device,
) -> Geometry | None:
    """Make `built`, the trees of what was shown `before`, those of `flat`, which shows what is there `now`, and return
    its geometry, which may be that of before. None where it is better to build all; both are as they were then.
    """
    parts, kept, changed, moved = mesh_parts(flat), dict[int, int](), set[int](), set[int]()
    if flat.motion is not None or flat.curves or any(mesh.step_units for mesh in built.meshes):
        return None
    if not built.instancing and len(parts) != 1:
        return None
    groups = {group.number: i for i, group in enumerate(before.groups)}
    for i, group in enumerate(now.groups):
        old = groups.get(group.number)
        if old is not None and _has_same_places(group, before.groups[old]):
            kept[i] = old
            if needs_refit(group, before.groups[old]):
                moved.add(i)
            elif group.is_there != before.groups[old].is_there:
                changed.add(i)
    shared = {key: len(before.groups) + i for i, key in enumerate(before.shared)}
    for i, key in enumerate(now.shared):
        if key in shared:
            kept[len(now.groups) + i] = shared[key]
    new = sum(part.triangle_count for i, part in enumerate(parts) if i not in kept)
    if new > _BUILT_SHARE * sum(part.triangle_count for part in parts):
        return None
    if changed or moved or list(kept.items()) != [(i, i) for i in range(len(built.meshes))] or len(parts) != len(kept):
        geometry = upload_geometry(flat, scene, device)
    else:
        update_instances(geometry, flat, scene)
    follow_shown(
        built, flat, geometry, scene.instances.visibility, device=device, kept=kept, changed=changed, moved=moved
    )
    return geometry


def _has_same_places(now: Group, before: Group) -> bool:
    """Whether a tree over one group may follow the other: their places have as many triangles."""
    return [each.triangle_count for each in now.members] == [each.triangle_count for each in before.members]
