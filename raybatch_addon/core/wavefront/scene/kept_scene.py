"""The last scene on its device as a whole, for the next render of the same."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from enum import Enum, auto
from itertools import chain
from operator import attrgetter
from typing import Any, TypeVar

import numpy as np

from ...attributes import attributes_of
from ...bvh.build.scene_tree import BuiltTree
from ...device.bulk import digest_of
from ...scene.description import Scene
from ...scene.features import SceneFeatures
from ...scene.frozen import Same, is_frozen
from ...scene.notice import Notice
from ...settings.settings import SETTINGS, RenderSettings
from ..plan.plan import Method
from ..plan.tracing import Tracing
from .device_scene import DeviceScene
from .geometry_request import GeometryRequest

# Arrays that may change are looked at in each render, together up to this size [bytes]
_LOOSE_MOST = 1 << 24
# Types of values that nobody can change: these themselves, and such as may be derived from
_PLAIN = frozenset((int, float, str, bool, type(None)))
_UNCHANGING = (Enum, np.number, np.bool_, Notice)
# All settings but those of random numbers
settings_but_seeds = attrgetter(*(name for name in SETTINGS if name not in ("seed", "sample_count")))
settings_but_seed = attrgetter(*(name for name in SETTINGS if name != "seed"))

Made = TypeVar("Made")


class KeptScene:
    """What the last render made of its scene, while scene and settings are the same but for random numbers."""

    def __init__(self) -> None:
        self._same: Same | None = None  # the scene of the last render
        self.is_sound = False  # checks of that scene found nothing
        self._derived: dict[str, tuple[Any, Any]] = {}  # by name: settings, and what follows from them and the scene
        self._asked: tuple = ()
        self._made: DeviceScene | None = None
        self._workers: tuple[tuple, Any] | None = None  # that rendered it, and what they were made for

    def clear(self) -> None:
        """Forget it."""
        self._same, self.is_sound = None, False
        self._derived = {}
        self._drop()

    def _drop(self) -> None:
        self._made = self._workers = None

    def begin(self, key: tuple[list[np.ndarray], tuple] | None) -> None:
        """A render of the scene with this `scene_key` begins: what was made of another one is dropped before anything
        is made of this.
        """
        if key is None:
            self.clear()
        elif self._same is None or not self._same.holds(*key):
            self.clear()
            self._same = Same(*key)

    @property
    def is_known(self) -> bool:
        """Whether the next `begin` can tell that a scene is the same."""
        return self._same is not None

    def derived(self, name: str, settings: RenderSettings, make: Callable[[], Made]) -> Made:
        """What `make` returns, which follows from the scene that `begin` got and from `settings` but for the seed."""
        if self._same is None:
            return make()
        key, found = settings_but_seed(settings), self._derived.get(name)
        if found is None or found[0] != key:
            found = self._derived[name] = key, make()
        return found[1]

    def find(self, asked: tuple) -> DeviceScene | None:
        """What was made of the scene that `begin` got, if it was asked for alike; otherwise that is dropped."""
        if self._asked != asked:
            self._drop()
        if self._made is not None and isinstance(self._made.built, BuiltTree):
            self._made.built.note(0, 0)
        return self._made

    def keep(self, asked: tuple, made: DeviceScene) -> None:
        """`made` was made of the scene that `begin` got. What lies beyond memory changes while it is rendered, and is
        not kept.
        """
        if self._same is not None and made.paged is None:
            self._drop()
            self._asked, self._made = asked, made

    def take_workers(self, scene: DeviceScene, key: tuple) -> Any:
        """The workers that rendered `scene` last, if they are kept and `key` is the same; they are the caller's now."""
        kept, self._workers = self._workers, None
        return kept[1] if kept is not None and scene is self._made and kept[0] == key else None

    def keep_workers(self, scene: DeviceScene, key: tuple, workers: Any) -> None:
        """Keep the `workers` that rendered `scene`, if that is kept."""
        if scene is self._made:
            self._workers = key, workers

    @property
    def device_bytes(self) -> int:
        """Memory on the device that only this keeps, and no cache of the scene's parts [bytes]."""
        made = self._made  # the build of a cancelled render may ask
        return 0 if made is None else made.own_bytes


def asked_of(
    settings: RenderSettings, features: SceneFeatures, shading: SceneFeatures, request: GeometryRequest
) -> tuple:
    """What a scene on its device follows from beside the `Scene`."""
    plan, tracing = request.plan, Tracing.of(request.plan, request.layout, features)
    sizes = (plan.treelet_size, plan.treelet_bytes) if plan.method is Method.BATCHED else ()
    return settings_but_seeds(settings), features, shading, tracing, sizes, plan.splits, request.kind()


def scene_key(scene: Scene) -> tuple[list[np.ndarray], tuple] | None:
    """All of `scene`: its frozen arrays, and values, among them a digest of its other arrays; None where these are so
    large that it is not worth while to look at them, or where there are things that may change unseen.
    """
    frozen: list[np.ndarray] = []
    loose: list[np.ndarray] = []

    def values_of(value: Any) -> Any:
        kind = type(value)
        if kind in _PLAIN:
            return value
        if isinstance(value, (tuple, list)):
            return values_of_all(tuple(value))
        if kind is np.ndarray and not value.dtype.hasobject:
            is_kept = is_frozen(value)
            (frozen if is_kept else loose).append(value)
            return _Array.FROZEN if is_kept else _Array.LOOSE
        if is_dataclass(kind):
            return kind, values_of(_reader(kind)(value))
        if isinstance(value, _UNCHANGING):
            return value
        raise _UnknownThing

    def values_of_all(parts: tuple) -> tuple:
        kinds = set(map(type, parts))
        if kinds <= _PLAIN or (kinds == {tuple} and _PLAIN.issuperset(map(type, chain.from_iterable(parts)))):
            return parts
        if len(kinds) == 1 and is_dataclass(kind := kinds.pop()):
            # field by field, because there may be many steps of programs
            return kind, len(parts), tuple(map(values_of, zip(*map(_reader(kind), parts), strict=True)))
        return tuple(map(values_of, parts))

    try:
        values = values_of(scene)
    except _UnknownThing:
        return None
    if sum(each.nbytes for each in loose) > _LOOSE_MOST:
        return None
    return frozen, (values, digest_of(loose))


class _Array(Enum):
    """The place of an array among values."""

    FROZEN = auto()
    LOOSE = auto()


class _UnknownThing(Exception):
    """Raised for a value of which nobody knows whether it can change."""


@functools.cache
def _reader(kind: type) -> Callable[[Any], tuple]:
    """What reads all fields of a dataclass."""
    return attributes_of([each.name for each in fields(kind)])
