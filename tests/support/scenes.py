"""Small scenes for tests, made of NumPy arrays."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

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

IDENTITY = np.eye(3, 4, dtype=np.float32)


def look_at(eye, target, up=(0.0, 0.0, 1.0)) -> np.ndarray:
    """Camera-to-world matrix, float32 [3, 4], of a camera at `eye` that looks at `target`."""
    eye, target, up = (np.asarray(v, np.float64) for v in (eye, target, up))
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    return np.column_stack([right, np.cross(back, right), back, eye]).astype(np.float32)


def camera(eye=(0, -4, 0), target=(0, 0, 0), half_width=0.5, aspect=1.0, up=(0.0, 0.0, 1.0), **more) -> Camera:
    """A perspective camera whose window is `2 * half_width` wide at distance 1."""
    half_height = half_width / aspect
    window = (-half_width, half_width, -half_height, half_height)
    return Camera(CameraKind.PERSPECTIVE, look_at(eye, target, up), window, **more)


def sphere(name="sphere", segments=48, rings=24, radius=1.0, smooth=False) -> Mesh:
    """A UV sphere; with `smooth`, corner normals are those of the true sphere."""
    theta = np.linspace(0, np.pi, rings + 1)
    phi = np.arange(segments) * (2 * np.pi / segments)
    ring = np.stack(
        [
            np.outer(np.sin(theta), np.cos(phi)),
            np.outer(np.sin(theta), np.sin(phi)),
            np.outer(np.cos(theta), np.ones(segments)),
        ],
        -1,
    )
    positions = ring.reshape(-1, 3)
    i, j = np.meshgrid(np.arange(rings), np.arange(segments), indexing="ij")
    a, b = i * segments + j, i * segments + (j + 1) % segments
    c, d = a + segments, b + segments
    triangles = np.concatenate(
        [np.stack([a, c, b], -1)[1:].reshape(-1, 3), np.stack([b, c, d], -1)[:-1].reshape(-1, 3)]
    )
    normals = positions[triangles].astype(np.float32) if smooth else None
    return Mesh(name, (radius * positions).astype(np.float32), triangles.astype(np.int32), corner_normals=normals)


def plane(name="plane", size=2.0) -> Mesh:
    """A square in the plane z = 0 that faces +z."""
    h = size / 2
    positions = np.array([[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0]], np.float32)
    return Mesh(name, positions, np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def box(name="box", size=2.0) -> Mesh:
    """A closed cube that faces outwards."""
    h = size / 2
    corners = np.array([[x, y, z] for x in (-h, h) for y in (-h, h) for z in (-h, h)], np.float32)
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return Mesh(name, corners, np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]]).astype(np.int32))


def translation(x, y, z, scale=1.0) -> np.ndarray:
    """Object-to-world matrix, float32 [3, 4]."""
    return np.column_stack([np.eye(3) * scale, [x, y, z]]).astype(np.float32)


def material(*closures: Closure, name="material", kinds=()) -> Material:
    """A material of these closures."""
    return Material(name, closures, tuple(kinds))


def diffuse(color=0.8) -> Material:
    """A Lambertian material."""
    return material(
        Closure(ClosureKind.DIFFUSE, (color, color, color) if np.isscalar(color) else tuple(color)), name="diffuse"
    )


def emitter(radiance=1.0) -> Material:
    """A material that only emits."""
    return material(Closure(ClosureKind.EMISSION, (radiance,) * 3), name="emitter")


def scene(objects=(), *, view=None, frame=None, lights=(), world=0.0) -> Scene:
    """A scene of (mesh, matrix, material[, visibility]) tuples; a mesh object used twice becomes two instances of
    it.
    """
    meshes: list[Mesh] = []
    materials: list[Material] = []
    rows = []
    for mesh, matrix, surface, *visibility in objects:
        place = next((i for i, m in enumerate(meshes) if m is mesh), None)
        if place is None:
            place = len(meshes)
            meshes.append(mesh)
        materials.append(surface)
        rows.append((place, np.asarray(matrix, np.float32), int(visibility[0]) if visibility else int(Visibility.ALL)))
    count = len(rows)
    ids = np.arange(count, dtype=np.int32)
    instances = Instances(
        np.array([r[0] for r in rows], np.int32),
        np.array([r[1] for r in rows], np.float32).reshape(-1, 3, 4),
        ids,
        np.array([r[2] for r in rows], np.int32),
        ids,
    )
    radiance = (world,) * 3 if np.isscalar(world) else tuple(world)
    return Scene(
        camera=view or camera(),
        frame=frame or Frame(32, 32),
        meshes=tuple(meshes),
        instances=instances,
        slot_materials=ids,
        materials=tuple(materials),
        lights=tuple(lights),
        world=World(radiance),
        object_names=tuple(f"object {i}" for i in ids),
    )


def sun(strength=1.0, angle=0.0, matrix=IDENTITY) -> Light:
    """A sun straight above by default."""
    return Light("sun", LightKind.SUN, matrix, (strength,) * 3, angle=angle)


def area_light(radiance=1.0, size=1.0, matrix=None) -> Light:
    """A square light two metres above the origin by default, shining down."""
    return Light(
        "area",
        LightKind.RECTANGLE,
        translation(0, 0, 2) if matrix is None else matrix,
        (radiance,) * 3,
        size=(size, size),
    )


def mixed(frame: Frame | None = None, fineness: int = 1) -> Scene:
    """A bit of everything: instances, glass, metal, transparency, an emitter, three lights and a tinted world. Balls
    have `fineness` times as many segments and rings.
    """
    segments, rings = 16 * fineness, 8 * fineness
    glass = material(Closure(ClosureKind.GLASS, (0.9, 1.0, 0.9), roughness=0.1, ior=1.45), name="glass")
    metal = material(Closure(ClosureKind.METAL, (0.9, 0.6, 0.3), roughness=0.3), name="metal")
    veil = material(
        Closure(ClosureKind.TRANSPARENT, (0.6, 0.7, 0.8)), Closure(ClosureKind.DIFFUSE, (0.3, 0.2, 0.1)), name="veil"
    )
    ball, floor = sphere(segments=segments, rings=rings), plane(size=12)
    smooth_ball = sphere("smooth", segments, rings, smooth=True)
    tilted = translation(1.6, -1.2, 0.2, 0.6)
    tilted[:, :3] = (
        0.6 * np.array([[1, 0, 0], [0, math.cos(1.2), -math.sin(1.2)], [0, math.sin(1.2), math.cos(1.2)]])
    ).astype(np.float32)
    return scene(
        [
            (floor, translation(0, 0, -1), diffuse((0.7, 0.6, 0.5))),
            (ball, translation(-1.3, 0, 0, 0.8), metal),
            (ball, translation(1.3, 0.4, 0, 0.8), diffuse((0.2, 0.4, 0.8))),
            (smooth_ball, translation(0, -0.8, -0.3, 0.6), glass),
            (plane("veil", 1.5), tilted, veil),
            (plane("lamp", 0.7), translation(-0.4, 0.9, 2.2), emitter(6.0)),
        ],
        view=camera(eye=(0.3, -5, 1.6), half_width=0.55, lens_radius=0.05, focus_distance=4.5),
        frame=frame or Frame(24, 20, passes=("Combined", "Depth", "Normal", "Position")),
        lights=[
            sun(0.7, 0.1, look_at((1, -1, 2), (0, 0, 0))),
            area_light(2.0, 0.8, translation(1.5, 0.5, 2.5)),
            Light("point", LightKind.POINT, translation(-2, -1, 1.5), (1.5, 1.0, 0.5), radius=0.2),
        ],
        world=(0.1, 0.15, 0.25),
    )


def few_bounces(scene: Scene) -> Scene:
    """`scene`, whose lamps and world paths aim at from their first vertices alone; the world casts no shadow."""
    lights = tuple(dataclasses.replace(light, bounce_max=0) for light in scene.lights)
    return dataclasses.replace(
        scene, lights=lights, world=dataclasses.replace(scene.world, bounce_max=1, casts_shadow=False)
    )


def lifted(scene: Scene) -> Scene:
    """`scene`, whose smooth meshes send shadow rays from above their faces."""
    cutoffs = np.full(len(scene.instances), 0.3, np.float32)
    return dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, terminator=cutoffs))
