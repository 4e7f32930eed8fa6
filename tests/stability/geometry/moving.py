"""What moves while the shutter is open, very far, not at all, and through maps without an inverse; and vertices that
are moved to no place.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from raybatch_addon.core.scene.description import Frame, Scene
from raybatch_addon.core.scene.motion import instance_maps
from tests.core.displacement.test_displaced import displacing, flat_square
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.support import scenes

FAMILY = "transforms"
WIDTH = 16


def moved_plate(size: float, maps: np.ndarray) -> Scene:
    """A plate that shines with radiance 1, seen from above, which moves by `maps`, shape [steps, 3, 4]."""
    view = scenes.camera(eye=(0, 0, 4), target=(0, 0, 0), half_width=0.1, up=(0, 1, 0))
    plate = (scenes.plane(size=size), scenes.IDENTITY, scenes.emitter(1.0))
    scene = scenes.scene([plate], view=view, frame=Frame(WIDTH, WIDTH))
    motion = maps[None].astype(np.float32)
    moved = replace(scene.instances, motion=instance_maps(motion), transform=motion[:, len(maps) // 2])
    return replace(scene, instances=moved)


@case(
    "motion of 1e5 m in a frame",
    FAMILY,
    "A glowing plate of 1e4 m that moves by 1e5 m while the shutter is open, seen in its middle: it is there a "
    "tenth of the time.",
    "Four standard deviations of the mean of independent times, and the part of a rounding of 1e5 m that is a pixel.",
    traces=False,
    quick=True,
)
def far(bench: Bench) -> Outcome:
    maps = np.repeat(np.asarray(scenes.IDENTITY, np.float64)[None], 3, 0)
    maps[:, 0, 3] = (-5e4, 0.0, 5e4)
    samples = 256
    picture = bench.render(moved_plate(1e4, maps), sample_count=samples, pixel_filter="BOX")
    deviation = np.sqrt(0.1 * 0.9 / (samples * WIDTH * WIDTH))
    return Outcome(float(picture.mean()), 0.1, 4 * deviation + 1e-6)


@case(
    "singular maps in mid-motion",
    FAMILY,
    "A glowing plate that is mirrored in the course of the frame, whose scale across it goes from 1 to -1; and one "
    "whose map is 0 at the second of four steps. Between steps a mirrored map is a point for a moment (Shoemake and "
    "Duff 1992, and in Cycles), and the other plate is nowhere at its step. The first once more by three steps, the "
    "middle one flat, so that it is mirrored in half of the time.",
    "No sample is invalid. A point at r of the view's half width is covered but for the share 0.2 / 3 r of the time by "
    "the first, 0.8 / 3 r by the second: means within 0.01. By three steps it is the share "
    "0.2 / 2 r.",
    traces=False,
    quick=True,
)
def singular(bench: Bench) -> Outcome:
    sweep = Sweep()
    maps = np.repeat(np.asarray(scenes.IDENTITY, np.float64)[None], 4, 0)
    maps[:, 2, 2] = (1.0, 1 / 3, -1 / 3, -1.0)
    picture = bench.render(moved_plate(4.0, maps), sample_count=64, pixel_filter="BOX")
    x = (np.arange(WIDTH) + 0.5) / WIDTH * 2 - 1
    off = np.maximum(np.abs(x)[:, None], np.abs(x)[None])
    sweep.add(picture.mean(), float((1 - 0.2 / 3 * off).mean()), 0.01, "a plate that is mirrored")
    maps = maps[[0, 1, 3]]
    maps[1, 2, 2] = 0.0
    picture = bench.render(moved_plate(4.0, maps), sample_count=64, pixel_filter="BOX")
    sweep.add(picture.mean(), float((1 - 0.2 / 2 * off).mean()), 0.01, "a plate that is flat in the middle")
    maps = np.repeat(np.asarray(scenes.IDENTITY, np.float64)[None], 4, 0)
    maps[1, :, :3] = 0.0
    picture = bench.render(moved_plate(2.0, maps), sample_count=256, pixel_filter="BOX")
    sweep.add(picture.mean(), float((1 - 0.8 / 3 * off).mean()), 0.01, "a plate that is nowhere for a moment")
    return sweep.outcome()


@case(
    "a shutter that is open for no time",
    FAMILY,
    "A glowing plate all of whose maps are the same, as in a frame of no length: the picture of the plate that stands "
    "still, to the bit.",
    "What does not move is not followed: nothing may differ.",
    traces=False,
    quick=True,
)
def instant(bench: Bench) -> Outcome:
    maps = np.repeat(np.asarray(scenes.IDENTITY, np.float64)[None], 3, 0)
    scene = moved_plate(0.5, maps)
    still = replace(scene, instances=replace(scene.instances, motion=None))
    settings = {"sample_count": 16, "pixel_filter": "BOX"}
    off = np.abs(bench.render(scene, **settings) - bench.render(still, **settings)).max()
    return Outcome(float(off), 0.0, 0.0)


@case(
    "displacement by NaN",
    FAMILY,
    "A glowing square whose material displaces it by what is not a number, and by more than a scene may measure: the "
    "picture is that of the square alone, to the bit.",
    "Vertices without a place stay where they are: nothing may differ, and no sample is invalid.",
    traces=False,
    quick=True,
)
def displaced(bench: Bench) -> Outcome:
    view = scenes.camera(eye=(0, 0, 4), target=(0, 0, 0), half_width=0.5, up=(0, 1, 0))
    worst, pictures = 0.0, []
    for steps in ((), (3e38, 3e38), (3e38, 3e38, 0.0)):
        material = scenes.emitter(1.0)
        if steps:
            material = replace(material, displacement=displacing("moved", *steps).displacement)
        scene = scenes.scene([(flat_square(), scenes.IDENTITY, material)], view=view, frame=Frame(WIDTH, WIDTH))
        pictures.append(bench.render(scene, sample_count=16, pixel_filter="BOX"))
        worst = max(worst, float(np.abs(pictures[-1] - pictures[0]).max()))
    return Outcome(worst if pictures[0].any() else np.inf, 0.0, 0.0)
