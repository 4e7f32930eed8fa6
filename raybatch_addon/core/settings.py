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

from .errors import SettingsError
from .setting_info import BYTES, GROUPS, INT_MAX, SettingInfo, checked, infos_of, setting

__all__ = ["BYTES", "GROUPS", "SETTINGS", "RenderSettings", "SettingInfo", "parse_setting", "setting_info"]

# 32-bit registers of a block of threads, on every CUDA device since 2014, and the steps in which a thread gets them
REGISTERS_MAX, REGISTER_STEP = 65_536, 8
# Threads of a block where `block_size` is 0
BLOCK_SIZE = 128


@dataclass(frozen=True)
class RenderSettings:
    """The settings of one render; construct with legal values only (checked, `SettingsError`)."""

    device: str = setting(
        "AUTO", "Device", "Where to render: AUTO (the first CUDA device, else the CPU), cpu, or cuda:N",
        group="DEVICE", effect="schedule", auto="AUTO",
    )
    thread_count: int = setting(
        0, "Threads", "Worker threads on the CPU; 0 uses every core. Not used on CUDA devices",
        group="DEVICE", effect="schedule", unit="threads", minimum=0, maximum=1024, auto=0,
    )

    sample_count: int = setting(
        128, "Samples", "Paths traced through every pixel",
        group="SAMPLING", unit="samples per pixel", minimum=1, maximum=INT_MAX,
    )
    time_limit: float = setting(
        0.0, "Time Limit", "A render ends when no more samples of every pixel are expected to fit in this time, counted without build and compilation; "
        "0 sets no limit. One sample is always rendered",
        group="SAMPLING", unit="s", minimum=0.0, maximum=1e9,
    )
    error_estimate: str = setting(
        "OFF", "Error Estimate", "Tell how far the picture is from its limit at infinitely many samples, without a reference",
        group="SAMPLING",
        choices=(
            ("OFF", "Off", "All samples have the same seed"),
            ("ON", "On", "Every other sample has another seed, and either half a film of its own: how far they differ tells the error of both together"),
        ),
    )
    error_target: float = setting(
        0.0, "Stop at Error", "A render ends when its estimated error is no larger than this: the mean over pixels and channels of the squared error over "
        "the squared value (relMSE). It implies Error Estimate; 0 renders all samples",
        group="SAMPLING", unit="relMSE", minimum=0.0, maximum=1e9,
    )
    seed: int = setting(
        0, "Seed", "Chooses another set of random numbers, and so another pattern of noise",
        group="SAMPLING", minimum=0, maximum=INT_MAX,
    )
    sample_sequence: str = setting(
        "SOBOL", "Sequence", "How the random numbers of a pixel are spread",
        group="SAMPLING",
        choices=(
            ("SOBOL", "Owen-scrambled Sobol", "Low-discrepancy points: less noise at the same sample count (Burley 2020)"),
            ("INDEPENDENT", "Independent", "Independent Philox numbers: error statistics are textbook Monte Carlo"),
        ),
    )
    nee: str = setting(
        "ON", "Light Sampling", "Next-event estimation: aim a shadow ray at a light from every surface",
        group="SAMPLING",
        choices=(
            ("ON", "On", "Lights are sampled directly, combined with BSDF sampling by multiple importance sampling"),
            ("OFF", "Off", "Light is found by BSDF sampling alone; lights without size then give no light"),
            ("HALF", "Half", "On in the left half of the frame, off in the right half, for comparing"),
        ),
    )
    mis: str = setting(
        "ON", "Combine Sampling", "Multiple importance sampling: what light sampling and BSDF sampling can both find is weighted by how likely each finds it",
        group="SAMPLING",
        choices=(
            ("ON", "On", "Weights of the power heuristic (Veach 1997): low noise whichever of the two is the better one"),
            ("OFF", "Off", "Light sampling alone finds what it can find: a control, noisy near lights and on shiny surfaces. Unused without light sampling"),
        ),
    )

    bounce_max: int = setting(
        8, "Bounces", "Bounces of indirect light; 0 renders direct light only",
        group="LIGHT_PATHS", unit="bounces", minimum=0, maximum=100_000,
    )
    transparent_bounce_max: int = setting(
        8, "Transparent Bounces", "Transparent surfaces that a ray passes before it is taken as blocked",
        group="LIGHT_PATHS", unit="surfaces", minimum=0, maximum=1024,
    )
    roulette_bounce: int = setting(
        3, "Roulette From", "Bounce from which Russian roulette may end a path that carries little light (unbiased)",
        group="LIGHT_PATHS", unit="bounces", minimum=0, maximum=100_000,
    )
    clamp_direct: float = setting(
        0.0, "Clamp Direct", "Largest radiance of one light seen directly or at the first bounce; 0 does not clamp. Clamping loses light",
        group="LIGHT_PATHS", unit="W/(m² sr)", minimum=0.0, maximum=1e30,
    )
    clamp_indirect: float = setting(
        0.0, "Clamp Indirect", "Largest radiance of one light found after the first bounce; 0 does not clamp. Clamping loses light",
        group="LIGHT_PATHS", unit="W/(m² sr)", minimum=0.0, maximum=1e30,
    )

    pixel_filter: str = setting(
        "BLACKMAN_HARRIS", "Pixel Filter", "Weight of the light around a pixel's centre",
        group="FILM",
        choices=(
            ("BLACKMAN_HARRIS", "Blackman-Harris", "Smooth, sharp, without ringing"),
            ("GAUSSIAN", "Gaussian", "Soft"),
            ("BOX", "Box", "The pixel's own square only"),
        ),
    )
    filter_width: float = setting(
        1.5, "Filter Width", "Width of the pixel filter; the box is one pixel wide always",
        group="FILM", unit="pixels", minimum=0.01, maximum=10.0,
    )

    batching: str = setting(
        "AUTO", "Batching", "Let rays wait at parts of the tree (treelets) and visit them together, or let each ray go its way",
        group="PERFORMANCE", effect="schedule", auto="AUTO",
        choices=(
            ("AUTO", "Automatic", "On for a scene that does not fit in the device's memory; else what is expected to be fastest"),
            ("ON", "On", "Rays wait in queues at treelets"),
            ("OFF", "Off", "Each ray visits the whole tree at once: fastest where the scene fits in memory"),
            ("REFERENCE", "Reference", "As off, with Warp's own tree: what the others are measured against"),
        ),
    )  # fmt: skip
    ray_sort: str = setting(
        "AUTO", "Sort Rays", "Sort rays by direction and origin before they are traced",
        group="PERFORMANCE", effect="schedule", auto="AUTO",
        choices=(
            ("AUTO", "Automatic", "Where that was measured to save time, by kind of ray"),
            ("ON", "On", "Always, but for rays that wait for geometry beyond memory: these are traced in the order of their paths"),
            ("OFF", "Off", "Never"),
        ),
    )
    tile_size: int = setting(
        0, "Tile Size", "Edge of the square tiles in which the frame is rendered and shown; 0 chooses by device",
        group="PERFORMANCE", effect="schedule", unit="pixels", minimum=0, maximum=65_536, auto=0,
    )
    spatial_splits: str = setting(
        "AUTO", "Spatial Splits", "Split triangles among the boxes of the tree: a slower build for faster rays where large or long triangles overlap",
        group="PERFORMANCE", effect="schedule", auto="AUTO",
        choices=(
            ("AUTO", "Automatic", "On the CPU, but for meshes that move from frame to frame: their trees follow them. On CUDA trees are built on the device, without splits"),
            ("OFF", "Off", "Each triangle is in one box"), ("ON", "On", "Triangles may be in several boxes (Stich et al. 2009). On CUDA the CPU builds the tree then"),
        ),  # fmt: skip
    )
    counters: str = setting(
        "OFF", "Counters", "Count the steps of every ray, by kind and bounce, and time each stage; the render takes longer",
        group="PERFORMANCE", effect="schedule",
        choices=(("OFF", "Off", "Nothing is counted, and nothing is paid for it"), ("ON", "On", "For the statistics and the passes that show cost")),
    )

    ray_count: int = setting(
        0, "Rays Alive", "Paths alive at once in all workers together; 0 chooses by device and scene. The panel's memory estimate tells what each takes",
        group="SCHEDULER", effect="schedule", unit="paths", minimum=0, maximum=2**28, auto=0,
    )
    ray_low_water: float = setting(
        0.75, "Low Water", "New paths are generated when fewer than this share of Rays Alive is left",
        group="SCHEDULER", effect="schedule", unit="of rays alive", minimum=0.0, maximum=1.0,
    )
    ray_high_water: float = setting(
        1.0, "High Water", "Share of Rays Alive up to which new paths are generated",
        group="SCHEDULER", effect="schedule", unit="of rays alive", minimum=0.0, maximum=1.0,
    )
    sample_order: str = setting(
        "FRAME_FIRST", "Sample Order", "Which path is generated next",
        group="SCHEDULER", effect="schedule",
        choices=(
            ("FRAME_FIRST", "Frame first", "One sample of every pixel of the tile, then the next sample"),
            ("PIXEL_FIRST", "Pixel first", "All samples of a pixel, then the next pixel"),
        ),
    )
    bucket_selection: str = setting(
        "AUTO", "Next Bucket", "Which bucket is served next: a treelet has one, with the rays that wait to enter it and those that left it",
        group="SCHEDULER", effect="schedule", auto="AUTO",
        choices=(
            ("AUTO", "Automatic", "By device"),
            ("MOST_FULL", "Most full", "The one in which most rays wait"),
            ("NEXT", "Next", "The one behind the last, in turn, that is not empty"),
            ("RANDOM", "Random", "Any that is not empty, from random numbers that repeat"),
            ("ALL", "All", "Every bucket in each step, in one sorted sweep"),
        ),
    )
    bucket_wait_max: int = setting(
        0, "Longest Wait", "Steps of the scheduler after which a bucket is served before all fuller ones; 0 lets rays wait as long as it takes",
        group="SCHEDULER", effect="schedule", unit="steps", minimum=0, maximum=INT_MAX,
    )
    top_level_traversal: str = setting(
        "NAIVE", "Top Level", "How the rays of a warp go through what is above the treelets. Not used on the CPU",
        group="SCHEDULER", effect="schedule",
        choices=(
            ("NAIVE", "Naive", "A lane takes the next ray as soon as its own is through"),
            ("INTERLOCKED", "Interlocked", "Lanes take new rays together, when all of their rays are through"),
        ),
    )

    queue_size: int = setting(
        0, "Block Size", "Rays that a block of a queue holds; 0 chooses by device and treelets",
        group="QUEUES", effect="schedule", unit="rays", minimum=0, maximum=2**24, auto=0,
    )
    queue_count: int = setting(
        0, "Blocks", "Blocks that all queues of a worker share; 0 chooses enough for Rays Alive. Where they run out, the fullest bucket is served first",
        group="QUEUES", effect="schedule", unit="blocks", minimum=0, maximum=2**28, auto=0,
    )
    ray_storage: str = setting(
        "INDIRECT", "Storage", "What queues hold of a ray",
        group="QUEUES", effect="schedule",
        choices=(
            ("INDIRECT", "Indirect", "Its number: 4 bytes, and its state stays where it is"),
            ("DIRECT", "Direct", "Its whole state for traversal, copied: rays of a queue lie side by side, and take more memory"),
        ),
    )
    debug_checks: str = setting(
        "OFF", "Check Queues", "Check after each step that every ray is in exactly one place and all counts agree; slow",
        group="QUEUES", effect="schedule",
        choices=(("OFF", "Off", "Nothing is checked, and nothing is paid for it"), ("ON", "On", "The render fails with what is wrong")),
    )

    treelet_size: int = setting(
        0, "Nodes at Most", "Most nodes of a treelet; 0 chooses by device. Nodes at Least comes first: where it keeps a node closed, a treelet is larger. "
        "As many as the tree has make it one treelet, as a control",
        group="TREELETS", effect="schedule", unit="nodes", minimum=0, maximum=INT_MAX, auto=0,
    )
    treelet_size_min: int = setting(
        1, "Nodes at Least", "No node is opened whose child would be a smaller treelet than this: it comes before Nodes at Most",
        group="TREELETS", effect="schedule", unit="nodes", minimum=1, maximum=INT_MAX,
    )
    treelet_bytes: int = setting(
        0, "Bytes at Most", "Most memory of a treelet's nodes and triangles, such as a cache's size; 0 chooses by device, or sets no limit where Nodes at Most is given",
        group="TREELETS", effect="schedule", unit=BYTES, minimum=0, maximum=INT_MAX, auto=0,
    )
    top_level_depth_max: int = setting(
        64, "Top Level Depth", "Levels of a mesh's tree that are above its treelets at most",
        group="TREELETS", effect="schedule", unit="levels", minimum=1, maximum=1024,
    )

    warp_count: int = setting(
        0, "Warps", "Warps that are launched, of 32 lanes each; 0 launches all that the device holds. On the CPU: slices of a list of rays, traced one after another",
        group="LAUNCH", effect="schedule", unit="warps", minimum=0, maximum=2**20, auto=0,
    )
    single_lane: str = setting(
        "OFF", "Single Lane", "Trace on one lane alone, one ray after another; slow",
        group="LAUNCH", effect="schedule",
        choices=(("OFF", "Off", "All lanes work"), ("ON", "On", "For debugging")),
    )
    register_cap: int = setting(
        0, "Registers", "Most registers of a thread (CUDA's maxrregcount); 0 lets the compiler choose. Not used on the CPU",
        group="LAUNCH", effect="schedule", unit="registers", minimum=0, maximum=255, least=16, auto=0,
    )
    block_size: int = setting(
        0, "Block Width", "Threads of a block; 0 chooses. Not used on the CPU",
        group="LAUNCH", effect="schedule", unit="threads", minimum=0, maximum=1024, multiple=32, auto=0,
    )

    geometry_budget: int = setting(
        0, "Geometry", "Memory that trees and triangles may take on the device; the rest waits behind it. 0: all of it where it fits, else what rays leave free",
        group="MEMORY", effect="schedule", unit=BYTES, minimum=0, maximum=2**62, auto=0,
    )
    geometry_store: str = setting(
        "AUTO", "Behind It", "Where geometry is kept that is not on the device",
        group="MEMORY", effect="schedule", auto="AUTO",
        choices=(
            ("AUTO", "Automatic", "Host memory of a CUDA device where that is large enough, else disk"),
            ("HOST", "Host memory", "The host's memory, page-locked for a CUDA device"),
            ("DISK", "Disk", "A file beside the cache of compiled kernels, written once and used again"),
        ),
    )

    def __post_init__(self):
        for info in SETTINGS.values():
            object.__setattr__(self, info.name, checked(info, getattr(self, info.name)))
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
                f"treelet_size_min ({self.treelet_size_min}) is above treelet_size ({self.treelet_size}): no treelet could have so many nodes; "
                "lower treelet_size_min, or raise treelet_size (0 lets RayBatch choose)"
            )
        if self.queue_size * self.queue_count > INT_MAX:
            return (
                f"queue_count ({self.queue_count}) times queue_size ({self.queue_size}) is {self.queue_size * self.queue_count:,} places for rays, "
                f"and {INT_MAX:,} can be numbered; lower one of the two, or set queue_count to 0"
            )
        return None

    def _complaint_of_launches(self) -> str | None:
        """Why a kernel could not be launched so."""
        if self.single_lane == "ON" and self.warp_count > 1:
            return (
                f"single_lane is ON, so one lane of one warp works, but warp_count is {self.warp_count}; "
                "set warp_count to 0 or 1, or single_lane to OFF"
            )
        if block_registers(self.register_cap, self.block_size or BLOCK_SIZE) > REGISTERS_MAX:
            return (
                f"register_cap ({self.register_cap}) times block_size ({self.block_size}) is more than the {REGISTERS_MAX:,} registers "
                f"that a block of threads can have, and a thread gets them in steps of {REGISTER_STEP}; lower one of the two, or set it to 0"
            )
        return None

    def _complaint_of_memory(self) -> str | None:
        """Why geometry could not be kept so."""
        if self.geometry_budget and self.batching in ("OFF", "REFERENCE"):
            why = "Warp's own tree is" if self.batching == "REFERENCE" else "without queues rays need the whole tree"
            return (
                f"batching is {self.batching}, and {why} on the device at once, but geometry_budget ({self.geometry_budget} bytes) lets a part of it "
                "wait elsewhere; set geometry_budget to 0, or batching to AUTO or ON"
            )
        return None

    @property
    def half_count(self) -> int:
        """In how many films samples come: 2 where the error is estimated."""
        return 2 if self.error_estimate == "ON" or self.error_target > 0 else 1

    def replace(self, **changes: Any) -> RenderSettings:
        """A copy with `changes`; raises `SettingsError` for an unknown name or an illegal value."""
        for name in changes:
            setting_info(name)
        return dataclasses.replace(self, **changes)


def block_registers(register_cap: int, block_size: int) -> int:
    """Registers that a block of `block_size` threads takes, each with up to `register_cap`; 0 where they are not capped."""
    return -(-register_cap // REGISTER_STEP) * REGISTER_STEP * block_size


def setting_info(name: str, beside: Iterable[str] = ()) -> SettingInfo:
    """The `SettingInfo` of `name`; raises `SettingsError` that names the closest ones, and lists all, those `beside` the settings too."""
    try:
        return SETTINGS[name]
    except KeyError:
        names = sorted((*SETTINGS, *beside))
        close = difflib.get_close_matches(name.lower().replace("-", "_"), names)
        hint = f"did you mean {' or '.join(close)}? The" if close else "the"
        raise SettingsError(f"no setting is called {name!r}; {hint} settings are {', '.join(names)}") from None


def parse_setting(name: str, text: str, beside: Iterable[str] = ()) -> Any:
    """The value of setting `name` written as `text` on a command line; raises `SettingsError`. What else has a name there is `beside`."""
    return checked(setting_info(name, beside), text)


SETTINGS: dict[str, SettingInfo] = infos_of(RenderSettings)
