"""Settings of files that another version saved: they become those of this version as the file is opened.

Each scene keeps the version that last had its settings. What a version renames, or takes in another way, is a
migration here; a setting that is only new needs none. Blender keeps the choice of an enumeration as its place: new ones
are added at the end, or a migration moves the old ones.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass

import bpy
from bpy.app.handlers import persistent

from ..core.version import VERSION

FIRST = "0.1.0"  # kept no version


@dataclass(frozen=True)
class Migration:
    """The change that came with `version`: `change` brings `scene.raybatch` of an earlier one to it, and leaves later
    ones alone.
    """

    version: str
    change: Callable[[bpy.types.PropertyGroup], None]


def _name_device(own: bpy.types.PropertyGroup) -> None:
    """Devices have the names of the list: any case, and “cuda” for the first one, were understood as well."""
    name = own.device.strip().lower()
    own.device = {"auto": "AUTO", "": "AUTO", "cuda": "cuda:0"}.get(name, name)


MIGRATIONS = (Migration("0.2.0", _name_device),)


def numbers(version: str) -> tuple[int, ...]:
    """`version` for comparing."""
    return tuple(int(part) if part.isdecimal() else 0 for part in version.split("."))


def version_of(scene: bpy.types.Scene) -> str:
    """The version that last had the settings of `scene`."""
    return scene.raybatch.version or FIRST


def complaint(scene: bpy.types.Scene) -> str:
    """What is to know of a scene whose settings are of a newer version; empty where they are not."""
    saved = version_of(scene)
    if numbers(saved) <= numbers(VERSION):
        return ""
    return (
        f"scene “{scene.name}” was saved by RayBatch {saved}, and this is {VERSION}: settings that only the newer one "
        "has are not heard. Update RayBatch to have them"
    )


def migrate(scene: bpy.types.Scene) -> None:
    """Bring the settings of `scene` to this version; those of a newer one stay as they are."""
    saved = numbers(version_of(scene))
    if saved > numbers(VERSION):
        return
    for migration in MIGRATIONS:
        if saved < numbers(migration.version):
            migration.change(scene.raybatch)
    scene.raybatch.version = VERSION


@persistent
def migrate_all(*_: object) -> None:
    """Bring the scenes of a file that was opened, or is to be saved, to this version."""
    for scene in bpy.data.scenes:
        if scene.library is None:
            migrate(scene)


@persistent
def _opened(*_: object) -> None:
    migrate_all()
    for scene in bpy.data.scenes:
        if scene.render.engine == "RAYBATCH" and (text := complaint(scene)):
            print(f"RayBatch: {text}", file=sys.stderr)


def register() -> None:
    """Bring files to this version as Blender opens them, and one that is open already."""
    bpy.app.handlers.load_post.append(_opened)
    bpy.app.handlers.save_pre.append(migrate_all)
    if hasattr(bpy.data, "scenes"):  # not while Blender itself starts: it opens a file then
        migrate_all()


def unregister() -> None:
    """Look at them no longer."""
    bpy.app.handlers.save_pre.remove(migrate_all)
    bpy.app.handlers.load_post.remove(_opened)
