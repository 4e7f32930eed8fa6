"""Which engine is right, judged by superposition: the picture of all sources of light is the sum of the pictures of
each.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from real_files.measures import Agreement, Pair, agreement

# An engine's pictures do not add up where the mean is off by more than EXCESS_MOST and by more than SIGMAS standard
# errors, or where blocks are off by more than counts as the same picture
EXCESS_MOST, SIGMAS = 0.01, 4.0
ERROR_MOST = 0.02  # standard error of the mean, relative, above which nothing can be decided
NAMES = {"CYCLES": "Cycles", "RAYBATCH": "RayBatch"}
UNDECIDED, TOO_NOISY = "undecided", "too noisy"


@dataclass(frozen=True)
class Judgement:
    """The verdict of superposition on a file."""

    right: str  # “RayBatch”, “Cycles”, UNDECIDED or TOO_NOISY
    why: str
    engines: dict[str, Agreement]  # by engine: its picture of all, against the sum of its pictures of each source
    sources: dict[str, Agreement]  # by source: RayBatch's picture of it alone, against that of Cycles

    def data(self) -> dict[str, Any]:
        """The values as JSON holds them."""
        return {
            "right": self.right,
            "why": self.why,
            "engines": {name: each.data() for name, each in self.engines.items()},
            "sources": {name: each.data() for name, each in self.sources.items()},
        }


def adds_up(each: Agreement) -> bool | None:
    """Whether a picture of all is the sum of the pictures of each; None where noise hides it."""
    excess = abs(each.ratio - 1)
    if not math.isfinite(excess):  # the sum is black
        return None
    if (excess > EXCESS_MOST and excess > SIGMAS * each.ratio_error) or each.relmse > each.relmse_most:
        return False
    return None if each.ratio_error > ERROR_MOST else True


def judge(everything: dict[str, Pair], alone: dict[str, dict[str, Pair]]) -> Judgement:
    """The judgement from the pictures of all sources, by engine, and of each source alone, by engine and source."""
    engines = {name: agreement(pair, Pair.sum(list(alone[name].values()))) for name, pair in everything.items()}
    sources = {
        name: agreement(pair, alone["CYCLES"][name])
        for name, pair in alone["RAYBATCH"].items()
        if name in alone["CYCLES"]
    }
    right, why = _verdict(engines, sources, agreement(everything["RAYBATCH"], everything["CYCLES"]))
    return Judgement(right, why, engines, sources)


def _verdict(engines: dict[str, Agreement], sources: dict[str, Agreement], both: Agreement) -> tuple[str, str]:
    reported = "; ".join(
        f"the picture of all by {NAMES[name]} has {_share(each)} of its sum" for name, each in engines.items()
    )
    holds = {name: adds_up(each) for name, each in engines.items()}
    apart = [name for name, each in sources.items() if not each.same]
    if False in holds.values():
        if list(holds.values()).count(False) == len(holds):
            return UNDECIDED, f"neither engine's pictures add up: {reported}"
        wrong = next(name for name, held in holds.items() if held is False)
        other = next(name for name in holds if name != wrong)
        if holds[other] is None:
            return (
                TOO_NOISY,
                f"{NAMES[wrong]}'s pictures do not add up, and those of {NAMES[other]} are too noisy: {reported}",
            )
        rest = f"; alone, {_names(apart)} differ too" if apart else "; alone, all sources look the same in both"
        return NAMES[other], f"{NAMES[wrong]}'s pictures do not add up: {reported}{rest}"
    if None in holds.values():
        return TOO_NOISY, f"the noise hides whether pictures add up: {reported}; render more --samples"
    if both.same:
        return UNDECIDED, f"both engines' pictures add up, and show the same: {reported}"
    where = f"what differs is in the pictures of {_names(apart)} alone" if apart else "no source alone differs"
    return UNDECIDED, f"both engines' pictures add up ({reported}): {where}"


def _share(each: Agreement) -> str:
    return f"{each.ratio:.3f} ±{each.ratio_error:.3f}"


def _names(sources: list[str]) -> str:
    shown = sources[:4]
    rest = [f"{len(sources) - len(shown)} more"] if len(sources) > len(shown) else []
    *first, last = shown + rest
    return f"{', '.join(first)} and {last}" if first else last
