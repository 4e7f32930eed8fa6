"""Every tuning parameter of a render, defined once.

The Blender panel, the command line, the manual and the checks of values are all made from
`RenderSettings`: a field's metadata holds its label, unit, range, choices and meaning.
*Estimator* settings change the film; *schedule* settings change only the time it takes (law:
"the schedule changes time, never the image").
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from .errors import SettingsError


@dataclass(frozen=True)
class SettingInfo:
    """What is known of one setting beside its value."""

    name: str
    label: str
    description: str
    group: str  # panel section: DEVICE, SAMPLING, LIGHT_PATHS, FILM, SCHEDULE
    effect: str  # "estimator" (changes the film) or "schedule" (changes time only)
    default: Any
    kind: type  # int, float or str (a str with `choices` is an enumeration)
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[tuple[str, str, str], ...] = ()  # (identifier, label, description)

    def range_text(self) -> str:
        """The legal values in words, for messages and the manual."""
        if self.choices:
            return "one of " + ", ".join(identifier for identifier, _, _ in self.choices)
        if self.kind is str:
            return "text"
        if self.kind is int:
            return f"{int(self.minimum)} to {int(self.maximum)}"
        return f"{self.minimum:g} to {self.maximum:g}"


def _setting(default, label, description, *, group, effect="estimator", unit="", minimum=None, maximum=None, choices=()):
    metadata = dict(
        label=label, description=description, group=group, effect=effect, unit=unit,
        minimum=minimum, maximum=maximum, choices=tuple(choices),
    )  # fmt: skip
    return dataclasses.field(default=default, metadata=metadata)


_INT_MAX = 2**31 - 1


@dataclass(frozen=True)
class RenderSettings:
    """The settings of one render; construct with legal values only (checked, `SettingsError`)."""

    device: str = _setting(
        "AUTO", "Device", "Where to render: AUTO (the first CUDA device, else the CPU), cpu, or cuda:N",
        group="DEVICE", effect="schedule",
    )
    thread_count: int = _setting(
        0, "Threads", "Worker threads on the CPU; 0 uses every core. Not used on CUDA devices",
        group="DEVICE", effect="schedule", unit="threads", minimum=0, maximum=1024,
    )

    sample_count: int = _setting(
        128, "Samples", "Paths traced through every pixel",
        group="SAMPLING", unit="samples per pixel", minimum=1, maximum=_INT_MAX,
    )
    seed: int = _setting(
        0, "Seed", "Chooses another set of random numbers, and so another pattern of noise",
        group="SAMPLING", minimum=0, maximum=_INT_MAX,
    )
    sample_sequence: str = _setting(
        "SOBOL", "Sequence", "How the random numbers of a pixel are spread",
        group="SAMPLING",
        choices=(
            ("SOBOL", "Owen-scrambled Sobol", "Low-discrepancy points: less noise at the same sample count (Burley 2020)"),
            ("INDEPENDENT", "Independent", "Independent Philox numbers: error statistics are textbook Monte Carlo"),
        ),
    )
    nee: str = _setting(
        "ON", "Light Sampling", "Next-event estimation: aim a shadow ray at a light from every surface",
        group="SAMPLING",
        choices=(
            ("ON", "On", "Lights are sampled directly, combined with BSDF sampling by multiple importance sampling"),
            ("OFF", "Off", "Light is found by BSDF sampling alone; lights without size then give no light"),
            ("HALF", "Half", "On in the left half of the frame, off in the right half, for comparing"),
        ),
    )

    bounce_max: int = _setting(
        8, "Bounces", "Bounces of indirect light; 0 renders direct light only",
        group="LIGHT_PATHS", unit="bounces", minimum=0, maximum=100_000,
    )
    transparent_bounce_max: int = _setting(
        8, "Transparent Bounces", "Transparent surfaces that a ray passes before it is taken as blocked",
        group="LIGHT_PATHS", unit="surfaces", minimum=0, maximum=1024,
    )
    roulette_bounce: int = _setting(
        3, "Roulette From", "Bounce from which Russian roulette may end a path that carries little light (unbiased)",
        group="LIGHT_PATHS", unit="bounces", minimum=0, maximum=100_000,
    )
    clamp_direct: float = _setting(
        0.0, "Clamp Direct", "Largest radiance of one light seen directly or at the first bounce; 0 does not clamp. Clamping loses light",
        group="LIGHT_PATHS", unit="W/(m² sr)", minimum=0.0, maximum=1e30,
    )
    clamp_indirect: float = _setting(
        0.0, "Clamp Indirect", "Largest radiance of one light found after the first bounce; 0 does not clamp. Clamping loses light",
        group="LIGHT_PATHS", unit="W/(m² sr)", minimum=0.0, maximum=1e30,
    )

    pixel_filter: str = _setting(
        "BLACKMAN_HARRIS", "Pixel Filter", "Weight of the light around a pixel's centre",
        group="FILM",
        choices=(
            ("BLACKMAN_HARRIS", "Blackman-Harris", "Smooth, sharp, without ringing"),
            ("GAUSSIAN", "Gaussian", "Soft"),
            ("BOX", "Box", "The pixel's own square only"),
        ),
    )
    filter_width: float = _setting(
        1.5, "Filter Width", "Width of the pixel filter; the box is one pixel wide always",
        group="FILM", unit="pixels", minimum=0.01, maximum=10.0,
    )

    tile_size: int = _setting(
        0, "Tile Size", "Edge of the square tiles in which the frame is rendered and shown; 0 chooses by device",
        group="SCHEDULE", effect="schedule", unit="pixels", minimum=0, maximum=65_536,
    )
    ray_count: int = _setting(
        0, "Rays Alive", "Paths alive at once in all workers together; 0 chooses by device. Each takes about 256 bytes",
        group="SCHEDULE", effect="schedule", unit="paths", minimum=0, maximum=2**28,
    )
    ray_low_water: float = _setting(
        0.75, "Low Water", "New paths are generated when fewer than this share of Rays Alive is left",
        group="SCHEDULE", effect="schedule", unit="of rays alive", minimum=0.0, maximum=1.0,
    )
    ray_high_water: float = _setting(
        1.0, "High Water", "Share of Rays Alive up to which new paths are generated",
        group="SCHEDULE", effect="schedule", unit="of rays alive", minimum=0.0, maximum=1.0,
    )
    sample_order: str = _setting(
        "FRAME_FIRST", "Sample Order", "Which path is generated next",
        group="SCHEDULE", effect="schedule",
        choices=(
            ("FRAME_FIRST", "Frame first", "One sample of every pixel of the tile, then the next sample"),
            ("PIXEL_FIRST", "Pixel first", "All samples of a pixel, then the next pixel"),
        ),
    )
    batching: str = _setting(
        "OFF", "Batching", "How rays visit the scene's tree",
        group="SCHEDULE", effect="schedule",
        choices=(
            ("OFF", "Off", "Each ray visits the whole tree at once: fastest where the scene fits in memory"),
            ("REFERENCE", "Reference", "As off, with Warp's own tree: what the others are measured against"),
        ),
    )
    spatial_splits: str = _setting(
        "AUTO", "Spatial Splits", "Split triangles among the boxes of the tree: a slower build for faster rays where large or long triangles overlap",
        group="SCHEDULE", effect="schedule",
        choices=(
            ("AUTO", "Automatic", "On the CPU, but for meshes that move from frame to frame: their trees follow them. On CUDA trees are built on the device, without splits"),
            ("OFF", "Off", "Each triangle is in one box"), ("ON", "On", "Triangles may be in several boxes (Stich et al. 2009). On CUDA the CPU builds the tree then"),
        ),  # fmt: skip
    )
    ray_sort: str = _setting(
        "AUTO", "Sort Rays", "Sort rays by direction and origin before they are traced",
        group="SCHEDULE", effect="schedule",
        choices=(
            ("AUTO", "Automatic", "Where that was measured to save time, by kind of ray"),
            ("ON", "On", "Always"),
            ("OFF", "Off", "Never"),
        ),
    )
    counters: str = _setting(
        "OFF", "Counters", "Count the steps of every ray, by kind and bounce, and time each stage; the render takes longer",
        group="SCHEDULE", effect="schedule",
        choices=(("OFF", "Off", "Nothing is counted, and nothing is paid for it"), ("ON", "On", "For the statistics and the passes that show cost")),
    )

    def __post_init__(self):
        for info in SETTINGS.values():
            object.__setattr__(self, info.name, _checked(info, getattr(self, info.name)))
        if self.ray_low_water > self.ray_high_water:
            raise SettingsError(
                f"ray_low_water ({self.ray_low_water:g}) is above ray_high_water ({self.ray_high_water:g}); "
                "lower it, or raise ray_high_water"
            )

    def replace(self, **changes: Any) -> RenderSettings:
        """A copy with `changes`; raises `SettingsError` for an unknown name or an illegal value."""
        for name in changes:
            setting_info(name)
        return dataclasses.replace(self, **changes)


def setting_info(name: str) -> SettingInfo:
    """The `SettingInfo` of `name`; raises `SettingsError` that lists the known names."""
    try:
        return SETTINGS[name]
    except KeyError:
        raise SettingsError(f"no setting is called {name!r}; the settings are {', '.join(sorted(SETTINGS))}") from None


def parse_setting(name: str, text: str) -> Any:
    """The value of setting `name` written as `text` on a command line; raises `SettingsError`."""
    return _checked(setting_info(name), text)


def _checked(info: SettingInfo, value: Any) -> Any:
    """`value` (or its text) as the setting's own type; raises `SettingsError` with the legal range."""
    complaint = SettingsError(f"{info.name} = {value!r} is not valid: it must be {info.range_text()}")
    if info.kind is str:
        text = str(value).strip()
        if info.choices:
            text = text.upper()
            if text not in {identifier for identifier, _, _ in info.choices}:
                raise complaint
        return text
    try:
        number = float(value)
        if info.kind is int:
            exact = int(value) if not isinstance(value, float) else int(number)
            if exact != number and abs(number) < 2**53:
                raise complaint
            number = exact
    except (TypeError, ValueError, OverflowError):
        raise complaint from None
    if not math.isfinite(number) or not info.minimum <= number <= info.maximum:
        raise complaint
    return number


_TYPES = {"int": int, "float": float, "str": str}
SETTINGS: dict[str, SettingInfo] = {
    field.name: SettingInfo(name=field.name, default=field.default, kind=_TYPES[field.type], **field.metadata)
    for field in dataclasses.fields(RenderSettings)
}
