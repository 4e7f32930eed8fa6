"""Stiff scheduling: rays that crowd, that scatter, and that do not end, with extreme sizes of queues."""

from __future__ import annotations

import functools
import tempfile
from typing import Any

import numpy as np
from checking.films import ComparedFilm, FilmComparer

from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.scene.description import Camera, CameraKind, Frame, Scene
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.tracers.buckets.policy import Selection
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.enclosures import (
    SCATTERED,
    facing_down,
    glass,
    icosphere_mesh,
    joined,
    lamp,
    mirror,
    stretched,
    view_along,
    wall,
)
from tests.support import scenes

FAMILY = "scheduling"
SAME = """A film is a function of its samples: a hit is one of the scene and the ray alone, sums are exact in any order,
random numbers are keyed by
    pixel, sample and bounce. So no bit may differ from the control's, and rays traced, taken in and finished are one
    number. Measured: the number of mistakes"""
SELECTIONS = tuple(Selection.__members__)
FINE = dict(batching="ON", treelet_size=1)  # every node of a tree has a bucket
WAITING = dict(batching="ON", treelet_bytes=4096)
ESTIMATOR = RenderSettings(sample_count=1, sample_sequence="INDEPENDENT", bounce_max=6, roulette_bounce=2)


class _Films:
    """Films of one scene under many schedules, against the control."""

    def __init__(self, bench: Bench, scene: Scene, estimator: RenderSettings, session: Session | None = None):
        self._bench, self.sweep = bench, Sweep()
        self._comparer = FilmComparer(session or bench.session, scene, estimator, 24)
        self.control = self._comparer.plain

    def add(self, note: str, rays_few: int | None = 0, **schedule: Any) -> ComparedFilm:
        """Render under `schedule`. Rays wait however few they are, unless `rays_few` is None."""
        found = self._comparer.compare(schedule, rays_few=rays_few)
        self._bench.invalid_samples += int(found.statistics.get("invalid_samples", 0))
        self.sweep.add(len(found.differs), 0, 0, "; ".join([note, *found.differs]))
        return found

    def expect(self, holds: bool, note: str) -> None:
        """Note a mistake unless the schedule was put to the intended test, which is so if it `holds`."""
        self.sweep.add(0 if holds else 1, 0, 0, note)

    def outcome(self) -> Outcome:
        """The first mistake, or the number of films that are right."""
        worst = self.sweep.outcome()
        return worst if not worst.passed else Outcome(worst.measured, 0, 0, f"{self.sweep.count} comparisons")


@functools.cache
def _room() -> Scene:
    """Coloured walls, a mirror, glass in glass and a lamp: rays of every kind go everywhere."""
    ball = icosphere_mesh(3)
    fine = [joined(name, ball, [scenes.IDENTITY]) for name in ("white", "mirror", "glass", "inner")]
    return scenes.scene(
        [
            (scenes.box("room", 4), scenes.IDENTITY, wall((0.9, 0.7, 0.3))),
            (fine[0], stretched(0.7, 0.7, 0.7, (0.8, 0.6, -1.2)), wall((0.2, 0.5, 0.9))),
            (fine[1], stretched(0.6, 0.6, 0.6, (-1.0, 0.8, -0.5)), mirror(0.9)),
            (fine[2], stretched(0.5, 0.5, 0.5, (0.1, 0.4, 0.4)), glass(1.5)),
            (fine[3], stretched(0.3, 0.3, 0.3, (0.1, 0.4, 0.4)), glass(0.7)),
            (scenes.plane("lamp", 0.8), facing_down(1.9), lamp(6.0)),
        ],
        frame=Frame(16, 12),
        view=scenes.camera(eye=(0.0, -1.8, 0.0), target=(0, 1, -0.2), half_width=0.8, aspect=4 / 3),
    )


def _patches(edge: int) -> Scene:
    """`edge` x `edge` squares of 128 triangles, apart from each other.

    Each fills one pixel's view from straight above.
    """
    transforms = [scenes.translation(x, y, 0) for y in range(edge) for x in range(edge)]
    cells = [stretched(0.09, 0.09, 1, (0.09 * (i % 8 - 3.5), 0.09 * (i // 8 - 3.5), 0)) for i in range(64)]
    patch = joined("patch", scenes.plane("cell", 1.0), cells)
    camera = Camera(
        CameraKind.ORTHOGRAPHIC,
        scenes.look_at((0, 0, 5), (0, 0, 0), up=(0, 1, 0)),
        (-0.5, edge - 0.5, -0.5, edge - 0.5),
    )
    field = joined("field", patch, transforms)
    return scenes.scene([(field, scenes.IDENTITY, wall())], frame=Frame(edge, edge), view=camera, world=1.0)


EDGE = 32


@case(
    "every ray wants one treelet",
    FAMILY,
    """All of 130,000 rays, of the camera and scattered, are over one triangle of 131,072, which are cut into thousands
    of treelets: one bucket fills, all others stay empty. Every way to choose the next bucket, in large blocks and in
    blocks of one ray.""",
    SAME,
    traces=False,
    quick=True,
)
def one_treelet_wanted(bench: Bench) -> Outcome:
    scene = _patches(EDGE)
    eye = (16.0475, 16.045, 5.0)
    scene = scenes.scene(
        [(scene.meshes[0], scenes.IDENTITY, wall())],
        frame=Frame(64, 64),
        view=view_along(eye, (16.0475, 16.045, 0.0)),
        world=1.0,
    )
    films = _Films(bench, scene, SCATTERED.replace(sample_count=16, bounce_max=2))
    # quantised boxes of neighbours overlap, so that a ray may look into some of these
    most = 1 if bench.session.layout is Layout.BOXES else 4
    for selection in SELECTIONS:
        for blocks in (dict(), dict(queue_size=1), dict(queue_size=64, queue_count=3)):
            found = films.add(f"{selection} {blocks}", **WAITING, bucket_selection=selection, **blocks)
            rays = found.statistics["rays"]
            films.expect(
                rays["camera"] <= found.statistics["treelet_visits"] <= most * rays["total"],
                "a ray visits the one treelet, or none",
            )
    films.expect(found.statistics["tree"]["cut"]["treelets"] > EDGE**2, "there are other treelets")
    return films.outcome()


@case(
    "every ray wants another treelet",
    FAMILY,
    """1024 rays over 1024 patches of 128 triangles, each with treelets of its own: at every bucket waits one ray. Every
    way to choose the next bucket, in blocks of one ray and of 64, and with 64 blocks for 1024 buckets.""",
    SAME,
    traces=False,
    quick=True,
)
def another_treelet_wanted(bench: Bench) -> Outcome:
    films = _Films(bench, _patches(EDGE), SCATTERED.replace(bounce_max=2, pixel_filter="GAUSSIAN", filter_width=0.05))
    for selection in SELECTIONS:
        for blocks in (
            dict(queue_size=64, queue_count=EDGE**2),
            dict(queue_size=1),
            dict(queue_size=64, queue_count=64),
        ):
            found = films.add(
                f"{selection} {blocks}", **FINE, bucket_selection=selection, thread_count=1, tile_size=EDGE, **blocks
            )
            if blocks.get("queue_count") == EDGE**2:
                # A block holds rays of one bucket; full blocks would be 16. (Quantised trees have fewer treelets, some
                # of two patches or more.)
                peak = found.statistics["blocks_peak"]
                films.expect(
                    peak > EDGE**2 / 8,
                    f"{selection}: few rays wait in each block of 64: {peak} blocks for {EDGE**2} rays",
                )
            elif "queue_count" in blocks:
                films.expect(found.statistics["batching"]["blocks_short"] > 0, f"{selection}: blocks run out")
    return films.outcome()


BOUNCES = 100_000
WIDTH = 1024


@case(
    "one path of 100,000 bounces",
    FAMILY,
    """A million pixels show a white floor in a world of 1, one bounce away, and a single one a closed mirror box that
    emits 1: its path has 100,000 bounces, alone for nearly all of the time. The queues drain, and every value is exact:
    1, and 100,002. The time is reported, not judged.""",
    """a path of the floor carries 1 to the bit; the sum of 100,002 ones is exact in float32. No value may differ. Rays
    traced, taken in and finished are one number, known beforehand: two for each pixel of the floor, 100,002 for the
    other""",
)
def one_long_path(bench: Bench) -> Outcome:
    sweep = Sweep()
    pixel = 4.0 / WIDTH
    middle = 300.5 * pixel - 2.0, 500.5 * pixel - 2.0
    # in front of the camera's plane are the floor and, around the origin of one pixel's ray, the box
    box = (scenes.box("box", 1.0), stretched(0.6 * pixel, 0.6 * pixel, 0.6 * pixel, (*middle, 3.0)), mirror(1.0, 1.0))
    camera = Camera(
        CameraKind.ORTHOGRAPHIC, scenes.look_at((0, 0, 3.0), (0, 0, 0), up=(0, 1, 0)), (-2.0, 2.0, -2.0, 2.0)
    )
    scene = scenes.scene(
        [(scenes.plane("floor", 6.0), scenes.IDENTITY, wall()), box], frame=Frame(WIDTH, WIDTH), view=camera, world=1.0
    )
    settings = SCATTERED.replace(
        bounce_max=BOUNCES, pixel_filter="GAUSSIAN", filter_width=0.05, tile_size=0, **bench.batching
    )
    film = bench.session.render(scene, settings)
    statistics, picture = film.statistics, film.passes["Combined"][..., :3]
    bench.invalid_samples += int(statistics["invalid_samples"])
    expected = np.ones_like(picture)
    expected[500, 300] = BOUNCES + 2
    sweep.add((picture != expected).sum(), 0, 0, f"values that differ; {statistics['seconds']['render']:.1f} s")
    rays = 2 * (WIDTH**2 - 1) + BOUNCES + 2
    sweep.add(statistics["rays"]["total"], rays, 0, "rays traced")
    if waited := statistics["batching"]:
        sweep.add(waited["rays"], rays, 0, "rays taken in")
        sweep.add(waited["finished"], rays, 0, "rays finished")
    return sweep.outcome()


@case(
    "the least of queues",
    FAMILY,
    """A room of glass, mirrors and coloured walls with one block (`queue_count` 1: as many as it takes to go on at
    all), blocks of one ray (`queue_size` 1), both, and one ray alive (`ray_count` 1), each with every way to choose the
    next bucket and both ways to store rays.""",
    SAME,
    traces=False,
)
def least_queues(bench: Bench) -> Outcome:
    films = _Films(bench, _room(), ESTIMATOR)
    for selection in SELECTIONS:
        for storage in ("INDIRECT", "DIRECT"):
            for least in (dict(queue_count=1), dict(queue_size=1), dict(queue_count=1, queue_size=1)):
                found = films.add(
                    f"{selection} {storage} {least}",
                    **WAITING,
                    bucket_selection=selection,
                    ray_storage=storage,
                    **least,
                )
                if "queue_count" in least:
                    films.expect(
                        found.statistics["batching"]["blocks_short"] > 0,
                        f"{selection} {storage} {least}: blocks run out",
                    )
    return films.outcome()


@case(
    "one ray alive",
    FAMILY,
    "The same room with one path alive at a time, and with two that are begun when both are done, for every way to "
    "choose the next bucket.",
    SAME,
    traces=False,
)
def one_ray_alive(bench: Bench) -> Outcome:
    films = _Films(bench, _room(), ESTIMATOR)
    for selection in SELECTIONS:
        films.add(f"{selection}, one", **WAITING, bucket_selection=selection, ray_count=1)
    films.add("two", **WAITING, ray_count=2, ray_low_water=0.0, ray_high_water=0.0)
    films.add("one, in the least of blocks", **WAITING, ray_count=1, queue_count=1, queue_size=1)
    return films.outcome()


@case(
    "every policy",
    FAMILY,
    """The room with every way to choose the next bucket, with and without a longest wait, rays stored by number and by
    value, through the top level naively and interlocked.""",
    SAME,
    traces=False,
)
def every_policy(bench: Bench) -> Outcome:
    films = _Films(bench, _room(), ESTIMATOR)
    for selection in SELECTIONS:
        for storage in ("INDIRECT", "DIRECT"):
            for top_level, wait in (("NAIVE", 0), ("INTERLOCKED", 0), ("INTERLOCKED", 3)):
                films.add(
                    f"{selection}, {storage}, {top_level}, wait {wait}",
                    **WAITING,
                    bucket_selection=selection,
                    bucket_wait_max=wait,
                    ray_storage=storage,
                    top_level_traversal=top_level,
                )
    return films.outcome()


@case(
    "out of blocks",
    FAMILY,
    """The room's rays in pools of 1 to 64 blocks of 1 to 64 rays, fewer than there are buckets or rays: the fullest
    bucket is drained when blocks run out, and nothing is lost.""",
    SAME,
    traces=False,
)
def out_of_blocks(bench: Bench) -> Outcome:
    films, short = _Films(bench, _room(), ESTIMATOR), 0
    for count in (1, 2, 8, 64):
        for size in (1, 3, 64):
            found = films.add(f"{count} blocks of {size}", **FINE, queue_count=count, queue_size=size)
            short += found.statistics["batching"]["blocks_short"]
            films.expect(
                found.statistics["blocks_peak"] <= found.statistics["batching"]["block_count"],
                "no more blocks than there are",
            )
    films.expect(short > 0, "blocks run out")
    return films.outcome()


@case(
    "one bucket",
    FAMILY,
    "The room with treelets as large as its trees, so that all rays wait in one bucket for each, for every way to "
    "choose the next.",
    SAME,
    traces=False,
    quick=True,
)
def one_bucket(bench: Bench) -> Outcome:
    films = _Films(bench, _room(), ESTIMATOR)
    for selection in SELECTIONS:
        found = films.add(selection, batching="ON", treelet_size=10**6, bucket_selection=selection)
        tree = found.statistics["tree"]
        films.expect(tree["cut"]["treelets"] == tree["trees"], f"{selection}: one treelet a tree")
    return films.outcome()


@functools.cache
def _fine_scene() -> Scene:
    ball = scenes.sphere("fine", 800, 420)
    return scenes.scene(
        [(ball, scenes.IDENTITY, wall(0.8)), (scenes.plane("floor", 8), scenes.translation(0, 0, -1), wall(0.5))],
        view=scenes.camera(eye=(0.4, -4, 1.2)),
        frame=Frame(24, 18),
        world=1.0,
    )


@case(
    "ten thousand buckets",
    FAMILY,
    """A ball of 670,000 triangles with a bucket for each of its nodes, more than 10,000 and more than there are rays,
    for every way to choose the next, and with 64 blocks of one ray.""",
    SAME,
    traces=False,
    quick=True,
)
def ten_thousand_buckets(bench: Bench) -> Outcome:
    films = _Films(bench, _fine_scene(), SCATTERED.replace(bounce_max=4, sample_count=2, spatial_splits="OFF"))
    for more in (
        *(dict(bucket_selection=each) for each in SELECTIONS),
        dict(queue_count=64, queue_size=1),
        dict(bucket_wait_max=3),
    ):
        found = films.add(str(more), **FINE, spatial_splits="OFF", top_level_depth_max=1024, **more)
    films.expect(found.statistics["tree"]["cut"]["treelets"] >= 10_000, "ten thousand treelets")
    return films.outcome()


@case(
    "beyond memory with one page",
    FAMILY,
    """The room with the least memory for geometry that is enough, which holds one page at a time: the others are in
    host memory or on disk, and each takes the place of the one before. Every way to choose the next bucket.""",
    SAME,
    traces=False,
)
def one_page(bench: Bench) -> Outcome:
    with tempfile.TemporaryDirectory() as folder:
        session = Session(bench.device, page_folder=folder)
        try:
            films = _Films(bench, _room(), ESTIMATOR, session)
            budget = films.add("least", batching="ON", geometry_budget=1).settings["geometry_budget"]
            for store in ("HOST", "DISK"):
                for selection in SELECTIONS:
                    found = films.add(
                        f"{store} {selection}",
                        batching="ON",
                        geometry_budget=budget,
                        geometry_store=store,
                        bucket_selection=selection,
                    )
                    evicted, loaded = found.statistics["pages_evicted"], found.statistics["pages_loaded"]
                    films.expect(
                        evicted >= loaded - 1 > 0, f"{store} {selection}: every page takes the place of the one before"
                    )
                    films.expect(
                        0 < found.statistics["resident_peak"] <= budget, f"{store} {selection}: the budget is kept"
                    )
            return films.outcome()
        finally:
            session.close()
