"""A scene with everything that an edit may leave alone, and edits of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.description import ClosureKind, Frame, Material, Mesh, Scene
from raybatch_addon.core.scene.frozen import freeze
from tests.core.wavefront.scene.keeping import frozen_meshes
from tests.support import scenes

MATERIALS = 20
# Its instances: the floor and a ball lie in world space, the others are of one mesh
FLOOR, BALL, FIRST_SHARED = range(3)


def painted(color: float, reads_places: bool, has_gamma: bool = False) -> Material:
    """A material of a program, whose pattern may lie in the space of its object; `has_gamma`: with a node more."""
    builder = ProgramBuilder()
    normal, _, _ = builder.value("normals")
    place = builder.value("object_coordinates", 0) if reads_places else normal
    tint = builder.value("multiply_colors", builder.value("multiply_colors", place, place), (color, 0.5, 0.25))
    if has_gamma:
        tint = builder.value("gamma", tint, 1.25)
    if color > 1:
        builder.closure("emission", tint)
    else:
        builder.closure("diffuse", tint, normal)
    kind = ClosureKind.EMISSION if color > 1 else ClosureKind.DIFFUSE
    return Material(f"color {color}", (), (kind,), builder.finish())


def edited_scene(*, grid: int = 8, balls: int = 30, reads_places: bool = False) -> Scene:
    """A floor of 2 x `grid`² triangles with twenty materials of programs, of which the last emits; a ball; and `balls`
    more, of one mesh.
    """
    steps = np.linspace(-4, 4, grid + 1)
    x, y = np.meshgrid(steps, steps)
    positions = np.stack([x, y, 0.1 * np.sin(3 * x)], -1).reshape(-1, 3).astype(np.float32)
    first = (np.arange(grid)[:, None] * (grid + 1) + np.arange(grid)).reshape(-1, 1)
    triangles = (first + [[0, 1, grid + 1]]).tolist() + (first + [[1, grid + 2, grid + 1]]).tolist()
    count = len(triangles)
    floor = Mesh("floor", positions, np.array(triangles, np.int32), np.arange(count, dtype=np.int32) % MATERIALS)
    ball, shared = scenes.sphere(segments=10, rings=6), scenes.sphere(segments=10, rings=6)
    width = int(np.ceil(np.sqrt(balls)))
    places = [(0.25 * (i % width - width / 2), 0.25 * (i // width), 1.0) for i in range(balls)]
    made = scenes.scene(
        [
            (floor, scenes.translation(0, 0, -1), scenes.diffuse()),
            (ball, scenes.translation(0, -1, 0, 0.3), scenes.diffuse()),
            *((shared, scenes.translation(*place, 0.1), scenes.diffuse()) for place in places),
        ],
        view=scenes.camera(eye=(0, -6, 2)),
        frame=Frame(8, 8),
        lights=[scenes.area_light(matrix=scenes.translation(0, -1, 3))],
        world=0.2,
    )
    colors = [0.04 * (1 + i) for i in range(MATERIALS - 1)] + [3.0]
    slots = np.concatenate([np.arange(MATERIALS), np.zeros(balls + 1)]).astype(np.int32)
    slot_first = np.concatenate([[0], MATERIALS + np.arange(balls + 1)]).astype(np.int32)
    return frozen_meshes(
        replace(
            made,
            materials=tuple(painted(color, reads_places) for color in colors),
            slot_materials=slots,
            instances=replace(made.instances, slot_first=slot_first),
        )
    )


def recolored(scene: Scene, index: int, factor: float) -> Scene:
    """Constants of the program of the material `index` are others: a slider moved."""
    materials = list(scene.materials)
    program = materials[index].program
    constants = np.array(program.constants)
    constants[constants > 0] *= factor
    materials[index] = replace(materials[index], program=replace(program, constants=constants))
    return replace(scene, materials=tuple(materials))


def regraphed(scene: Scene, index: int) -> Scene:
    """The material `index` has a node more, of a kind that no other has."""
    materials = list(scene.materials)
    reads_places = "object_coordinates" in materials[index].program.ops
    materials[index] = painted(0.04 * (1 + index), reads_places, has_gamma=True)
    return replace(scene, materials=tuple(materials))


def moved(scene: Scene, instance: int, by: float) -> Scene:
    """One instance is elsewhere."""
    transform = scene.instances.transform.copy()
    transform[instance, :, 3] += by
    return replace(scene, instances=replace(scene.instances, transform=transform))


def hidden(scene: Scene, instance: int) -> Scene:
    """One instance is not there."""
    old, kept = scene.instances, np.arange(len(scene.instances)) != instance
    names = ("mesh", "transform", "slot_first", "visibility", "object")
    return replace(scene, instances=replace(old, **{name: getattr(old, name)[kept] for name in names}))


EDITS = {
    "camera": lambda scene: replace(scene, camera=scenes.camera(eye=(0.5, -6, 2))),
    "value": lambda scene: recolored(scene, 1, 0.9),
    "value of an emitter": lambda scene: recolored(scene, MATERIALS - 1, 0.9),
    "graph": lambda scene: regraphed(scene, 1),
    "place": lambda scene: moved(scene, FIRST_SHARED + 3, 0.01),
    "place in world space": lambda scene: moved(scene, BALL, 0.01),
    "place of an emitter": lambda scene: moved(scene, FLOOR, 0.01),
    "world": lambda scene: replace(scene, world=replace(scene.world, radiance=(0.2, 0.25, 0.3))),
    "light": lambda scene: replace(scene, lights=(replace(scene.lights[0], emission=(2.0, 2.0, 1.0)),)),
    "mesh": lambda scene: replace(
        scene,
        meshes=(
            scene.meshes[0],
            replace(scene.meshes[1], positions=freeze(scene.meshes[1].positions * np.float32(1.01))),
            *scene.meshes[2:],
        ),
    ),
    "visibility": lambda scene: hidden(scene, FIRST_SHARED + 3),
    "visibility in world space": lambda scene: hidden(scene, BALL),
    "visibility of an emitter": lambda scene: hidden(scene, FLOOR),
}
