"""A live scene that is informed of edits, and what it is to be equal to."""

from collections import Counter

import bpy

from raybatch_addon.export.live.edits import updates_of
from raybatch_addon.export.live.live_scene import LiveScene, is_same
from raybatch_addon.export.scene import export_scene
from tests.blender.viewport.regions import updates_to


class Reader:
    """A live scene that is informed of edits as Blender shows a viewport."""

    def __init__(self, seconds=10.0):
        self.live, self.seconds, self.changes = LiveScene(), seconds, 0

    def read(self, depsgraph):
        while not self.live.is_current:
            self.changes += self.live.read(depsgraph, None, self.seconds)

    def receive(self, depsgraph):
        self.live.note(updates_of(depsgraph))
        self.read(depsgraph)

    def edit(self, change) -> Counter:
        """What `change()` made necessary."""
        before, self.changes = Counter(self.live.counts), 0
        with updates_to(self.receive):
            change()
            bpy.context.view_layer.update()
        after = Counter(self.live.counts)
        after.subtract(before)
        return Counter({name: count for name, count in after.items() if count})


def as_exported(live) -> bool:
    """Whether what is read is what an export of the same depsgraph reads, but for camera and frame."""
    exported = export_scene(bpy.context.evaluated_depsgraph_get())
    own = live.scene
    names = ("meshes", "instances", "slot_materials", "materials", "lights", "world", "images", "object_names")
    return all(is_same(getattr(exported, name), getattr(own, name)) for name in names)
