"""What programs refer to by its place in the scene: images and attributes, collected while graphs are compiled."""

from __future__ import annotations

from typing import Any

# A kind of attribute: where instances are on what places them; `generated` or `uv`
OF_INSTANCER = "OF_INSTANCER"


class Collections:
    """Collected over all graphs of a scene."""

    def __init__(self) -> None:
        self.frame = 0  # of the scene, for images that change with it
        self.images: list[Any] = []  # the core's `Image`s
        self.environment_width = 0  # of the widest image that worlds show [texels]
        self.sun_width = 0  # texels around worlds of which the smallest sun in their skies is two wide
        self.warnings: list[str] = []  # of images and attributes that cannot be used as they are, by name
        self._image_places: dict[Any, int] = {}
        self._attribute_places: dict[tuple[str, str], int] = {}
        self._object_attribute_places: dict[tuple[str, str], int] = {}
        self.asked: set[tuple[str, str]] = set()  # attributes that the graph at hand asks for
        self.view_layer: Any = None  # Blender's, whose properties graphs may ask for
        self.scene: Any = None

    def image(self, key: Any, make) -> int:
        """The place of the image known as `key`, which `make()` exports when it is asked for first."""
        if key not in self._image_places:
            self._image_places[key] = len(self.images)
            self.images.append(make())
        return self._image_places[key]

    def attribute(self, kind: str, name: str) -> int:
        """The place of an attribute of meshes: `kind` tells how it is found, see `export/attributes.py`."""
        self.asked.add((kind, name))
        return self._attribute_places.setdefault((kind, name), len(self._attribute_places))

    def object_attribute(self, kind: str, name: str) -> int:
        """The same of objects (`kind` OBJECT), or of what places them (INSTANCER)."""
        self.asked.add((kind, name))
        return self._object_attribute_places.setdefault((kind, name), len(self._object_attribute_places))

    @property
    def attributes(self) -> list[tuple[str, str]]:
        """(kind, name) of all attributes of meshes, by their place."""
        return list(self._attribute_places)

    @property
    def object_attributes(self) -> list[tuple[str, str]]:
        """(kind, name) of all attributes of objects, by their place."""
        return list(self._object_attribute_places)
