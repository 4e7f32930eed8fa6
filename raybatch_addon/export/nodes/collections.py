"""Images and attributes that programs refer to by index, collected while graphs are compiled."""

from __future__ import annotations

from collections.abc import Hashable
from typing import TYPE_CHECKING, Any

from ...core.scene.description import Image

if TYPE_CHECKING:
    import bpy

# Kind of an attribute: position of instances on the surface that places them, `generated` or `uv`
OF_INSTANCER = "OF_INSTANCER"
_WITHOUT_WORLD = 3e38  # [m]


def occlusion_distance(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> float:
    """How far occlusion reaches in Blender's `scene` where nothing else says so [m]."""
    world = getattr(view_layer, "world_override", None) or getattr(scene, "world", None)
    return _WITHOUT_WORLD if world is None else float(world.light_settings.distance)


class Collections:
    """Images and attributes of all graphs of a scene."""

    def __init__(self) -> None:
        self.frame = 0  # the scene's frame, for images that change with it
        self.images: list[Image] = []
        self.environments: set[int] = set()  # images that worlds show all around, by index
        # suns in the worlds' skies: unit vector towards each, None where it is not known, and angular diameter [rad]
        self.suns: set[tuple[tuple[float, float, float] | None, float]] = set()
        self.warnings: list[str] = []  # messages about images and attributes that cannot be used as they are, by name
        self._image_places: dict[Hashable, int] = {}
        self._attribute_places: dict[tuple[str, str], int] = {}
        self._object_attribute_places: dict[tuple[str, str], int] = {}
        self.asked: set[tuple[str, str]] = set()  # attributes that the current graph reads
        # what the current graph asked for: `image` with its key, `attribute` and `object_attribute` with their
        # arguments, and the answers; None: it depends on more than its nodes and these answers
        self.record: list[tuple[str, Hashable, Any]] | None = []
        self.has_grids = False  # there are objects with grids, which volumes read as attributes
        self.view_layer: bpy.types.ViewLayer | None = None  # Blender's, whose properties graphs may read
        self.scene: bpy.types.Scene | None = None
        self.engine = "CYCLES"  # whose output node counts where a tree has one for each engine

    @property
    def environment_width(self) -> int:
        """Width of the widest image that worlds show [texels]."""
        pictures = [self.images[index].pixels for index in self.environments]
        return max((each.shape[1] for each in pictures if each is not None), default=0)

    def output(self, tree: bpy.types.NodeTree) -> bpy.types.Node | None:
        """The output node of a node tree that counts, None where it has none for this engine or for all."""
        return tree.get_output_node(self.engine) or tree.get_output_node("ALL")

    def begin(self) -> None:
        """The next graph begins to ask."""
        self.asked.clear()
        self.record = []

    def note_lookup(self) -> None:
        """The current graph depends on something that is neither in its nodes nor asked for here."""
        self.record = None

    def image(self, key: Hashable, make) -> int:
        """Index of the image known as `key`, which `make()` exports at the first request."""
        if key not in self._image_places:
            self._image_places[key] = len(self.images)
            self.images.append(make())
        return self._noted("image", key, self._image_places[key])

    def images_by_key(self) -> dict[Hashable, Image]:
        """All images, by what they are known as."""
        return {key: self.images[place] for key, place in self._image_places.items()}

    def attribute(self, kind: str, name: str) -> int:
        """Index of an attribute of meshes; for `kind` see `export/meshes/attributes.py`."""
        self.asked.add((kind, name))
        place = self._attribute_places.setdefault((kind, name), len(self._attribute_places))
        return self._noted("attribute", (kind, name), place)

    def object_attribute(self, kind: str, name: str) -> int:
        """Index of an attribute of objects (`kind` OBJECT), or of the objects that place them (INSTANCER)."""
        self.asked.add((kind, name))
        place = self._object_attribute_places.setdefault((kind, name), len(self._object_attribute_places))
        return self._noted("object_attribute", (kind, name), place)

    def aov(self, name: str) -> int:
        """The number of the view layer's pass that materials write under `name`, times two, and 1 more where it is of
        numbers; -1: it has none. As in Cycles the first of that name.
        """
        found = -1
        for number, aov in enumerate(each for each in getattr(self.view_layer, "aovs", ()) if each.is_valid):
            if aov.name == name and found < 0:
                found = 2 * number + (aov.type == "VALUE")
        return self._noted("aov", (name,), found)

    def occlusion_distance(self) -> float:
        """How far a node looks for occlusion whose own distance is 0: that of the world [m]."""
        return self._noted("occlusion_distance", (), occlusion_distance(self.scene, self.view_layer))

    def grids(self) -> bool:
        """Whether there are objects with grids."""
        return bool(self._noted("grids", (), int(self.has_grids)))

    def _noted(self, kind: str, what: Hashable, place: Any) -> Any:
        if self.record is not None:
            self.record.append((kind, what, place))
        return place

    @property
    def attributes(self) -> list[tuple[str, str]]:
        """(kind, name) of all attributes of meshes, by index."""
        return list(self._attribute_places)

    @property
    def object_attributes(self) -> list[tuple[str, str]]:
        """(kind, name) of all attributes of objects, by index."""
        return list(self._object_attribute_places)
