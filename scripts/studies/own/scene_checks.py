"""The scenes that a definition names."""

from __future__ import annotations

import importlib.util
import re
import zipfile
from pathlib import Path
from typing import Any

from lib.command import UsageError
from lib.geometry_files import parse_view
from rendering.request import ARCHIVE, BLEND, NPZ, RESOLUTION_MAX, kind_of

from raybatch_addon.core.errors import RayBatchError
from studies.own.checks import Checks
from studies.own.sources import NAMES, SceneSource

SCENE_KEYS = ("file", "name", "grid", "camera", "up", "size")


class SceneChecks(Checks):
    """Checks the keys `scenes` and `size`."""

    def size(self, key: str, value: Any) -> tuple[int, int]:
        """Width and height of a frame [pixels]."""
        whole = isinstance(value, list) and all(isinstance(v, int) and not isinstance(v, bool) for v in value)
        if not whole or len(value) != 2 or not all(1 <= v <= RESOLUTION_MAX for v in value):
            raise self.error(key, f"{value!r} is not valid: write [width, height], each 1 to {RESOLUTION_MAX} pixels")
        return value[0], value[1]

    def scenes(self, values: Any, size: tuple[int, int] | None) -> tuple[SceneSource, ...]:
        """The scenes, in frames of `size` where they have none of their own there."""
        if values is None:
            raise self.error("scenes", f"none is named: give files, or names of {', '.join(NAMES)}")
        found = [self._scene(each, size) for each in self.entries("scenes", values, "scenes")]
        names = [scene.name for scene in found]
        if double := {name for name in names if names.count(name) > 1}:
            raise self.error("scenes", f"two are called {min(double)!r}: give each a name, {{ file = .., name = .. }}")
        return tuple(found)

    def _scene(self, value: Any, size: tuple[int, int] | None) -> SceneSource:
        given = {"file": value} if isinstance(value, str) else value
        self.known("scenes", given, SCENE_KEYS)
        file = given.get("file")
        if not isinstance(file, str) or not file:
            raise self.error("scenes", f'{value!r} names no file: write file = "..."')
        if "size" in given:
            size = self.size(f"scenes: {file}: size", given["size"])
        if not re.search(r"[./\\]", file):  # no path: a scene that studies have
            if file not in NAMES:
                raise self.error("scenes", self.unknown("scene", file, NAMES) + "; a file has an extension")
            if set(given) - {"file", "size"}:
                raise self.error(f"scenes: {file}", "name, grid, camera and up are for files")
            return SceneSource(file, size=size)
        key, path = f"scenes: {file}", (self.folder / file).absolute()
        try:
            kind = kind_of(path, (BLEND, ARCHIVE, NPZ))
        except UsageError as error:
            raise self.error("scenes", str(error)) from None
        if not path.is_file():
            raise self.error("scenes", f"there is no file {path}")
        self._check_archive(key, path, kind)
        if kind == BLEND and importlib.util.find_spec("bpy") is None:
            raise self.error(
                key,
                "a .blend needs Blender's Python module bpy, which is not here; save the scene where it is "
                "(render.py --save-scene)",
            )
        if kind != NPZ and set(given) & {"grid", "camera", "up"}:
            raise self.error(key, "grid, camera and up are for geometry (.npz); this file has its own camera")
        name = self.text(f"{key}: name", given.get("name", path.name))
        if name in NAMES:
            raise self.error(f"{key}: name", f"{name!r} is a scene that studies have: choose another name")
        up = given.get("up")
        if up not in (None, "y", "z"):
            raise self.error(f"{key}: up", f'{up!r} is not valid: write "y" or "z"')
        grid = self.whole(f"{key}: grid", given.get("grid", 1), 1, 1000)
        found = SceneSource(name, path, grid=grid, camera=self._camera(key, given.get("camera")), up=up, size=size)
        try:
            _ = found.key
        except OSError as error:
            raise self.error(key, f"it cannot be read: {error.strerror or error}") from None
        return found

    def _check_archive(self, key: str, path: Path, kind: str) -> None:
        """Raise `UsageError` for an .npz that is none, or lacks what its kind has; its arrays are not read."""
        if kind == BLEND:
            return
        wanted = ("header",) if kind == ARCHIVE else ("v", "f")
        try:
            with zipfile.ZipFile(path) as archive:
                names = archive.namelist()
        except (OSError, zipfile.BadZipFile) as error:
            raise self.error(key, f"it cannot be read as a NumPy archive; is it damaged? ({error})") from None
        if missing := [name for name in wanted if f"{name}.npy" not in names]:
            what = "a saved scene" if kind == ARCHIVE else "geometry"
            raise self.error(key, f"it is not {what}: it has no array {' and no array '.join(missing)}")

    def _camera(self, key: str, value: Any) -> str | None:
        if value is None:
            return None
        text = ",".join(map(str, value)) if isinstance(value, list) else value
        try:
            parse_view(text if isinstance(text, str) else repr(text))
        except RayBatchError as error:
            raise self.error(f"{key}: camera", str(error)) from None
        return text
