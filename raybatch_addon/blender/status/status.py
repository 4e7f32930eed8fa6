"""Blender's status line, progress bar and memory of a render; without a window, lines on the terminal."""

from __future__ import annotations

import time

import bpy

from ...core.film import Film
from ...core.observers import Progress
from .terminal import line_of_frame, plain_lines
from .text import status_text

# Blender's status line is written at most this often [s]
STATUS_SECONDS = 0.25


class RenderStatus:
    """What is said of the render of one view layer."""

    def __init__(self, engine: bpy.types.RenderEngine, layer_name: str, frame: int) -> None:
        self._engine, self._layer_name, self._frame = engine, layer_name, frame
        self._shown = float("-inf")
        plain_lines.begin()

    def show(self, text: str) -> None:
        """Write `text` now; without a window only where a line is due."""
        if not bpy.app.background or plain_lines.is_due:
            self._write(text)

    def end(self, film: Film, sample_count: int) -> None:
        """The last line of a render without a window, which those who count its samples wait for. It is printed later
        where it comes too soon.
        """
        if not (bpy.app.background and film.complete):
            return
        text = f"Sample {sample_count}/{sample_count} | Finished"
        if plain_lines.is_due:
            self._write(text)
        else:
            plain_lines.wait_with(line_of_frame(self._frame, text))

    def _is_due(self) -> bool:
        if bpy.app.background:
            return plain_lines.is_due
        return time.perf_counter() - self._shown >= STATUS_SECONDS

    def _write(self, text: str) -> None:
        self._shown = time.perf_counter()
        plain_lines.note()
        self._engine.update_stats(self._layer_name, text)

    def update(self, progress: Progress) -> None:
        """Show `progress`, unless something was shown just before."""
        if not self._is_due():
            return
        if progress.stage == "render":
            # of a render that goes on from a checkpoint the fraction counts what this run has to do
            share = progress.samples_done / progress.samples_total
            self._engine.update_progress(min(max(progress.fraction, share), 1.0))
        if progress.memory_bytes:
            used, peak = progress.memory_bytes / 2**20, progress.memory_peak / 2**20
            self._engine.update_memory_stats(memory_used=used, memory_peak=max(used, peak))
        self.show(status_text(progress))
