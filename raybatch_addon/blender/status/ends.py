"""Renders that Blender ends without a picture where there is no window: its exit code says so.

An engine hears neither of a picture that cannot be written nor of a render that Blender does not even begin. Where a
picture is not written, or somebody stops an animation, Blender says that the render was cancelled. Where there is no
camera, or a movie cannot be written, it says that a render begins, and nothing after it.
"""

from __future__ import annotations

from collections.abc import Callable

import bpy
from bpy.app.handlers import persistent

from .. import exit_code
from .terminal import plain_lines


@persistent
def _begin(scene: bpy.types.Scene | None, *_: object) -> None:
    if exit_code.is_awaited():  # what Blender did not begin
        exit_code.end_with(exit_code.RENDER_FAILED)
    exit_code.has_ended()
    if scene is not None and scene.render.engine == "RAYBATCH":
        exit_code.await_render()


@persistent
def _complete(*_: object) -> None:
    exit_code.has_ended()


@persistent
def _cancel(*_: object) -> None:
    if exit_code.is_awaited():
        plain_lines.begin()  # Blender has said what is wrong: behind it no end is said
        exit_code.end_with(exit_code.RENDER_FAILED)
    exit_code.has_ended()


def register() -> None:
    """Follow Blender's renders from now on, if it has no window and is no module of a script, which has exit codes of
    its own.
    """
    if bpy.app.background and not bpy.app.module:
        for handlers, function in _handlers():
            handlers.append(function)


def unregister() -> None:
    """Follow them no longer."""
    for handlers, function in _handlers():
        if function in handlers:
            handlers.remove(function)


def _handlers() -> list[tuple[list, Callable[..., None]]]:
    events = bpy.app.handlers
    return [(events.render_init, _begin), (events.render_complete, _complete), (events.render_cancel, _cancel)]
