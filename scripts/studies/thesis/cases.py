"""The cases measured for the thesis's tables: its combinations of parameters, on our tracer."""

from __future__ import annotations

import itertools
from typing import Any

from raybatch_addon.core.settings.presets import preset_settings
from raybatch_addon.core.settings.settings import RenderSettings
from studies import scenes
from studies.bench import Bench, with_frame
from studies.study import Case, Options, Row

SCENES = ("dragon", "sponza")
ORDERS, STORAGES = ("FRAME_FIRST", "PIXEL_FIRST"), ("DIRECT", "INDIRECT")
TREELET_SIZES, RAY_COUNTS = (200, 800, 1600, 2000), (1024, 10240, 1048576)
# Values of the thesis's appendices D and E
MANY_RAY_COUNTS, QUEUE_SIZES = tuple(2**k for k in range(8, 22)), (32, 64, 128, 256, 512, 1024, 2048)
SAMPLES, BOUNCES = 2, 7  # SPP and MAXDEPTH
# What all runs of a table had, as far as the thesis states it: (sample_order, treelet_size, ray_count, queue_size)
SWEEP = {"sample_order": "FRAME_FIRST", "treelet_size": 800, "ray_count": 1048576, "queue_size": 64}
PARAMETERS = ("sample_order", "ray_storage", "treelet_size", "ray_count", "queue_size")


def settings_of(changes: dict[str, Any], samples: int = SAMPLES) -> RenderSettings:
    """Our settings for parameters of the thesis: those of the preset THESIS on all warps, with `changes`.

    MIN_TREELETSIZE, which the thesis does not state, is 1, so that TREELETSIZE alone decides: with the preset's (as
    large as TREELETSIZE) most of the 96 would be of one treelet, since our nodes hold about six of the thesis's, and so
    there are fewer of them.
    """
    values = {**preset_settings("THESIS"), "warp_count": 0, "treelet_size_min": 1, **changes}
    # no Russian roulette: the thesis does not mention any
    return RenderSettings(
        sample_count=samples,
        bounce_max=BOUNCES,
        roulette_bounce=BOUNCES + 1,
        pixel_filter="BOX",
        sample_sequence="INDEPENDENT",
        **values,
    )


def initial_cases() -> list[Case]:
    """The thesis's 96 combinations (table 4.2)."""
    found = []
    for scene, treelets, rays, storage, order in itertools.product(SCENES, TREELET_SIZES, RAY_COUNTS, STORAGES, ORDERS):
        what = {
            "table": "initial",
            "scene": scene,
            "sample_order": order,
            "ray_storage": storage,
            "treelet_size": treelets,
            "ray_count": rays,
        }
        found.append(Case(f"initial {scene} {order} {storage} {treelets} {rays}", f"initial {scene} {treelets}", what))
    return found


def cases(options: Options) -> list[Case]:
    """The cases of the three tables, each group beside the same render without queues, and on one warp where there are
    warps.
    """
    found = initial_cases()
    for scene in SCENES:
        for rays in MANY_RAY_COUNTS:
            what = {"table": "ray_count", "scene": scene, "ray_storage": "DIRECT", **SWEEP, "ray_count": rays}
            found.append(Case(f"ray_count {scene} {rays}", f"ray_count {scene}", what))
        for size, storage in itertools.product(QUEUE_SIZES, STORAGES):
            what = {"table": "queue_size", "scene": scene, "ray_storage": storage, **SWEEP, "queue_size": size}
            found.append(Case(f"queue_size {scene} {storage} {size}", f"queue_size {scene}", what))
    for group, scene in dict.fromkeys((case.group, case.what["scene"]) for case in found):
        found.append(Case(f"control of {group}", group, {"table": "control", "scene": scene}))
    if options.is_cuda:
        for scene, order, treelets, rays in (
            ("dragon", "FRAME_FIRST", 800, 10240),
            ("sponza", "PIXEL_FIRST", 200, 1024),
        ):
            what = {
                "table": "one_warp",
                "scene": scene,
                "sample_order": order,
                "ray_storage": "DIRECT",
                "treelet_size": treelets,
                "ray_count": rays,
            }
            found.append(Case(f"one_warp {scene}", f"one_warp {scene}", what))
    return found


def measure(case: Case, turn: int, bench: Bench) -> Row:
    """One render of both samples."""
    options, what = bench.options, case.what
    edge = 1280 if options.is_cuda else options.pick(80, 320)
    scene = bench.scene(what["scene"], lambda: scenes.under_a_plane(what["scene"], options, 64))
    if what["table"] == "control":
        settings = settings_of({}).replace(**preset_settings("UNBATCHED"))
    else:
        settings = settings_of({name: what[name] for name in PARAMETERS if name in what})
    if what["table"] == "one_warp":
        settings = settings.replace(warp_count=1)
    cap = options.pick(1.5, 20.0) if options.is_cuda else options.pick(2.0, 8.0)
    warm = (what["scene"], settings.batching, settings.ray_storage, settings.treelet_size)
    return {"edge": edge, **bench.timed(with_frame(scene, edge, edge), settings, warm, cap)}
