"""The scenes of studies of one's own: files, and those that studies build."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmarking.scenes import SceneRequest
from benchmarking.whole_render import RenderRequest, open_scene

from raybatch_addon.core.scene.archive import load_scene
from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.settings.settings import RenderSettings
from studies import many_lights, scenes
from studies.bench import with_frame
from studies.images import painted_hills, textures
from studies.scenes import FILES, find
from studies.study import Options

SIZE_DEFAULT = (320, 240)  # of scenes without a frame of their own [pixels]
EDGE = 64  # of the frame in which a scene is built, before it gets its own [pixels]
# What studies build themselves
BUILT: dict[str, Callable[[], Scene]] = {
    "plates": lambda: scenes.plates(EDGE, EDGE),
    "room": lambda: scenes.room(EDGE, EDGE),
    "hall": lambda: many_lights.hall("lamps", 100, EDGE),
    "checkerboard": textures.checkerboard,
    "painted-hills": lambda: painted_hills.scene(EDGE),
}
SAVED = ("bmw", "livingroom")  # of `FILES`: scenes of .blend files, with lights of their own
NAMES = (*BUILT, *FILES)


@dataclass(frozen=True)
class SceneSource:
    """A scene that is asked for."""

    name: str
    file: Path | None = None  # None: `name` is one of `NAMES`
    grid: int = 1
    camera: str | None = None
    up: str | None = None
    size: tuple[int, int] | None = None  # of the frame; None: the file's own, else `SIZE_DEFAULT`

    @functools.cached_property
    def key(self) -> str:
        """What rows are found by: the name, the frame, and for a file what is in it. Raises `OSError`."""
        parts = [self.name, "x".join(map(str, self.size)) if self.size else ""]
        if self.file is not None:
            with self.file.open("rb") as opened:
                digest = hashlib.file_digest(opened, "blake2b")
            digest.update(repr((self.grid, self.camera, self.up)).encode())
            parts.append(f"#{digest.hexdigest()[:8]}")
        return " ".join(part for part in parts if part)

    def open(self, options: Options) -> tuple[Scene, RenderSettings]:
        """The scene in its frame, and the settings of its file; raises `RayBatchError`."""
        if self.file is not None:
            request = SceneRequest(self.file, self.grid, self.camera, self.up)
            # geometry has no frame of its own
            size = self.size or (SIZE_DEFAULT if self.is_geometry else None)
            opened = open_scene(RenderRequest(request, size=size))
            frame = opened.scene.frame
            settings = opened.settings.replace(time_limit=0.0, error_target=0.0)
            return with_frame(opened.scene, frame.width, frame.height), settings
        if self.name in SAVED:
            scene, settings = load_scene(find(self.name, options))
            settings = settings.replace(device="AUTO", thread_count=0, time_limit=0.0, error_target=0.0)
            return with_frame(scene, *(self.size or (scene.frame.width, scene.frame.height))), settings
        made = BUILT[self.name]() if self.name in BUILT else scenes.under_the_sky(self.name, options, EDGE)
        return with_frame(made, *(self.size or SIZE_DEFAULT)), RenderSettings()

    @property
    def is_geometry(self) -> bool:
        """Whether the file is an .npz of geometry, which has neither camera nor frame."""
        name = "" if self.file is None else self.file.name.lower()
        return name.endswith(".npz") and not name.endswith(".scene.npz")
