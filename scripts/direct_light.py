#!/usr/bin/env python3
"""Report the direct light of single pixels in float64, with every triangle asked for every ray: who is right where two
engines differ.

python scripts/direct_light.py SCENE.scene.npz --size 160x160 --pixel X,Y [--pixel X,Y ...] [--samples N]

SCENE is a scene that render.py --save-scene wrote: matt surfaces under suns and a world of one colour. A surface gets
light on the side of its triangle that is seen, from where the ray meets no triangle. Two figures are reported: with the
cosine to the interpolated normal everywhere, and with that to the triangle's own normal where the interpolated one is
turned away from the viewer. Pixels count from the bottom left.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from lib.command import UsageError, exit_code
from rendering.request import parse_settings
from rendering.standalone import resized

from raybatch_addon.core.scene.archive import load_scene
from raybatch_addon.core.scene.description import CameraKind, ClosureKind, LightKind, Scene
from raybatch_addon.core.scene.flatten import flatten

# Share of the distance from the camera: a nearer triangle is the one that a ray leaves; float64 is 1e6 times better
CLOSE = 1e-9


@dataclass(frozen=True)
class Triangles:
    """All triangles in the world, float64."""

    corner: np.ndarray  # [m], shape [n, 3]
    edges: np.ndarray  # from the corner to the other two, shape [n, 2, 3]
    normals: np.ndarray  # of the corners, unit, shape [n, 3, 3]

    @staticmethod
    def of(scene: Scene) -> Triangles:
        """The triangles of `scene`; raises `UsageError` for what is not known here."""
        flat = flatten(scene)
        matt = all(c.kind == ClosureKind.DIFFUSE for material in scene.materials for c in material.closures)
        suns = all(light.kind == LightKind.SUN for light in scene.lights)
        if not (matt and suns) or len(flat.shared) or scene.camera.kind != CameraKind.PERSPECTIVE:
            raise UsageError("this is for matt surfaces that are placed once, suns, and a camera with perspective")
        places = flat.positions.astype(np.float64)[flat.triangles]
        edges = places[:, 1:] - places[:, :1]
        face = np.cross(edges[:, 0], edges[:, 1])
        normals = (
            np.repeat(face[:, None], 3, 1)
            if not len(flat.corner_normals)
            else flat.corner_normals.reshape(-1, 3, 3).astype(np.float64)
        )
        return Triangles(
            places[:, 0], edges, normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-300)
        )

    def meet(self, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distances of all triangles along a ray (infinite: not met), and weights of their second and third corners
        (Moeller, Trumbore 1997).
        """
        across = np.cross(direction, self.edges[:, 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1 / (self.edges[:, 0] * across).sum(1)
            from_corner = origin - self.corner
            u = (from_corner * across).sum(1) * inverse
            aside = np.cross(from_corner, self.edges[:, 0])
            v = (aside @ direction) * inverse
            t = (aside * self.edges[:, 1]).sum(1) * inverse
            return np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf), u, v


def pixel_light(
    scene: Scene, triangles: Triangles, pixel: tuple[int, int], samples: int, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Radiance, mean of channels, of `samples` rays through a pixel (box filter), with either normal as in this file's
    text.
    """
    random = np.random.default_rng(seed)
    camera, frame = scene.camera, scene.frame
    matrix, (left, right, bottom, top) = np.asarray(camera.transform, np.float64), camera.window
    eye, albedo = (
        matrix[:, 3],
        [float(np.mean([float(np.mean(c.weight)) for c in m.closures] or [0.0])) for m in scene.materials],
    )
    world, slots = float(np.mean(scene.world.radiance)), flatten(scene).triangle_slot
    found = np.zeros((2, samples))
    for i in range(samples):
        x, y = np.asarray(pixel) + random.random(2)
        direction = matrix[:, :3] @ (
            left + (right - left) * x / frame.width,
            bottom + (top - bottom) * y / frame.height,
            -1.0,
        )
        t, u, v = triangles.meet(eye, direction)
        hit = int(t.argmin())
        if not math.isfinite(t[hit]):
            found[:, i] = world
            continue
        reflected = albedo[scene.slot_materials[slots[hit]] if len(slots) else scene.slot_materials[0]]
        place = eye + t[hit] * direction
        face = np.cross(*triangles.edges[hit])
        face *= -np.sign(face @ direction) / np.linalg.norm(face)
        normal = np.array([1 - u[hit] - v[hit], u[hit], v[hit]]) @ triangles.normals[hit]
        normal /= np.linalg.norm(normal)
        normal *= np.sign(normal @ face) or 1.0
        near = CLOSE * t[hit] * np.linalg.norm(direction)

        def arrives(towards: np.ndarray) -> bool:
            if towards @ face <= 0:
                return False
            away = triangles.meet(place, towards)[0]
            return not (np.isfinite(away) & (away >= near)).any()

        suns = [
            (towards, float(np.mean(light.emission)) / math.pi * arrives(towards))
            for light in scene.lights
            for towards in [_within_sun(light, random)]
        ]
        numbers = random.random(2)
        for row, shaded in enumerate((normal, normal if normal @ direction < 0 else face)):
            light = sum(irradiance * max(0.0, float(towards @ shaded)) for towards, irradiance in suns)
            found[row, i] = reflected * (light + world * arrives(_cosine(shaded, numbers)))
    return found[0], found[1]


def _frame(axis: np.ndarray) -> np.ndarray:
    side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(axis, side), axis], -1)


def _within_sun(light, random: np.random.Generator) -> np.ndarray:
    """A direction to the sun's disk."""
    height = 1 - random.random() * (1 - math.cos(light.angle / 2))
    turn, radius = 2 * math.pi * random.random(), math.sqrt(max(0.0, 1 - height * height))
    return _frame(np.asarray(light.transform, np.float64)[:, 2]) @ (
        radius * math.cos(turn),
        radius * math.sin(turn),
        height,
    )


def _cosine(normal: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """A direction whose density is the cosine over pi, for two numbers from 0 to 1."""
    square, turn = numbers[0], 2 * math.pi * numbers[1]
    return _frame(normal) @ (
        math.sqrt(square) * math.cos(turn),
        math.sqrt(square) * math.sin(turn),
        math.sqrt(1 - square),
    )


def parse_pixel(text: str, scene: Scene) -> tuple[int, int]:
    """`X,Y` within the picture; raises `UsageError`."""
    parts = text.split(",")
    if len(parts) == 2 and all(part.strip().isdecimal() for part in parts):
        x, y = map(int, parts)
        if x < scene.frame.width and y < scene.frame.height:
            return x, y
    raise UsageError(f"--pixel {text} is not X,Y within {scene.frame.width} x {scene.frame.height} pixels")


def argument_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    parser.add_argument("scene", type=Path)
    parser.add_argument("--size", required=True, metavar="WxH")
    parser.add_argument("--pixel", action="append", required=True, metavar="X,Y")
    parser.add_argument("--samples", type=int, default=40)
    return parser


def run(given: argparse.Namespace) -> int:
    """The exit code; raises `RayBatchError`."""
    size = parse_settings([f"resolution={given.size}"])[1]
    assert size is not None
    scene = resized(load_scene(given.scene)[0], *size)
    triangles = Triangles.of(scene)
    for text in given.pixel:
        found = pixel_light(scene, triangles, parse_pixel(text, scene), given.samples)
        light = [f"{each.mean():.3f} ± {each.std(ddof=1) / math.sqrt(given.samples):.3f}" for each in found]
        print(
            f"pixel {text}: {light[0]} with interpolated normals, {light[1]} with the triangle's own where that is "
            "turned away",
            flush=True,
        )
    return 0


def main() -> int:
    """The exit code."""
    parser = argument_parser()
    given = parser.parse_args()
    if given.samples < 2:
        parser.error(f"--samples {given.samples} tells no error: give 2 or more")
    return exit_code("direct_light.py", lambda: run(given))


if __name__ == "__main__":
    sys.exit(main())
