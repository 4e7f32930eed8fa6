"""What `blender -b ... -- OPTIONS` asks of RayBatch: options behind `--`, which Blender leaves to others.

--raybatch-strict [SETTING|REPLACED|MISSING]   do not render what would lack something; the exit code is 3
--raybatch-settings-from cycles|eevee          render with the settings of that engine
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass

from ..core.errors import SettingsError
from ..core.scene.notice import Weight

STRICT, SETTINGS_FROM = "--raybatch-strict", "--raybatch-settings-from"
ENGINES = ("CYCLES", "EEVEE")


@dataclass(frozen=True)
class Asked:
    """The options, as they were read."""

    strict: Weight | None = None  # what weighs at least so much is not rendered without; None: the scene says
    settings_from: str = ""  # of `ENGINES`; empty: RayBatch's own


def asked(arguments: Sequence[str] | None = None) -> Asked:
    """The options in `arguments` (those of this process). Raises `SettingsError` for a value that there is not."""
    arguments = list(sys.argv if arguments is None else arguments)
    own = arguments[arguments.index("--") + 1 :] if "--" in arguments else []
    strict, engine = None, ""
    for i, argument in enumerate(own):
        following = own[i + 1].upper() if i + 1 < len(own) and not own[i + 1].startswith("-") else ""
        if argument == STRICT:
            strict = strict_weight(following or Weight.REPLACED.name)
        elif argument == SETTINGS_FROM:
            if following not in ENGINES:
                raise SettingsError(f"{SETTINGS_FROM} takes one of {', '.join(ENGINES).lower()}")
            engine = following
    return Asked(strict, engine)


def strict_weight(name: str) -> Weight:
    """The weight called `name`, from SETTING up; raises `SettingsError`."""
    if name.upper() not in {weight.name for weight in Weight if weight}:
        names = ", ".join(weight.name for weight in Weight if weight)
        raise SettingsError(f"{name} is no weight of what may be missing: write one of {names}")
    return Weight[name.upper()]
