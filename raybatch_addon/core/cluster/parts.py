"""A scene as parts that are known by what they hold: a recipe, and arrays by digest.

Frames of an animation share the parts that did not change, and a machine fetches none that it has.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..device.bulk import digest_of
from ..errors import SceneError
from ..scene.archive import record_of_scene, scene_of_record
from ..scene.description import Scene
from ..scene.frozen import freeze
from ..settings.settings import RenderSettings


@dataclass(frozen=True)
class SceneParts:
    """The parts of a scene and its settings."""

    recipe: str  # JSON: all but the arrays, and their digests
    arrays: dict[str, np.ndarray] = field(repr=False)  # by digest

    @property
    def digest(self) -> str:
        """Is equal for equal scenes and settings only."""
        return hashlib.blake2b(self.recipe.encode(), digest_size=16).hexdigest()


def part_digest(array: np.ndarray) -> str:
    """Is equal for equal arrays only."""
    return digest_of([array]).hex()[:40]


def parts_of(scene: Scene, settings: RenderSettings) -> SceneParts:
    """`scene` and `settings` in parts."""
    record, arrays = record_of_scene(scene, settings)
    digests = {name: part_digest(array) for name, array in arrays.items()}
    recipe = json.dumps({"record": record, "arrays": digests}, ensure_ascii=False, sort_keys=True)
    return SceneParts(recipe, {digests[name]: array for name, array in arrays.items()})


def digests_in(recipe: str) -> list[str]:
    """Of all arrays that it asks for, each once."""
    return sorted(set(json.loads(recipe)["arrays"].values()))


def scene_of(recipe: str, load: Callable[[str], np.ndarray]) -> tuple[Scene, RenderSettings]:
    """The inverse of `parts_of`; `load` gives the array of a digest. Raises `SceneError` for what is none."""
    try:
        read = json.loads(recipe)
        arrays = {name: freeze(load(digest)) for name, digest in read["arrays"].items()}
        return scene_of_record(read["record"], arrays)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise SceneError(f"the scene that was sent cannot be read: {error}") from error
