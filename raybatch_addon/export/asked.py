"""Options of RayBatch in `blender -b ... -- OPTIONS`: those behind `--`, which Blender leaves to others.

--raybatch-device DEVICE                       render there: AUTO, cpu or cuda:N
--raybatch-set NAME=VALUE                      render with this value of a setting (may be repeated)
--raybatch-strict [SETTING|REPLACED|MISSING]   do not render what would lack something; the exit code is 3
--raybatch-settings-from cycles|eevee          render with the settings of that engine

Threads are asked for by Blender's own option `-t`.
"""

from __future__ import annotations

import functools
import itertools
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..core.errors import SettingsError
from ..core.scene.notice import Weight
from ..core.settings.settings import parse_setting

STRICT, SETTINGS_FROM = "--raybatch-strict", "--raybatch-settings-from"
DEVICE, SET = "--raybatch-device", "--raybatch-set"
OPTIONS = (DEVICE, SET, STRICT, SETTINGS_FROM)
ENGINES = ("CYCLES", "EEVEE")


@dataclass(frozen=True)
class Asked:
    """The options, as they were read."""

    strict: Weight | None = None  # what weighs at least so much is not rendered without; None: the scene says
    settings_from: str = ""  # of `ENGINES`; empty: RayBatch's own
    settings: dict[str, Any] = field(default_factory=dict)  # by name: they come before those of the scene


def asked(arguments: Sequence[str] | None = None) -> Asked:
    """The options in `arguments` (those of this process). Raises `SettingsError` for a value that there is not."""
    return _asked(tuple(sys.argv if arguments is None else arguments))


@functools.lru_cache(maxsize=4)
def _asked(arguments: tuple[str, ...]) -> Asked:
    end = arguments.index("--") if "--" in arguments else len(arguments)
    own = arguments[end + 1 :]
    is_blender = bool(arguments) and Path(arguments[0]).stem.lower().startswith("blender")  # not a script
    strict, engine, settings = None, "", _threads(arguments[:end]) if is_blender else {}
    for i, argument in enumerate(own):
        following = own[i + 1] if i + 1 < len(own) and not own[i + 1].startswith("-") else ""
        if argument == STRICT:
            strict = strict_weight(following or Weight.REPLACED.name)
        elif argument == SETTINGS_FROM:
            if following.upper() not in ENGINES:
                raise SettingsError(f"{SETTINGS_FROM} takes one of {', '.join(ENGINES).lower()}")
            engine = following.upper()
        elif argument == DEVICE:
            if not following:
                raise SettingsError(f"{DEVICE} takes the name of a device: AUTO, cpu or cuda:N")
            settings["device"] = following
        elif argument == SET:
            name, is_given, value = following.partition("=")
            if not is_given:
                raise SettingsError(f"{SET} takes NAME=VALUE, such as sample_count=64, and not {following!r}")
            settings[name.strip()] = parse_setting(name.strip(), value)
        elif argument.startswith("--raybatch-"):
            raise SettingsError(f"there is no option {argument}: the options are {', '.join(OPTIONS)}")
    return Asked(strict, engine, settings)


def _threads(arguments: Sequence[str]) -> dict[str, Any]:
    """What Blender's option for threads asks for, as a setting; nothing for 0, which is all of them."""
    for argument, following in itertools.pairwise(arguments):
        if argument in ("-t", "--threads") and following.isdecimal() and int(following):
            return {"thread_count": int(following)}
    return {}


def strict_weight(name: str) -> Weight:
    """The weight called `name`, from SETTING up; raises `SettingsError`."""
    if name.upper() not in {weight.name for weight in Weight if weight}:
        names = ", ".join(weight.name for weight in Weight if weight)
        raise SettingsError(f"{name} is no weight of what may be missing: write one of {names}")
    return Weight[name.upper()]
