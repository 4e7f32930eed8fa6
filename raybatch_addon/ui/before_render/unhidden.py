"""Objects that are rendered though the viewport hides them, shown for as long as a look at the scene takes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import bpy


@contextmanager
def unhidden(view_layer: bpy.types.ViewLayer) -> Iterator[None]:
    """Objects and collections of `view_layer` that are hidden in the viewport alone are not, within this context."""
    hidden, eyes = [], []  # what was shown
    try:
        for each in list(_in_viewport_alone(view_layer)):
            each.hide_viewport = False
            hidden.append(each)
        for obj in view_layer.objects:
            if not obj.hide_render and obj.hide_get(view_layer=view_layer):
                obj.hide_set(False, view_layer=view_layer)
                eyes.append(obj)
        yield
    finally:
        for obj in eyes:
            obj.hide_set(True, view_layer=view_layer)
        for each in hidden:
            each.hide_viewport = True


def _in_viewport_alone(view_layer: bpy.types.ViewLayer) -> Iterator[bpy.types.ID | bpy.types.LayerCollection]:
    """What has its button Disable in Viewports pressed, or is a collection without its eye."""
    for each in (*bpy.data.objects, *bpy.data.collections):  # also those that are instanced alone
        if each.hide_viewport and not each.hide_render:
            yield each
    waiting = [view_layer.layer_collection]
    while waiting:
        each = waiting.pop()
        if each.exclude or each.collection.hide_render:
            continue
        if each.hide_viewport:
            yield each
        waiting += each.children
