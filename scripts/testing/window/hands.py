"""The mouse and the keyboard of `walk.py`: events of X11, sent by xdotool as if a person made them."""

from __future__ import annotations

import shutil
import subprocess

import bpy

PROGRAM = "xdotool"
_CODES = {"F12": "96"}  # by its name xdotool presses it with Alt


def look_for_program() -> None:
    """End with a message where xdotool is missing."""
    if shutil.which(PROGRAM) is None:
        raise SystemExit(f"walk.py: {PROGRAM} is not installed, which moves the mouse and presses keys")


def press(key: str) -> None:
    """Press and release `key`, by X11's name of it: "F12", "Escape", "r"."""
    _send("key", _CODES.get(key, key))


def hold(key: str) -> None:
    """Press `key` and hold it. Blender asks which keys are down when it reads an event: wait before a click."""
    _send("keydown", key)


def release(key: str) -> None:
    """Release it."""
    _send("keyup", key)


def place(x: float, y: float) -> None:
    """Move the mouse to a place of Blender's window [pixels from its bottom left, as areas and regions count]."""
    window = bpy.context.window_manager.windows[0]
    _send("mousemove", str(round(x)), str(round(window.height - 1 - y)))


def click(x: float, y: float) -> None:
    """Click there with the left button."""
    place(x, y)
    _send("click", "1")


def scroll(x: float, y: float, steps: int) -> None:
    """Turn the wheel there, so that what lies below comes into view."""
    place(x, y)
    _send("click", "--repeat", str(steps), "5")


def begin_drag() -> None:
    """Press the middle button of the mouse."""
    _send("mousedown", "2")


def end_drag() -> None:
    """Release it."""
    _send("mouseup", "2")


def _send(*words: str) -> None:
    subprocess.run([PROGRAM, *words], check=True)
