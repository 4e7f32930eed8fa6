"""A live render: a thread that renders the newest scene that it was given, and goes on from coarse to fine."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ..denoise.library import DenoiseStoppedError
from ..denoise.picture import denoised
from ..errors import RayBatchError
from ..film import Film
from ..measure.snapshot import Snapshot
from ..observers import Cancel, Progress, RenderObserver, Tile
from ..scene.description import Scene
from ..session import Session
from ..settings.settings import RenderSettings
from .picture import LivePicture, LiveRequest, TileCanvas
from .steps import Pace, coarse, without_splits

# The first picture after an edit has so much time to be drawn before the next one is rendered [s]
REST_SECONDS = 0.15

# What a render does before its first ray is told where it takes longer than this [s]: a draw that shows no new picture
# would delay the one that does
QUIET_SECONDS = 0.3

_STAGES = {"build": "Building the scene", "compile": "Loading kernels", "render": "Rendering"}


class SessionSource(Protocol):
    """Who lends a session to live renders."""

    def session(self, request: LiveRequest, given_up: Callable[[], bool]) -> AbstractContextManager[Session | None]:
        """The session for `request`, to oneself, as soon as it is free; None once `given_up()`. Raises
        `RayBatchError`.
        """

    def is_wanted(self, has_shown: bool) -> bool:
        """Whether somebody waits for the session who goes first; `has_shown`: since it was lent, a picture came."""


@dataclass(frozen=True)
class LiveState:
    """The state of a live render: what it does now, and how far it is."""

    stage: str = ""  # in words; empty: nothing
    error: str = ""  # why there is no picture of the newest request
    samples: float = 0.0  # mean samples per pixel, at full size
    samples_total: int = 0
    side: int = 0  # of the pixels that are rendered, in pixels of the frame; 0: none
    memory_bytes: int = 0
    compiles: bool = False  # specialised kernels are compiled beside


class LiveRender:
    """Renders in a thread of its own what it is shown, the newest alone; it sleeps when that has all its samples.

    A picture of a request is there after its first, coarse step, which a newer request does not end: who moves a
    slider sees pictures meanwhile. All other steps end at once. After that step it rests until the picture is drawn:
    where the processor draws too, a draw would take twice as long beside a render.
    """

    def __init__(self, source: SessionSource, on_change: Callable[[], None] = lambda: None) -> None:
        """`on_change` is called on the thread when there is something new to show."""
        self._source, self._on_change = source, on_change
        self._pace = Pace()
        self._changed = threading.Condition()
        self._request: LiveRequest | None = None  # the newest
        self._rendered = 0  # number of the request that needs no more work
        # a finest picture that was stopped; one with all its samples while it was denoised
        self._kept: tuple[LiveRequest, Film] | None = None
        self._shown_since_lent = False
        # request and side of the picture that was drawn last, by somebody who tells
        self._drawn: tuple[int, int] | None = None
        self._closed = False
        self._thread: threading.Thread | None = None
        self.picture: LivePicture | None = None
        self.state = LiveState()
        self.warnings: Sequence[str] = ()  # of the last finished film

    # --- for whoever edits and draws

    def show(self, request: LiveRequest) -> None:
        """Render `request` from now on, and nothing that was asked for before."""
        with self._changed:
            if self._closed:
                return
            self._request, self.warnings = request, ()
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="RayBatch live render", daemon=True)
                self._thread.start()
            self._changed.notify_all()

    def drop(self) -> None:
        """Nothing is to be shown: end what is rendered, and forget the picture."""
        with self._changed:
            self._request = self.picture = None
            self.state, self.warnings = LiveState(), ()

    def note_drawn(self, picture: LivePicture) -> None:
        """`picture` is being drawn."""
        with self._changed:
            self._drawn = _mark_of(picture)
            self._changed.notify_all()

    @property
    def is_idle(self) -> bool:
        """Whether nothing is left to do."""
        with self._changed:
            return self._request is None or self._request.number == self._rendered

    def close(self) -> None:
        """End soon; `join` waits for it."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def join(self, seconds: float | None = None) -> bool:
        """Wait for the thread's end, at most `seconds`; whether it has ended."""
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(seconds)
            return not self._thread.is_alive()
        return True

    # --- the thread

    def _work(self) -> None:
        while (request := self._next()) is not None:
            try:
                finished = self._render(request)
            except RayBatchError as error:
                finished = self._fail(str(error))
            except Exception as error:  # nobody above could show it
                finished = self._fail(f"the render failed: {type(error).__name__}: {error}")
            if finished:
                with self._changed:
                    self._rendered = request.number
            elif not self._is_superseded(request):
                self.state = replace(self.state, stage="Waiting for another render")
            if self._request is None:  # it was dropped meanwhile
                self._kept, self.state = None, LiveState()
            if finished or not self._is_superseded(request):  # else there is no more to show than before
                self._on_change()
        self._kept = None

    def _next(self) -> LiveRequest | None:
        """The newest request that needs work, once there is one; None: this is closed."""
        with self._changed:
            while not self._closed and (self._request is None or self._request.number == self._rendered):
                self._changed.wait()
            return None if self._closed else self._request

    def _fail(self, message: str) -> bool:
        """The request is done with, for this reason."""
        self._kept = None
        self.state = LiveState(error=" ".join(message.split()))
        return True

    def _is_superseded(self, request: LiveRequest) -> bool:
        return self._closed or self._request is not request

    def _must_stop(self) -> bool:
        return self._closed or self._request is None or self._source.is_wanted(self._shown_since_lent)

    def _render(self, request: LiveRequest) -> bool:
        """Render `request`; False where it was stopped before it had all samples."""
        if self.state.error:
            self.state = LiveState()
        with self._source.session(request, lambda: self._is_superseded(request)) as session:
            if session is None:
                return False
            self._shown_since_lent = False
            if self._kept is not None and self._kept[0] is not request:
                self._kept = None
            if self._kept is None:
                pixels = request.scene.frame.pixel_count / request.pixel_side**2
                for divisor in self._pace.divisors(pixels)[:-1]:
                    side = divisor * request.pixel_side
                    shown = self._shown_side(request)
                    if (shown is None or side < shown) and not self._render_coarse(session, request, side):
                        return False
                    if shown is None:
                        self._rest(request)
            return self._render_fine(session, request)

    def _rest(self, request: LiveRequest) -> None:
        """Wait for the draw of the first picture of `request`, if anybody tells of draws, but not for long."""
        with self._changed:
            if self._drawn is not None and self.picture is not None:
                first = _mark_of(self.picture)
                self._changed.wait_for(
                    lambda: self._drawn == first or self._is_superseded(request) or self._must_stop(), REST_SECONDS
                )

    def _shown_side(self, request: LiveRequest) -> int | None:
        """Side of the pixels of the picture of `request` that is shown, if there is one."""
        return self.picture.side if self.picture is not None and self.picture.request is request else None

    def _stops(self, request: LiveRequest) -> bool | Cancel:
        """Whether the step under way ends: the first picture of a request comes whatever follows. What nobody asks for
        any more ends at once; what makes way for another render goes on later.
        """
        is_superseded = self._is_superseded(request)
        if self._must_stop() or (self._shown_side(request) is not None and is_superseded):
            return Cancel.AT_ONCE if is_superseded else True
        return False

    def _render_coarse(self, session: Session, request: LiveRequest, side: int) -> bool:
        scene, stops = coarse(request.scene, side), lambda: self._stops(request)
        canvas = TileCanvas(scene.frame)
        film = self._timed(
            session, request, scene, request.settings.replace(sample_count=1), side=side, canvas=canvas, stops=stops
        )
        if not film.complete:
            return False
        self._show(LivePicture(request, canvas.picture(), side, canvas.origin, 1))
        return not self._is_superseded(request)

    def _render_fine(self, session: Session, request: LiveRequest) -> bool:
        side, stops = request.pixel_side, lambda: self._stops(request)
        scene = coarse(request.scene, side)
        canvas = TileCanvas(scene.frame)
        marks = self._pace.marks(request.settings.sample_count, scene.frame.pixel_count, request.denoiser is not None)
        shown = _Shown(marks, lambda snapshot: self._show_fine(request, canvas, side, snapshot.samples))
        resumed = self._kept[1] if self._kept else None
        if resumed is not None:
            canvas.passes = {name: np.array(pixels, np.float32) for name, pixels in resumed.passes.items()}
        self._kept = None
        if resumed is not None and resumed.complete:  # all but the denoising of its last picture is done
            film = resumed
            shown.ended = self._show_fine(request, canvas, side, request.settings.sample_count)
        else:
            film = self._timed(
                session,
                request,
                scene,
                request.settings,
                side=side,
                canvas=canvas,
                stops=stops,
                shown=shown,
                resumed=resumed,
            )
        if film.complete and shown.ended:
            self.warnings = tuple(film.statistics["warnings"])
            self.state = LiveState(
                samples=request.settings.sample_count, samples_total=request.settings.sample_count, side=side
            )
            return True
        if (film.complete or film.resume_state is not None) and not self._is_superseded(request):
            self._kept = request, film
        return False

    def _timed(
        self,
        session: Session,
        request: LiveRequest,
        scene: Scene,
        settings: RenderSettings,
        *,
        side: int,
        canvas: TileCanvas,
        stops: Callable[[], bool | Cancel],
        shown: _Shown | None = None,
        resumed: Film | None = None,
    ) -> Film:
        """A render into `canvas`, which also measures how long its pixels take."""

        begun, told = time.perf_counter(), ""

        def on_progress(progress: Progress) -> None:
            nonlocal told
            stage = _STAGES.get(progress.stage, "") if not progress.message else progress.message
            self.state = LiveState(
                stage=stage,
                samples=progress.samples_done if shown else 0.0,
                samples_total=request.settings.sample_count,
                side=side,
                memory_bytes=progress.memory_bytes,
                compiles=progress.compiles,
            )
            if stage != told and progress.stage != "render" and time.perf_counter() - begun > QUIET_SECONDS:
                told = stage
                self._on_change()

        already = resumed.sample_total if resumed else 0
        film = session.render(
            scene,
            without_splits(settings),
            on_tile=canvas.add,
            on_progress=on_progress,
            cancelled=stops,
            observers=[shown] if shown else [],
            resume=resumed,
        )
        if film.complete and film.sample_total > already:
            parts = film.statistics["seconds"]
            seconds = parts["paths"] + parts["render"] - (shown.seconds if shown else 0.0)
            self._pace.note(film.sample_total - already, seconds)
        return film

    def _show_fine(self, request: LiveRequest, canvas: TileCanvas, side: int, samples: int) -> bool:
        """False where the denoiser was stopped, as a render would be, and what it works on is still to be shown."""
        if self._closed or not canvas.passes:
            return True
        if self._is_superseded(request) and self._shown_side(request) is not None:
            return True  # a draw of it would delay that of the newer one
        pixels = canvas.picture()
        if request.denoiser is not None:
            if samples == 1:  # it takes a while until the first one without noise is there
                self._show(LivePicture(request, pixels, side, canvas.origin, samples))
            if self._is_superseded(request):
                return True
            try:
                pixels = denoised(canvas.passes, request.settings, request.denoiser, lambda: bool(self._stops(request)))
            except DenoiseStoppedError:
                return False
        self._show(LivePicture(request, pixels, side, canvas.origin, samples))
        return True

    def _show(self, picture: LivePicture) -> None:
        with self._changed:
            if self._request is None:
                return
            self.picture = picture
        self._shown_since_lent = True
        self._on_change()


def _mark_of(picture: LivePicture) -> tuple[int, int]:
    return picture.request.number, picture.side


class _Shown(RenderObserver):
    """Shows a picture at given sample counts."""

    def __init__(self, marks: Sequence[int], show: Callable[[Snapshot], bool]) -> None:
        """`show` returns False where it was stopped."""
        self._marks, self._show = marks, show
        self.ended = True  # what it showed last was not stopped
        self.seconds = 0.0  # that it took

    def snapshot_samples(self, sample_count: int) -> Sequence[int]:
        return self._marks

    def on_snapshot(self, snapshot: Snapshot) -> None:
        start = time.perf_counter()
        self.ended = self._show(snapshot)
        self.seconds += time.perf_counter() - start

    def on_tile(self, tile: Tile) -> None:
        pass

    def on_progress(self, progress: Progress) -> None:
        pass
