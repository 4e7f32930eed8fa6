"""Taking over: the settings of another engine become ours, and what differs is reported."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import bpy

from ...core.scene.notice import Notice, Weight
from ...core.settings.settings import SETTINGS, SettingInfo
from ..asked import asked
from ..settings import assign_setting, engine_settings, exposure_of, settings_from
from .rows import CYCLES, EEVEE, ROWS

ENGINE_LABELS = {CYCLES: "Cycles", EEVEE: "EEVEE"}


EXPOSURE = "exposure"  # no setting of the core: pictures are shown brighter, films are as they are
MATERIAL_OUTPUT = "material_output"
_OF_FILE = {EXPOSURE: "Exposure", MATERIAL_OUTPUT: "Material Output"}
# Limits that count only as far as those of all bounces let them
_OF_KINDS = ("diffuse_bounce_max", "glossy_bounce_max", "transmission_bounce_max", "volume_bounce_max")
# Those that count only where pictures are denoised
_OF_DENOISING = {"denoise_inputs", "denoise_prefilter", "denoise_quality"}

# Names of settings that a script gives, which has a command line of its own; those of Blender's are in `asked`
of_command: set[str] = set()


@dataclass(frozen=True)
class Difference:
    """One of our settings that another engine has with another value."""

    setting: str
    theirs: Any
    ours: Any

    def text(self, engine: str) -> str:
        """The difference in words, as long as it is one."""
        label, theirs, ours = self._words()
        return f"{label}: {theirs} in {ENGINE_LABELS[engine]}, {ours} here"

    def taken(self, engine: str) -> str:
        """What was taken over of it, in words."""
        label, theirs, ours = self._words()
        return f"{label}: {theirs}, as in {ENGINE_LABELS[engine]} (before: {ours})"

    def _words(self) -> tuple[str, str, str]:
        """The setting's label, their value and ours."""
        info = SETTINGS.get(self.setting)
        label = _OF_FILE[self.setting] if info is None else info.title
        theirs, ours = (
            "no limit" if info is not None and info.off is not None and value == info.off else _shown(info, value)
            for value in (self.theirs, self.ours)
        )
        return label, theirs, ours


def differences(scene: bpy.types.Scene, engine: str, chosen: bool = False) -> list[Difference]:
    """Settings of `engine` that are not ours; with `chosen` those alone that someone changed from a new scene's."""
    wanted = {row.setting for row in ROWS[engine] if row.is_chosen(scene) or not chosen}
    # others are asked for where they have a say: whether pictures can be denoised takes a library to be loaded
    ruling = {"bounce_max"} | ({"denoise"} if not wanted.isdisjoint(_OF_DENOISING) else set())
    theirs, settings = engine_settings(scene, engine, wanted | ruling), settings_from(scene)
    ours = {name: getattr(settings, name) for name in theirs}
    if theirs.get("denoise") != "ON":
        wanted -= _OF_DENOISING
    found = [
        Difference(name, value, ours[name])
        for name, value in theirs.items()
        if name in wanted and _counting(name, theirs) != _counting(name, ours)
    ]
    exposures = exposure_of(scene, engine), exposure_of(scene)
    if chosen and exposures[0] == 1:
        return found  # that of a new scene: ours is a choice of its own
    return found + ([Difference(EXPOSURE, *exposures)] if exposures[0] != exposures[1] else [])


def _counting(name: str, settings: dict[str, Any]) -> Any:
    """The setting `name` as far as it has a say."""
    return min(settings[name], settings["bounce_max"]) if name in _OF_KINDS else settings[name]


def take_over(scene: bpy.types.Scene, engine: str) -> list[Difference]:
    """Make the settings of `engine` ours; what was changed."""
    found = differences(scene, engine)
    for each in found:
        if each.setting == EXPOSURE:
            scene.raybatch_export.exposure = each.theirs
        else:
            assign_setting(scene.raybatch, each.setting, each.theirs)
    output = scene.raybatch_export.material_output
    if output == engine:
        return found
    scene.raybatch_export.material_output = engine
    return [*found, Difference(MATERIAL_OUTPUT, ENGINE_LABELS[engine], ENGINE_LABELS[output])]


def passed_over_settings(scene: bpy.types.Scene) -> list[Notice]:
    """A notice of what someone chose in Cycles' settings and is another way here."""
    if not hasattr(scene, "raybatch"):
        return []
    # another seed is another noise alone, and of what a command line gives its user knows
    known = {"seed", *asked().settings, *of_command}
    found = [each for each in differences(scene, CYCLES, chosen=True) if each.setting not in known]
    if not found:
        return []
    reported = "; ".join(each.text(CYCLES) for each in found)
    remedy = "take them over: Before the Render > Settings of Other Engines > Settings From Cycles"
    weight = Weight.REPLACED if any(each.setting == EXPOSURE for each in found) else Weight.SETTING
    text = f"scene “{scene.name}”: settings of Cycles are not used. {reported}"
    return [Notice(text, weight, remedy=remedy, option="settings-from cycles")]


def _shown(info: SettingInfo | None, value: Any) -> str:
    if info is not None:
        return info.name_of(value)
    return f"{value:g}" if isinstance(value, float) else str(value)
