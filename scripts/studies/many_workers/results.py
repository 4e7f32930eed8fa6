"""What was measured and simulated, as tables of Markdown and as a plot."""

from __future__ import annotations

import functools
import statistics
from collections.abc import Iterable
from dataclasses import fields, replace
from pathlib import Path

from studies.many_workers import devices, jobs
from studies.many_workers.cluster import simulated
from studies.many_workers.model import FREE, Costs, Job, Losses, Outcome, Site
from studies.pages import machine, number, table
from studies.study import Report

LOSSES = {
    "scene": "scene sent",
    "kernels": "kernels, trees",
    "films": "films made",
    "waits": "between tasks",
    "end": "end",
    "twice": "done twice",
    "home": "merged, home",
    "shared": "rates",
}
_UNITS = {
    "client_task": ("who hands out, a task of Dask's", 1e3, "ms"),
    "scheduler_task": ("the scheduler, a task of Dask's", 1e3, "ms"),
    "relay": ("the scheduler, what it passes on", 1e9, "s a GB"),
    "film_made": ("a worker, the film of a task", 1e6, "s a megapixel"),
    "film_merged": ("a worker, two films that become one", 1e6, "s a megapixel"),
    "film_received": ("at home, a film that came", 1e6, "s a megapixel"),
    "film_joined": ("at home, bands that become a picture", 1e6, "s a megapixel"),
    "film_bytes": ("a film of the picture alone", 1.0, "bytes a pixel"),
    "scene_cut": ("at home, a scene in parts with digests", 1e9, "s a GB"),
    "scene_kept": ("a machine, parts that are written", 1e9, "s a GB"),
    "scene_read": ("a worker, a scene of its parts", 1e9, "s a GB"),
}


def costs_of(report: Report) -> Costs:
    """Medians over turns; those of bands that become a picture are of all that is done then."""
    found: dict[str, float] = {}
    for name in ("film_added", "film_shown", *_UNITS):
        values = [row[name] for row in report["rows"] if row.get(name) is not None]
        found[name] = statistics.median(values)
    found["film_joined"] += found.pop("film_added") + found.pop("film_shown")
    return replace(FREE, latency=Costs.latency, **found)


@functools.cache
def outcome(costs: Costs, site: Site, job: Job) -> Outcome:
    """`simulated`, once."""
    return simulated(costs, site, job)


def works(is_cold: bool) -> dict[str, Job]:
    """All that is rendered, by name."""
    found = {name: jobs.still(seconds, is_cold) for name, seconds in jobs.STILLS.items()}
    return found | {jobs.ANIMATION: jobs.animation(is_cold)}


def fragment(reports: dict[str, Report]) -> str:
    """The parts, the judgement of the simulation, and what it says of many GPUs."""
    report = reports["cpu"]
    costs = costs_of(report)
    return "\n\n".join(
        [
            f"- {machine(report)} Seconds of processors; the machine was busy.",
            "**Measured parts**",
            _parts(costs),
            "**Simulated, and measured**",
            _judged(costs),
            "**Many GPUs**: machines of eight, 25 Gbit/s; shares of the GPUs' time",
            _many(costs),
            "**Networks** of machines: efficiency of a still of 10 minutes whose scene is sent",
            _networks(costs),
            "**What would help**: efficiency of stills where scene and kernels are there",
            _helped(costs),
        ]
    )


def _parts(costs: Costs) -> str:
    rows = [[what, number(getattr(costs, name) * times), unit] for name, (what, times, unit) in _UNITS.items()]
    return table(["part", "takes", ""], rows)


@functools.cache
def lost_seconds() -> float:
    """What a render by several GPUs takes beyond its samples, in the mean of those that were measured."""
    return statistics.mean(case.seconds / case.speedup - devices.process_seconds(case, 0.0) for case in jobs.MEASURED)


def speedup(case: devices.Shared) -> float:
    """Of GPUs of a process, as simulated."""
    return case.seconds / devices.process_seconds(case, lost_seconds())


def not_shared() -> float:
    """The share of one GPU's time that others do not take over, by Amdahl's law and the longest render measured."""
    longest = max(jobs.MEASURED, key=lambda case: case.seconds)
    return devices.serial_share(longest.gpus, longest.speedup)


def _judged(costs: Costs) -> str:
    rows = []
    for case in (*jobs.MEASURED, *jobs.PREDICTED):
        found, law = speedup(case), devices.amdahl(case.gpus, not_shared())
        if case.speedup:
            error = f"{found / case.speedup - 1:+.1%}"
            rows.append([case.words, f"{case.speedup:.3f}", f"{found:.3f}", error, f"{law:.3f}"])
        else:
            rows.append([f"{case.words} (predicted)", "", f"{found:.2f}", "", f"{law:.2f}"])
    for alone, measured in jobs.LOCAL:
        found = jobs.LOCAL_START + outcome(costs, *jobs.local_job(alone)).seconds
        what = f"two workers on two cores, {alone:.0f} s alone"
        speeds = alone / measured, alone / found
        rows.append([what, *(f"{each:.2f}" for each in speeds), f"{speeds[1] / speeds[0] - 1:+.1%}", ""])
    return table(["case", "measured speedup", "simulated", "error", "Amdahl's law"], rows)


def _many(costs: Costs) -> str:
    rows = []
    for is_cold in (True, False):
        for name, job in works(is_cold).items():
            for gpus in jobs.GPUS:
                found = outcome(costs, jobs.site(gpus), job)
                shares = [getattr(found.losses, each.name) / (found.gpus * found.seconds) for each in fields(Losses)]
                state = "sent" if is_cold else "there"
                head = [name, state, gpus, number(found.seconds), f"{found.speedup:.1f}", f"{found.efficiency:.2f}"]
                rows.append([*head, *(f"{100 * each:.0f} %" if abs(each) >= 5e-3 else "" for each in shares)])
    return table(["what", "scene", "GPUs", "seconds", "speedup", "efficiency", *LOSSES.values()], rows)


def _networks(costs: Costs) -> str:
    job = jobs.still(600.0, True)
    rows = [
        [f"{rate} Gbit/s", *(f"{outcome(costs, jobs.site(gpus, rate), job).efficiency:.2f}" for gpus in jobs.GPUS)]
        for rate in jobs.BANDWIDTHS
    ]
    return table(["network", *(f"{gpus} GPUs" for gpus in jobs.GPUS)], rows)


def changes(costs: Costs) -> dict[str, tuple[Costs, Site]]:
    """What might be otherwise, by name, for a site of any size."""
    site = jobs.site(8)
    return {
        "as it is": (costs, site),
        "a task waits at each worker": (costs, replace(site, ahead=1)),
        "a worker for each machine's eight GPUs": (costs, replace(site, gpus_worker=8)),
        "the same, and its GPUs share without loss": (costs, replace(site, gpus_worker=8, shared_loss=0.0)),
        "who hands out and the scheduler take no time": (replace(costs, client_task=0.0, scheduler_task=0.0), site),
        "films are made, merged and joined in no time": (
            replace(costs, film_made=0.0, film_merged=0.0, film_received=0.0, film_joined=0.0),
            site,
        ),
    }


def _helped(costs: Costs) -> str:
    rows = []
    serial = not_shared()
    for name, (own, site) in changes(costs).items():
        loss = serial if site.gpus_worker > 1 and "without loss" not in name else 0.0
        cells = [
            f"{outcome(own, replace(site, gpus=gpus, shared_loss=loss), jobs.still(seconds, False)).efficiency:.2f}"
            for seconds in (600.0, 18_000.0)
            for gpus in jobs.GPUS
        ]
        rows.append([name, *cells])
    heads = [f"{words}, {gpus}" for words in ("10 min", "5 h") for gpus in jobs.GPUS]
    return table(["change", *heads], rows)


def draw(reports: dict[str, Report], folder: Path) -> None:
    """Efficiency over GPUs, scene and kernels there."""
    from studies import plots

    costs = costs_of(reports["cpu"])
    figure, (axis,) = plots.panels(1)
    counts = [2**i for i in range(3, 10)]
    for (name, job), color in zip(works(False).items(), plots.COLORS, strict=False):
        axis.plot(counts, _efficiencies(costs, counts, job), color=color, marker=".", label=name)
    axis.set_xscale("log", base=2)
    axis.set_ylim(0, 1.02)
    axis.set_xlabel("GPUs, each a worker's, eight a machine")
    axis.set_ylabel("speedup a GPU")
    axis.grid(True, color="#dddddd")
    axis.legend(fontsize=8)
    plots.save(figure, folder, "many-workers")


def _efficiencies(costs: Costs, counts: Iterable[int], job: Job) -> list[float]:
    return [outcome(costs, jobs.site(count), job).efficiency for count in counts]
