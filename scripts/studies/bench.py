"""Measures renders for studies: one session, scenes and references that are kept, and a row of figures for each
render.
"""

from __future__ import annotations

import dataclasses
import hashlib
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from converging.reference import core_digest
from rendering.standalone import resized

from raybatch_addon.blender.kernel_cache import kernel_cache_folder
from raybatch_addon.core.convergence.errors import relmse, rmse
from raybatch_addon.core.convergence.points import (
    ConvergenceRecorder,
    Reference,
    efficiency,
    load_reference,
    noise_floor,
    save_reference,
    scene_hash,
)
from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.film import Film
from raybatch_addon.core.observers import Progress, RenderObserver
from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from studies.curves import slope_of
from studies.study import Options, Row

WARM_EDGE = 32  # pixels of the render before the first that is timed
REFERENCE_SEED = 1_000_003
# What a render with queues reports of itself
_BATCHING = (
    "steps",
    "rays_queued_per_ray",
    "treelet_visits_per_ray",
    "bytes_copied",
    "pages_loaded",
    "resident_peak",
    "blocks_short",
)


class TimeCap(RenderObserver):
    """An observer that ends a render after some seconds of rendering, build and compilation not counted."""

    def __init__(self, seconds: float | None):
        self._seconds = seconds
        self._began: float | None = None

    def on_progress(self, progress: Progress) -> None:
        """The clock runs from the first rays on."""
        if progress.stage == "render" and self._began is None:
            self._began = time.perf_counter()

    def cancelled(self) -> bool:
        """Whether time is up."""
        return (
            self._seconds is not None and self._began is not None and time.perf_counter() - self._began > self._seconds
        )


class Bench:
    """One device."""

    def __init__(self, options: Options):
        self.options = options
        self.session = Session(options.device, None, kernel_cache_folder())
        self._scenes: dict[Any, Scene] = {}
        self._references: dict[Any, Reference] = {}
        self._warm: set[Any] = set()
        self.geometry_bytes: int | None = None  # of the scene at hand, where a study needs it

    def close(self) -> None:
        """Give back what is held."""
        self.session.close()
        self._scenes.clear()

    def scene(self, key: Any, make: Callable[[], Scene]) -> Scene:
        """The scene called `key`, made the first time; only the last one is kept, which may be large."""
        if key not in self._scenes:
            self.session.close()
            self._scenes = {key: make()}
        return self._scenes[key]

    def timed(self, scene: Scene, settings: RenderSettings, warm: Any = None, cap: float | None = None) -> Row:
        """Figures of one render. A small one comes first, untimed, where there was none of `warm` yet: kernels are
        loaded then.

        A render that takes more than `cap` seconds is ended, and reported by how far it came: `complete` is false,
        `share` what was done.
        """
        self._warm_up(scene, settings, warm)
        watch = TimeCap(cap)
        film = self.session.render(scene, settings, observers=[watch], cancelled=watch.cancelled)
        return row_of(film, settings)

    def curve(self, scene: Scene, settings: RenderSettings, reference: Reference, warm: Any = None) -> Row:
        """Figures of one render, and its error at geometric sample counts against `reference`."""
        self._warm_up(scene, settings, warm)
        recorder = ConvergenceRecorder()
        film = self.session.render(scene, settings, observers=[recorder])
        points = recorder.points(reference)
        reported = [
            {"seconds": p.seconds, "samples": p.samples, "rmse": p.rmse, "relmse": p.relmse, "spread": p.rmse_spread}
            for p in points
        ]
        return {
            **row_of(film, settings),
            "points": reported,
            "sequence": settings.sample_sequence,
            "slope": slope_of(points),
            "efficiency": efficiency(points, "relmse"),
            "floor": dict(zip(("rmse", "relmse"), noise_floor(reference), strict=True)),
        }

    def compared(self, scene: Scene, settings: RenderSettings, reference: Reference, warm: Any = None) -> Row:
        """Figures of one render that nobody watches: the error of its film, the mean of its samples, how bright it is
        beside `reference`, and `cost`: its seconds, on a CPU those of processors, so that other work does not count.
        """
        self._warm_up(scene, settings, warm)
        began = time.process_time()
        film = self.session.render(scene, settings)
        seconds = time.process_time() - began
        reported, picture = film.statistics, film.passes["Combined"][..., :3]
        adaptive = reported["adaptive"] or {}
        return {
            **row_of(film, settings),
            "cost": reported["seconds"]["render"] if self.options.is_cuda else seconds,
            "samples_mean": reported["samples"] / (film.width * film.height),
            "converged": adaptive.get("converged"),
            "rounds": len(adaptive.get("looks", ())) + 1,
            "relmse": relmse(picture, reference.picture),
            "rmse": rmse(picture, reference.picture),
            "brightness": float(picture.mean(dtype=float) / reference.picture.mean(dtype=float)),
        }

    def _warm_up(self, scene: Scene, settings: RenderSettings, warm: Any) -> None:
        if warm is not None and warm not in self._warm:
            self.session.render(resized(scene, WARM_EDGE, WARM_EDGE), settings.replace(sample_count=1))
            self._warm.add(warm)

    def reference(self, key: Any, scene: Scene, settings: RenderSettings, samples: int) -> Reference:
        """What the picture should be: by this engine as it is, with another seed, in halves that give its own error;
        kept in a file.
        """
        settings = settings.replace(seed=REFERENCE_SEED, sample_count=samples, error_estimate="ON")
        if key in self._references:
            return self._references[key]
        frame = scene.frame
        made = (
            f"{scene_hash(scene)[:16]}-{core_digest()[:8]}-{frame.width}x{frame.height}-{settings.bounce_max}-{samples}"
        )
        path = self.options.cache / f"reference-{made}.npz"
        if path.is_file():
            reference = load_reference(path, (frame.width, frame.height), scene_hash(scene), settings)
        else:
            recorder = ConvergenceRecorder(1e9)
            self.session.render(scene, settings, observers=[recorder])
            halves = recorder.snapshots[-1].halves
            assert halves is not None  # of a render with an error estimate
            a, b = halves
            reference = Reference.of_halves(a, b, f"RayBatch, {samples} samples", samples)
            save_reference(path, reference, scene_hash(scene), settings)
        self._references = {key: reference}
        return reference


def row_of(film: Film, settings: RenderSettings) -> Row:
    """What is kept of a film and its statistics."""
    reported = film.statistics
    whole = film.width * film.height * settings.sample_count
    share = reported["samples"] / whole
    seconds = reported["seconds"]
    batching = reported.get("batching") or {}
    tree, images = reported.get("tree") or {}, reported["images"]
    cut = tree.get("cut") or {}
    return {
        "seconds": round(seconds["render"], 6),
        "build": round(seconds["build"], 4),
        "rays": reported["rays"]["total"],
        "rays_per_second": reported["rays_per_second"],
        "complete": bool(reported["complete"]),
        "share": 1.0 if reported["complete"] else share,
        "film": digest(film) if reported["complete"] else None,
        "invalid_samples": reported["invalid_samples"],
        "rays_alive": reported["schedule"]["ray_count"],
        "method": chosen(reported),
        "tree_bytes": tree.get("bytes"),
        **({"treelets": cut["treelets"], "treelet_nodes": cut["treelet_nodes_mean"]} if cut else {}),
        **{name: batching[name] for name in _BATCHING if name in batching},
        **({"tiles": images["tiles"]} if "tiles" in images else {}),
        **({"warnings": reported["warnings"]} if reported["warnings"] else {}),
    }


def chosen(reported: dict[str, Any]) -> str:
    """What `batching` was, or AUTO made of it."""
    asked = reported["settings"]["batching"]
    return reported["auto"].get("batching", {}).get("value", asked) if asked == "AUTO" else asked


def digest(film: Film) -> str:
    """Digest of the bits of the picture."""
    return hashlib.blake2b(np.ascontiguousarray(film.passes["Combined"]).tobytes(), digest_size=8).hexdigest()


def whole_seconds(row: Row) -> float | None:
    """Seconds of the whole render; of one that was ended estimated from the share that was done; None: too little
    was.
    """
    if row.get("seconds") is None:
        return None
    return row["seconds"] if row["complete"] else row["seconds"] / row["share"] if row["share"] > 1e-3 else None


def refused(error: RayBatchError) -> Row:
    """A row for a case that RayBatch refuses."""
    return {"seconds": None, "complete": False, "share": 0.0, "refused": " ".join(str(error).split())}


def with_frame(scene: Scene, width: int, height: int) -> Scene:
    """`scene` in a frame of this size, the picture alone."""
    scene = resized(scene, width, height)
    return dataclasses.replace(scene, frame=dataclasses.replace(scene.frame, passes=("Combined",)))
