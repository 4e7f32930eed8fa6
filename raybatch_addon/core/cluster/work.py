"""What workers of a cluster do: keep parts of scenes, render ranges of samples, and merge films.

Arguments and results are text, numbers and arrays, so that a worker needs the library alone, by whatever name.
"""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..checkpoint.identity import FilmIdentity
from ..device.devices import device_description, start_warp, warp_cache_folder
from ..errors import RayBatchError
from ..scene.description import Scene
from ..session import Session
from ..settings.settings import RenderSettings
from ..wavefront.adaptive.active_pixels import ActivePixels
from . import films
from .bands import active_in_band, scene_of_band
from .parts import scene_of
from .store import PartStore

# Environment variables of a worker: its device and threads, as the settings of these names; and its folders
WORKER_DEVICE, WORKER_THREADS = "RAYBATCH_DEVICE", "RAYBATCH_THREADS"
KERNEL_CACHE, PART_FOLDER = "RAYBATCH_KERNEL_CACHE", "RAYBATCH_PART_FOLDER"
_SCENES_KEPT = 2

_lock = threading.Lock()  # a worker renders one range at a time
_session: Session | None = None
_scenes: dict[str, tuple[Scene, RenderSettings]] = {}  # by digest of the recipe, the last ones
_identities: dict[str, FilmIdentity] = {}  # of their films: to digest a scene takes as long as it is large


def part_store() -> PartStore:
    """The store of this machine."""
    if named := os.environ.get(PART_FOLDER):
        return PartStore(Path(named))
    start_warp(os.environ.get(KERNEL_CACHE) or None)
    return PartStore(warp_cache_folder() / "scenes")


def lacks(digests: list[str]) -> list[str]:
    """Those of the parts that are not on this machine."""
    return part_store().lacks(digests)


def put(arrays: dict[str, np.ndarray]) -> int:
    """Keep parts here, by their digests; how many there were."""
    part_store().put(arrays)
    return len(arrays)


def render(recipe: str, digest: str, band: Sequence[int], first: int, count: int, stopped: str = "") -> films.Sent:
    """The film of `count` samples from `first` on in a band (x0, y0, x1, y1) of the frame, of the scene of `recipe`.
    `stopped` is the digest of the pixels that have ended their sampling, as `ActivePixels` has them; empty: none.
    Raises `PartMissing` where parts of the scene are not here.
    """
    with _lock:
        started = time.perf_counter()
        whole, settings = _scene(recipe, digest)
        x0, y0, x1, y1 = band
        scene = scene_of_band(whole, (x0, y0, x1, y1))
        session = _opened()
        settings = settings.replace(sample_count=count)
        after = None
        if stopped:
            active = ActivePixels(whole.frame.region, settings.noise_threshold, part_store().load(stopped))
            after = active_in_band(active, (x0, y0, x1, y1))
        # when the render ends is decided where all samples are
        own = settings.replace(error_target=0.0, error_estimate="ON") if settings.error_target else settings
        film = session.render(scene, own, sample_first=first, after=after)
        if digest not in _identities:
            _identities[digest] = FilmIdentity.of(whole, settings, session.device)
        identity = _identities[digest]
        own_settings = {**identity.settings, "sample_count": count}
        identity = replace(identity, region=(x0, y0, x1, y1), settings=own_settings)
        kept = films.kept_of(film, identity, first, settings.sample_order)
        halves = films.packed(kept)
        statistics = film.statistics
        share = {
            "first": first,
            "end": first + count,
            "region": [x0, y0, x1, y1],
            "worker": f"{socket.gethostname()}, process {os.getpid()}",
            "device": device_description(session.device),
            "identity": identity.device,
            "seconds": round(time.perf_counter() - started, 6),
            "seconds_rendering": statistics["seconds"]["render"],
            "rays": statistics["rays"],
            "memory_peak": statistics["memory_peak"],
            "warnings": [str(each) for each in statistics["warnings"] if each not in scene.warnings],
        }
        return films.sent_film(kept, [share], halves)


def shares_of(sent: films.Sent) -> Any:
    """Who rendered which of its samples, or the error that it is instead; raises `DamagedFilm`."""
    return sent if "error" in sent else films.sent_shares(sent)


def merge(first: films.Sent, second: films.Sent) -> films.Sent:
    """See `films.merged`; the error of one of them, if it has no film."""
    return next((each for each in (first, second) if "error" in each), None) or films.merged(first, second)


def picture(sent: films.Sent) -> dict[str, np.ndarray]:
    """Its passes."""
    return films.received_film(sent)[0].film().passes


def _scene(recipe: str, digest: str) -> tuple[Scene, RenderSettings]:
    if digest not in _scenes:
        while len(_scenes) >= _SCENES_KEPT:
            first = next(iter(_scenes))
            del _scenes[first]
            _identities.pop(first, None)
        scene, settings = scene_of(recipe, part_store().load)
        threads = os.environ.get(WORKER_THREADS) or "0"
        if not threads.isdecimal():
            raise RayBatchError(f"{WORKER_THREADS} is {threads!r}; set it to a number of threads, or not at all")
        _scenes[digest] = scene, settings.replace(thread_count=int(threads))
    return _scenes[digest]


def _opened() -> Session:
    global _session
    if _session is None:
        folder = os.environ.get(KERNEL_CACHE)
        _session = Session(os.environ.get(WORKER_DEVICE) or "AUTO", cache_folder=folder or None)
    return _session
