"""A render as a sequence of rounds: workers take tiles, a round ends when all tiles have its samples, and observers see
pictures between.
"""

from __future__ import annotations

import math
import queue
import threading
import time
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import numpy as np

from ...convergence.halves import HalfError, half_error
from ...device.failures import named_failures
from ...film import Film
from ...film.tile import FinishedTile
from ...measure.snapshot import Snapshot
from ...observers import Cancel
from ...scene.passes import GUIDE_PASSES
from ..integrator import TileIntegrator, TileState
from .deal import Deal
from .events import RenderEvents, StateKeeper
from .resume import ResumeState
from .steps import LEFT_SHARE, TileParts, TileSteps
from .summary import complaints, error_summary, ray_totals

# How often the calling thread looks up from waiting for results, to see whether it is cancelled [s]
POLL_SECONDS = 0.01
# How often it reports progress meanwhile [s]
PROGRESS_SECONDS = 0.05
# A render that one worker ends so soon begins no thread [s]
SHORT_SECONDS = 0.05
# A tile that is rendered in parts is shown before its last one where it was not for so long [s]
PART_SEEN_SECONDS = 5.0
# A cancelled render waits this long for the rays that are under way [s]; those that are left are given up then
DRAIN_SECONDS = 0.25
# A cancelled render that is kept waits this long for the rays that are under way, without which it cannot go on [s]
KEPT_PATIENCE = 5.0


class Rendering:
    """The rounds of one render, and what is known of it at their ends."""

    def __init__(
        self,
        integrators: Sequence[TileIntegrator],
        state: ResumeState,
        film: Film,
        events: RenderEvents,
        started: float,
        steps: TileSteps | None = None,
        *,
        parts: TileParts | None = None,
    ):
        """`state` is brought up to date and `film` filled; `started` is when the render was asked for
        (`time.perf_counter`). With `steps` all tiles are shown after few samples, and then refined; without, each has
        all samples of a round when it is shown. With `parts` workers render it part by part.
        """
        self._integrators, self._state, self._film, self._events, self._started = (
            integrators,
            state,
            film,
            events,
            started,
        )
        self._steps, self._parts = steps, parts
        # the parts under way: tiles, and how many samples of the round each half has at the end
        self._taken: dict[TileIntegrator, tuple[Sequence[TileState], int]] = {}
        # halves of tiles with more parts to come, whose pictures nobody has made, and by whom they are
        self._unseen: dict[Hashable, tuple[TileIntegrator, list[FinishedTile]]] = {}
        self._seen: dict[Hashable, float] = {}  # when a tile was shown last (`time.perf_counter`)
        self._total, self._pixels = state.items_to_come, state.pixel_count
        self._earlier = film.sample_total  # paths that are in the film already
        self._earlier_invalid = state.invalid_samples
        self._begun = self._reported = time.perf_counter()
        self._items_kept = 0  # paths of this call that were there when the state was kept last
        self.error: HalfError | None = None  # at the end of the last round where it was looked at
        self.error_samples = 0  # of every pixel, then
        self.warnings: list[str] = []

    def run(self) -> None:
        """Until the policy or a cancel ends it; raises what a worker or a callback raised."""
        if self._events.keeper:
            self._events.keeper.start()
        try:
            self._run_rounds()
            self._note_invalid()
        finally:
            for integrator in self._integrators:
                integrator.release()

    def _note_invalid(self) -> None:
        self._state.invalid_samples = self._earlier_invalid + sum(each.invalid_samples for each in self._integrators)

    def _run_rounds(self) -> None:
        state, policy = self._state, self._state.policy
        rendering = 0.0  # without what observers do meanwhile [s]
        if state.end is None:
            state.begin_round(policy.next_end(state.done, 0.0, state.share))
            if state.end is None:  # no pixel gets samples
                self._report_progress()
                self._show(0.0, is_last=True)
        while state.end is not None:
            start = time.perf_counter()
            samples = state.items_open / self._pixels
            if not self._render_round():
                return
            seconds = time.perf_counter() - start
            rendering += seconds
            state.end_round()
            if looks := policy.looks_at_noise(state.done):
                state.look_at_noise()
            looked_at = self._look_at_error() if policy.looks_at_error(state.done) else None
            policy.note_round(samples, seconds, looked_at and looked_at.relmse)
            end = policy.next_end(state.done, time.perf_counter() - self._begun, state.share)
            self._show(rendering, is_last=end is None)
            state.begin_round(end)
            if looks and end is not None:
                state.list_active()
                self._total = self._items_done() + state.items_to_come
        if self.error_samples != state.done:
            self._look_at_error()
        self.warnings += complaints(policy, self._film, state.done)

    def error_report(self) -> dict[str, Any] | None:
        """What is known of the film's error, for statistics; None where halves are not kept apart."""
        if not self._film.halves:
            return None
        return error_summary(self._state.policy, self.error, self.error_samples)

    # --- a round

    def _render_round(self) -> bool:
        """Let the workers render what is left of the round, with stops for who keeps it; False: it was cancelled."""
        state, keeper = self._state, self._events.keeper
        while True:
            if keeper and self._is_due(keeper):
                self._note_invalid()
                keeper.keep(state)
                self._items_kept = self._items_done()
            is_kept = self._render_tiles()
            if not (is_kept and state.drained and state.open_tiles):
                return state.drained and not state.open_tiles

    def _render_tiles(self) -> bool:
        """Let the workers render open tiles, and take their results on this thread. They stop when it is cancelled, and
        when somebody wants to keep the state, but give up no rays for that; whether that was all that stopped them.
        """
        state, events = self._state, self._events
        is_cancelled = is_kept = False
        self._taken.clear()
        # with steps no tile gets ahead of the others, however often the workers are stopped
        tiles = state.open_tiles_behind_first if self._steps else state.open_tiles
        todo = Deal((halves, halves[0].place, self._seconds_left(halves)) for halves in tiles)
        results: queue.SimpleQueue[FinishedTile | BaseException | None] = queue.SimpleQueue()
        stop = threading.Event()

        def look() -> None:
            """See, on the calling thread, whether the workers are to stop."""
            nonlocal is_cancelled, is_kept
            if not is_cancelled and (cancel := events.cancelled()):
                is_cancelled = True
                patience = 0.0 if cancel is Cancel.AT_ONCE else DRAIN_SECONDS
                for integrator in self._integrators:
                    integrator.patience = KEPT_PATIENCE if events.keeper else patience
                stop.set()
            elif events.keeper and not stop.is_set() and self._is_due(events.keeper):
                is_kept = True
                stop.set()

        def work(
            integrator: TileIntegrator,
            is_stopped: Callable[[], bool] = stop.is_set,
            finish: Callable[[FinishedTile], None] = results.put,
        ) -> None:
            place = integrator.device.alias
            try:
                while not stop.is_set() and (halves := todo.take(place)) is not None:
                    left = state.items_left_of(halves)
                    with named_failures(integrator.device):
                        if tile := self._render_tile(integrator, halves, is_stopped):
                            finish(tile)
                    if 0 < state.items_left_of(halves) < left:  # one that was stopped waits for who resumes it
                        todo.put_back(halves, place, self._seconds_left(halves))
            except BaseException as error:  # carried to the calling thread, and raised there
                stop.set()
                results.put(error)
            finally:
                results.put(None)  # this worker is through

        for integrator in self._integrators:
            integrator.patience = math.inf if events.keeper else DRAIN_SECONDS
        threads = [threading.Thread(target=work, args=(i,), daemon=True) for i in self._integrators]
        working = len(threads)
        look()  # before there is a path: it may have been cancelled while the scene was built
        if self._is_short():
            threads = []
            work(self._integrators[0], *self._alone(look, stop))
        for thread in threads:
            thread.start()
        try:
            while working:
                look()
                try:
                    result = results.get(timeout=POLL_SECONDS)
                    if isinstance(result, BaseException):
                        raise result
                    if result is None:
                        working -= 1
                    else:
                        self._hand_out(result)
                    self._report_progress()
                except queue.Empty:
                    self._report_now_and_then()
        finally:
            stop.set()
            for thread in threads:
                thread.join()
        while self._unseen:
            integrator, halves = self._unseen.popitem()[1]
            with named_failures(integrator.device):
                self._hand_out(integrator.shown(halves))
        return is_kept and not is_cancelled

    def _is_short(self) -> bool:
        """Whether the one worker is soon through, by what it took for a tile of the same scene: then to begin a thread
        may take as long as that.
        """
        if len(self._integrators) > 1 or self._steps is not None:
            return False
        return self._state.items_open * self._integrators[0].seconds_a_path < SHORT_SECONDS

    def _alone(
        self, look: Callable[[], None], stop: threading.Event
    ) -> tuple[Callable[[], bool], Callable[[FinishedTile], None]]:
        """For a worker on the calling thread: whether it is to stop, and what takes its tiles. It looks up behind each
        tile, and now and then as that thread does otherwise.
        """
        looked = time.perf_counter()

        def is_stopped() -> bool:
            nonlocal looked
            if time.perf_counter() - looked >= POLL_SECONDS:
                look()
                self._report_now_and_then()
                looked = time.perf_counter()
            return stop.is_set()

        def finish(tile: FinishedTile) -> None:
            nonlocal looked
            self._hand_out(tile)
            look()
            self._report_progress()
            looked = time.perf_counter()

        return is_stopped, finish

    def _render_tile(
        self, integrator: TileIntegrator, halves: Sequence[TileState], stop: Callable[[], bool]
    ) -> FinishedTile | None:
        """A step of a tile, or all that is left of its round; None for a part behind which it goes on unseen."""
        box = halves[0].tile.box
        self._unseen.pop(box, None)
        start, tail_seconds, finished = time.perf_counter(), 0.0, []
        samples_most = self._step_end(integrator, halves)
        begun, before = [state.items_begun for state in halves], integrator.items_done
        for state in halves:
            state.move_to(integrator.device)
            samples = self._state.samples_of(state)
            most = max(samples_most * state.pixel_count - state.items_begun, 0)
            finished.append(integrator.render(state, samples.first, samples.sample_count, stop, most))
            tail_seconds += integrator.tail_seconds
        joined, now, stopped = time.perf_counter(), [state.items_begun for state in halves], stop()
        goes_on = self._parts is not None and not stopped and self._state.items_left_of(halves) > 0
        if goes_on and joined - self._seen.get(box, self._begun) < PART_SEEN_SECONDS:
            tile, self._unseen[box] = None, (integrator, finished)
        else:
            tile, self._seen[box] = integrator.shown(finished), joined
        end = time.perf_counter()
        integrator.seconds_working += end - start
        if done := integrator.items_done - before:
            integrator.seconds_a_path = (end - start) / done
        if begun == now or stopped:
            return tile
        if self._parts:
            self._parts.note(box, sum(now) - sum(begun), joined - start)
        if self._steps:
            samples = max((b - a) / max(each.pixel_count, 1) for a, b, each in zip(begun, now, halves, strict=True))
            self._steps.note(box, samples, end - start, tail_seconds + end - joined)
        return tile

    def _seconds_left(self, halves: Sequence[TileState]) -> float:
        """What is left of a tile's round takes; inf where that is not known, or does not matter."""
        if not self._parts:
            return math.inf
        return self._parts.seconds(halves[0].tile.box, self._state.items_left_of(halves))

    def _items_taken(self, integrator: TileIntegrator) -> int:
        """Paths that are in parts of others than `integrator`, and not begun yet."""
        state = self._state
        return sum(
            max(0, min(end, state.samples_of(each).sample_count) * each.pixel_count - each.items_begun)
            for other, (halves, end) in list(self._taken.items())
            for each in halves
            if other is not integrator
        )

    def _step_end(self, integrator: TileIntegrator, halves: Sequence[TileState]) -> int:
        """Samples of the round that each half of a tile has when it is shown: the same for all, wherever a stop left
        them. Tiles of images come to a GPU anew in each step, so all but the first have as many paths as wait together.
        """
        box = halves[0].tile.box
        last = max(self._state.samples_of(state).sample_count for state in halves)
        if not (self._steps or self._parts):
            return last
        begun = min(state.items_begun // max(state.pixel_count, 1) for state in halves)
        pixels, left = max(sum(state.pixel_count for state in halves), 1), last - begun
        open_to_all = max(self._state.items_open - self._items_taken(integrator), 0)
        share = LEFT_SHARE / len(self._integrators) * open_to_all / pixels
        if self._parts:
            end = begun + self._parts.samples(box, left, pixels, share)
            self._taken[integrator] = halves, end
            return end
        waits = begun > 0 and integrator.textures is not None and integrator.device.is_cuda
        together = integrator.path_count // pixels if waits else 0
        samples = self._steps.samples(box, left, share)
        return begun + max(samples, min(together, left))

    def _hand_out(self, tile: FinishedTile) -> None:
        """Put `tile` into the film, and show it."""
        start = time.perf_counter()
        self._events.on_tile(tile, self._film.add_tile(tile))
        if self._steps:
            self._steps.note_shown(tile.rectangle, time.perf_counter() - start)

    def _report_progress(self) -> None:
        seconds = time.perf_counter() - self._begun
        items = self._items_done()
        done = items / self._total if self._total else 1.0
        if limit := self._state.policy.time_limit:
            done = max(done, min(seconds / limit, 1.0))
        self._events.on_progress(done, (self._earlier + items) / self._pixels, seconds)
        self._reported = time.perf_counter()

    def _report_now_and_then(self) -> None:
        if time.perf_counter() - self._reported >= PROGRESS_SECONDS:
            self._report_progress()

    def _is_due(self, keeper: StateKeeper) -> bool:
        """Whether the workers are to stop for `keeper` now: there is something new to keep."""
        return self._items_done() > self._items_kept and keeper.is_due()

    def _items_done(self) -> int:
        """Paths of this call that came to their end."""
        return sum(integrator.items_done for integrator in self._integrators)

    # --- between rounds

    def _look_at_error(self) -> HalfError | None:
        """None where the film has no halves, or one of them no sample."""
        film, state = self._film, self._state
        samples = state.samples_so_far.of_half(0, 2).sample_count, state.samples_so_far.of_half(1, 2).sample_count
        if not film.halves or not all(samples):
            return None
        self.error, self.error_samples = half_error(*(_colors(half) for half in film.halves), state.counts), state.done
        return self.error

    def _show(self, seconds: float, is_last: bool) -> None:
        """Hand out the picture as it is after `seconds` of rendering."""
        done = self._state.done
        watching = [watcher for watcher in self._events.watchers if is_last or done in watcher.marks]
        for watcher in watching:
            rays = ray_totals(self._integrators)
            rays["bounced"] = rays.pop("bounce")
            halves = self._film.halves
            watcher.on_snapshot(
                Snapshot(
                    samples=done,
                    seconds=seconds,
                    seconds_total=time.perf_counter() - self._started,
                    rays=rays,
                    invalid_samples=sum(each.invalid_samples for each in self._integrators),
                    picture=_colors(self._film).copy(),
                    halves=tuple(_colors(half).copy() for half in halves) if halves else None,
                    counts=self._state.counts if self._state.active else None,
                    guides={
                        name: self._film.passes[name].copy() for name in self._film.pass_names if name in GUIDE_PASSES
                    },
                )
            )


def _colors(film: Film) -> np.ndarray:
    """The film's picture without alpha, shape [height, width, 3]."""
    return film.passes["Combined"][..., :3]
