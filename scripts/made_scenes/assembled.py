"""A scene of meshes with a colour each, in the light of geometry files."""

from __future__ import annotations

import numpy as np
from lib.geometry_files import SKY_RADIANCE, View, look_at, sun

from made_scenes.placing import Placements
from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame, Material, Mesh, Scene, World

Color = tuple[float, float, float]


def assembled(
    meshes: list[Mesh], colors: list[Color], placements: Placements, view: View, width: int, height: int
) -> Scene:
    """The scene; each of `meshes` is an object and has a material of its own."""
    slots = np.arange(len(meshes), dtype=np.int32)
    return Scene(
        camera=look_at(view, "z", width, height),
        frame=Frame(width, height),
        meshes=tuple(meshes),
        instances=placements.instances(slots),
        slot_materials=slots,
        materials=tuple(
            Material(mesh.name, (Closure(ClosureKind.DIFFUSE, color),), (ClosureKind.DIFFUSE,))
            for mesh, color in zip(meshes, colors, strict=True)
        ),
        lights=(sun(view, "z"),),
        world=World(SKY_RADIANCE),
        object_names=tuple(mesh.name for mesh in meshes),
    )
