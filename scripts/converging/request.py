"""The request of convergence.py, and the settings that it compares."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Any

from benchmarking.scenes import SceneRequest
from lib.command import UsageError
from rendering.request import ARCHIVE, BLEND, NPZ, kind_of

from raybatch_addon.core.settings.presets import preset_settings
from raybatch_addon.core.settings.settings import RenderSettings, parse_setting, setting_info

SAMPLES_DEFAULT = 64
# Under --seconds a render ends by its time, or at this many samples of every pixel
SAMPLES_MOST = 2**20
REFERENCE_FACTOR = 16  # samples of a reference to those of a run
PRESET = "preset"  # may be compared as if it were a setting
# Settings that are neither for --compare nor for --set, and what says it instead
ELSEWHERE = {"time_limit": "--seconds", "error_target": "--target", "error_estimate": "--reference halves"}
# and those that are for --set alone
NOT_COMPARED = {
    **ELSEWHERE,
    "device": "--device",
    "sample_count": "--samples",
    "seed": "--runs",
    "resolution": "--size",
}
CLAMPS = ("clamp_direct", "clamp_indirect")
RAYBATCH, CYCLES = "RayBatch", "Cycles"  # engines
# What --reference may say beside a file's name: an engine whose picture is made, each engine's own picture, or none at
# all
REFERENCES = ("raybatch", "cycles", "own", "halves")


@dataclass(frozen=True)
class Variant:
    """One of those that compete: an engine, and one choice of values for the settings that are compared."""

    label: str
    values: dict[str, Any]  # as compared; empty when nothing is
    settings: RenderSettings
    engine: str = RAYBATCH


@dataclass(frozen=True)
class ConvergenceRequest:
    """One call of convergence.py; raises `UsageError` for what does not go together."""

    scene: SceneRequest
    _: KW_ONLY
    device: str = "AUTO"
    size: tuple[int, int] | None = None
    samples: int | None = None  # None: SAMPLES_DEFAULT, or as many as fit in `seconds`
    seconds: float | None = None  # of rendering, for each run
    runs: int = 3  # of each variant, with different seeds
    target: float | None = None  # relMSE
    reference: str | None = None  # one of REFERENCES or a file; None: "raybatch", with another engine "own"
    cycles: bool = False  # Cycles competes too
    reference_samples: int | None = None  # None: REFERENCE_FACTOR times those of a run
    new_reference: bool = False  # make it again though it is kept
    save_reference: Path | None = None
    flip: bool = True
    compare: tuple[str, ...] = ()  # SETTING=A,B,C
    settings: dict[str, Any] = field(default_factory=dict)  # changed for all, on top of a preset
    preset: str | None = None  # for all

    def __post_init__(self):
        for name, value in (("seconds", self.seconds), ("target", self.target)):
            if value is not None and not (math.isfinite(value) and value > 0):
                raise UsageError(f"--{name} {value:g} is not valid: it must be above 0")
        for name, value, least in (
            ("runs", self.runs, 1),
            ("samples", self.samples, 1),
            ("reference-samples", self.reference_samples, 2),
        ):
            if value is not None and value < least:
                raise UsageError(f"--{name} {value} is not valid: it must be {least} or more")
        if self.samples is not None and self.samples > SAMPLES_MOST * 16:
            raise UsageError(f"--samples {self.samples} is not valid: it must be {SAMPLES_MOST * 16} or less")
        for name in self.settings:
            if name in ELSEWHERE:
                raise UsageError(f"--set {name} is not possible: {ELSEWHERE[name]} says it")
        if self.samples is not None and "sample_count" in self.settings:
            raise UsageError("--samples and --set sample_count say the same: give one of them")
        self._check_reference()
        if self.preset is not None:
            preset_settings(self.preset)  # raises where there is none
        if kind_of(self.scene.path, (BLEND, ARCHIVE, NPZ)) != BLEND:
            for option, wanted in (
                ("--against cycles", self.cycles),
                ("--reference cycles", self.reference_from == "cycles"),
            ):
                if wanted:
                    raise UsageError(f"{option} needs a .blend, not {self.scene.path.name}")

    def _check_reference(self) -> None:
        if self.reference and self.reference_from == "file" and not Path(self.reference).is_file():
            raise UsageError(
                f"there is no file {self.reference}; --reference is a file, or one of {', '.join(REFERENCES)}"
            )
        for option, given in (
            ("--reference-samples", self.reference_samples),
            ("--new-reference", self.new_reference),
            ("--save-reference", self.save_reference),
        ):
            if given and not self.makes_reference:
                raise UsageError(
                    f"{option} is for a reference that is made: leave it or --reference {self.reference} out"
                )
        if self.reference_from == "halves" and self.cycles:
            raise UsageError(
                "--reference halves tells the error of RayBatch alone: choose another for --against cycles"
            )
        if self.save_reference and not self.save_reference.name.lower().endswith(".npz"):
            raise UsageError(f"--save-reference {self.save_reference}: name it with the ending .npz")

    @property
    def reference_from(self) -> str:
        """One of REFERENCES, or "file"."""
        if self.reference is None:
            return "own" if self.cycles else "raybatch"
        return self.reference if self.reference in REFERENCES else "file"

    @property
    def makes_reference(self) -> bool:
        """Whether one may have to be rendered."""
        return self.reference_from not in ("file", "halves")


def run_settings(request: ConvergenceRequest, opened: RenderSettings) -> RenderSettings:
    """What every run has: the settings of the file as changed by the request, with its samples or its time; raises
    `RayBatchError`.

    Beside Cycles light is clamped only where the request says so, whatever the file does.
    """
    changes = {
        "sample_count": SAMPLES_DEFAULT if request.seconds is None else SAMPLES_MOST,
        **(preset_settings(request.preset) if request.preset else {}),
        **request.settings,
        "time_limit": request.seconds or 0.0,
        "error_target": 0.0,
        "error_estimate": "OFF",
    }
    if request.cycles:  # it is without bias, and comparable with what is without bias too
        changes = dict.fromkeys(CLAMPS, 0.0) | changes
    if request.samples is not None:
        changes["sample_count"] = request.samples
    if request.reference_from == "halves":
        changes["error_estimate"] = "ON"
        if changes["sample_count"] < 2:
            raise UsageError("--reference halves needs two samples or more: one for either half")
    return opened.replace(**changes)


def parse_comparison(texts: Sequence[str], already: dict[str, Any]) -> list[tuple[str, list[Any]]]:
    """Names and values of `SETTING=A,B,C` texts; `already` are settings that have one value for all. Raises
    `RayBatchError`.
    """
    found: list[tuple[str, list[Any]]] = []
    for text in texts:
        name, _, listed = text.partition("=")
        name = name.strip()
        if name in NOT_COMPARED:
            raise UsageError(f"--compare {name} is not possible: {NOT_COMPARED[name]} says it, for all")
        if name != PRESET:
            setting_info(name, (PRESET,))
        parts = [part.strip() for part in listed.split(",") if part.strip()]
        if not parts:
            raise UsageError(f"--compare {text} names no values; write --compare {name}=A,B,C")
        values = [_preset(part) if name == PRESET else parse_setting(name, part) for part in parts]
        if any(name == other for other, _ in found):
            raise UsageError(f"--compare {name} is given twice: write all its values behind one")
        if name in already:
            raise UsageError(f"{name} is compared, and set for all too: give it once")
        found.append((name, list(dict.fromkeys(values))))
    return found


def _preset(name: str) -> str:
    preset_settings(name)  # raises where there is none
    return name.upper()


def variants(
    comparison: list[tuple[str, list[Any]]], settings: RenderSettings, kept: Iterable[str] = ()
) -> list[Variant]:
    """Every combination of the values compared, on top of `settings`, of which no preset changes those that are `kept`.

    Raises `SettingsError` for values that do not go together.
    """
    names = [name for name, _ in comparison]
    found = []
    for values in itertools.product(*(values for _, values in comparison)):
        chosen = dict(zip(names, values, strict=True))
        preset = preset_settings(chosen[PRESET]) if PRESET in chosen else {}
        changes = {n: v for n, v in preset.items() if n not in kept} | {n: v for n, v in chosen.items() if n != PRESET}
        label = (
            ", ".join(f"{n}={v:.12g}" if isinstance(v, float) else f"{n}={v}" for n, v in chosen.items()) or RAYBATCH
        )
        found.append(Variant(label, chosen, settings.replace(**changes)))
    return found


def run_seeds(first: int, count: int, taken: Sequence[int]) -> list[int]:
    """`count` seeds from `first` on, without those `taken` by references: equal noise would hide in the difference."""
    seeds = (seed % 2**31 for seed in itertools.count(first))
    return list(itertools.islice((seed for seed in seeds if seed not in taken), count))
