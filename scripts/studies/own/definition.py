"""Reads the definition of a study: a TOML file, or a dictionary of the same form. All of it is checked before time is
spent, and errors name the file, the key, and what to do.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lib.command import UsageError

from raybatch_addon.core.errors import SettingsError
from raybatch_addon.core.settings.info import checked
from raybatch_addon.core.settings.settings import RenderSettings, setting_info
from studies.own.measures import MEASURES
from studies.own.scene_checks import SceneChecks
from studies.own.sources import SceneSource

KEYS = {
    "title": "of the page",
    "about": "a sentence: what is asked",
    "scenes": "files, or names of scenes that studies build",
    "size": "[width, height] of the frame, in pixels",
    "vary": "settings, each with a list of values: all combinations are measured",
    "cases": "named cases, each with settings of its own",
    "common": "settings of all cases",
    "control": "the case that ratios are taken to",
    "measures": "columns of the table",
    "turns": "how often everything is measured",
    "devices": "where",
    "reference": "samples of the picture that errors are measured against, and settings of it",
}
MEASURES_DEFAULT = ("seconds", "mrays_per_second")
TURNS_DEFAULT, TURNS_MAX = 3, 1000
CASES_MAX = 4096  # of one scene
# Settings that have no place in a study, and what to do instead
ELSEWHERE = {
    "device": "name where to measure with devices",
    "time_limit": "what a clock ends cannot be compared; set sample_count",
}
_DEVICE = re.compile(r"AUTO|cpu|cuda(:\d+)?", re.IGNORECASE)


@dataclass(frozen=True)
class OwnCase:
    """Settings that are measured."""

    label: str
    axes: dict[str, Any]  # values of the axes; empty for a named case
    settings: dict[str, Any]  # in which it differs from what is common
    control: str | None = None  # label of the case that it is compared with

    @property
    def key(self) -> str:
        """What rows are found by: the settings, with the name of a named case."""
        named = bool(self.settings) and not self.axes
        return f"{self.label} ({label_of(self.settings)})" if named else self.label


@dataclass(frozen=True, kw_only=True)
class Definition:
    """A study, checked."""

    name: str  # what its files are called by
    title: str
    about: str
    scenes: tuple[SceneSource, ...]
    axes: dict[str, tuple[Any, ...]]
    cases: tuple[OwnCase, ...]
    common: dict[str, Any]
    measures: tuple[str, ...]
    turns: int
    devices: tuple[str, ...]
    reference_samples: int  # 0: errors are not measured
    reference: dict[str, Any]  # settings in which the reference differs from what is common
    source: str  # the text that it was read from, in TOML or JSON
    digest: str  # of what decides what rows hold, but for scenes and cases, which are in their keys

    @property
    def measures_errors(self) -> bool:
        """Whether renders are watched and compared with a reference."""
        return self.reference_samples > 0


def is_own(name: str) -> bool:
    """Whether what stands on the command line is a file with a study."""
    return name.lower().endswith(".toml")


def read_definition(path: Path) -> Definition:
    """The study in a TOML file; raises `UsageError`."""
    try:
        text = path.read_text(encoding="utf-8")
        values = tomllib.loads(text)
    except FileNotFoundError:
        raise UsageError(f"there is no file {path}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error}") from None
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"{path} is not TOML: {error}") from None
    return definition_of(values, path.stem, str(path), path.parent, text)


def definition_of(
    values: dict[str, Any], name: str, where: str = "the study", folder: Path = Path(), text: str | None = None
) -> Definition:
    """The study that `values` describe, called `name`; `where` begins messages, and files are relative to `folder`.
    Raises `UsageError`.
    """
    return _Reader(where, folder).definition(values, name, text)


class _Reader(SceneChecks):
    """Checks one definition."""

    def definition(self, values: dict[str, Any], name: str, text: str | None) -> Definition:
        if not re.fullmatch(r"[\w-]+", name):
            raise self.error("", f"{name!r} cannot name files: use letters, digits, - and _")
        self.known("", values, KEYS)
        title = self.text("title", values.get("title", name.replace("-", " ").replace("_", " ").capitalize()))
        about = self.text("about", values.get("about", ""))
        size = self.size("size", values["size"]) if "size" in values else None
        scenes = self.scenes(values.get("scenes"), size)
        common = self._settings("common", values.get("common", {}))
        axes = self._axes(values.get("vary", {}), common)
        named = self._named(values.get("cases", []))
        cases = self._product(axes) + named
        if not cases:
            raise self.error("", "there are no cases: give settings with their values in [vary], or [[cases]]")
        labels = [case.label for case in cases]
        if double := {label for label in labels if labels.count(label) > 1}:
            raise self.error("cases", f"two cases are called {min(double)!r}: give each a name of its own")
        self._valid_together(common, cases)
        cases = self._with_controls(values.get("control"), axes, cases)
        measures = self._measures(values.get("measures", list(MEASURES_DEFAULT)))
        samples, reference = self._reference(values.get("reference"), measures, common)
        turns = self.whole("turns", values.get("turns", TURNS_DEFAULT), 1, TURNS_MAX)
        devices = self._devices(values.get("devices", ["AUTO"]))
        decides = json.dumps([common, samples, reference], sort_keys=True)
        return Definition(
            name=name,
            title=title,
            about=about,
            scenes=scenes,
            axes=axes,
            cases=tuple(cases),
            common=common,
            measures=measures,
            turns=turns,
            devices=devices,
            reference_samples=samples,
            reference=reference,
            source=text if text is not None else json.dumps(values, indent=2, ensure_ascii=False),
            digest=hashlib.blake2b(decides.encode(), digest_size=8).hexdigest(),
        )

    # --- settings

    def _value(self, key: str, name: str, value: Any) -> Any:
        if name in ELSEWHERE:
            raise self.error(key, f"{name} has no place in a study: {ELSEWHERE[name]}")
        if name == "resolution":
            raise self.error(key, "the frame is no setting here: write size = [width, height] at the top")
        try:
            info = setting_info(name)
            if info.group == "DENOISING":
                raise self.error(key, f"{name} has no place in a study: what is measured is not denoised")
            return checked(info, value)
        except SettingsError as error:
            raise self.error(key, str(error)) from None

    def _settings(self, key: str, values: Any) -> dict[str, Any]:
        if not isinstance(values, dict):
            raise self.error(key, f"{values!r} is not valid: write settings, NAME = VALUE")
        return {name: self._value(key, name, value) for name, value in values.items()}

    def _axes(self, values: Any, common: dict[str, Any]) -> dict[str, tuple[Any, ...]]:
        if not isinstance(values, dict):
            raise self.error("vary", f"{values!r} is not valid: write settings, each with a list of values")
        found = {}
        for name, given in values.items():
            if name in common:
                raise self.error(f"vary: {name}", "it is in [common] too: leave one of the two out")
            setting = [
                self._value(f"vary: {name}", name, each) for each in self.entries(f"vary: {name}", given, "values")
            ]
            found[name] = tuple(dict.fromkeys(setting))
            if len(found[name]) < len(setting):
                raise self.error(f"vary: {name}", f"two of {given!r} are the same value: leave one out")
        count = math.prod(map(len, found.values()))
        if count > CASES_MAX:
            raise self.error("vary", f"these are {count:,} combinations, more than {CASES_MAX:,}: leave values out")
        return found

    def _product(self, axes: dict[str, tuple[Any, ...]]) -> list[OwnCase]:
        if not axes:
            return []
        combinations = (dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values()))
        return [OwnCase(label_of(each), each, each) for each in combinations]

    def _named(self, values: Any) -> list[OwnCase]:
        found = []
        for each in self.entries("cases", values, "tables, [[cases]]") if values != [] else []:
            if not isinstance(each, dict) or "name" not in each:
                raise self.error("cases", f'{each!r} has no name: write name = "..." in each [[cases]]')
            name = self.text("cases: name", each["name"])
            settings = {key: value for key, value in each.items() if key != "name"}
            found.append(OwnCase(name, {}, self._settings(f"cases: {name}", settings)))
        return found

    def _valid_together(self, common: dict[str, Any], cases: list[OwnCase]) -> None:
        for case in cases:
            try:
                RenderSettings().replace(**{**common, **case.settings})
            except SettingsError as error:
                raise self.error(f"case {case.label}", str(error)) from None

    def _with_controls(self, value: Any, axes: dict[str, tuple[Any, ...]], cases: list[OwnCase]) -> list[OwnCase]:
        if value is None:
            return cases
        labels = [case.label for case in cases]
        if isinstance(value, str):
            if value not in labels:
                raise self.error("control", self.unknown("case", value, labels))
            return [OwnCase(case.label, case.axes, case.settings, value) for case in cases]
        if not isinstance(value, dict) or not value:
            raise self.error(
                "control",
                f'{value!r} is not valid: name a case, or give values of axes, such as {{ batching = "OFF" }}',
            )
        fixed = {}
        for name, each in value.items():
            if name not in axes:
                raise self.error("control", self.unknown("axis", name, axes) + "; the control is one of the cases")
            fixed[name] = self._value(f"control: {name}", name, each)
            if fixed[name] not in axes[name]:
                raise self.error(
                    f"control: {name}", f"{each!r} is not among the values that are varied: {list(axes[name])}"
                )
        whole = label_of({name: fixed[name] for name in axes}) if len(fixed) == len(axes) else None
        return [
            OwnCase(case.label, case.axes, case.settings, label_of({**case.axes, **fixed}) if case.axes else whole)
            for case in cases
        ]

    # --- the rest

    def _measures(self, values: Any) -> tuple[str, ...]:
        for name in self.entries("measures", values, "names"):
            if name not in MEASURES:
                raise self.error("measures", self.unknown("measure", name, MEASURES))
        return tuple(values)

    def _reference(self, values: Any, measures: tuple[str, ...], common: dict[str, Any]) -> tuple[int, dict[str, Any]]:
        errors = [name for name in measures if MEASURES[name].is_error]
        if values is None:
            if errors:
                raise self.error(
                    "measures", f"{errors[0]} is an error, and errors need a reference: add [reference] with samples"
                )
            return 0, {}
        if not errors:
            names = ", ".join(name for name, measure in MEASURES.items() if measure.is_error)
            raise self.error("reference", f"no measure needs it: add one of {names} to measures, or leave it out")
        if not isinstance(values, dict) or "samples" not in values:
            raise self.error("reference", "it has no samples: write samples = 4096, or another number")
        samples = self.whole("reference: samples", values["samples"], 2, 2**31 - 1)
        settings = self._settings("reference", {name: each for name, each in values.items() if name != "samples"})
        try:
            RenderSettings().replace(**{**common, **settings})
        except SettingsError as error:
            raise self.error("reference", str(error)) from None
        return samples, settings

    def _devices(self, values: Any) -> tuple[str, ...]:
        found = self.entries("devices", values, 'devices, such as "cpu" or "cuda:0"')
        for name in found:
            if not isinstance(name, str) or not _DEVICE.fullmatch(name):
                raise self.error("devices", f"{name!r} is no device: write AUTO, cpu or cuda:N")
        kinds = [name.lower().partition(":")[0] for name in found]
        if len(set(kinds)) < len(kinds) or (len(kinds) > 1 and "auto" in kinds):
            raise self.error(
                "devices",
                f"{found!r}: one CPU and one GPU at most go on a page; measure others with --device and another --out",
            )
        return tuple(found)


def label_of(values: dict[str, Any]) -> str:
    """Settings and their values, in words."""
    return ", ".join(f"{name} {value}" for name, value in values.items())
