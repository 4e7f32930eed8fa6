"""What programs refer to by its place in the scene: images and attributes, collected while graphs are compiled."""

from __future__ import annotations

from typing import Any


class Collections:
    """Collected over all graphs of a scene."""

    def __init__(self) -> None:
        self.frame = 0  # of the scene, for images that change with it
        self.images: list[Any] = []  # the core's `Image`s
        self.environment_width = 0  # of the widest image that worlds show [texels]
        self.warnings: list[str] = []  # of images and attributes that cannot be used as they are, by name
        self._image_places: dict[Any, int] = {}
        self._attribute_places: dict[tuple[str, str], int] = {}

    def image(self, key: Any, make) -> int:
        """The place of the image known as `key`, which `make()` exports when it is asked for first."""
        if key not in self._image_places:
            self._image_places[key] = len(self.images)
            self.images.append(make())
        return self._image_places[key]

    def attribute(self, kind: str, name: str) -> int:
        """The place of an attribute: `kind` tells where it is looked for."""
        return self._attribute_places.setdefault((kind, name), len(self._attribute_places))

    @property
    def attributes(self) -> list[tuple[str, str]]:
        """(kind, name) of all attributes, by their place."""
        return list(self._attribute_places)
