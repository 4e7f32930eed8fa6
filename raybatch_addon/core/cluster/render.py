"""One render on a cluster: ranges of samples go out as tasks, their films are merged there, and one film comes back."""

from __future__ import annotations

import time
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

from . import films
from .bands import Region, bands_of, film_of_bands
from .connection import ClusterError, Connection, Worker, is_diagnosed, told, why_lost
from .keeping import ClusterKeeper, Received, sound
from .parts import SceneParts, part_digest
from .ranges import MergeTree, RangeDeal, SampleRange
from .report.events import ClusterEvents, EventKind
from .report.tasks_again import TasksAgain
from .rounds import ClusterRounds
from .staging import LeftOut, Staging

# How often a picture of what is there is asked for [s]
PICTURE_SECONDS = 5.0
# Tasks that fail, but not by the end of their worker, are rendered so many times
_TRIES = 3


@dataclass
class _Task:
    """A range that is being rendered, by one worker or several."""

    samples: SampleRange
    begun: float  # [s]
    futures: list[Any]
    hosts: frozenset[str]  # that may render it
    done: Any = None  # the first future that is there
    about: Any = None  # the future of who rendered it


@dataclass
class _Film:
    """A film that is there, or being merged."""

    samples: SampleRange
    rank: int
    future: Any
    hosts: tuple[frozenset[str], ...]  # that may render it again, for each task that it is of
    merged_of: tuple[_Film, ...] = ()  # stay until it is safe
    secured: Future | None = None  # is done when two workers have it: else the end of one loses it


class _FilmLost(Exception):
    """A film that did not come, and has to be rendered again."""

    def __init__(self, film: _Film, why: str):
        super().__init__(why)
        self.film = film


class ClusterRender:
    """The state of one render; `look` and then `issue` go on with it, and never wait."""

    def __init__(self, connection: Connection, parts: SceneParts, keeper: ClusterKeeper, rounds: ClusterRounds):
        self._connection, self._scene, self._keeper = connection, parts, keeper
        self.rounds = rounds
        self._first = keeper.first
        self._helpers = ThreadPoolExecutor(max_workers=4, thread_name_prefix="RayBatch cluster")
        self._failures: dict[SampleRange, int] = {}
        self._region: Region = rounds.region
        self._bands = bands_of(self._region)
        self._pictures: list[tuple[Region, dict[str, Any]]] = []
        self.wants_pictures = False  # somebody looks at them
        self.workers: list[Worker] = []
        self.tasks_again = TasksAgain()
        self.events = ClusterEvents()
        self.left_out = LeftOut(self.events)  # machines that are asked for nothing
        self.rays = 0  # that were traced
        self._prepared: set[str] = set()  # workers that have kernels and trees
        self.begin()

    def begin(self, like: float | None = None) -> None:
        """What is not here of the round is to be rendered, by a cluster that knows of nothing; `like`: what a sample
        should take a worker [s].
        """
        self._parts, self._stopped = self._scene, ""
        if (stopped := self.rounds.stopped) is not None:  # travels as parts of the scene do
            self._stopped = part_digest(stopped)
            self._parts = replace(self._scene, arrays={**self._scene.arrays, self._stopped: stopped})
        self._staging = Staging(self._connection, self._parts, self.left_out)
        self._deal = RangeDeal(self._keeper.end, self.rounds.end, len(self._bands), like)
        self._again: list[SampleRange] = []
        self._tasks: list[_Task] = []
        self._unsafe: list[_Film] = []
        self._films: dict[SampleRange, _Film] = {}  # those that are safe, and wait to be merged
        self._tree = MergeTree()
        self._fetched: tuple[list[_Film], Future] | None = None  # of all bands, with the same samples
        self._picture: tuple[SampleRange, Any] | None = None  # of a band, that is being made
        self._pictured = dict.fromkeys(range(len(self._bands)), 0)  # samples of the last one of each
        self._pictured_at = time.monotonic()

    def begin_again(self) -> None:
        """What is not here is to be rendered anew: the scheduler that knew of it is gone."""
        self.events.note("SCHEDULER_LOST", "", "what had not come from workers is rendered again")
        self._begin_round()

    def _begin_round(self) -> None:
        self.begin(self._deal.sample_seconds)

    def close(self) -> None:
        """Nothing of it is wanted any more."""
        films = [each.future for each in (*self._films.values(), *self._unsafe)]
        self._connection.cancel([*films, *(each for task in self._tasks for each in task.futures)])
        self._helpers.shutdown(wait=False, cancel_futures=True)

    # --- one step

    @property
    def is_over(self) -> bool:
        """Whether all samples are here."""
        return self.rounds.is_over and self._fetched is None

    @property
    def is_rendering(self) -> bool:
        """Whether a worker renders, or did."""
        return bool(self._tasks or self._films or self._unsafe)

    @property
    def samples_done(self) -> float:
        """Samples of every pixel that are rendered, with what those under way should have come to."""
        left = float(sum(each.count for each in self._again))  # of a band each
        now, a_sample = time.monotonic(), self._deal.sample_seconds
        for task in self._tasks:
            share = 0.0 if a_sample is None else (now - task.begun) / (a_sample * task.samples.count)
            left += task.samples.count * (1.0 - min(share, 0.95))
        return self._deal.dealt - self._first - left / len(self._bands)

    @property
    def tasks_running(self) -> int:
        """Tasks that workers have of it. One that is done makes room at once, where it is known what samples take:
        who rendered it is told later.
        """
        if self._deal.sample_seconds is None:
            return sum(len(task.futures) for task in self._tasks)
        return sum(not each.done() for task in self._tasks for each in task.futures)

    def look(self) -> None:
        """See what came; raises `ClusterError`."""
        self.workers = self._connection.workers()
        gone = self.events.see_workers((each.address for each in self.workers), self._connection.silent)
        if gone:
            self.tasks_again.give(self._connection.went_with(gone))
        self._staging.step(self.workers)
        self._see_lost({each.host for each in self.workers})
        self._see_tasks()
        self._see_films()
        self._merge()
        self._fetch()
        self._see_picture()

    def issue(self, busy: int = 0) -> None:
        """Ask for what comes next, where other renders have `busy` tasks."""
        able = self._staging.ready - self.left_out.hosts
        ready = [each for each in self.workers if each.slots and each.host in able]
        slots, running = sum(each.slots for each in ready), busy + self.tasks_running
        hosts, now = frozenset(each.host for each in ready), time.monotonic()
        while running < slots:
            samples = self._again.pop(0) if self._again else self._deal.next(slots)
            if samples is None:
                break
            self._tasks.append(_Task(samples, now, [self._asked(samples, hosts)], hosts))
            running += 1
        for task in sorted(self._tasks, key=lambda each: each.begun):
            # nothing else is left: who is late is helped
            is_alone = len(task.futures) == 1 and task.done is None
            if running < slots and is_alone and self._deal.is_late(task.samples, now - task.begun):
                task.futures.append(self._asked(task.samples, hosts))
                task.hosts |= hosts
                self.tasks_again.ask()
                self.events.note("TASK_LATE", str(task.samples), "another worker renders it too")
                running += 1

    def _asked(self, samples: SampleRange, hosts: frozenset[str]) -> Any:
        band = self._bands[samples.band]
        what = self._parts.recipe, self._parts.digest, band, samples.first, samples.count, self._stopped
        return self.tasks_again.know(self._connection.submit("render", *what, workers=hosts, slot=True))

    # --- what came

    def _see_lost(self, hosts: set[str]) -> None:
        """Have rendered again what is lost with all machines that could: Dask waits for them."""
        if not hosts:
            return
        for task in [*self._tasks]:
            if not task.hosts & hosts:
                self._tasks.remove(task)
                self.events.note("TASK_LOST", str(task.samples), "all machines went that could render it")
                self._render_again(task.samples, task.futures)
        fetched = self._fetched[0] if self._fetched else []
        for film in [*self._unsafe, *self._films.values(), *fetched]:
            if not film.future.done() and not all(each & hosts for each in film.hosts):
                if film in self._unsafe:
                    self._unsafe.remove(film)
                else:
                    if film in fetched:
                        self._put_back()
                    self._take(film.samples)
                self.events.note("TASK_LOST", str(film.samples), "its film went with all machines that had it")
                self._render_again(film.samples, [film.future])

    def _render_again(self, samples: SampleRange, futures: list[Any]) -> None:
        self._connection.cancel(futures)
        self.tasks_again.ask(futures)
        self._again += self._deal.cut(samples)

    def _see_tasks(self) -> None:
        for task in [*self._tasks]:
            if task.about is None:
                task.done = next((each for each in task.futures if each.done()), None)
                if task.done is None:
                    continue
                if task.done.status == "finished":
                    task.about = self._connection.submit("shares_of", task.done, workers=task.hosts, priority=50)
                else:
                    self._fail(task, task.done, why_lost(task.done))
            elif task.about.done():
                found = told(task.about)
                if isinstance(found, dict):
                    self._fail(task, task.about, found["text"], found.get("error", ""))
                else:
                    self._finish(task, found[0])

    def _finish(self, task: _Task, share: dict[str, Any]) -> None:
        self._keeper.check(share)
        self._tasks.remove(task)
        self._connection.cancel([each for each in task.futures if each is not task.done])
        beside = share["seconds"] - share["seconds_rendering"]
        self._deal.note(task.samples, share["seconds_rendering"], beside if share["worker"] in self._prepared else None)
        self._prepared.add(share["worker"])
        self.left_out.note_work()
        self.rays += share["rays"]["total"]
        self._unsafe.append(_Film(task.samples, 0, task.done, (task.hosts,)))

    def _fail(self, task: _Task, future: Any, why: str, kind: str = "") -> None:
        """Have it rendered again, for what `future` came to; raises `ClusterError` where that would not help."""
        self._tasks.remove(task)
        if kind and kind not in ("PartMissing", "DamagedFilm"):
            raise ClusterError(why)  # scene, settings or device are at fault
        if kind == "PartMissing":
            self._staging.again()
        what: dict[str, EventKind] = {"PartMissing": "PART_MISSING", "DamagedFilm": "FILM_DAMAGED"}
        self.events.note(what.get(kind, "TASK_LOST"), str(task.samples), why)
        self._blame(future, task.samples, why)
        self._render_again(task.samples, task.futures)

    def _blame(self, future: Any, samples: SampleRange, why: str) -> None:
        """Count a failure against its machine, or else against `samples`; raises `ClusterError` for one too many."""
        if host := self._connection.failed_on(future):
            self.left_out.count(host, f"{host} cannot do its part: {why}", is_diagnosed(future))
            return
        self._failures[samples] = self._failures.get(samples, 0) + 1
        if self._failures[samples] >= _TRIES:
            raise ClusterError(f"samples {samples.first} to {samples.end - 1} could not be rendered: {why}")

    def _add(self, film: _Film) -> None:
        """It waits to be merged, or to be brought here."""
        self._films[film.samples] = film
        self._tree.add(film.samples, film.rank)

    def _take(self, samples: SampleRange) -> _Film:
        """The film of `samples`, which does not wait any more."""
        self._tree.remove(samples)
        return self._films.pop(samples)

    def _see_films(self) -> None:
        """Films that two workers have may be merged, and their own parts go."""
        for film in [*self._unsafe]:
            if film.secured is None and film.future.done():
                if film.future.status != "finished":
                    self._merge_again(film)
                    continue
                film.secured = self._helpers.submit(self._connection.secure, film.future)
            elif film.secured is not None and film.secured.done():
                self._unsafe.remove(film)
                film.merged_of = ()
                self._add(film)

    def _merge_again(self, film: _Film) -> None:
        """It is not there: the films that it is of are merged again, or rendered where they are not there either."""
        self._unsafe.remove(film)
        why = why_lost(film.future)
        self.events.note("TASK_LOST", str(film.samples), why)
        self._blame(film.future, film.samples, why)
        for part in film.merged_of or (film,):
            if part.future.status in ("finished", "pending"):
                self._add(part)
            else:
                self._render_again(part.samples, [part.future])

    def _merge(self) -> None:
        while (pair := self._tree.take_pair(self._is_dealt and not self._tasks)) is not None:
            earlier, later, rank = pair
            parts = self._films.pop(earlier), self._films.pop(later)
            able = self.left_out.others(each.host for each in self.workers)
            hosts = parts[0].hosts + parts[1].hosts + ((able,) if able else ())
            future = self._connection.submit("merge", *(each.future for each in parts), workers=able, priority=60)
            self._unsafe.append(_Film(replace(earlier, end=later.end), rank, future, hosts, parts))

    @property
    def _is_dealt(self) -> bool:
        return self._deal.is_dealt and not self._again

    def _fetch(self) -> None:
        """Bring the films of the next samples here, at the end of a round or where it is time to keep them."""
        if self._fetched is None:
            is_last = self._is_dealt and not self._tasks and not self._unsafe
            if not (is_last or self._keeper.is_due()):
                return
            following = self._tree.take_following(self._keeper.end, len(self._bands), self._deal.layer_end)
            if following:
                taken = [self._films.pop(each) for each in following]
                self._fetched = taken, self._helpers.submit(self._received, taken)
        elif self._fetched[1].done():
            received = self._fetched[1]
            try:
                self._keep(received.result())
            except _FilmLost as error:
                if self._connection.is_lost:
                    return
                self._put_back()
                film = self._take(error.film.samples)
                is_damaged = isinstance(error.__cause__, films.DamagedFilm)
                self.events.note("FILM_DAMAGED" if is_damaged else "TASK_LOST", str(film.samples), str(error))
                if is_damaged or film.future.status == "error":
                    self._blame(film.future, film.samples, str(error))
                self._render_again(film.samples, [film.future])

    def _put_back(self) -> None:
        """What was to come here waits again."""
        if self._fetched is not None:
            for film in self._fetched[0]:
                self._add(film)
        self._fetched = None

    def _received(self, taken: list[_Film]) -> Received:
        """On a thread that may wait: the films of all bands, and what follows from them at the end of a round. Raises
        `_FilmLost`.
        """
        parts, shares = [], []
        for each in taken:
            try:
                film, its = films.received_film(sound(each.future.result()))
            except (films.DamagedFilm, OSError, MemoryError, CancelledError) as error:  # or the scheduler went, or all
                raise _FilmLost(each, str(error)) from error
            parts.append(film)
            shares += its
        return self._keeper.received(film_of_bands(parts, self._region), shares, self.rounds)

    def _keep(self, received: Received) -> None:
        """Go on with the next round, where that was the last of this one."""
        self._fetched = None
        is_next, self.rounds = received.rounds is not self.rounds, received.rounds
        self._keeper.keep(received.kept, received.shares, self.rounds)
        if not is_next or self.rounds.is_over:
            return
        if received.film is not None and self.wants_pictures:
            self._pictures.append((self._region, received.film.passes))
        self._begin_round()

    # --- pictures

    def _see_picture(self) -> None:
        if self._picture is None:
            # of later rounds, all that was before is here
            is_wanted = self.wants_pictures and not self.rounds.number and self._films
            if is_wanted and time.monotonic() - self._pictured_at >= PICTURE_SECONDS / len(self._bands):
                gained = {each: each.count / max(self._pictured[each.band], 0.5) for each in self._films}
                best = max(gained, key=lambda each: gained[each])
                if gained[best] > 1.0:
                    self._picture = best, self._connection.submit("picture", self._films[best].future, priority=40)
        elif self._picture[1].done():
            (samples, future), self._picture = self._picture, None
            if future.status == "finished":
                self._pictured[samples.band] = samples.count
                self._helpers.submit(self._receive_picture, self._bands[samples.band], future)
            self._pictured_at = time.monotonic()

    def _receive_picture(self, band: Region, future: Any) -> None:
        passes = future.result()
        if "error" not in passes:
            # where arrays lie in what was received is any byte's place, which not all who show them can read
            self._pictures.append((band, {name: values.copy() for name, values in passes.items()}))

    def take_pictures(self) -> list[tuple[Region, dict[str, Any]]]:
        """Parts of the frame that came since the last call, and their passes by name, each better than that before."""
        taken, self._pictures = self._pictures, []
        return taken
