"""Every tuning parameter of a render, defined once.

The Blender panel, the command line, the manual and the checks of values are all made from
`RenderSettings`: a field's metadata (`SettingInfo`) holds its label, unit, range, choices and meaning.
*Estimator* settings change the film; *schedule* settings change only the time it takes (law:
"the schedule changes time, never the image"). Where 0 or AUTO lets RayBatch choose, the statistics say what it chose.
"""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from ..errors import SettingsError
from .denoise import DenoiseSettings
from .device import TRACE_BLOCK_SIZE, DeviceSettings, LaunchSettings, MemorySettings
from .estimator import EstimatorSettings
from .info import BYTES, GROUPS, INT_MAX, SettingInfo, checked, infos_of
from .schedule import SchedulerSettings, TracingSettings
from .waiting import QueueSettings, TreeletSettings

__all__ = ["BYTES", "GROUPS", "SETTINGS", "RenderSettings", "SettingInfo", "parse_setting", "setting_info"]

# 32-bit registers of a block of threads, on every CUDA device since 2014, and the steps in which a thread gets them
REGISTERS_MAX, REGISTER_STEP = 65_536, 8
# Paths count their bounces of a kind up to this number, which stands for all above
KIND_BOUNCES_COUNTED = 511


# Fields come in the order of the bases from the last to the first: that of the panel and of the manual
@dataclass(frozen=True)
class RenderSettings(
    MemorySettings,
    LaunchSettings,
    TreeletSettings,
    QueueSettings,
    SchedulerSettings,
    TracingSettings,
    DenoiseSettings,
    EstimatorSettings,
    DeviceSettings,
):
    """The settings of one render; construct with legal values only (checked, `SettingsError`)."""

    def __post_init__(self):
        for info in SETTINGS.values():
            value = getattr(self, info.name)
            if type(value) is info.kind and value == info.default:
                continue  # as it should be
            object.__setattr__(self, info.name, checked(info, value))
        for complaint in (self._complaint_of_queues(), self._complaint_of_launches(), self._complaint_of_memory()):
            if complaint:
                raise SettingsError(complaint)

    def _complaint_of_queues(self) -> str | None:
        """Why marks, sizes and counts do not go together."""
        if self.ray_low_water > self.ray_high_water:
            return (
                f"ray_low_water ({self.ray_low_water:g}) is above ray_high_water ({self.ray_high_water:g}); "
                "lower it, or raise ray_high_water"
            )
        if self.treelet_size and self.treelet_size_min > self.treelet_size:
            return (
                f"treelet_size_min ({self.treelet_size_min}) is above treelet_size ({self.treelet_size}): no treelet "
                "could have so many nodes; lower treelet_size_min, or raise treelet_size (0 lets RayBatch choose)"
            )
        if self.queue_size * self.queue_count > INT_MAX:
            return (
                f"queue_count ({self.queue_count}) times queue_size ({self.queue_size}) is "
                f"{self.queue_size * self.queue_count:,} places for rays, "
                f"and {INT_MAX:,} can be numbered; lower one of the two, or set queue_count to 0"
            )
        return None

    def _complaint_of_launches(self) -> str | None:
        """Why a kernel could not be launched so."""
        if self.is_on("single_lane") and self.warp_count > 1:
            return (
                f"single_lane is ON, so one lane of one warp works, but warp_count is {self.warp_count}; "
                "set warp_count to 0 or 1, or single_lane to OFF"
            )
        if block_registers(self.register_cap, self.block_size or TRACE_BLOCK_SIZE) > REGISTERS_MAX:
            return (
                f"register_cap ({self.register_cap}) times block_size ({self.block_size}) is more than the "
                f"{REGISTERS_MAX:,} registers that a block of threads can have, and a thread gets them in steps of "
                f"{REGISTER_STEP}; lower one of the two, or set it to 0"
            )
        return None

    def _complaint_of_memory(self) -> str | None:
        """Why geometry or images could not be kept so."""
        if self.geometry_budget and self.batching in ("OFF", "REFERENCE"):
            why = "Warp's own tree is" if self.batching == "REFERENCE" else "without queues rays need the whole tree"
            return (
                f"batching is {self.batching}, and {why} on the device at once, but geometry_budget "
                f"({self.geometry_budget} bytes) lets a part of it "
                "wait elsewhere; set geometry_budget to 0, or batching to AUTO or ON"
            )
        if self.texture_tile_size.bit_count() != 1:
            below = 1 << self.texture_tile_size.bit_length() - 1
            return f"texture_tile_size is {self.texture_tile_size}, no power of two; set it to {below} or {2 * below}"
        return None

    @property
    def texture_tile_bytes(self) -> int:
        """Memory of a tile of an image [bytes]."""
        return 4 * self.texture_tile_size**2

    @property
    def half_count(self) -> int:
        """In how many films samples come: 2 where the error is estimated."""
        return 2 if keeps_halves(self) else 1

    @property
    def counts_bounces_by_kind(self) -> bool:
        """Whether bounces of one kind may end a path before `bounce_max` does."""
        least = min(self.diffuse_bounce_max, self.glossy_bounce_max, self.transmission_bounce_max)
        return least < min(self.bounce_max, KIND_BOUNCES_COUNTED)

    @property
    def is_adaptive(self) -> bool:
        """Whether some pixels may get fewer samples than others."""
        return self.is_on("adaptive_sampling")

    def is_on(self, name: str) -> bool:
        """Whether the setting `name`, one of those that can be ON, is so."""
        return getattr(self, name) == "ON"

    def replace(self, **changes: Any) -> RenderSettings:
        """A copy with `changes`; raises `SettingsError` for an unknown name or an illegal value."""
        for name in changes:
            setting_info(name)
        return dataclasses.replace(self, **changes)


def keeps_halves(settings: Any) -> bool:
    """Whether samples come in two halves, so that the error is estimated; of settings, or of properties named alike."""
    return settings.error_estimate == "ON" or settings.error_target > 0 or settings.adaptive_sampling == "ON"


def block_registers(register_cap: int, block_size: int) -> int:
    """Registers that a block of `block_size` threads takes, each with up to `register_cap`; 0 where they are not
    capped.
    """
    return -(-register_cap // REGISTER_STEP) * REGISTER_STEP * block_size


def setting_info(name: str, beside: Iterable[str] = ()) -> SettingInfo:
    """The `SettingInfo` of `name`; raises `SettingsError` that names the closest ones, or all if none is
    close, those `beside` the settings too.
    """
    try:
        return SETTINGS[name]
    except KeyError:
        names = sorted((*SETTINGS, *beside))
        close = close_names(name, names)
        hint = f"did you mean {' or '.join(close)}?" if close else f"the settings are {', '.join(names)}"
        raise SettingsError(f"no setting is called {name!r}; {hint}") from None


def close_names(name: str, names: Iterable[str]) -> list[str]:
    """What `name` may have meant, the likeliest first: `samples` is the number of them, `bounces` the most."""
    asked = name.lower().replace("-", "_")
    numbers = [each for each in names if each in (f"{asked.removesuffix('s')}_count", f"{asked.removesuffix('s')}_max")]
    return numbers + [each for each in difflib.get_close_matches(asked, names) if each not in numbers]


def parse_setting(name: str, text: str, beside: Iterable[str] = ()) -> Any:
    """The value of setting `name` written as `text` on a command line; raises `SettingsError`. What else has a name
    there is `beside`.
    """
    return checked(setting_info(name, beside), text)


SETTINGS: dict[str, SettingInfo] = infos_of(RenderSettings)
