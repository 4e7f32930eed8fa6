"""The list of features that are compared with Cycles, by name and family."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any

FAMILIES = (
    "Shaders",
    "Textures",
    "Inputs",
    "Utility",
    "World",
    "Surface",
    "Curves",
    "Volumes",
    "Light linking",
    "Shadow catchers",
)
# files of features in `families/`
MODULES = (
    "shaders",
    "shaders_principled",
    "portals.rays",
    "portals.world",
    "textures",
    "textures_image",
    "inputs",
    "inputs_pictures",
    "inputs_rays",
    "utility.values",
    "utility.mix",
    "utility.pictures",
    "worlds",
    "light_paths",
    "surfaces",
    "lamps",
    "linking",
    "catchers.pictures",
    "curves.strands",
    "curves.particle_hair",
    "volumes",
    "volumes_moving",
    "cameras",
    "motion",
)
SAMPLES = 96  # samples of each of the two renders of a picture, at first
RESOLUTION = 40  # edge of a picture [pixels]


@dataclass(frozen=True)
class Feature:
    """One row of the table of parity.

    kind "node": `build(graph, variant)` makes a graph and returns the sockets to look at, by name; a plane emits each.
    kind "picture": `build(scene)` fills a scene with the same settings for both engines.
    """

    name: str
    family: str
    kind: str
    build: Callable[..., Any]
    _: KW_ONLY
    quick: bool = False
    variants: tuple[Any, ...] = (None,)
    offset: float = 8.0  # added to a node's output, so that negative numbers can be emitted
    flat: bool = False  # the node gives one value everywhere
    samples: int = 0  # samples of each render of a picture, at first; 0: SAMPLES
    resolution: int = RESOLUTION
    shows: str = "Combined"  # the pass of a picture that is compared; Combined lies over grey where it has alpha
    finding: str = ""  # who is right where the engines differ, and how that is known


_FEATURES: dict[str, Feature] = {}


def feature(
    name: str, family: str, kind: str, *, variants: Sequence[Any] = (None,), **more
) -> Callable[[Callable], Callable]:
    """Register the decorated function as the builder of a feature; see `Feature` for the rest."""
    assert family in FAMILIES and kind in ("node", "picture"), name
    assert name not in _FEATURES, f"two features are called {name}"

    def enter(build: Callable) -> Callable:
        _FEATURES[name] = Feature(name, family, kind, build, variants=tuple(variants), **more)
        return build

    return enter


def all_features() -> list[Feature]:
    """Every feature, family by family."""
    for module in MODULES:
        importlib.import_module(f"{__package__}.families.{module}")
    return sorted(_FEATURES.values(), key=lambda each: FAMILIES.index(each.family))


def chosen_features(names: Sequence[str] = (), quick: bool = False) -> list[Feature]:
    """The features that `names` choose: a name, a family, or a part of names; without names all.

    Raises `LookupError`.
    """
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
