"""When a list of rays is sorted before it is traced: pure policy, without Warp or a device.

Where sorting pays depends on the scene, the device and how far the paths have scattered, so it is measured. At fixed
points of the work, after `items_first` paths, sixteen times as many and so on, each class of rays tries both ways in
turn on a few waves and keeps the cheaper, sorting included. The film is the same either way.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterable
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

# Classes of rays that are decided apart: what they start from
CAMERA, BOUNCE_1, BOUNCE_2, BOUNCE_LATER, SHADOW, BOUNCE = RAY_CLASSES = (
    "camera",
    "bounce 1",
    "bounce 2",
    "bounce 3 and later",
    "shadow",
    "bounce",
)
# BOUNCE stands for scattered rays in one list, where they are not distinguished: nothing is tried on them

# Waves that are traced each way in a trial; their median counts
TRIAL_WAVES = 3
# Each trial comes after so many times the paths of the one before: where sorting does not pay, trying it must cost
# little
TRIAL_SPACING = 16
# The other way must be cheaper by this factor to be taken up
SWITCH_RATIO = 0.92
# Smaller waves cost what a launch costs, and are traced as they are
RAYS_MIN = 1024


@dataclass
class _Trial:
    """Both ways are being tried."""

    waves: int = 0  # that tried a way so far
    costs: dict[bool, list[float]] = field(
        default_factory=lambda: {False: [], True: []}
    )  # sorted or not: time a ray [s]

    def is_over(self) -> bool:
        return all(len(costs) >= TRIAL_WAVES for costs in self.costs.values())


@dataclass
class _Decision:
    """The state of the decision for one class of rays."""

    next_trial: int  # number of begun paths at which both ways are tried again
    _: KW_ONLY
    sorts: bool = False
    trial: _Trial | None = None
    is_trying: bool = False  # the wave that was decided last belongs to the trial
    trials: int = 0
    switches: int = 0
    costs: dict[bool, float] = field(default_factory=dict)  # of the last trial [s]
    waves: dict[bool, int] = field(default_factory=lambda: {False: 0, True: 0})


class SortPolicy:
    """Decides for one worker."""

    def __init__(self, mode: str, items_first: int, rays_min: int = RAYS_MIN):
        """`mode` is the setting `ray_sort`: AUTO, ON or OFF. Trials begin when `items_first` paths (1 or more) were
        begun.
        """
        self._mode = mode
        self._rays_min = rays_min
        self._decisions = {ray_class: _Decision(items_first) for ray_class in RAY_CLASSES}

    def choose(self, ray_class: str, rays: int, items_begun: int) -> bool:
        """Whether to sort a wave of `rays` rays; `items_begun` counts the worker's paths so far."""
        decision = self._decisions[ray_class]
        if ray_class == BOUNCE and self._mode == "AUTO":
            sorts = False
        else:
            sorts = self._choice(decision, rays, items_begun)
        decision.waves[sorts] += 1
        return sorts

    def treats_alike(self, ray_classes: Iterable[str], items_begun: int) -> bool:
        """Whether no ray of these classes is sorted now, nor tried, so that they may be traced as one list."""
        if self._mode != "AUTO":
            return True
        decisions = [self._decisions[ray_class] for ray_class in ray_classes]
        return not any(each.sorts or each.trial or items_begun >= each.next_trial for each in decisions)

    def is_measured(self, ray_class: str) -> bool:
        """Whether the time of the wave that was decided last is wanted by `record`."""
        return self._decisions[ray_class].is_trying

    def record(self, ray_class: str, was_sorted: bool, rays: int, seconds: float) -> None:
        """A wave of `rays` rays took `seconds`, sorting included. Waves may be reported late, and in any order."""
        decision = self._decisions[ray_class]
        trial = decision.trial
        if trial is None:
            return
        if rays < self._rays_min:
            trial.waves -= 1  # try another instead
            return
        trial.costs[was_sorted].append(seconds / rays)
        if trial.is_over():
            self._decide(decision, trial)

    def report(self) -> dict[str, Any]:
        """For statistics: each class's choice, the last trial's figures [ns a ray, sorting included] and how many waves
        went which way.
        """
        classes = {}
        for ray_class, decision in self._decisions.items():
            if not any(decision.waves.values()):
                continue
            classes[ray_class] = {
                "sorted": decision.sorts if self._mode == "AUTO" else self._mode == "ON",
                "trials": decision.trials,
                "switches": decision.switches,
                "ns_unsorted": _nanoseconds(decision.costs.get(False)),
                "ns_sorted": _nanoseconds(decision.costs.get(True)),
                "waves_unsorted": decision.waves[False],
                "waves_sorted": decision.waves[True],
            }
        return {"mode": self._mode, "classes": classes}

    def _choice(self, decision: _Decision, rays: int, items_begun: int) -> bool:
        decision.is_trying = False
        if self._mode != "AUTO":
            return self._mode == "ON"
        if rays < self._rays_min:
            return False
        if items_begun >= decision.next_trial:
            while decision.next_trial <= items_begun:
                decision.next_trial *= TRIAL_SPACING
            decision.trial = _Trial()
        trial = decision.trial
        if trial is None or trial.waves >= 2 * TRIAL_WAVES:
            return decision.sorts
        trial.waves += 1
        decision.is_trying = True
        return trial.waves % 2 == 0

    def _decide(self, decision: _Decision, trial: _Trial) -> None:
        decision.costs = {way: statistics.median(costs) for way, costs in trial.costs.items()}
        if decision.costs[not decision.sorts] < SWITCH_RATIO * decision.costs[decision.sorts]:
            decision.sorts = not decision.sorts
            decision.switches += 1
        decision.trials += 1
        decision.trial = None


def _nanoseconds(seconds: float | None) -> float | None:
    return None if seconds is None else round(seconds * 1e9, 3)


def merged_reports(reports: Iterable[dict[str, Any]]) -> dict[str, Any] | None:
    """The reports of several workers as one: counts are added, figures averaged, and `sorted` is the share of workers
    that sort.
    """
    reports = list(reports)
    if not reports:
        return None
    classes = {}
    for ray_class in RAY_CLASSES:
        found = [report["classes"][ray_class] for report in reports if ray_class in report["classes"]]
        if found:
            merged: dict[str, Any] = {"sorted": round(sum(each["sorted"] for each in found) / len(found), 3)}
            for name in ("trials", "switches", "waves_unsorted", "waves_sorted"):
                merged[name] = sum(each[name] for each in found)
            for name in ("ns_unsorted", "ns_sorted"):
                known = [each[name] for each in found if each[name] is not None]
                merged[name] = round(sum(known) / len(known), 3) if known else None
            classes[ray_class] = merged
    return {"mode": reports[0]["mode"], "classes": classes}
