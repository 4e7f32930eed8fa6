"""Emitters of a scene, and how bright each is. Host side, NumPy only.

Emitters are numbered: first the lights without mesh, in the scene's order, then the emissive triangles, sorted by
instance and then by primitive.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...errors import SceneError
from ...scene.description import ClosureKind, Light, LightKind, Material, Scene, Visibility
from ...scene.frozen import fact, freeze
from ...scene.motion import apart
from ...scene.validate import box_of

# Kinds of rays that leave surfaces, where lights are sampled; an emitter that none of them sees lights nothing
_LIT = int(Visibility.DIFFUSE | Visibility.GLOSSY | Visibility.TRANSMISSION)

# Rounding of cosines that come from sines: where lights are chosen, a cone counts as so much wider
COSINE_ERROR = 1e-3

# Entries of a temporary [instances of one mesh, triangles] block while areas are computed: 32 MB of float64
_BLOCK = 2**22


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

    @functools.cached_property
    def strength_most(self) -> float:
        """The largest of `triangle_strengths`; 0 where there are none."""
        return float(triangle_strengths(self).max(initial=0))


def find_emissive_triangles(
    scene: Scene, emitted: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
) -> EmissiveTriangles:
    """The emissive triangles of `scene` that surfaces can be lit by.

    `emitted` computes the mean radiance of triangles (instances, primitives) whose material is a program, float32,
    shape [n, 3]. Triangles of radiance 0 are not sampled. Without `emitted` no program emits.
    """
    instances = scene.instances
    emission = _material_emission(scene)
    by_program = np.array([emitted is not None and _may_emit(material) for material in scene.materials], bool)
    emits = emission.any(1) | by_program
    chunks: list[tuple[np.ndarray, ...]] = []
    # what moves is not aimed at: where it is, and how wide it is seen, is another matter at each time
    candidates = np.flatnonzero((instances.visibility & _LIT) * ~apart(scene)) if emits.any() else np.zeros(0, int)
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
            step = max(1, _BLOCK // len(primitive))
            for first in range(0, len(members), step):
                some = members[first : first + step]
                area = _instanced_areas(instances.transform[some], normal)
                which, triangle = np.nonzero(area > 0)
                chosen = primitive[triangle]
                chunks.append(
                    (some[which].astype(np.int32), chosen, radiance[chosen], area[which, triangle], program[chosen])
                )
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
    order = np.argsort(instance, kind="stable")
    first = np.searchsorted(instance[order], np.arange(len(instances) + 1)).astype(np.int32)
    radiance = freeze(radiance[order])
    return EmissiveTriangles(
        instance[order], primitive[order], radiance, area[order], program[order].astype(np.int32), first
    )


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
    return triangles.radiance.astype(np.float64).mean(1) * triangles.area


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
    emission = np.mean(np.asarray(light.emission, np.float64))
    if not np.isfinite(emission) or emission < 0:
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
    """Whether `material` may emit; with `programs` also by a program."""
    return any(each.kind == ClosureKind.EMISSION for each in material.closures) or (programs and _may_emit(material))


def _may_emit(material: Material) -> bool:
    # a program whose emission is known to be black has no emission step, though its kinds count it
    program = material.program
    return (
        program is not None
        and ClosureKind.EMISSION in material.kinds
        and any(step.op == "emission" for step in program.instructions)
    )


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
