"""Hills whose every part has images of its own, made by rule: together as many bytes as are asked for."""

from __future__ import annotations

import dataclasses

import numpy as np

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder, Value
from raybatch_addon.core.programs.ops.textures.image import Projection
from raybatch_addon.core.scene.description import (
    Camera,
    CameraKind,
    ClosureKind,
    Image,
    ImageEncoding,
    Light,
    LightKind,
    Material,
    Mesh,
    Scene,
)
from raybatch_addon.core.scene.frozen import freeze
from raybatch_addon.core.shading.images.textures import Extension, Interpolation
from studies import scenes

SIDE = 4  # parts along either side of the hills
PART = 60.0  # edge of a part [m]
LEAVES = 160  # cards of leaves
_CORNERS = 48  # of a part's mesh, along either side
LEAF_IMAGES = 4


def scene(edge: int) -> Scene:
    """Hills of 16 parts, each with an image of colors, 8-bit with `edge` texels along a side, and one of roughness in
    half precision with a quarter of them; and cards with leaves cut out by alpha.
    """
    pairs: list[tuple[Mesh, Material]] = []
    images: list[Image] = []
    for number in range(SIDE * SIDE):
        first = len(images)
        images += [
            Image(f"ground {number}", ground(edge, number), ImageEncoding.SRGB),
            Image(f"roughness {number}", roughness(edge // 4, number)),
        ]
        pairs.append((part(number % SIDE, number // SIDE), earth(f"earth {number}", first)))
    first = len(images)
    images += [Image(f"leaves {i}", leaves(edge, i), ImageEncoding.SRGB) for i in range(LEAF_IMAGES)]
    for i in range(LEAF_IMAGES):
        pairs.append((cards(i), foliage(f"foliage {i}", first + i)))
    ahead = np.array([[1, 0, 0, 0], [0, 0.17, -0.985, -0.46 * SIDE * PART], [0, 0.985, 0.17, 9]], np.float32)
    camera = Camera(CameraKind.PERSPECTIVE, ahead, (-0.55, 0.55, -0.45, 0.2))
    built = scenes.scene_of(pairs, camera, 64, 64)
    sun = Light(
        "sun", LightKind.SUN, np.array([[1, 0, 0, 0], [0, 0.8, -0.6, 0], [0, 0.6, 0.8, 0]], np.float32), (3.0,) * 3
    )
    return dataclasses.replace(built, images=tuple(images), lights=(sun,))


def image_bytes(built: Scene) -> int:
    """Bytes of all images of `built`."""
    return sum(each.pixels.nbytes for each in built.images if each.pixels is not None)


def ground(edge: int, seed: int) -> np.ndarray:
    """Stones on earth: RGBA, uint8, shape [edge, edge, 4]."""
    rng = np.random.default_rng(seed)
    tint = rng.uniform(0.3, 0.9, 3) * 150
    rough = _steps(edge, rng, 8) + 0.5 * _steps(edge, rng, 64) + 0.5 * _steps(edge, rng, edge)
    rough *= 1 / rough.max()
    pixels = np.full((edge, edge, 4), 255, np.uint8)
    for channel in range(3):
        pixels[..., channel] = tint[channel] * (0.35 + 0.65 * rough)
    return freeze(pixels)


def roughness(edge: int, seed: int) -> np.ndarray:
    """How rough the ground is: float16, shape [edge, edge, 1]."""
    rng = np.random.default_rng(seed + 1000)
    return freeze((0.3 + 0.6 * _steps(edge, rng, 32))[..., None].astype(np.float16))


def leaves(edge: int, seed: int) -> np.ndarray:
    """Leaves and the gaps between them: RGBA, uint8, shape [edge, edge, 4]."""
    rng = np.random.default_rng(seed + 2000)
    there = _steps(edge, rng, 24) + 0.6 * _steps(edge, rng, 192) > 0.75
    pixels = np.zeros((edge, edge, 4), np.uint8)
    pixels[there] = (40, 110, 30, 255)
    pixels[..., 1] += (60 * there * _steps(edge, rng, edge)).astype(np.uint8)
    return freeze(pixels)


def _steps(edge: int, rng: np.random.Generator, cells: int) -> np.ndarray:
    """Random numbers in 0..1, each for a square of `edge` / `cells` texels; float32, shape [edge, edge]."""
    repeated = -(-edge // cells)
    values = rng.random((cells, cells), np.float32)
    return np.repeat(np.repeat(values, repeated, 0), repeated, 1)[:edge, :edge]


def part(column: int, row: int) -> Mesh:
    """The mesh of a part of the hills, whose image it shows once."""
    at = np.arange(_CORNERS) / (_CORNERS - 1)
    v, u = np.meshgrid(at, at, indexing="ij")
    x, y = (column + u - SIDE / 2) * PART, (row + v - SIDE / 2) * PART
    positions = np.stack([x, y, _height(x, y)], -1).reshape(-1, 3).astype(np.float32)
    i = np.arange((_CORNERS - 1) * _CORNERS).reshape(-1, _CORNERS)[:, :-1].ravel()
    triangles = np.concatenate(
        [np.stack([i, i + 1, i + 1 + _CORNERS], 1), np.stack([i, i + 1 + _CORNERS, i + _CORNERS], 1)]
    ).astype(np.int32)
    uvs = np.stack([u, v], -1).reshape(-1, 2).astype(np.float32)
    return Mesh(f"part {column} {row}", positions, triangles, corner_uvs=uvs[triangles])


def _height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 7 * np.sin(x / 23) * np.cos(y / 31) + 2 * np.sin(x / 7 + y / 9)


def cards(seed: int) -> Mesh:
    """Upright squares that stand on the hills, each with a part of an image."""
    rng = np.random.default_rng(seed + 3000)
    count = LEAVES // LEAF_IMAGES
    half = SIDE * PART / 2
    x, y = rng.uniform(-half, half, count), rng.uniform(-half, half, count)
    turn, size, shown = rng.uniform(0, np.pi, count), rng.uniform(3, 9, count), rng.random((count, 2)) * 0.6
    across = np.stack([np.cos(turn), np.sin(turn), np.zeros(count)], -1) * size[:, None] / 2
    foot = np.stack([x, y, _height(x, y)], -1)
    up = np.array([0, 0, 1]) * size[:, None]
    positions = np.stack([foot - across, foot + across, foot + across + up, foot - across + up], 1)
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * 0.4
    uvs = (shown[:, None] + square).reshape(-1, 2).astype(np.float32)
    triangles = (4 * np.arange(count)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3).astype(np.int32)
    return Mesh(f"cards {seed}", positions.reshape(-1, 3).astype(np.float32), triangles, corner_uvs=uvs[triangles])


def _look_up(builder: ProgramBuilder, image: int) -> tuple[Value, Value]:
    place = (image, Interpolation.LINEAR, Extension.REPEAT, Projection.FLAT, 0)
    found = builder.value("image", *place, builder.value("uv", -1, 0))
    assert isinstance(found, tuple)
    color, alpha = found
    return color, alpha


def earth(name: str, first: int) -> Material:
    """Matt, as rough as an image says, in the color of another."""
    builder = ProgramBuilder()
    color, _ = _look_up(builder, first)
    rough, _ = _look_up(builder, first + 1)
    builder.closure("rough_diffuse", color, color, builder.value("luminance", rough), (0.0,) * 3)
    return Material(name, (), (ClosureKind.ROUGH_DIFFUSE,), builder.finish())


def foliage(name: str, image: int) -> Material:
    """Matt where the image is there, and nothing where it is not."""
    builder = ProgramBuilder()
    color, alpha = _look_up(builder, image)
    shares = builder.value("mix_weights", (1.0,) * 3, alpha)
    assert isinstance(shares, tuple)  # of what is behind, and of the leaf
    builder.closure("diffuse", builder.value("multiply_colors", shares[1], color), (0.0,) * 3)
    builder.closure("transparent", shares[0])
    return Material(name, (), (ClosureKind.DIFFUSE, ClosureKind.TRANSPARENT), builder.finish())
