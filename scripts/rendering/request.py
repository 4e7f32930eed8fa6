"""The request of render.py."""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lib.command import UsageError

from raybatch_addon.core.checkpoint import INTERVAL_DEFAULT
from raybatch_addon.core.errors import SettingsError
from raybatch_addon.core.scene.passes import PASSES
from raybatch_addon.core.scene.validate import PASS_NAMES
from raybatch_addon.core.settings.presets import preset_settings
from raybatch_addon.core.settings.settings import parse_setting

BLEND, BLENDER_GEOMETRY, ARCHIVE, NPZ = "blend", "geometry through Blender", "saved scene", "NumPy geometry"
KINDS = (
    (".blend", BLEND),
    (".obj", BLENDER_GEOMETRY),
    (".ply", BLENDER_GEOMETRY),
    (".gltf", BLENDER_GEOMETRY),
    (".glb", BLENDER_GEOMETRY),
    (".scene.npz", ARCHIVE),
    (".npz", NPZ),
)
RESOLUTION_DEFAULT = (960, 540)  # of geometry, which has none of its own [pixels]
RESOLUTION_MAX = 65_536  # Blender's own limit
VECTOR_PASSES = tuple(name for name, channels in PASSES.items() if channels > 1)


@dataclass(frozen=True, kw_only=True)
class Request:
    """One call of render.py, checked as far as it can be without opening the file."""

    source: Path
    kind: str  # of the constants above
    out: str | None = None
    frames: tuple[int, ...] | None = None  # None: the file's current one
    view_layers: tuple[str, ...] = ()  # empty: those that the file renders
    settings: dict[str, Any] = field(default_factory=dict)  # RenderSettings to change
    resolution: tuple[int, int] | None = None
    passes: tuple[str, ...] = ()  # asked for beside the file's own
    film: str | None = None
    heat_maps: tuple[tuple[str, str], ...] = ()  # pass and file; the passes are in `passes`
    json: str | None = None
    save_scene: str | None = None
    checkpoint: str | None = None
    checkpoint_interval: float = INTERVAL_DEFAULT  # [s]
    sample_first: int = 0
    cluster: str = ""  # where it is rendered, as --cluster has it; empty: by this process
    camera: str | None = None
    up: str | None = None
    settings_from: str = ""  # CYCLES or EEVEE: take over that engine's settings first
    multilayer: bool = False  # `out` is an OpenEXR file with all layers and passes
    strict: str = ""  # name of a `Weight`: what weighs so much may not be missing

    @property
    def renders(self) -> bool:
        """Whether a render is wanted, not just the exported scene."""
        return bool(self.out or self.film or self.json or self.heat_maps or self.checkpoint)


def kind_of(source: Path, taken: Sequence[str] = tuple(dict(KINDS).values())) -> str:
    """The kind of file by its name; raises `UsageError` for one that is of none of the kinds that are `taken`."""
    for suffix, kind in KINDS:
        if source.name.lower().endswith(suffix) and kind in taken:
            return kind
    raise UsageError(
        f"{source}: what kind of file is this? It must end in "
        f"{', '.join(suffix for suffix, kind in KINDS if kind in taken)}"
    )


def not_layered(out: str) -> UsageError:
    """The error for `out` where --multilayer was given."""
    return UsageError(f"--multilayer writes OpenEXR files, and {out} is none: name it with .exr")


def parse_frames(text: str) -> tuple[int, ...]:
    """`A..B`, both included; raises `UsageError`."""
    first, dots, last = text.partition("..")
    try:
        a, b = int(first), int(last)
    except ValueError:
        raise UsageError(f"--frames {text} is not a range A..B of whole numbers, such as 1..24") from None
    if not dots or a > b:
        raise UsageError(f"--frames {text} is not a range A..B with A at most B")
    return tuple(range(a, b + 1))


def parse_pass(text: str) -> str:
    """The name of a pass, written in letters of any case; raises `UsageError`."""
    for name in PASS_NAMES:
        if text.strip().lower() == name.lower():
            return name
    begun = [name for name in PASS_NAMES if text.strip() and name.lower().startswith(text.strip().lower())]
    close = begun[:3] or difflib.get_close_matches(text.strip().title(), PASS_NAMES)
    hint = f"did you mean {' or '.join(close)}?" if close else f"the passes are {', '.join(PASS_NAMES)}"
    raise UsageError(f"there is no pass {text.strip()!r}; {hint}")


def parse_heat_map(text: str) -> tuple[str, str]:
    """Pass and file of `PASS=FILE.png`; raises `UsageError`."""
    name, _, path = text.partition("=")
    if not path.lower().endswith(".png"):
        raise UsageError(f"--heat-map {text} is not PASS=FILE.png")
    name = parse_pass(name)
    if name in VECTOR_PASSES:
        raise UsageError(f"--heat-map {text}: {name} has three values a pixel; choose a pass that has one")
    return name, path


def parse_seconds(option: str, text: str | None, default: float) -> float:
    """A time above 0 [s]; raises `UsageError`."""
    try:
        seconds = default if text is None else float(text)
    except ValueError:
        seconds = 0.0
    if not 0.0 < seconds < math.inf:
        raise UsageError(f"{option} {text} is no time: write a number of seconds above 0")
    return seconds


def parse_sample(option: str, text: str | None) -> int:
    """The number of a sample; raises `UsageError`."""
    if text is not None and not text.strip().isdecimal():
        raise UsageError(f"{option} {text} is no sample: write a whole number, from 0 on")
    return int(text or 0)


def parse_settings(assignments: list[str], preset: str | None = None) -> tuple[dict[str, Any], tuple[int, int] | None]:
    """Settings by name, and the resolution if one is given, from `name=value` texts, on top of a preset; raises
    `SettingsError`.
    """
    values: dict[str, Any] = preset_settings(preset) if preset else {}
    resolution = None
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        name = name.strip()
        if not equals:
            raise SettingsError(f"--set {assignment} has no value; write --set {name}=VALUE")
        if name == "resolution":
            resolution = _parse_resolution(text)
        else:
            values[name] = parse_setting(name, text, beside=("resolution",))
    return values, resolution


def _parse_resolution(text: str) -> tuple[int, int]:
    parts = text.lower().split("x")
    if len(parts) == 2 and all(part.strip().isdecimal() for part in parts):
        width, height = int(parts[0]), int(parts[1])
        if 1 <= width <= RESOLUTION_MAX and 1 <= height <= RESOLUTION_MAX:
            return width, height
    raise SettingsError(
        f"resolution = {text!r} is not valid: write WIDTHxHEIGHT in pixels, each 1 to {RESOLUTION_MAX}, such as 160x120"
    )
