"""A .blend that is open in this process: made small, alike for both engines, and rendered into files."""

from __future__ import annotations

import tempfile
from pathlib import Path

import bpy
import numpy as np
from lib.cycles_peer import leave_as_rendered, make_unbiased

from raybatch_addon.blender import reports
from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.settings.settings import SETTINGS, RenderSettings
from raybatch_addon.export.settings import assign_setting
from real_files.sheets import sheets_of

CYCLES, RAYBATCH = "CYCLES", "RAYBATCH"
BOUNCES, TRANSPARENT_BOUNCES = 8, 64
HEIGHT_LEAST = 16  # pixels, of pictures that are very wide


class FileError(RayBatchError):
    """A file that cannot be compared, and what to do about it."""


class OpenFile:
    """The open .blend, rendered by one engine."""

    def __init__(self, path: str, engine: str, width: int, threads: int, defaults: bool, kernels: str = "AUTO"):
        """Open `path` for `engine`, with RayBatch registered; raises `FileError`.

        `defaults`: engines render with their own settings as they are in a new scene, and without denoising. `kernels`:
        RayBatch's setting `kernel_tier`.
        """
        try:
            bpy.ops.wm.open_mainfile(filepath=path, load_ui=False, use_scripts=False)
        except RuntimeError as error:
            raise FileError(
                f"Blender {bpy.app.version_string} cannot open it ({' '.join(str(error).split())}): open it in the "
                "Blender that made it, and save it anew"
            ) from None
        self.scene, self.engine, self._defaults = bpy.context.scene, engine, defaults
        self._sheets = None if self.scene.camera else sheets_of(self.scene)
        if self.scene.camera is None:
            raise FileError(
                f"the scene “{self.scene.name}” has no camera, and nothing that one could see: open the file in "
                "Blender, choose a scene that has, and save"
            )
        if engine == CYCLES and not hasattr(self.scene, "cycles"):
            raise FileError(
                "this bpy has no Cycles, so there is nothing to compare with: install the bpy of blender.org, or use "
                "`blender -b` of a complete Blender"
            )
        self._settings = RenderSettings(
            bounce_max=BOUNCES,
            transparent_bounce_max=TRANSPARENT_BOUNCES,
            clamp_direct=0.0,
            clamp_indirect=0.0,
            thread_count=threads,
            device="cpu",
            kernel_tier=kernels,
        )
        self._prepare(width, threads)

    def _prepare(self, width: int, threads: int) -> None:
        scene, render = self.scene, self.scene.render
        if self._defaults:
            _reset(scene.raybatch)
        if hasattr(scene, "cycles"):
            if self._defaults:
                _reset(scene.cycles)
                leave_as_rendered(scene)
            else:
                make_unbiased(scene, self._settings)
            scene.cycles.use_denoising = False
            scene.cycles.device = "CPU"
            scene.cycles.use_animated_seed = False
            scene.cycles.use_auto_tile = False
        used = [layer for layer in scene.view_layers if layer.use] or list(scene.view_layers)
        for layer in scene.view_layers:
            layer.use = layer == used[0]
        values = self._values()
        for name in ("device", "thread_count", "kernel_tier") if self._defaults else values:
            assign_setting(scene.raybatch, name, values[name])
        shape = render.resolution_y * render.pixel_aspect_y / (render.resolution_x * render.pixel_aspect_x)
        render.resolution_percentage = 100
        render.pixel_aspect_x = render.pixel_aspect_y = 1
        self.size = width, max(HEIGHT_LEAST, round(width * shape))
        render.use_border = render.use_multiview = render.use_persistent_data = False
        render.use_stamp = False
        render.threads_mode = "FIXED" if threads else "AUTO"
        if threads:
            render.threads = threads
        image = render.image_settings
        if hasattr(image, "media_type"):
            image.media_type = "IMAGE"
        image.file_format, image.color_mode, image.color_depth, image.exr_codec = "OPEN_EXR", "RGBA", "32", "ZIP"
        image.color_management = "FOLLOW_SCENE"
        render.use_file_extension = True

    def _values(self) -> dict:
        return {name: getattr(self._settings, name) for name in SETTINGS}

    def render(self, samples: int, seed: int, size: tuple[int, int] | None = None) -> np.ndarray:
        """Render and write a picture; returns it, linear, float32 [height, width, 4], bottom row first. The sheets of a
        library are one picture, the first on top. Raises `FileError` if the engine fails.
        """
        if not self._sheets or not self._sheets.sheets:
            return self._rendered(samples, seed, size)
        pictures = []
        for sheet in self._sheets.sheets:
            sheet.show(self._sheets)
            pictures.append(self._rendered(samples, seed, size))
        return np.concatenate(pictures[::-1])

    def _rendered(self, samples: int, seed: int, size: tuple[int, int] | None) -> np.ndarray:
        scene, render = self.scene, self.scene.render
        render.engine = self.engine
        render.resolution_x, render.resolution_y = size or self.size
        scene.raybatch.sample_count, scene.raybatch.seed = samples, seed
        if hasattr(scene, "cycles"):  # for RayBatch too, which would report that they differ
            scene.cycles.samples, scene.cycles.seed = samples, seed
        with tempfile.TemporaryDirectory() as folder:
            render.filepath = str(Path(folder) / "picture")
            try:
                bpy.ops.render.render(write_still=True)
            except RuntimeError as error:
                raise FileError(self._failure(str(error))) from None
            written = list(Path(folder).iterdir())
            if not written:
                raise FileError(self._failure("it wrote no picture"))
            return _pixels(written[0])

    def _failure(self, text: str) -> str:
        report = reports.last() if self.engine == RAYBATCH else None
        text = "; ".join(report.errors) if report and report.errors else text
        name = "RayBatch" if self.engine == RAYBATCH else "Cycles"
        return f"{name} could not render it: {' '.join(text.removeprefix('Error:').split())}"

    def record(self) -> dict:
        """What RayBatch reports of the last render: warnings by name, invalid samples, triangles, seconds by stage."""
        report = reports.last() if self.engine == RAYBATCH else None
        if report is None:
            return {}
        statistics = next(iter(report.statistics.values()), {})
        return {
            "warnings": list(report.warnings),
            "invalid_samples": statistics.get("invalid_samples", 0),
            "triangles": statistics.get("triangles", 0),
            "stages": statistics.get("seconds", {}),
        }

    def prepared(self) -> dict:
        """What was added to a file without a camera: `prepared`, in words, and the `cells` of materials on balls."""
        return {"prepared": self._sheets.note, "cells": self._sheets.cells(self.size)} if self._sheets else {}

    def missing(self) -> list[str]:
        """Images and libraries that the file names and that are not there, by name: engines do without them each in its
        own way.
        """
        absent = [
            f"image “{image.name}”"
            for image in bpy.data.images
            if image.source in ("FILE", "SEQUENCE", "MOVIE", "TILED")
            and image.packed_file is None
            and not image.packed_files
            and image.users
            and not _is_there(image)
        ]
        absent += [
            f"library “{each.name}”"
            for each in bpy.data.libraries
            if not Path(bpy.path.abspath(each.filepath)).exists()
        ]
        return sorted(absent)


def _reset(settings) -> None:
    """Give Blender's group `settings` the values that it has in a new scene."""
    for each in settings.bl_rna.properties:
        if each.identifier not in ("rna_type", "name") and not each.is_readonly:
            settings.property_unset(each.identifier)


def _is_there(image: bpy.types.Image) -> bool:
    path = bpy.path.abspath(image.filepath_raw, library=image.library)
    return "<UDIM>" in path or Path(path).exists()


def _pixels(path: Path) -> np.ndarray:
    loaded = bpy.data.images.load(str(path))
    loaded.colorspace_settings.name = "Non-Color"
    pixels = np.empty(len(loaded.pixels), np.float32)
    loaded.pixels.foreach_get(pixels)
    width, height = loaded.size
    bpy.data.images.remove(loaded)
    return pixels.reshape(height, width, 4)
