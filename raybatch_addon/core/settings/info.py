"""Settings as data: label, unit, range and meaning beside the value; and how values are read and checked."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from ..errors import SettingsError

BYTES = "bytes"
INT_MAX = 2**31 - 1
# What a number of bytes may end with; without an i decimal, as everywhere in reports, with it binary
_BYTE_UNITS = {"": 1} | {
    f"{letter}{binary}": (1024 if binary else 1000) ** power
    for power, letter in enumerate("KMGT", 1)
    for binary in ("", "I")
}
_BYTE_TEXT = re.compile(r"([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*([KMGT]?I?)B?", re.IGNORECASE)


@dataclass(frozen=True)
class GroupInfo:
    """Settings that belong together: a panel in Blender, a section of the manual."""

    label: str
    description: str
    parent: str = ""  # the group that this one is part of
    closed: bool = True  # at first


GROUPS = {
    "DEVICE": GroupInfo("Device", "Where to render.", closed=False),
    "SAMPLING": GroupInfo("Sampling", "How many paths are traced through a pixel.", closed=False),
    "ERROR": GroupInfo("Error", "How far the picture is from what it would be at last.", "SAMPLING"),
    "ADVANCED": GroupInfo("Advanced", "What decides where paths go.", "SAMPLING"),
    "DENOISING": GroupInfo("Denoise", "Noise that is removed from the finished picture."),
    "LIGHT_PATHS": GroupInfo("Light Paths", "How far light is followed."),
    "BOUNCES": GroupInfo("Max Bounces", "How often light may change its way.", "LIGHT_PATHS", closed=False),
    "CLAMPING": GroupInfo("Clamping", "Light above a limit is cut: less noise, and light is lost.", "LIGHT_PATHS"),
    "CAUSTICS": GroupInfo(
        "Caustics", "Light that mirrors and glass throw on other surfaces.", "LIGHT_PATHS", closed=False
    ),
    "TEXTURES": GroupInfo("Textures", "How images of materials are looked up.", "LIGHT_PATHS"),
    "ROULETTE": GroupInfo("Russian Roulette", "Which paths end early. The picture stays unbiased.", "LIGHT_PATHS"),
    "FILM": GroupInfo("Film", "How samples become pixels."),
    "PERFORMANCE": GroupInfo(
        "Performance", "How a frame is rendered. From here on no setting changes the picture, only the time it takes."
    ),
    "MEMORY": GroupInfo(
        "Memory", "How much of the scene's geometry and images is on the device, and where the rest is.", "PERFORMANCE"
    ),
    "BATCHING": GroupInfo("Batching", "How rays are traced: for those who study it."),
    "SCHEDULER": GroupInfo("Scheduler", "Which rays are alive, and what is done next.", "BATCHING"),
    "QUEUES": GroupInfo("Queues", "Where rays wait. For renders that batch.", "BATCHING"),
    "TREELETS": GroupInfo(
        "Treelets", "How trees are cut into parts that rays visit together. For renders that batch.", "BATCHING"
    ),
    "LAUNCH": GroupInfo(
        "Launch",
        "How the kernels that trace rays are compiled and launched, but for those of Warp's own tree.",
        "BATCHING",
    ),
}


@dataclass(frozen=True, kw_only=True)
class SettingInfo:
    """Facts about one setting beside its value."""

    name: str
    label: str
    description: str  # of the number with `auto` or `off`, where that is spoken of
    panel_description: str  # the same for those who see a checkbox instead of that number
    group: str  # of `GROUPS`
    effect: str  # "estimator" (changes the film) or "schedule" (changes time only)
    default: Any
    kind: type  # int, float or str (a str with `choices` is an enumeration)
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    least: int = 0  # of an int: smallest value but `minimum`
    multiple: int = 1  # of an int: values are whole multiples of it
    choices: tuple[tuple[str, str, str], ...] = ()  # (identifier, label, description)
    auto: Any = None  # the value that lets RayBatch choose; None: there is none
    off: Any = None  # the value of a number that sets no limit; None: there is none
    start: Any = None  # of a number with `auto` or `off`: what it is at first where it is neither

    @property
    def range(self) -> tuple[float, float]:
        """The smallest and the largest value of a number."""
        assert self.minimum is not None and self.maximum is not None, f"{self.name} is no number"
        return self.minimum, self.maximum

    def range_text(self) -> str:
        """The legal values in words, for messages and the manual."""
        if self.choices:
            return "one of " + ", ".join(identifier for identifier, _, _ in self.choices)
        if self.kind is str:
            return "text"
        minimum, maximum = self.range
        if self.kind is not int:
            return f"{minimum:g} to {maximum:g}"
        lowest, highest = int(minimum), int(maximum)
        if self.least or self.multiple > 1:
            words = f"{lowest}, or {self.least or self.multiple} to {highest}"
            return words + (f" in steps of {self.multiple}" if self.multiple > 1 else "")
        return f"{lowest} to {highest}"

    @property
    def title(self) -> str:
        """The label, with its panel's where it says nothing alone."""
        group = GROUPS[self.group]
        return f"{group.label}, {self.label}" if group.parent else self.label

    @property
    def is_switch(self) -> bool:
        """Whether it is on or off, and nothing else."""
        return sorted(identifier for identifier, _, _ in self.choices) == ["OFF", "ON"]

    def name_of(self, value: Any) -> str:
        """`value` as the panel names it, where it is one of the choices; else as text."""
        if isinstance(value, float):
            return f"{value:g}"
        return next((label for identifier, label, _ in self.choices if identifier == value), str(value))

    def is_auto(self, value: Any) -> bool:
        """Whether `value` lets RayBatch choose."""
        return self.auto is not None and value == self.auto


def setting(
    default: Any,
    label: str,
    description: str,
    *,
    group: str,
    effect: str = "estimator",
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    least: int = 0,
    multiple: int = 1,
    choices: Iterable[tuple[str, str, str]] = (),
    auto: Any = None,
    off: Any = None,
    start: Any = None,
) -> Any:
    """A field of a dataclass of settings; for the arguments see `SettingInfo`. `{rest}` in a description is the value
    `auto` or `off`.
    """
    metadata = dict(
        label=label,
        description=description,
        group=group,
        effect=effect,
        unit=unit,
        minimum=minimum,
        maximum=maximum,
        least=least,
        multiple=multiple,
        choices=tuple(choices),
        auto=auto,
        off=off,
        start=start,
    )
    return dataclasses.field(default=default, metadata=metadata)


_TYPES = {"int": int, "float": float, "str": str}


def infos_of(settings: type) -> dict[str, SettingInfo]:
    """By name, of a dataclass whose fields are made by `setting`."""
    found = {}
    for field in dataclasses.fields(settings):
        about = dict(field.metadata)
        text, auto, off = about["description"], about["auto"], about["off"]
        about["description"] = text.replace("{rest}", f"{off if auto is None else auto}".removesuffix(".0"))
        about["panel_description"] = text.replace("{rest}", "off" if auto is None else "Auto")
        found[field.name] = SettingInfo(name=field.name, default=field.default, kind=_TYPES[str(field.type)], **about)
    return found


def checked(info: SettingInfo, value: Any) -> Any:
    """`value` (or its text) as the setting's own type; raises `SettingsError` with the legal range.

    Numbers of bytes may be written with a unit: `1.5G` or `1500MB` are 1,500,000,000 bytes, `512Mi` or `512MiB` are
    536,870,912.
    """

    def complaint(whole: str = "") -> SettingsError:
        legal = f"{whole}{info.range_text()}{_unit_hint(info)}"
        return SettingsError(f"{info.name} = {given!r} is not valid: it must be {legal}")

    given = value
    if info.kind is str:
        text = str(value).strip()
        if info.choices:
            text = text.upper()
            if text not in {identifier for identifier, _, _ in info.choices}:
                raise complaint()
        return text
    minimum, maximum = info.range
    if info.unit == BYTES and isinstance(value, str):
        value = _bytes(value, complaint)
    try:
        number = float(value)
        if info.kind is int:
            exact = int(value) if not isinstance(value, float) else int(number)
            if exact != number and abs(number) < 2**53:
                raise ValueError(number)
            number = exact
    except (TypeError, ValueError, OverflowError):
        raise complaint("a whole number, " if info.kind is int else "") from None
    if not math.isfinite(number) or not minimum <= number <= maximum:
        raise complaint()
    if info.kind is int and number != minimum and (number < info.least or number % info.multiple):
        raise complaint()
    return number


def _unit_hint(info: SettingInfo) -> str:
    return " bytes; 1.5G is 1,500,000,000, and 512Mi is 536,870,912" if info.unit == BYTES else ""


def _bytes(text: str, complaint: Callable[[], SettingsError]) -> int:
    """The number that `text` means, exactly; raises what `complaint` returns."""
    found = _BYTE_TEXT.fullmatch(text.strip())
    if not found or found[2].upper() not in _BYTE_UNITS:
        raise complaint()
    number = Fraction(found[1]) * _BYTE_UNITS[found[2].upper()]
    if number.denominator != 1:
        raise complaint()
    return int(number)
