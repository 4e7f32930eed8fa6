"""A render on a cluster, simulated: the project's own rules (`core/cluster/ranges.py`) deal samples and pair films;
workers, the network, Dask's scheduler and who hands out take what they were measured to take.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from raybatch_addon.core.cluster.bands import bands_of
from raybatch_addon.core.cluster.ranges import MergeTree, RangeDeal, SampleRange
from studies.many_workers.clock import Clock, Line, Port, transfer
from studies.many_workers.model import Costs, Job, Losses, Outcome, Site

_BUNDLE_BYTES, _AT_ONCE = float(1 << 25), 4  # as in core/cluster/staging.py
_TOGETHER_SECONDS = 0.005  # as in core/cluster/connection.py
_HELPERS = 4  # threads that wait for films, as in core/cluster/render.py


@dataclass(eq=False, kw_only=True)
class Worker:
    """One of the cluster's, with one GPU or several."""

    machine: int
    port: Port
    rate: float  # samples' seconds of one GPU that it does in a second
    merging: Line  # its second thread
    queue: list[Callable[[], None]] = field(default_factory=list)
    is_busy: bool = False
    has_kernels: bool = False
    frames: set[int] = field(default_factory=set)  # that it has built
    free_since: float = 0.0


@dataclass(eq=False)
class _Task:
    samples: SampleRange
    begun: float
    workers: list[Worker]
    is_known: bool = False  # its end
    is_told: bool = False  # who rendered it
    by: Worker | None = None


@dataclass(eq=False)
class _Film:
    samples: SampleRange
    rank: int
    holders: list[Worker]
    is_there: bool = True
    is_secured: bool | None = None  # None: not asked for


class Frame:
    """One frame under way: what `ClusterRender` knows of it."""

    def __init__(self, number: int, job: Job):
        bands = bands_of((0, 0, job.width, job.height))
        self.number, self.bands = number, len(bands)
        self.pixels = job.width * job.height / len(bands)  # of a band
        self.deal = RangeDeal(0, job.samples, len(bands))
        self.tree, self.films, self.tasks = MergeTree(), dict[SampleRange, _Film](), list[_Task]()
        self.unsafe: list[_Film] = []
        self.prepared: set[Worker] = set()
        self.is_asked = self.is_fetching = self.is_over = False
        self.ready: set[int] = set()  # machines that have its scene

    @property
    def running(self) -> int:
        """Tasks that workers have of it; those whose end is known make room once it is known what samples take."""
        is_measured = self.deal.sample_seconds is not None
        return sum(len(task.workers) - (is_measured and task.by is not None) for task in self.tasks)


class Simulation:
    """One job on one cluster."""

    def __init__(self, costs: Costs, site: Site, job: Job, seed: int = 0):
        self.costs, self.site, self.job = costs, site, job
        self._random, self.clock, self.losses = np.random.default_rng(seed), Clock(), Losses()
        clock = self.clock
        self._scheduler, self._client, self._home = Line(clock), Line(clock), Port(clock, site.bandwidth)
        self._helpers, self._helped = 0, list[Callable[[Callable[[], None]], None]]()
        machines = -(-site.gpus // site.gpus_machine)
        ports = [Port(clock, site.bandwidth) for _ in range(machines)]
        rates = np.exp(self._random.normal(0.0, site.spread, site.workers)) if site.spread else np.ones(site.workers)
        rates[: round(site.slow_share * site.workers)] *= 0.5
        a_machine = site.gpus_machine // site.gpus_worker
        self.workers = [
            Worker(machine=i // a_machine, port=ports[i // a_machine], rate=rate, merging=Line(clock))
            for i, rate in enumerate(site.worker_rate * rates)
        ]
        self._ports = ports
        self.frames: list[Frame] = []
        self._begun = self._taken = self.tasks = 0
        self._last_task = 0.0  # when the last one ended
        self._steps_cost = 0.0
        self._looks, self._next_look, self._least_pause = 0, 0.0, 0.0

    def run(self) -> Outcome:
        """Until the last frame is at home."""
        site, clock = self.site, self.clock
        self._step()
        clock.run(lambda: self._taken == self.job.frames)
        seconds, gpus = clock.now, site.gpus_worker
        for worker in self.workers:
            self.losses.end += gpus * max(self._last_task - worker.free_since, 0.0)
        self.losses.home += site.workers * gpus * (seconds - self._last_task)
        useful = self.job.seconds * self.job.frames
        lost = sum(vars(self.losses).values())
        self.losses.shared = site.workers * gpus * seconds - useful - lost
        busy = self._scheduler.busy / seconds, self._client.busy / seconds
        return Outcome(seconds, useful, site.workers * gpus, self.losses, self.tasks, *busy)

    # --- who hands out

    def _step(self) -> None:
        """One look at all frames, and what follows from it; then a pause, until something comes."""
        job, self._steps_cost = self.job, 0.0
        while self._begun < job.frames and self._begun - self._taken < job.under_way:
            self._begin_frame()
        for frame in [*self.frames]:
            self._look(frame)
        for frame in self.frames:
            self._issue(frame, sum(each.running for each in self.frames if each is not frame))
        self._client.busy += self._steps_cost
        if self._taken < job.frames:
            self._least_pause = self.clock.now + self._steps_cost
            self._look_at(self._least_pause + self.site.poll)

    def _look_at(self, seconds: float) -> None:
        """The next look is then, and not when it was to be."""
        self._looks += 1
        self._next_look = seconds
        number = self._looks
        self.clock.at(seconds, lambda: self._step() if number == self._looks else None)

    def _came(self) -> None:
        """Something that was asked for is there: a look is due."""
        due = max(self.clock.now, self._least_pause) + _TOGETHER_SECONDS
        if due < self._next_look:
            self._look_at(due)

    def _asked(self, then: Callable[[], None]) -> None:
        """A task is asked for: `then`, once the scheduler has dealt with it."""
        self._steps_cost += self.costs.client_task
        self.clock.after(
            self._steps_cost + self.costs.latency, lambda: self._scheduler.serve(self.costs.scheduler_task, then)
        )

    def _begin_frame(self) -> None:
        frame = Frame(self._begun, self.job)
        self._begun += 1
        self.frames.append(frame)
        self._send_scene(frame)

    def _look(self, frame: Frame) -> None:
        for task in [*frame.tasks]:
            if task.is_told:
                frame.tasks.remove(task)
                by = task.by
                assert by is not None  # or nobody told
                beside = self.costs.film_made * frame.pixels if by in frame.prepared else None
                frame.deal.note(task.samples, self._sample_seconds(frame, task.samples, by), beside)
                frame.prepared.add(by)
                frame.unsafe.append(_Film(task.samples, 0, [by]))
            elif task.by is not None and not task.is_known:
                task.is_known = True
                told = functools.partial(self._told, task)
                self._asked(functools.partial(self.clock.after, 2 * self.costs.latency, told))
        for film in [*frame.unsafe]:
            if film.is_there and film.is_secured is None:
                film.is_secured = False
                self._help(functools.partial(self._secure, frame, film))
            elif film.is_secured:
                frame.unsafe.remove(film)
                frame.films[film.samples] = film
                frame.tree.add(film.samples, film.rank)
        self._merge(frame)
        is_last = frame.deal.is_dealt and not frame.tasks and not frame.unsafe
        if is_last and not frame.is_fetching:
            following = frame.tree.take_following(0, frame.bands, frame.deal.layer_end)
            if following:
                frame.is_fetching = True
                taken = [frame.films.pop(each) for each in following]
                self._help(functools.partial(self._fetch, frame, taken))
        if frame.is_over:
            self.frames.remove(frame)
            self._taken += 1

    def _issue(self, frame: Frame, busy: int) -> None:
        ready = [each for each in self.workers if each.machine in frame.ready]
        slots = len(ready) * (1 + self.site.ahead)
        running = busy + frame.running
        while running < slots:
            samples = frame.deal.next(len(ready))
            if samples is None:
                break
            frame.tasks.append(task := _Task(samples, self.clock.now, []))
            self._send(frame, task, ready)
            running += 1
        for task in sorted(frame.tasks, key=lambda each: each.begun):
            waited = self.clock.now - task.begun
            if running < slots and len(task.workers) == 1 and frame.deal.is_late(task.samples, waited):
                self._send(frame, task, ready)
                running += 1

    def _sample_seconds(self, frame: Frame, samples: SampleRange, worker: Worker) -> float:
        job = self.job
        return job.seconds / job.samples / frame.bands * samples.count / worker.rate

    # --- workers

    def _send(self, frame: Frame, task: _Task, ready: list[Worker]) -> None:
        """The task goes to a worker that has least to do."""
        worker = min(ready, key=lambda each: len(each.queue) + each.is_busy)
        task.workers.append(worker)
        self.tasks += 1
        worker.queue.append(lambda: self._render(frame, task, worker))
        if len(worker.queue) == 1 and not worker.is_busy:
            worker.is_busy = True
            self._asked(lambda: self.clock.after(self.costs.latency, worker.queue.pop(0)))
        else:
            self._asked(lambda: None)

    def _render(self, frame: Frame, task: _Task, worker: Worker) -> None:
        gpus, costs, job, losses = self.site.gpus_worker, self.costs, self.job, self.losses
        is_first = not worker.has_kernels and not worker.frames
        if not is_first:
            losses.waits += gpus * (self.clock.now - worker.free_since)
        else:
            losses.scene += gpus * self.clock.now
        before = 0.0
        if not worker.has_kernels:
            worker.has_kernels, before = True, job.kernel_seconds
        if frame.number not in worker.frames:
            worker.frames.add(frame.number)
            before += job.build_seconds + costs.scene_read * job.scene_bytes
        made = costs.film_made * frame.pixels
        rendered = self._sample_seconds(frame, task.samples, worker)
        losses.kernels += gpus * before
        losses.films += gpus * made
        self.clock.after(before + rendered + made, lambda: self._rendered(frame, task, worker, rendered))

    def _rendered(self, frame: Frame, task: _Task, worker: Worker, seconds: float) -> None:
        worker.free_since, worker.is_busy = self.clock.now, False
        if worker.queue:
            worker.is_busy = True
            self.clock.after(0.0, worker.queue.pop(0))
        if task.by is not None or task.is_known:
            self.losses.twice += self.site.gpus_worker * seconds
            return
        self._last_task = self.clock.now
        self._scheduler.serve(0.0, lambda: self.clock.after(self.costs.latency, lambda: self._ended(task, worker)))

    def _ended(self, task: _Task, worker: Worker) -> None:
        task.by = task.by or worker
        self._came()

    def _told(self, task: _Task) -> None:
        task.is_told = True
        self._came()

    # --- films

    def _help(self, work: Callable[[Callable[[], None]], None]) -> None:
        """On one of the threads that may wait."""
        self._helped.append(work)
        self._next_help()

    def _next_help(self) -> None:
        while self._helped and self._helpers < _HELPERS:
            self._helpers += 1
            self._asked(functools.partial(self._helped.pop(0), self._help_ends))

    def _help_ends(self) -> None:
        self._helpers -= 1
        self._next_help()

    def _secure(self, frame: Frame, film: _Film, end: Callable[[], None]) -> None:
        """Another worker gets it too."""

        def done() -> None:
            film.is_secured = True
            end()

        others = [each for each in self.workers if each not in film.holders]
        if not others:
            done()
            return
        other = others[int(self._random.integers(len(others)))]
        source = film.holders[0]
        film.holders.append(other)
        transfer(self.clock, source.port, other.port, self._film_bytes(frame), self.costs.latency, done)

    def _film_bytes(self, frame: Frame) -> float:
        return self.costs.film_bytes * frame.pixels

    def _merge(self, frame: Frame) -> None:
        is_last = frame.deal.is_dealt and not frame.tasks
        while (pair := frame.tree.take_pair(is_last)) is not None:
            earlier, later, rank = pair
            first, second = frame.films.pop(earlier), frame.films.pop(later)
            both = [each for each in first.holders if each in second.holders]
            by = (both or first.holders)[0]
            film = _Film(replace(earlier, end=later.end), rank, [by], is_there=False)
            frame.unsafe.append(film)

            def merged(film: _Film = film) -> None:
                film.is_there = True
                self._came()

            def merge(by: Worker = by, merged: Any = merged) -> None:
                by.merging.serve(self.costs.film_merged * frame.pixels, merged)

            def bring(second: _Film = second, by: Worker = by, merge: Any = merge, both: Any = both) -> None:
                if both:
                    merge()
                else:
                    source = second.holders[0].port
                    transfer(self.clock, source, by.port, self._film_bytes(frame), self.costs.latency, merge)

            self._asked(bring)

    def _fetch(self, frame: Frame, films: list[_Film], end: Callable[[], None]) -> None:
        """One band after another comes home, through the scheduler; then they are one frame."""
        costs = self.costs
        if not films:
            pixels = frame.pixels * frame.bands

            def over() -> None:
                frame.is_over = True
                end()

            self.clock.after(costs.film_joined * pixels, over)
            return
        size = self._film_bytes(frame)

        def relayed() -> None:
            self._scheduler.serve(
                costs.relay * size,
                lambda: self.clock.after(
                    costs.film_received * frame.pixels, lambda: self._fetch(frame, films[1:], end)
                ),
            )

        transfer(self.clock, films[0].holders[0].port, self._home, size, costs.latency, relayed)

    # --- scenes

    def _send_scene(self, frame: Frame) -> None:
        """Each bundle leaves home once, and goes on from machine to machine; some at a time come to each."""
        size = self.job.scene_bytes * (1.0 if frame.number == 0 else self.job.changed)
        count = max(1, -(-int(size) // int(_BUNDLE_BYTES)))
        waiting: list[list[int]] = [[] for _ in range(count)]  # machines, by bundle
        idle: list[list[Port]] = [[self._home] for _ in range(count)]  # that have it, and do not send it
        machines = range(len(self._ports))
        asked, left = dict.fromkeys(machines, 0), dict.fromkeys(machines, count)

        def ask(machine: int) -> None:
            if asked[machine] < count:
                bundle = asked[machine]
                asked[machine] += 1
                waiting[bundle].append(machine)
                pump(bundle)

        def pump(bundle: int) -> None:
            while waiting[bundle] and idle[bundle]:
                source, machine = idle[bundle].pop(0), waiting[bundle].pop(0)
                came = functools.partial(arrived, bundle, source, machine)
                transfer(self.clock, source, self._ports[machine], size / count, self.costs.latency, came)

        def arrived(bundle: int, source: Port, machine: int) -> None:
            idle[bundle] += [self._ports[machine], *([] if source is self._home else [source])]
            pump(bundle)
            self.clock.after(self.costs.scene_kept * size / count, functools.partial(kept, machine))

        def kept(machine: int) -> None:
            left[machine] -= 1
            if left[machine]:
                ask(machine)
            else:
                frame.ready.add(machine)

        def begin() -> None:
            for machine in machines:
                for _ in range(_AT_ONCE):
                    ask(machine)

        self.clock.after(self.costs.scene_cut * size, begin)


def simulated(costs: Costs, site: Site, job: Job, seed: int = 0) -> Outcome:
    """What comes of `job` on `site`."""
    return Simulation(costs, site, job, seed).run()
