"""What becomes of each frame that Blender has rendered: its picture goes to its place, films and heat maps are written
while the next frame is rendered.
"""

from __future__ import annotations

import contextlib
import functools
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy
from lib.output import film_arrays, numbered, print_saved, write_film
from lib.writer import BackgroundWriter

from raybatch_addon.blender import checkpoints
from raybatch_addon.blender.checkpoints import AskedCheckpoint
from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.film import Film
from rendering.pictures import write_heat_map
from rendering.progress import ProgressBar
from rendering.request import Request
from rendering.workshop import Workshop

# Blender's name of a picture in the workshop: this and the frame's number, then what is its own (an eye of stereoscopy,
# the extension)
_NAME, _DIGITS = "frame", "######"


@dataclass(frozen=True, kw_only=True)
class FrameFiles:
    """Where the files of a frame go; None where none is wanted."""

    number: int
    label: str  # of its progress and errors
    picture: Path | None
    film: Path | None
    checkpoint: Path | None
    heat_maps: tuple[tuple[str, Path], ...]  # pass and file

    @staticmethod
    def of(request: Request, number: int, many: bool, picture: Path | None) -> FrameFiles:
        """The files of frame `number`, which is one of `many`."""
        return FrameFiles(
            number=number,
            label=f"frame {number}: " if many else "",
            picture=picture,
            film=numbered(request.film, number, many) if request.film else None,
            checkpoint=numbered(request.checkpoint, number, many) if request.checkpoint else None,
            heat_maps=tuple((name, numbered(path, number, many)) for name, path in request.heat_maps),
        )

    @property
    def paths(self) -> list[Path]:
        """All of them."""
        every = (self.picture, self.film, self.checkpoint, *(path for _, path in self.heat_maps))
        return [path for path in every if path is not None]


class FrameDeliveries:
    """Follows Blender from frame to frame: inside, each that it begins and ends is heard of, and `films` of its view
    layers are those of one frame.

    Blender goes on where what it calls fails, so that the first error is kept: `failure`. At the end all files are
    written; raises `OutputError` for one that could not be, unless there was an error before.
    """

    def __init__(
        self,
        request: Request,
        files: Sequence[FrameFiles],
        bar: ProgressBar,
        films: list[tuple[str, Film]],
        is_stopped: Callable[[], bool],
    ) -> None:
        """`is_stopped`: whether the user has asked for an end; Blender may end a frame without a picture then."""
        self._is_stopped = is_stopped
        self._request, self._bar, self._films = request, bar, films
        self._by_number = {each.number: each for each in files}
        self._picture = files[0].picture
        self._delivered = 0
        self._writer = BackgroundWriter()
        self.failure: Exception | None = None

    def __enter__(self) -> FrameDeliveries:
        self._workshop = Workshop(self._picture.parent if self._picture else Path(tempfile.gettempdir()))
        self._workshop.__enter__()
        bpy.app.handlers.render_pre.append(self._begin)
        bpy.app.handlers.render_post.append(self._end)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        bpy.app.handlers.render_pre.remove(self._begin)
        bpy.app.handlers.render_post.remove(self._end)
        self._workshop.__exit__()
        error = self._writer.close()
        if error is not None and (kind is None or issubclass(kind, KeyboardInterrupt)):
            raise error

    @property
    def output(self) -> str:
        """What is to be Blender's output path meanwhile."""
        return str(self._workshop.folder / f"{_NAME}{_DIGITS}")

    @property
    def are_complete(self) -> bool:
        """Whether all frames have been rendered and handed on."""
        return self._delivered == len(self._by_number)

    @property
    def how_far(self) -> str:
        """Of a sequence that was stopped: which frames are there, and how to get the others."""
        numbers = list(self._by_number)
        done = "those before it are written" if self._delivered else "none is written"
        at = numbers[self._delivered]
        return f"stopped in frame {at}: {done}, and --frames {at}..{numbers[-1]} goes on"

    def _begin(self, scene: bpy.types.Scene, *_: object) -> None:
        """Blender begins a frame."""
        with self._keeping_failure():
            files = self._by_number[scene.frame_current]
            self._bar.label = files.label
            self._films.clear()
            request = self._request
            following = self._by_number.get(files.number + 1)
            checkpoints.asked = AskedCheckpoint(
                files.checkpoint,
                request.checkpoint_interval,
                request.sample_first,
                following.checkpoint if following else None,
            )

    def _end(self, scene: bpy.types.Scene, *_: object) -> None:
        """Blender has rendered and written a frame. The thread that writes gets arrays of the host alone, since films
        hold the device's memory, which the next frame needs.
        """
        with self._keeping_failure():
            files = self._by_number[scene.frame_current]
            if files.picture is not None and self._workshop.is_empty and self._is_stopped():
                return
            if files.picture is not None:
                self._workshop.deliver(files.picture, _NAME)
            else:
                self._workshop.clear()
            heated = [(path, name, self._films[0][1].passes[name][..., 0]) for name, path in files.heat_maps]
            arrays = film_arrays(self._films) if files.film is not None else {}
            self._films.clear()
            if files.film is not None:
                self._writer.write(functools.partial(write_film, files.film, arrays))
                self._writer.write(functools.partial(print_saved, files.film, "the film"))
            for path, name, values in heated:
                self._writer.write(functools.partial(write_heat_map, path, values, name))
            self._delivered += 1

    @contextlib.contextmanager
    def _keeping_failure(self) -> Iterator[None]:
        """What is raised inside is kept: Blender would print it and go on."""
        try:
            yield
        except Exception as error:
            if isinstance(error, OSError):
                error = RayBatchError(f"{self._bar.label}{error}")
            self.failure = self.failure or error
