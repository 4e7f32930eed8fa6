"""A room whose surfaces show images of all encodings, in all ways in which programs look them up."""

import dataclasses

import numpy as np

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.ops.textures.environment import EnvironmentProjection
from raybatch_addon.core.programs.ops.textures.image import Projection
from raybatch_addon.core.scene.description import (
    Closure,
    ClosureKind,
    Frame,
    Image,
    ImageEncoding,
    Material,
    Mesh,
    Scene,
    World,
)
from raybatch_addon.core.scene.frozen import freeze
from raybatch_addon.core.shading.images.textures import Extension, Interpolation
from tests.support import scenes

DIFFUSE = (ClosureKind.DIFFUSE,)
COLORS, GREYS, LEAVES, TILES, BYTES = range(5)


def images() -> tuple[Image, ...]:
    """Pictures of odd sizes: bytes of three channels with the sRGB curve, half and full floats, a UDIM, and grey."""
    rng = np.random.default_rng(11)
    leaves = rng.random((150, 210, 4)).astype(np.float16)
    leaves[..., 3] = leaves[..., 3] > 0.5
    tiles = [(1001, rng.integers(0, 256, (90, 130, 4), np.uint8)), (1002, rng.integers(0, 256, (8, 8, 4), np.uint8))]
    return (
        Image("colors", freeze(rng.integers(0, 256, (333, 300, 3), np.uint8)), ImageEncoding.SRGB),
        Image("greys", freeze(rng.random((131, 257, 1)).astype(np.float32))),
        Image("leaves", freeze(leaves)),
        Image("tiles", None, ImageEncoding.SRGB, tuple((number, freeze(pixels)) for number, pixels in tiles)),
        Image("bytes", freeze(rng.integers(0, 256, (260, 190, 1), np.uint8))),
    )


def looked_up(builder: ProgramBuilder, image: int, coordinates, how=(Interpolation.LINEAR, Extension.REPEAT)):
    """Color and alpha of an image."""
    found = builder.value("image", image, *how, Projection.FLAT, 0, coordinates)
    assert isinstance(found, tuple)
    return found


def matt(name: str, builder: ProgramBuilder, color, kinds=DIFFUSE) -> Material:
    """A material that scatters `color`."""
    builder.closure("diffuse", color, (0.0, 0.0, 0.0))
    return Material(name, (), kinds, builder.finish())


def plain(image: int, how) -> Material:
    """An image by UV."""
    builder = ProgramBuilder()
    return matt("plain", builder, looked_up(builder, image, builder.value("uv", -1, 0), how)[0])


def distorted() -> Material:
    """An image whose coordinates are read from another, and from its own box projection."""
    builder = ProgramBuilder()
    uv = builder.value("uv", -1, 0)
    aside, _ = looked_up(builder, BYTES, uv)
    moved = builder.value("vector_math", 0, uv, aside, (0.0, 0.0, 0.0), 1.0)
    color, _ = looked_up(builder, COLORS, moved[0])
    place = (GREYS, Interpolation.LINEAR, Extension.REPEAT, 0, 0.4)
    boxed = builder.value("image_box", *place, color, builder.value("object_normal"))
    return matt("distorted", builder, builder.value("multiply_colors", color, boxed[0]))


def leaf() -> Material:
    """A surface with holes where an image has no alpha."""
    builder = ProgramBuilder()
    color, alpha = looked_up(builder, LEAVES, builder.value("uv", -1, 0))
    behind, own = builder.value("mix_weights", (1.0, 1.0, 1.0), alpha)
    builder.closure("transparent", behind)
    kinds = (ClosureKind.DIFFUSE, ClosureKind.TRANSPARENT)
    return matt("leaf", builder, builder.value("multiply_colors", own, color), kinds)


def shown(mesh: Mesh, repeats: float) -> Mesh:
    """`mesh` with a UV map that repeats an image."""
    uvs = mesh.positions[:, :2] * np.float32(repeats)
    return dataclasses.replace(mesh, corner_uvs=uvs[mesh.triangles])


def sky(image: int = COLORS) -> World:
    """A world that shows an image."""
    builder = ProgramBuilder()
    place = (image, Interpolation.LINEAR, EnvironmentProjection.EQUIRECTANGULAR, 0)
    color, _ = builder.value("environment", *place, builder.value("position", 0))
    builder.closure("emission", color)
    return World(program=builder.finish())


def room(interpolation=Interpolation.LINEAR, extension=Extension.REPEAT, frame=Frame(20, 16)) -> Scene:
    """A floor, a table under leaves, and a mirror, lit by the sun."""
    how = (interpolation, extension)
    mirror = scenes.material(Closure(ClosureKind.METAL, (0.9,) * 3, roughness=0.0), name="mirror")
    built = scenes.scene(
        [
            (shown(scenes.plane(size=12.0), 0.2), scenes.translation(0, 0, -1), plain(COLORS, how)),
            (shown(scenes.plane(size=2.0), 0.9), scenes.translation(-1.2, 0.5, -0.6), plain(GREYS, how)),
            (shown(scenes.plane(size=3.0), 0.4), scenes.translation(1.3, 1.2, -0.7), plain(TILES, how)),
            (shown(scenes.box(size=1.0), 0.7), scenes.translation(0.2, -0.6, -0.5), distorted()),
            (shown(scenes.plane(size=4.0), 0.3), scenes.translation(0, 0.4, 0.6), leaf()),
            (scenes.sphere("ball", 16, 8, smooth=True), scenes.translation(1.6, -0.5, -0.3, 0.6), mirror),
        ],
        view=scenes.camera(eye=(0.3, -5, 1.9), half_width=0.5),
        frame=frame,
        lights=[scenes.sun(2.0, 0.05)],
        world=(0.1, 0.15, 0.25),
    )
    return dataclasses.replace(built, images=images())
