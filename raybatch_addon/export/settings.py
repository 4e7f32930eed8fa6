"""The settings of a Blender scene as the core's `RenderSettings`."""

from __future__ import annotations

import functools
from collections.abc import Collection
from operator import attrgetter
from typing import Any

import bpy

from ..core.settings.info import SettingInfo, checked
from ..core.settings.settings import BYTES, SETTINGS, RenderSettings
from .asked import asked
from .taken_over.rows import ROWS, exact


def settings_from(scene: bpy.types.Scene) -> RenderSettings:
    """The settings at `scene.raybatch`, or the defaults if the add-on is not registered; the command line comes first.
    Raises `SettingsError`.
    """
    wanted = asked()
    properties = getattr(scene, "raybatch", None)
    own = {} if properties is None else dict(zip(SETTINGS, map(exact, _stored(properties)), strict=True))
    values = own | engine_settings(scene, wanted.settings_from) | wanted.settings
    return _settings_of(tuple(values.items()))


_stored = attrgetter(*SETTINGS)


@functools.lru_cache(maxsize=16)
def _settings_of(values: tuple[tuple[str, Any], ...]) -> RenderSettings:
    """The settings with these values, by name: those of the last renders were looked at before."""
    return RenderSettings(**dict(values))


def output_engine(scene: bpy.types.Scene) -> str:
    """The engine whose output node counts where a material has one for each: CYCLES or EEVEE."""
    own = getattr(scene, "raybatch_export", None)
    return asked().settings_from or (own.material_output if own is not None else "CYCLES")


def exposure_of(scene: bpy.types.Scene, engine: str = "") -> float:
    """How many times as bright pictures are shown: as the scene says, or as `engine` has it."""
    engine = engine or asked().settings_from
    if engine:
        return exact(getattr(getattr(scene, "cycles", None), "film_exposure", 1.0)) if engine == "CYCLES" else 1.0
    own = getattr(scene, "raybatch_export", None)
    return 1.0 if own is None else exact(own.exposure)


def engine_settings(scene: bpy.types.Scene, engine: str, names: Collection[str] | None = None) -> dict[str, Any]:
    """Our settings, or those of `names`, as `engine` has them, by name; none for no engine."""
    rows = [row for row in ROWS.get(engine, ()) if names is None or row.setting in names]
    found = {row.setting: row.value(scene) for row in rows}
    return {name: within(SETTINGS[name], value) for name, value in found.items() if value is not None}


def assign_setting(properties: bpy.types.PropertyGroup, name: str, value) -> None:
    """Give the setting `name` of `scene.raybatch` a value that `RenderSettings` takes.

    Numbers of bytes are kept as text.
    """
    setattr(properties, name, str(value) if SETTINGS[name].unit == BYTES else value)


def within(info: SettingInfo, value: Any) -> Any:
    """A value of another engine within the range of our setting."""
    if info.minimum is not None:
        value = min(max(value, info.kind(info.minimum)), info.kind(info.maximum))
    return checked(info, value)
