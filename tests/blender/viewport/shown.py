"""A viewport that is drawn as Blender would."""

from types import SimpleNamespace

import bpy

from raybatch_addon.blender.viewport.viewport import Viewport
from tests.blender.viewport.regions import wait_for


class Shown:
    """A viewport in a region, which is drawn as often as it asks for."""

    def __init__(self, context):
        self.context, self.asked, self.drawn = context, 0, []
        self.viewport = Viewport(self._ask)
        self.engine = SimpleNamespace()

    def _ask(self):
        self.asked += 1

    def update(self, depsgraph):
        self.viewport.update(self.context, depsgraph)

    def draw(self):
        self.viewport.draw(self.engine, self.context, bpy.context.evaluated_depsgraph_get())

    def until(self, condition):
        """Draw as Blender would until `condition()`."""

        def look():
            self.draw()
            return condition()

        wait_for(look)

    def is_finished(self):
        return self.viewport.live.is_current and self.viewport.render.is_idle

    @property
    def request(self):
        return self.drawn[-1].request


def edit(change):
    """Make an edit, and have Blender evaluate it."""
    change()
    bpy.context.view_layer.update()
