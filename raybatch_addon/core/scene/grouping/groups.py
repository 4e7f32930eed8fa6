"""Groups of baked instances that share a tree: all that rays see alike, at first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...device.bulk import digest_of
from ..description import Mesh, Scene
from ..frozen import fact
from ..linking import RAY_BITS
from ..motion import apart


@dataclass(frozen=True)
class Member:
    """A baked instance in its group, or the place that one has left."""

    instance: int  # its id; -1: it is not there
    name: str  # of its object
    mesh: bytes  # `mesh_key` of its mesh; empty: not known
    place: bytes  # its map
    point: tuple[float, float, float]  # of its mesh in the world, at which all of an empty place lies [m]
    vertex_count: int
    triangle_count: int


@dataclass(frozen=True)
class Group:
    """Baked instances that share a tree."""

    number: int  # which it keeps from frame to frame
    visibility: int  # `Visibility` bits, which all of them share
    members: tuple[Member, ...]  # in the order of their triangles
    is_late: bool = False  # what is in it came behind the others
    is_refitted: bool = (
        False  # its tree was refitted since places in it are empty: boxes have no room for what was there
    )

    @property
    def is_there(self) -> list[bool]:
        """Whether each member is there."""
        return [each.instance >= 0 for each in self.members]


def baked_instances(scene: Scene) -> np.ndarray:
    """Which instances lie in world space: bool, shape [n]."""
    instances = scene.instances
    if not len(instances):
        return np.zeros(0, bool)
    uses = np.bincount(instances.mesh, minlength=len(scene.meshes))
    filled = np.array([len(mesh.triangles) > 0 for mesh in scene.meshes], bool)
    return filled[instances.mesh] & (uses[instances.mesh] == 1) & ~apart(scene)


def groups_of(scene: Scene, keyed: bool = False) -> tuple[Group, ...]:
    """The groups of a scene by itself; keys of meshes are known if `keyed`."""
    instances, baked = scene.instances, baked_instances(scene)
    seen = instances.visibility & RAY_BITS
    groups = []
    for number, visibility in enumerate(sorted(set(seen[baked].tolist()), reverse=True)):
        members = np.flatnonzero(baked & (seen == visibility)).tolist()
        groups.append(Group(number, visibility, tuple(_member(scene, i, keyed) for i in members)))
    return tuple(groups)


def _member(scene: Scene, instance: int, keyed: bool) -> Member:
    mesh, transform = scene.meshes[scene.instances.mesh[instance]], scene.instances.transform[instance]
    point = transform[:, :3] @ mesh.positions[0] + transform[:, 3]
    number = int(scene.instances.object[instance])
    return Member(
        instance,
        scene.object_names[number] if 0 <= number < len(scene.object_names) else "",
        mesh_key(mesh) if keyed else b"",
        transform.tobytes(),
        tuple(point.tolist()),
        len(mesh.positions),
        len(mesh.triangles),
    )


def mesh_key(mesh: Mesh) -> bytes:
    """Bytes that are equal for meshes alone that are the same to trees and to geometry on the device."""
    arrays = mesh.positions, mesh.triangles, mesh.corner_normals, mesh.triangle_slot
    return b"".join(b"-" if each is None else fact(each, _digest) for each in arrays)


def _digest(array: np.ndarray) -> bytes:
    return digest_of([array])
