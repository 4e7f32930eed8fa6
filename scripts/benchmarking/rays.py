"""Rays of real paths: a render is watched, and the rays that it hands to its tracer are copied in the order in which it
does.
"""

from __future__ import annotations

import contextlib
import re
import sys
from collections.abc import Iterator
from dataclasses import KW_ONLY, dataclass, field

import numpy as np
import warp as wp
from lib.command import UsageError

from benchmarking.scenes import BenchmarkScene
from raybatch_addon.blender.kernel_cache import kernel_cache_folder
from raybatch_addon.core.rays import RayKind, RayList, Rays
from raybatch_addon.core.scene.description import Visibility
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.integrator import TileIntegrator
from raybatch_addon.core.wavefront.rays import BOUNCE_SHIFT, VISIBILITY_SHIFT, Paths
from raybatch_addon.core.wavefront.render import workers
from raybatch_addon.core.wavefront.stages.work import TileWork
from raybatch_addon.core.wavefront.tracers.interface import Tracer

CAMERA_RAYS_MAX = 32  # camera rays that are spent at most, for each ray of a kind that is wanted
TILE_MAX = 65_536  # one tile for the whole frame, so that rays come from all of it


@dataclass(frozen=True)
class RayType:
    """Rays of one kind and bounce."""

    name: str
    shadow: bool
    # scattering events of the path before an extending ray; of a shadow ray, the number of the hit it starts at
    bounce: int


@dataclass(frozen=True)
class RayPlaces:
    """Where in its render each ray belongs."""

    pixel: np.ndarray  # column and row in the frame, from its bottom left, int32, shape [n, 2]
    sample: np.ndarray  # of the pixel, from 0, int32, shape [n]
    wave: np.ndarray  # number of the call that handed it to the tracer, from 0, int32, shape [n]
    sequence: np.ndarray  # its number among all rays that were handed over, of any type, int64, shape [n]

    def taken(self, order: np.ndarray) -> RayPlaces:
        """Those of the rays `order`, indices, in that order."""
        return RayPlaces(self.pixel[order], self.sample[order], self.wave[order], self.sequence[order])


@dataclass(frozen=True)
class CapturedRays:
    """Rays of one type, on the host."""

    type: RayType
    origin: np.ndarray  # [m], float32, shape [n, 3]
    direction: np.ndarray  # unit length, float32, shape [n, 3]
    t_max: np.ndarray  # [m], float32, shape [n]
    visibility: np.ndarray  # `Visibility` bit, int32, shape [n]
    places: RayPlaces | None = None  # where they were asked for

    def __len__(self) -> int:
        return len(self.t_max)

    def taken(self, order: np.ndarray) -> CapturedRays:
        """The rays `order`, indices, in that order."""
        parts = (
            np.ascontiguousarray(part[order]) for part in (self.origin, self.direction, self.t_max, self.visibility)
        )
        return CapturedRays(self.type, *parts, None if self.places is None else self.places.taken(order))


def parse_ray_types(text: str) -> list[RayType]:
    """The types of a list such as `primary,bounce1,shadow1`; raises `UsageError`."""
    types = []
    for name in text.split(","):
        match = re.fullmatch(r"primary|(bounce|shadow)([1-9]\d?)", name.strip())
        if not match:
            raise UsageError(
                f"--rays {name.strip()!r} is not known: choose of primary, bounce1, bounce2 ... and shadow1, shadow2 "
                "..."
            )
        ray_type = RayType(match[0], match[1] == "shadow", int(match[2] or 0))
        if ray_type not in types:
            types.append(ray_type)
    return types


@dataclass
class RayCollector:
    """Keeps the first `ray_count` rays of each type."""

    types: list[RayType]
    ray_count: int
    _: KW_ONLY
    places: bool = False  # keep where in the render each ray belongs, too
    camera_rays: int = 0  # seen so far
    _waves: int = 0
    _handed: int = 0
    _parts: dict[str, list[tuple[np.ndarray, ...]]] = field(default_factory=dict)
    _counts: dict[str, int] = field(default_factory=dict)

    def enough(self) -> bool:
        """Whether all types are complete."""
        return all(self._counts.get(each.name, 0) >= self.ray_count for each in self.types)

    def take(self, kind: RayKind, submitted: RayList, paths: Paths, rays: Rays, work: TileWork) -> None:
        """Copy what is wanted of rays that are handed to a tracer; `work` says which tile they are of."""
        slots = submitted.slots.numpy()[: int(submitted.count.numpy()[0])]
        shadow = kind != RayKind.CLOSEST
        path = slots - paths.status.shape[0] if shadow else slots
        status = paths.status.numpy()
        bounce = status[path] >> BOUNCE_SHIFT
        if shadow:
            bounce = np.maximum(
                bounce, 1
            )  # a path that passed straight through its first surface has not scattered yet
        else:
            self.camera_rays += int(np.count_nonzero(bounce == 0))
        for wanted in self.types:
            left = self.ray_count - self._counts.get(wanted.name, 0)
            if wanted.shadow != shadow or left <= 0:
                continue
            where = np.flatnonzero(bounce == wanted.bounce)
            if shadow and len(where):
                # one to a point of the lamp that it begins at may have no length: it meets nothing
                where = where[_gathered(rays.t_max, _indices(slots[where], rays)) > 0]
            where = where[:left]
            chosen = slots[where]
            if len(chosen):
                indices = _indices(chosen, rays)
                columns = [_gathered(column, indices) for column in (rays.origin, rays.direction, rays.t_max)]
                # the tracer's own array is there only if it reads it
                seen = np.full(len(chosen), int(Visibility.SHADOW)) if shadow else _kinds(status[chosen])
                if self.places:
                    pixel, sample = pixel_samples(work, paths.item.numpy()[path[where]])
                    wave = np.full(len(chosen), self._waves, np.int32)
                    columns += [pixel, sample, wave, self._handed + where.astype(np.int64)]
                self._parts.setdefault(wanted.name, []).append((*columns[:3], seen.astype(np.int32), *columns[3:]))
                self._counts[wanted.name] = self._counts.get(wanted.name, 0) + len(chosen)
        self._waves += 1
        self._handed += len(slots)

    def captured(self) -> list[CapturedRays]:
        """The rays by type, in the order of `types`; raises `UsageError` for a type of which there are none."""
        found = []
        for wanted in self.types:
            if wanted.name not in self._parts:
                raise UsageError(
                    f"the paths of this scene have no rays {wanted.name} (in {self.camera_rays:,} camera rays); leave "
                    "them out of --rays"
                )
            columns = [np.concatenate(column) for column in zip(*self._parts[wanted.name], strict=True)]
            found.append(CapturedRays(wanted, *columns[:4], RayPlaces(*columns[4:]) if self.places else None))
        return found


def _kinds(status: np.ndarray) -> np.ndarray:
    """The `Visibility` bits of extending rays, of which `visibility_of` is the kernels' function."""
    kinds = status >> VISIBILITY_SHIFT & 31
    return np.where(kinds == int(Visibility.SHADOW), int(Visibility.VOLUME_SCATTER), kinds)


def pixel_samples(work: TileWork, number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels in the frame, int32, shape [n, 2], and samples, int32, shape [n], of the paths `number` of a tile: the
    host's twin of `pixel_sample`.
    """
    width, height = int(work.width), int(work.height)
    item = int(work.item_base) + number.astype(np.int64)
    slow, fast = np.divmod(item, int(work.sample_count) if work.pixel_first else width * height)
    pixel, sample = (slow, fast) if work.pixel_first else (fast, slow)
    strip, rest = np.divmod(pixel, 8 * width)  # tiles are walked in blocks of 8 x 8
    rows = np.minimum(8, height - 8 * strip)
    block, rest = np.divmod(rest, 8 * rows)
    row, column = np.divmod(rest, np.minimum(8, width - 8 * block))
    place = np.stack([int(work.x) + 8 * block + column, int(work.y) + 8 * strip + row], 1)
    return place.astype(np.int32), (int(work.sample_first) + sample).astype(np.int32)


def _indices(slots: np.ndarray, rays: Rays) -> wp.array:
    return wp.array(slots, dtype=int, device=rays.origin.device)


def _gathered(array: wp.array, indices: wp.array) -> np.ndarray:
    # a copy: on the CPU the integrator's own memory is not to be kept
    return np.array(wp.indexedarray(array, [indices]).contiguous().numpy())


class ObservedTracer:
    """The integrator's own tracer, with every ray that is handed to it shown to a collector first."""

    def __init__(self, tracer: Tracer, paths: Paths, rays: Rays, collector: RayCollector):
        self._tracer, self._paths, self._rays, self._collector = tracer, paths, rays, collector
        self.work: TileWork | None = None  # of the tile that is rendered

    def submit(self, kind: RayKind, rays: RayList) -> None:
        """See `Tracer.submit`."""
        if rays.bound and not self._collector.enough():
            self._collector.take(kind, rays, self._paths, self._rays, self.work)
        self._tracer.submit(kind, rays)

    def __getattr__(self, name: str):
        return getattr(self._tracer, name)


@contextlib.contextmanager
def observed(collector: RayCollector) -> Iterator[None]:
    """Meanwhile every render shows its rays to `collector`."""

    class ObservedIntegrator(TileIntegrator):
        """Wraps its tracer."""

        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            if self._tracer is not None:
                self._tracer = ObservedTracer(self._tracer, self._paths, self._rays, collector)

        def _begin_tile(self, *arguments):
            work, film = super()._begin_tile(*arguments)
            if self._tracer is not None:
                self._tracer.work = work
            return work, film

    original = workers.TileIntegrator
    workers.TileIntegrator = ObservedIntegrator
    try:
        yield
    finally:
        workers.TileIntegrator = original


def capture_rays(
    scene: BenchmarkScene,
    settings: RenderSettings,
    types: list[RayType],
    ray_count: int,
    device: str,
    places: bool = False,
) -> list[CapturedRays]:
    """`ray_count` rays of each type, or as many as there are, from a render of `scene` by one worker; with their
    `places` where that is asked for.
    """
    collector = RayCollector(types, ray_count, places=places)
    pixels = scene.scene.frame.width * scene.scene.frame.height
    samples = -(-CAMERA_RAYS_MAX * ray_count // pixels)
    # paths go no farther than is asked for, and without roulette, so that late bounces are less rare
    bounces = max(0, *(each.bounce - 1 for each in types))
    settings = settings.replace(
        sample_count=samples,
        tile_size=TILE_MAX,
        thread_count=1,
        sample_order="FRAME_FIRST",
        bounce_max=bounces,
        roulette_bounce=bounces + 1,
    )
    session = Session(device, settings, kernel_cache_folder())
    try:
        with observed(collector):
            session.render(scene.scene, settings, cancelled=collector.enough)
    finally:
        session.close()
    captured = collector.captured()
    for rays in captured:
        if len(rays) < ray_count:
            print(
                f"benchmark.py: {rays.type.name}: {len(rays):,} rays of the {ray_count:,} that were asked for",
                file=sys.stderr,
            )
    return captured
