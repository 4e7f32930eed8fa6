"""The list of features: what is compared with Cycles, by name and family."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

FAMILIES = ("Shaders", "Textures", "Inputs", "Utility", "World", "Surface")
# Files of features beside this one
MODULES = (
    "shaders", "shaders_principled", "textures", "textures_image", "inputs", "inputs_pictures", "utility", "utility_mix",
    "utility_pictures", "worlds", "surfaces", "lamps",
)  # fmt: skip
SAMPLES = 96  # of each of the two renders of a picture, at first
RESOLUTION = 40  # pixels, of a picture's edge


@dataclass(frozen=True)
class Feature:
    """One row of the table of parity.

    kind "node": `build(graph, variant)` makes a graph and returns the sockets to look at, by name. Each is emitted by a plane.
    kind "picture": `build(scene)` fills a scene that is set alike for both engines.
    """

    name: str
    family: str
    kind: str
    build: Callable[..., Any]
    quick: bool = False
    variants: tuple[Any, ...] = (None,)
    offset: float = 8.0  # added to what a node gives, so that negative numbers can be emitted
    flat: bool = False  # a node that gives one value everywhere
    samples: int = 0  # of each render of a picture, at first; 0: SAMPLES
    resolution: int = RESOLUTION


_FEATURES: dict[str, Feature] = {}


def feature(name: str, family: str, kind: str, *, variants: Sequence[Any] = (None,), **more) -> Callable[[Callable], Callable]:
    """Enter what is decorated as the builder of a feature. See `Feature` for the rest."""
    assert family in FAMILIES and kind in ("node", "picture"), name
    assert name not in _FEATURES, f"two features are called {name}"

    def enter(build: Callable) -> Callable:
        _FEATURES[name] = Feature(name, family, kind, build, variants=tuple(variants), **more)
        return build

    return enter


def all_features() -> list[Feature]:
    """Every feature, family by family."""
    for module in MODULES:
        importlib.import_module(f"{__package__}.{module}")
    return sorted(_FEATURES.values(), key=lambda each: FAMILIES.index(each.family))


def chosen_features(names: Sequence[str] = (), quick: bool = False) -> list[Feature]:
    """Those called, or of the family, or with a part of their name in `names` (all without any). Raises `LookupError`."""
    everything = all_features()
    chosen = [each for each in everything if each.quick or not quick]
    if not names:
        return chosen
    found: list[Feature] = []
    for name in names:
        exact = [each for each in chosen if name.lower() in (each.name.lower(), each.family.lower())]
        matching = exact or [each for each in chosen if name.lower() in each.name.lower()]
        if not matching:
            raise LookupError(f"no feature is called {name!r}; --list names them")
        found += matching
    return [each for each in chosen if each in found]
