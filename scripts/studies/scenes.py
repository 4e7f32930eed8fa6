"""The scenes of studies: archives that lie outside the project, with the lights and cameras of the studies, and what is
made here.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from benchmarking.scenes import SceneRequest, geometry_scene
from lib.command import UsageError
from lib.geometry_files import View, load_geometry, look_at

from raybatch_addon.core.scene.description import (
    Camera,
    CameraKind,
    Closure,
    ClosureKind,
    Frame,
    Instances,
    Light,
    LightKind,
    Material,
    Mesh,
    Scene,
    Visibility,
    World,
)
from studies.study import Options

VARIABLE = "RAYBATCH_SCENES"
# Files by which a scene is found, and the axis of theirs that points up
FILES = {
    "dragon": (("dragon.npz",), "y"),
    "sponza": (("sponza.npz", "crytek_sponza_half.npz"), "y"),
    "san_miguel": (("san_miguel.npz", "san_miguel_building.npz"), "z"),
    "bunny": (("bunny144k.npz", "bunny.npz"), "y"),
    "san_francisco": (("sionna_san_francisco.npz",), "z"),
    "hotel": (("hotel_room.npz",), "y"),
    # scenes of .blend files, as scripts/render.py saves them
    "bmw": (("bmw.scene.npz",), "z"),
    "livingroom": (("livingroom.scene.npz",), "z"),
}
# Where cameras stand that look from inside: eye and target in the file's units, field of view [degrees]
VIEWS = {
    "sponza": ((-8.0, 1.5, -0.3), (5.0, 3.5, 0.0), 70.0),
    "san_miguel": ((27.6255, -2.42353, 1.49616), (26.6582, -2.17012, 1.48803), 60.0),
    "san_francisco": ((-350.0, -350.0, 180.0), (150.0, 100.0, 40.0), 60.0),
    "hotel": ((7500.0, 1600.0, -10500.0), (12000.0, 900.0, -3000.0), 70.0),
}
HIDDEN = int(Visibility.ALL & ~Visibility.CAMERA)
STRAY_BANNER = 24  # material of Sponza that hangs before the camera


def folders_of(text: str | None) -> tuple[Path, ...]:
    """Folders of `--scenes`, else of the environment; both as PATH has them."""
    text = text if text is not None else os.environ.get(VARIABLE, "")
    return tuple(Path(part) for part in text.split(os.pathsep) if part)


def find(name: str, options: Options) -> Path:
    """The archive of a scene; raises `UsageError` that says where it was looked for."""
    return find_all([name], options)[0]


def find_all(names: Sequence[str], options: Options) -> list[Path]:
    """The archives of scenes; raises `UsageError` that names all that are missing, and says where they were looked
    for.
    """
    found = [_found(name, options) for name in names]
    missing = [f"{name} ({' or '.join(FILES[name][0])})" for name, path in zip(names, found, strict=True) if not path]
    if missing:
        where = ", ".join(map(str, options.scenes)) or "no folder was given"
        what = f"the scene {missing[0]} was" if len(missing) == 1 else f"the scenes {', '.join(missing)} were"
        raise UsageError(f"{what} not found ({where}): give the folder with --scenes, or in {VARIABLE}")
    return [path for path in found if path]


def _found(name: str, options: Options) -> Path | None:
    paths = (folder / each for folder in options.scenes for each in FILES[name][0])
    return next((path for path in paths if path.is_file()), None)


def view_of(name: str) -> View | None:
    """The camera of a scene that one looks at from inside."""
    if name not in VIEWS:
        return None
    eye, target, degrees = VIEWS[name]
    return View(eye, target, math.radians(degrees))


def under_the_sky(name: str, options: Options, edge: int) -> Scene:
    """A scene under the default sun and sky."""
    return _without_banner(
        name, load_geometry(find(name, options), width=edge, height=edge, view=view_of(name), up=FILES[name][1])
    )


def grid(name: str, options: Options, count: int, edge: int) -> Scene:
    """`count` x `count` copies of a mesh, triangles of their own, under sun and sky."""
    return geometry_scene(SceneRequest(find(name, options), count, None, FILES[name][1]), edge, edge)


def under_a_plane(name: str, options: Options, edge: int) -> Scene:
    """A white mesh lit by two glowing triangles alone, as the thesis lit its scenes: above the dragon, in the open roof
    of Sponza.

    The thesis does not state where its plane and cameras stood.
    """
    up = FILES[name][1]
    scene = under_the_sky(name, options, edge)
    mesh = scene.meshes[0]
    used = mesh.positions[np.unique(mesh.triangles)].astype(np.float64)
    low, high = used.min(0), used.max(0)
    if name == "sponza":
        corners = [
            (-7.0, high[1] - 1.0, -1.6),
            (7.0, high[1] - 1.0, -1.6),
            (7.0, high[1] - 1.0, 1.6),
            (-7.0, high[1] - 1.0, 1.6),
        ]
        radiance, camera = 4.0, scene.camera
    else:
        middle, extent = (low + high) / 2, float((high - low).max())
        y, half = high[1] + 0.5 * extent, 0.5 * extent
        corners = [(middle[0] + sx * half, y, middle[2] + sz * half) for sx, sz in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        eye = middle + extent * np.array([0.3, 0.35, 1.35])
        radiance, camera = 4.0, look_at(View(tuple(eye), tuple(middle), math.radians(45)), up, edge, edge)
    white = Material("White", (Closure(ClosureKind.DIFFUSE, (0.8,) * 3),), (ClosureKind.DIFFUSE,))
    mesh = dataclasses.replace(mesh, triangle_slot=None)
    return scene_of([(mesh, white), (quad("Lamp", corners), glow(radiance))], camera, edge, edge)


def plates(width: int, height: int) -> Scene:
    """Four shiny plates of growing roughness that mirror four spheres of growing size and equal power (after Veach
    1997, figure 9.2).

    The camera does not see the spheres: the few pixels at their edges would make most of the error.
    """
    eye, lights_y, lights_z = np.array([0.0, -6.0, 3.0]), 2.0, 2.6
    radii = (0.03, 0.1, 0.3, 0.9)
    lights = tuple(
        Light(
            f"Ball {i}",
            LightKind.POINT,
            _at(-2.6 + 1.6 * i, lights_y, lights_z),
            (1.2,) * 3,
            radius=r,
            soft_falloff=False,
            visibility=HIDDEN,
        )
        for i, r in enumerate(radii)
    )
    things = [
        (quad("Floor", [(-8, -6, -1.2), (8, -6, -1.2), (8, 5, -1.2), (-8, 5, -1.2)]), diffuse(0.4)),
        (quad("Wall", [(-8, 5, -1.2), (8, 5, -1.2), (8, 5, 6), (-8, 5, 6)]), diffuse(0.4)),
    ]
    for i, roughness in enumerate((0.08, 0.2, 0.35, 0.5)):
        middle = np.array([0.0, -2.6 + 1.05 * i, -0.9 + 0.32 * i])
        to_eye, to_light = eye - middle, np.array([0.0, lights_y, lights_z]) - middle
        normal = to_eye / np.linalg.norm(to_eye) + to_light / np.linalg.norm(to_light)
        normal /= np.linalg.norm(normal)
        side = np.array([1.0, 0.0, 0.0])
        along = np.cross(normal, side)
        corners = [middle + 2.6 * sx * side + 0.38 * sy * along for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        shiny = Material(
            f"Plate {i}", (Closure(ClosureKind.GLOSSY, (0.6, 0.65, 0.7), roughness=roughness),), (ClosureKind.GLOSSY,)
        )
        things.append((quad(f"Plate {i}", corners), shiny))
    view = View(tuple(eye), (0.0, 0.0, 0.7), math.radians(50))
    return scene_of(things, look_at(view, "z", width, height), width, height, lights)


def room(width: int, height: int) -> Scene:
    """A room that one small lamp behind a shade lights: most of what is seen is light that bounced."""
    w = diffuse(0.75)
    things = [
        (quad("Floor", [(-2, -3, 0), (2, -3, 0), (2, 3, 0), (-2, 3, 0)]), w),
        (quad("Ceiling", [(-2, -3, 2.5), (-2, 3, 2.5), (2, 3, 2.5), (2, -3, 2.5)]), w),
        (quad("Back", [(-2, 3, 0), (2, 3, 0), (2, 3, 2.5), (-2, 3, 2.5)]), w),
        (quad("Front", [(-2, -3, 0), (-2, -3, 2.5), (2, -3, 2.5), (2, -3, 0)]), w),
        (quad("Left", [(-2, -3, 0), (-2, 3, 0), (-2, 3, 2.5), (-2, -3, 2.5)]), diffuse((0.7, 0.2, 0.15))),
        (quad("Right", [(2, -3, 0), (2, -3, 2.5), (2, 3, 2.5), (2, 3, 0)]), diffuse((0.2, 0.3, 0.7))),
        (quad("Shade", [(-0.6, 0.4, 1.6), (0.6, 0.4, 1.6), (0.6, 1.6, 1.6), (-0.6, 1.6, 1.6)]), w),
        (quad("Lamp", [(-0.25, 0.75, 1.75), (0.25, 0.75, 1.75), (0.25, 1.25, 1.75), (-0.25, 1.25, 1.75)]), glow(30.0)),
    ]
    view = View((0.0, -2.8, 1.3), (0.0, 1.0, 1.1), math.radians(65))
    return scene_of(things, look_at(view, "z", width, height), width, height)


# --- parts


def scene_of(
    things: Sequence[tuple[Mesh, Material]], camera: Camera, width: int, height: int, lights: tuple[Light, ...] = ()
) -> Scene:
    """A scene of meshes in their places, each with one material, without world."""
    count = len(things)
    ids = np.arange(count, dtype=np.int32)
    transform = np.tile(np.eye(4, dtype=np.float32)[None, :3], (count, 1, 1))
    instances = Instances(ids, transform, ids, np.full(count, int(Visibility.ALL), np.int32), ids)
    assert camera.kind == CameraKind.PERSPECTIVE
    return Scene(
        camera=camera,
        frame=Frame(width, height),
        meshes=tuple(mesh for mesh, _ in things),
        instances=instances,
        slot_materials=ids,
        materials=tuple(material for _, material in things),
        lights=lights,
        world=World(),
        object_names=tuple(mesh.name for mesh, _ in things),
    )


def quad(name: str, corners: Sequence[Sequence[float] | np.ndarray]) -> Mesh:
    """Two triangles."""
    return Mesh(name, np.asarray(corners, np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def diffuse(color: float | tuple[float, float, float]) -> Material:
    """A Lambertian material."""
    weight = color if isinstance(color, tuple) else (color, color, color)
    return Material("Diffuse", (Closure(ClosureKind.DIFFUSE, weight),), (ClosureKind.DIFFUSE,))


def glow(radiance: float) -> Material:
    """Emits on both sides and reflects nothing."""
    return Material("Glow", (Closure(ClosureKind.EMISSION, (radiance,) * 3),), (ClosureKind.EMISSION,))


def _at(x: float, y: float, z: float) -> np.ndarray:
    return np.column_stack([np.eye(3), [x, y, z]]).astype(np.float32)


def _without_banner(name: str, scene: Scene) -> Scene:
    """Sponza without what hangs before the camera."""
    mesh = scene.meshes[0]
    if name != "sponza" or mesh.triangle_slot is None:
        return scene
    banner = [slot for slot, material in enumerate(scene.materials) if material.name == f"Material {STRAY_BANNER}"]
    kept = ~np.isin(mesh.triangle_slot, banner)
    mesh = dataclasses.replace(mesh, triangles=mesh.triangles[kept], triangle_slot=mesh.triangle_slot[kept])
    return dataclasses.replace(scene, meshes=(mesh, *scene.meshes[1:]))
