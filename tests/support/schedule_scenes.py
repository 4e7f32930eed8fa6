"""Small scenes that every schedule renders alike."""

import functools
from dataclasses import replace
from typing import Any

import numpy as np
from checking.films import FilmComparer

from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame, Scene
from raybatch_addon.core.scene.passes import COST_PASSES, GUIDE_PASSES, MATTE_PASSES, OCCLUSION_PASS
from raybatch_addon.core.scene.passes import PASSES as PASS_CHANNELS
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes
from tests.support.paged_scenes import strands, swaying, turning
from tests.support.under_test import DEVICE

ESTIMATOR = RenderSettings(sample_count=3, bounce_max=5, roulette_bounce=2, clamp_indirect=3.0)
# Every pass of the general tier but those that show cost, and of mattes those of two levels. Ambient Occlusion has
# kernels of its own (`tests/renders/requests`)
PASSES = tuple(
    name
    for name in PASS_CHANNELS
    if name not in (*COST_PASSES, *GUIDE_PASSES, OCCLUSION_PASS) and (name not in MATTE_PASSES or name.endswith("00"))
)


def frame(width: int = 16, height: int = 12) -> Frame:
    """A small frame with every pass but those that show cost."""
    return Frame(width, height, passes=PASSES)


def open_scene() -> Scene:
    """A ball on a floor below a sky and a sun: all in one tree, most shadow rays reach their light."""
    return scenes.scene(
        [
            (scenes.sphere("ball", 20, 10), scenes.IDENTITY, scenes.diffuse()),
            (scenes.plane("floor", 8), scenes.translation(0, 0, -1), scenes.diffuse(0.5)),
        ],
        view=scenes.camera(eye=(0.4, -4, 1.2), aspect=4 / 3),
        frame=frame(),
        world=(0.3, 0.4, 0.6),
        lights=[scenes.sun(2.0, 0.05, scenes.look_at((1, -1, 3), (0, 0, 0)))],
    )


def closed_scene() -> Scene:
    """A room without a way out: instances, and shadow rays that go on through veils."""
    veil = scenes.material(
        Closure(ClosureKind.TRANSPARENT, (0.7, 0.6, 0.5)), Closure(ClosureKind.DIFFUSE, (0.1, 0.2, 0.2)), name="veil"
    )
    ball, sheet = scenes.sphere("ball", 14, 7), scenes.plane("sheet", 2.5)
    places = ((-1.4, 0, -1.5), (1.2, 0.5, -1), (0, 1.5, 0.5))
    return scenes.scene(
        [
            (scenes.box("room", 6), scenes.IDENTITY, scenes.diffuse((0.7, 0.7, 0.6))),
            *((ball, scenes.translation(*place, 0.7), scenes.diffuse((0.6, 0.3, 0.3))) for place in places),
            *((sheet, scenes.translation(0.3 * z, 0, z), veil) for z in (0.9, 1.4, 1.9)),
            (scenes.plane("lamp", 1), scenes.translation(0, 0, 2.7), scenes.emitter(8.0)),
        ],
        view=scenes.camera(eye=(0, -2.8, 0.2), half_width=0.8, aspect=4 / 3),
        frame=frame(12, 9),
        lights=[scenes.area_light(4.0, 0.6, scenes.translation(1, 1, 2.8))],
    )


def mixed_scene() -> Scene:
    """A bit of everything."""
    return scenes.mixed(frame())


def living_scene() -> Scene:
    """Hair, ribbons and points, which stand still, turn and sway; a ball that deforms, and a camera that moves."""
    tuft, coat = (
        strands("tuft", 60, seed=2),
        scenes.material(Closure(ClosureKind.DIFFUSE, (0.6, 0.4, 0.2)), name="coat"),
    )
    made = scenes.scene(
        [
            (strands("hair", 150), scenes.IDENTITY, coat),
            (scenes.sphere("skin", 20, 10), scenes.IDENTITY, scenes.diffuse((0.7, 0.5, 0.4))),
            (swaying(strands("grass", 120, ribbons=True, seed=3)), scenes.translation(1.8, 0.5, -0.6), coat),
            (swaying(scenes.sphere("pulse", 16, 8)), scenes.translation(-1.9, 0.6, 0, 0.8), scenes.diffuse(0.6)),
            (tuft, scenes.translation(-1, -1, 0.3, 0.5), coat),
            (tuft, scenes.translation(1.1, -1.2, 0.1, 0.4), coat),
            (scenes.plane("floor", 8), scenes.translation(0, 0, -1), scenes.diffuse(0.5)),
        ],
        view=scenes.camera(eye=(0.4, -5, 1.2), aspect=4 / 3),
        frame=frame(),
        world=(0.3, 0.4, 0.6),
        lights=[scenes.sun(2.0, 0.05, scenes.look_at((1, -1, 3), (0, 0, 0)))],
    )
    ways = np.repeat(np.asarray(made.camera.transform, np.float32)[None], 2, 0)
    ways[1, 0, 3] += 0.1
    return turning(replace(made, camera=replace(made.camera, motion=ways)), (1, 5))


SCENES = {"open": open_scene, "closed": closed_scene, "mixed": mixed_scene, "living": living_scene}

# What plain runs on a CPU do not draw, since other kernels would be compiled for it, which take most of their time:
# those of both tiers they leave to `test_tiers.py`, those of the other schedule to `streaming`, and others of tracers
# to other scenes
_TRACED = {"schedule": "WAVEFRONT", "kernel_tier": "AUTO", "single_lane": "OFF", "treelet_tier_bytes": 0}
FIXED = {
    "open": {"schedule": "WAVEFRONT", "kernel_tier": "AUTO", "counters": "OFF", "single_lane": "ON", "warp_count": 1},
    "closed": {**_TRACED, "counters": "ON"},
    "mixed": {**_TRACED, "counters": "ON"},
    "living": {**_TRACED, "counters": "OFF"},
}


@functools.cache
def least_budget(device: str, name: str = "mixed") -> int:
    """The budget that the engine calls enough when it refuses one that is not: with one page at a time [bytes]."""
    session = Session(device)
    found = FilmComparer(session, SCENES[name](), ESTIMATOR.replace(sample_count=1), 24).compare(
        dict(batching="ON", geometry_budget=1)
    )
    session.close()
    assert found.raised == 1 and not found.differs
    return found.settings["geometry_budget"]


def not_drawn(name: str, thorough: bool) -> dict[str, Any]:
    """Settings of the scene `name` that are as they are in this run; none where it is `thorough` or on a GPU."""
    return {} if thorough or DEVICE != "cpu" else FIXED[name]
