"""Emitters of a scene, and how bright each is. Host side, NumPy only.

Emitters are numbered: first the lights without mesh, in the scene's order, then cells of volumes, then the emissive
triangles, sorted by instance and then by primitive.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...device.bulk import in_slices
from ...errors import SceneError
from ...scene.description import ClosureKind, Light, LightKind, Material, Scene
from ...scene.features import scene_volumes
from ...scene.frozen import fact, freeze
from ...scene.linking import light_rays
from ...scene.motion import apart
from ...scene.validate import box_of

# Rounding of cosines that come from sines: where lights are chosen, a cone counts as so much wider
COSINE_ERROR = 1e-3

# `LightRecord.kind` of a cell of a volume, beside those of `LightKind`
CELL = -1

# Entries of a temporary [instances of one mesh, triangles] block that a thread computes areas of: 4 MB of float64
_BLOCK = 2**19


@dataclass(frozen=True)
class EmissiveCells:
    """Cells in which volumes emit, each a parallelepiped; float64."""

    middle: np.ndarray  # [m], shape [c, 3]
    half: np.ndarray  # from the middle to three of the faces, in rows [m], shape [c, 3, 3]
    rate: np.ndarray  # about how many points along a metre scattered rays look at for light [1/m], shape [c]
    strength: np.ndarray  # intensity, estimated, mean of the channels [W/sr], shape [c]
    instance: np.ndarray  # that the volume fills, int32, shape [c]

    def __len__(self) -> int:
        return len(self.rate)


@dataclass(frozen=True)
class EmissiveTriangles:
    """Triangles that emit and have an area, one entry for each instance and primitive."""

    instance: np.ndarray  # int32, shape [e], ascending
    primitive: np.ndarray  # triangle of the instance's mesh, int32, shape [e], ascending within an instance
    radiance: np.ndarray  # on both sides [W/(m² sr)], float32, shape [e, 3]; nobody writes to it
    area: np.ndarray  # in world space [m²], float64, shape [e]
    program: np.ndarray  # 1: a program computes the emission, and `radiance` is an estimated mean; int32, shape [e]
    instance_first: np.ndarray  # first entry of each instance, int32, shape [instance_count + 1]

    def __len__(self) -> int:
        return len(self.instance)

    @property
    def bytes(self) -> int:
        """Memory that they take [bytes]."""
        arrays = self.instance, self.primitive, self.radiance, self.area, self.program, self.instance_first
        return sum(each.nbytes for each in arrays)

    @functools.cached_property
    def strength_most(self) -> float:
        """The largest of `triangle_strengths`; 0 where there are none."""
        return float(triangle_strengths(self).max(initial=0))


def find_emissive_triangles(
    scene: Scene, emitted: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
) -> EmissiveTriangles:
    """The emissive triangles of `scene` that surfaces can be lit by.

    `emitted` computes the mean radiance of triangles (instances, primitives) whose material is a program, float32,
    shape [n, 3]. Triangles of radiance 0, or of materials that are not aimed at, are not sampled. Without `emitted` no
    program emits.
    """
    instances = scene.instances
    emission = _material_emission(scene)
    by_program = np.array([emitted is not None and _may_emit(material) for material in scene.materials], bool)
    aimed = np.array([material.aimed for material in scene.materials], bool)
    emits = (emission.any(1) | by_program) & aimed
    chunks: list[tuple[np.ndarray, ...]] = []
    # what moves is not aimed at: where it is, and how wide it is seen, is another matter at each time
    # an emitter that no ray sees which surfaces or volumes scatter lights nothing
    seen = instances.visibility & light_rays(scene_volumes(scene))
    candidates = np.flatnonzero(seen * ~apart(scene)) if emits.any() else np.zeros(0, int)
    for mesh_index in np.flatnonzero(np.bincount(instances.mesh[candidates])).tolist():
        mesh = scene.meshes[mesh_index]
        if len(mesh.triangles) == 0:
            continue
        placed = candidates[instances.mesh[candidates] == mesh_index]
        slots = 1 if mesh.triangle_slot is None else fact(mesh.triangle_slot, _most) + 1
        # instances that share their first slot share their materials
        for slot_first in np.flatnonzero(np.bincount(instances.slot_first[placed])).tolist():
            if not emits[scene.slot_materials[slot_first : slot_first + slots]].any():
                continue
            slot = np.zeros(len(mesh.triangles), np.int32) if mesh.triangle_slot is None else mesh.triangle_slot
            material = scene.slot_materials[slot_first + slot]
            primitive = np.flatnonzero(emits[material]).astype(np.int32)
            if len(primitive) == 0:
                continue
            radiance, program = emission[material], by_program[material]
            corners = mesh.positions.astype(np.float64)[mesh.triangles[primitive]]
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
            members = placed[instances.slot_first[placed] == slot_first]
            chunks += _with_area(instances.transform, members, primitive, normal, radiance, program)
    if not chunks:
        none = np.zeros(0, np.int32)
        first = np.zeros(len(instances) + 1, np.int32)
        return EmissiveTriangles(none, none, np.zeros((0, 3), np.float32), np.zeros(0), none, first)
    instance, primitive, radiance, area, program = (np.concatenate(parts) for parts in zip(*chunks))
    if program.any():
        radiance[program] = emitted(instance[program], primitive[program])
        shines = radiance.any(1)
        instance, primitive, radiance, area, program = (
            each[shines] for each in (instance, primitive, radiance, area, program)
        )
    # triangles of one block stay in order; only blocks of different meshes are out of order
    if (instance[1:] < instance[:-1]).any():
        order = np.argsort(instance, kind="stable")
        instance, primitive, radiance, area, program = (
            each[order] for each in (instance, primitive, radiance, area, program)
        )
    first = np.searchsorted(instance, np.arange(len(instances) + 1, dtype=instance.dtype)).astype(np.int32)
    return EmissiveTriangles(instance, primitive, freeze(radiance), area, program.astype(np.int32), first)


def _with_area(
    transform: np.ndarray,
    members: np.ndarray,
    primitive: np.ndarray,
    normal: np.ndarray,
    radiance: np.ndarray,
    program: np.ndarray,
) -> list[tuple[np.ndarray, ...]]:
    """The triangles `primitive` of one mesh in each of the instances `members` where they have an area: parts of the
    first five arrays of `EmissiveTriangles`, one after the other.

    Args:
        transform: of all instances.
        normal: area vectors of the triangles.
        radiance, program: of all triangles of the mesh.
    """
    step = max(1, _BLOCK // len(primitive))
    chunks: list[tuple[np.ndarray, ...]] = [()] * -(-len(members) // step)
    radiance, program = radiance[primitive], program[primitive]

    def look(part: slice) -> None:
        some = members[part].astype(np.int32)
        area = _instanced_areas(transform[some], normal)
        if (area > 0).all():
            count = len(some)
            which, found = np.repeat(some, len(primitive)), (np.tile(primitive, count), np.tile(radiance, (count, 1)))
            chunks[part.start // step] = (which, *found, area.reshape(-1), np.tile(program, count))
            return
        which, triangle = np.nonzero(area > 0)
        found = primitive[triangle], radiance[triangle], area[which, triangle], program[triangle]
        chunks[part.start // step] = (some[which], *found)

    in_slices(len(members), look, step)
    return chunks


def light_strengths(lights: Sequence[Light]) -> np.ndarray:
    """How bright each light without mesh is, float64, shape [n]; a heuristic for choosing.

    Suns: irradiance of a surface that faces them [W/m²]. Others: intensity along the axis [W/sr], the irradiance 1 m
    away; of area lights as if they had no spread, which gathers light around the axis but leaves none elsewhere;
    of spots times the part of the directions that the choice takes for lit (`COSINE_ERROR`) which is.
    Raises `SceneError` for emission that is not finite.
    """
    return np.array([_strength(light) for light in lights], np.float64)


def triangle_strengths(triangles: EmissiveTriangles) -> np.ndarray:
    """How bright each emissive triangle is: intensity along its normal [W/sr], float64, shape [e]."""
    strengths = np.empty(len(triangles))

    def compute(part: slice) -> None:
        red, green, blue = (triangles.radiance[part, channel].astype(np.float64) for channel in range(3))
        np.multiply((red + green + blue) / 3, triangles.area[part], out=strengths[part])

    in_slices(len(triangles), compute)
    return strengths


def scene_radius(scene: Scene) -> float:
    """Radius of a sphere around all geometry and lights [m].

    It is at least the radius of one light or point, and 1 for an empty scene.
    """
    boxes = np.full((len(scene.meshes), 2, 3), np.nan)
    for i, mesh in enumerate(scene.meshes):
        if len(mesh.positions):
            boxes[i] = fact(mesh.positions, box_of)
    points = [np.asarray(light.transform, np.float64)[:, 3] for light in scene.lights if light.kind != LightKind.SUN]
    low, high = [np.array(points).reshape(-1, 3)], [np.array(points).reshape(-1, 3)]
    if len(scene.instances):
        matrix = scene.instances.transform.astype(np.float64)
        box = boxes[scene.instances.mesh]
        centre = np.einsum("nij,nj->ni", matrix[:, :, :3], box.mean(1)) + matrix[:, :, 3]
        reach = np.einsum("nij,nj->ni", np.abs(matrix[:, :, :3]), (box[:, 1] - box[:, 0]) / 2)
        filled = np.isfinite(centre).all(1) & np.isfinite(reach).all(1)
        low.append((centre - reach)[filled])
        high.append((centre + reach)[filled])
    low, high = np.concatenate(low), np.concatenate(high)
    if len(low) == 0:
        return 1.0
    radius = float(np.linalg.norm(high.max(0) - low.min(0)) / 2)
    return radius if radius > 0 else 1.0


def _strength(light: Light) -> float:
    red, green, blue = light.emission
    emission = (float(red) + float(green) + float(blue)) / 3  # NumPy takes ten times as long for one lamp
    if not math.isfinite(emission) or emission < 0:
        raise SceneError(
            f"light “{light.name}”: its emission {light.emission} is not usable; give it a finite, positive power"
        )
    if light.kind in (LightKind.POINT, LightKind.SUN):
        return emission
    if light.kind == LightKind.SPOT:
        cone = 1 - np.cos(np.clip(light.angle, 0, np.pi) / 2)
        return emission * cone / (cone + COSINE_ERROR)
    if light.kind in (LightKind.RECTANGLE, LightKind.ELLIPSE):
        return emission * light_area(light)
    raise ValueError(f"there is no strength of lights of kind {light.kind!r}: add one here")


def light_area(light: Light) -> float:
    """Area of a RECTANGLE or ELLIPSE [m²]."""
    area = abs(float(light.size[0]) * float(light.size[1]))
    return area * np.pi / 4 if light.kind == LightKind.ELLIPSE else area


def _most(values: np.ndarray) -> int:
    return int(values.max())


def emits_light(material: Material, programs: bool) -> bool:
    """Whether light that `material` may emit is aimed at; with `programs` also that of a program."""
    emits = any(each.kind == ClosureKind.EMISSION for each in material.closures)
    return material.aimed and (emits or (programs and _may_emit(material)))


def _may_emit(material: Material) -> bool:
    return material.program is not None and ClosureKind.EMISSION in material.kinds and material.program.may_emit


def _material_emission(scene: Scene) -> np.ndarray:
    """Radiance of each material, float32, shape [material_count, 3]."""
    emission = np.zeros((len(scene.materials), 3))
    for i, material in enumerate(scene.materials):
        for closure in material.closures:
            if closure.kind == ClosureKind.EMISSION:
                emission[i] += closure.weight
        if not np.isfinite(emission[i]).all():
            raise SceneError(f"material “{material.name}”: its emission is not finite; give it a finite strength")
    return np.clip(emission, 0, np.finfo(np.float32).max).astype(np.float32)


def _instanced_areas(transform: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Areas of triangles under each transform, float64, shape [transforms, triangles].

    `normal` holds area vectors, shape [triangles, 3]. A transform takes them by its cofactor matrix, singular or not.
    """
    rows = transform[:, :, :3].astype(np.float64)
    cofactor = np.stack(
        [np.cross(rows[:, 1], rows[:, 2]), np.cross(rows[:, 2], rows[:, 0]), np.cross(rows[:, 0], rows[:, 1])], 1
    )
    return np.linalg.norm(np.einsum("nij,kj->nki", cofactor, normal), axis=-1)
