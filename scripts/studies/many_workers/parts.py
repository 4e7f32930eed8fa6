"""What the parts of a render on a cluster take, measured on a processor: tasks, films, scenes, and what goes through
Dask's scheduler.
"""

from __future__ import annotations

import dataclasses
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest import mock

import numpy as np

from raybatch_addon.core.checkpoint.identity import FilmIdentity
from raybatch_addon.core.checkpoint.merging import joined
from raybatch_addon.core.cluster import films, ranges
from raybatch_addon.core.cluster.bands import film_of_bands
from raybatch_addon.core.cluster.parts import parts_of, scene_of
from raybatch_addon.core.cluster.store import PartStore
from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.settings.settings import RenderSettings
from studies.many_lights import hall
from studies.study import Case, Options, Row

if TYPE_CHECKING:
    from studies.bench import Bench

EDGE = 512  # of the film that is measured: 262,144 pixels, a band of a large picture
TASKS = (60, 180)  # of the renders whose difference is what a task costs
DASK_TASKS = 4  # of Dask's, for a range of samples: it is rendered, who did so is told, its film is copied, and merged
RELAYED = 8  # films that go through the scheduler


def processor_seconds(work: Callable[[], Any]) -> float:
    """Of this process, for `work`."""
    began = time.process_time()
    work()
    return time.process_time() - began


def measured_films(bench: Bench) -> Row:
    """Seconds of a processor for what happens to a film, for each pixel, and its bytes."""
    scene, settings = hall("lamps", 10, EDGE), RenderSettings(sample_count=1, bounce_max=0)
    session, kept = bench.session, []
    for sample in range(2):
        film = session.render(scene, settings, sample_first=sample)
        identity = FilmIdentity.of(scene, settings, session.device)
        kept.append(films.kept_of(film, identity, sample, settings.sample_order))
    first, second = (films.sent_film(each, []) for each in kept)
    pixels = EDGE * EDGE
    bands = []  # halves of the frame, to be put together
    for y0, y1 in ((0, EDGE // 2), (EDGE // 2, EDGE)):
        part = dataclasses.replace(scene, frame=dataclasses.replace(scene.frame, border=(0, y0, EDGE, y1)))
        film = session.render(part, settings)
        identity = dataclasses.replace(FilmIdentity.of(scene, settings, session.device), region=(0, y0, EDGE, y1))
        bands.append(films.kept_of(film, identity, 0, settings.sample_order))
    halves = films.packed(kept[0])
    whole = film_of_bands(bands, (0, 0, EDGE, EDGE))
    works = {
        "film_made": lambda: films.sent_film(kept[0], [], films.packed(kept[0])),
        "film_merged": lambda: films.merged(first, second),
        "film_received": lambda: films.received_film(first),
        "film_joined": lambda: film_of_bands(bands, (0, 0, EDGE, EDGE)),
        "film_added": lambda: joined(*kept),
        "film_shown": lambda: whole.film().passes,
    }
    row: dict[str, float] = {name: processor_seconds(work) / pixels for name, work in works.items()}
    row["film_bytes"] = sum(array.nbytes for half in halves for array in half.values()) / pixels
    return row


def measured_scene(bench: Bench) -> Row:
    """Seconds of a processor for a scene that is sent, for each byte."""
    edge = bench.options.pick(400, 1000)
    scene = _terrain(edge)
    parts: list[Any] = []
    cut = processor_seconds(lambda: parts.append(parts_of(scene, RenderSettings())))
    size = sum(array.nbytes for array in parts[0].arrays.values())
    with tempfile.TemporaryDirectory(prefix="raybatch-study-") as folder:
        store = PartStore(Path(folder))
        kept = processor_seconds(lambda: store.put(parts[0].arrays))
        read = processor_seconds(lambda: scene_of(parts[0].recipe, store.load))
    return {"scene_cut": cut / size, "scene_kept": kept / size, "scene_read": read / size, "scene_bytes": size}


def _terrain(edge: int) -> Scene:
    y, x = np.mgrid[:edge, :edge].astype(np.float32)
    height = np.sin(x * 0.1) * np.cos(y * 0.13)
    vertices = np.stack([x, y, height], -1).reshape(-1, 3).astype(np.float32)
    corner = (np.arange(edge - 1)[:, None] * edge + np.arange(edge - 1)).reshape(-1, 1)
    quads = corner + np.array([0, 1, edge + 1, edge])
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    lit = hall("lamps", 10, 32)
    mesh = dataclasses.replace(lit.meshes[0], positions=vertices, triangles=triangles)
    return dataclasses.replace(lit, meshes=(mesh, *lit.meshes[1:]))


def measured_tasks(bench: Bench) -> Row:
    """Seconds of a processor of the scheduler and of who hands out, for each of Dask's tasks; and of the scheduler and
    the workers for each byte that goes through it.
    """
    import psutil
    from testing.cluster_faults.machines import Machines

    from raybatch_addon.core.cluster.connection import Connection
    from raybatch_addon.core.cluster.session import ClusterSession

    with (
        tempfile.TemporaryDirectory(prefix="raybatch-study-", ignore_cleanup_errors=True) as folder,
        mock.patch.multiple(ranges, TASK_SECONDS=0.0, TASK_TIMES_FILM=0.0, LEAST_SECONDS=0.0),
    ):
        machines = Machines(Path(folder))
        try:
            for _ in range(2):
                machines.add()
            connection = Connection(machines.address)
            machines.mend(connection)
            scheduler, session = psutil.Process(machines.scheduler_pid), ClusterSession(connection)
            scene = hall("lamps", 10, 16)

            def render(count: int) -> tuple[float, float]:
                began = scheduler.cpu_times(), time.process_time()
                session.render(scene, RenderSettings(sample_count=count, bounce_max=0))
                ended = scheduler.cpu_times(), time.process_time()
                return _seconds(*(each[0] for each in (began, ended))), ended[1] - began[1]

            render(8)  # kernels are loaded
            few, many = (render(count) for count in TASKS)
            count = DASK_TASKS * (TASKS[1] - TASKS[0])
            relayed = _relayed(connection, scheduler)
            session.close()
            connection.close()
        finally:
            machines.close()
    return {
        "scheduler_task": max(many[0] - few[0], 0.0) / count,
        "client_task": max(many[1] - few[1], 0.0) / count,
        "relay": relayed,
    }


def _relayed(connection: Any, scheduler: Any) -> float:
    """Seconds of the scheduler's processor for a byte of what it passes on."""
    client = connection._client
    size = 18 << 20
    futures = [client.submit(bytes, size, pure=False) for _ in range(RELAYED)]
    for future in futures:
        future.exception()
    began = scheduler.cpu_times()
    for future in futures:
        future.result()
    return _seconds(began, scheduler.cpu_times()) / (RELAYED * size)


def _seconds(began: Any, ended: Any) -> float:
    return ended.user + ended.system - began.user - began.system


MEASURES: dict[str, Callable[[Bench], Row]] = {
    "films": measured_films,
    "scenes": measured_scene,
    "tasks": measured_tasks,
}


def cases(options: Options) -> list[Case]:
    """The kinds of parts."""
    return [Case(name, name) for name in MEASURES]


def measure(case: Case, turn: int, bench: Bench) -> Row:
    """The seconds of one kind."""
    return MEASURES[case.key](bench)
