"""What is measured: both schedules, with and without queues at treelets, in scenes of different kinds."""

from __future__ import annotations

from typing import TYPE_CHECKING

from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.settings.settings import RenderSettings
from studies import scenes
from studies.bench import with_frame
from studies.study import Case, Options, Row

if TYPE_CHECKING:
    from studies.bench import Bench

SCENES = ("room", "sponza", "san_miguel", "bunny", "san_francisco", "hotel")
BATCHINGS = ("OFF", "ON")
SCHEDULES = ("WAVEFRONT", "STREAMING")
BUNNIES = {False: 1, True: 4}  # along an edge of their grid, by whether on a GPU
# Pixels along the edges, samples: quick and full, by whether on a GPU
FRAMES = {False: ((64, 36, 2), (320, 180, 16)), True: ((320, 180, 4), (1280, 720, 32))}
BOUNCES = 7
EDGE = 64  # of a frame, before it is that of the study [pixels]


def cases(options: Options) -> list[Case]:
    """Both schedules take turns within each scene and `batching`."""
    found = []
    for scene in SCENES:
        for batching in BATCHINGS:
            for schedule in SCHEDULES:
                what = {"scene": scene, "batching": batching, "schedule": schedule}
                found.append(Case(f"{scene} {batching} {schedule}", f"{scene} {batching}", what))
    return found


def measure(case: Case, turn: int, bench: Bench) -> Row:
    """One render, behind a small one of the same settings that loads kernels."""
    what, options = case.what, bench.options
    width, height, samples = options.pick(*FRAMES[options.is_cuda])
    scene = bench.scene(what["scene"], lambda: made(what["scene"], options))
    settings = RenderSettings(
        sample_count=samples,
        bounce_max=BOUNCES,
        batching=what["batching"],
        schedule=what["schedule"],
        kernel_tier="SPECIALISED",
    )
    return bench.timed(with_frame(scene, width, height), settings, case.key)


def made(name: str, options: Options) -> Scene:
    """A scene of the study, in a small square frame that `measure` replaces; raises `UsageError` where its file is not
    found.
    """
    if name == "room":
        return scenes.room(EDGE, EDGE)
    if name == "bunny":
        return scenes.grid(name, options, BUNNIES[options.is_cuda], EDGE)
    return scenes.under_the_sky(name, options, EDGE)
