"""Settings of the device: which one renders, how kernels are launched on it, and what geometry it holds."""

from __future__ import annotations

import os
from dataclasses import dataclass

from .info import BYTES, setting

# Threads of a block of the kernels that trace rays, where `block_size` is 0
TRACE_BLOCK_SIZE = 128


@dataclass(frozen=True, kw_only=True)
class DeviceSettings:
    """Where to render."""

    device: str = setting(
        "AUTO",
        "Device",
        "Where to render: AUTO (the first CUDA device, else the CPU), cpu, cuda:N, several of these with commas "
        "between, which share each picture, or ALL CUDA devices of the first one's model (the CPU where there is none)",
        group="DEVICE",
        effect="schedule",
        auto="AUTO",
    )
    thread_count: int = setting(
        0,
        "Threads",
        "Worker threads on the CPU; {rest} uses every core. Not used on CUDA devices",
        group="DEVICE",
        effect="schedule",
        unit="threads",
        minimum=0,
        maximum=1024,
        auto=0,
        start=os.cpu_count() or 1,
    )
    kernel_tier: str = setting(
        "AUTO",
        "Kernels",
        "Which kernels shade: the general ones are compiled once and render any scene, those specialised on the scene "
        "are faster and are compiled for each new combination of nodes and lights",
        group="DEVICE",
        effect="schedule",
        choices=(
            (
                "AUTO",
                "Auto",
                "Specialised ones that are compiled already, else the general ones; the specialised ones "
                "are compiled meanwhile where that pays, or after the render where Blender has a window",
            ),
            ("GENERAL", "General", "The general ones, for the whole render"),
            ("SPECIALISED", "Specialised", "The specialised ones; a render waits until they are compiled"),
        ),
        auto="AUTO",
    )


@dataclass(frozen=True, kw_only=True)
class LaunchSettings:
    """How the kernels that trace rays are compiled and launched."""

    warp_count: int = setting(
        0,
        "Warps",
        "Warps that are launched, of 32 lanes each; {rest} launches all that the device holds. On the CPU: slices of "
        "a list of rays, traced one after another",
        group="LAUNCH",
        effect="schedule",
        unit="warps",
        minimum=0,
        maximum=2**20,
        auto=0,
        start=64,
    )
    single_lane: str = setting(
        "OFF",
        "Single Lane",
        "Trace on one lane alone, one ray after another; slow",
        group="LAUNCH",
        effect="schedule",
        choices=(("OFF", "Off", "All lanes work"), ("ON", "On", "For debugging")),
    )
    register_cap: int = setting(
        0,
        "Max Registers",
        "Most registers of a thread (CUDA's maxrregcount); {rest} lets the compiler choose. Not used on the CPU",
        group="LAUNCH",
        effect="schedule",
        unit="registers",
        minimum=0,
        maximum=255,
        least=16,
        auto=0,
        start=64,
    )
    block_size: int = setting(
        0,
        "Block Width",
        "Threads of a block; {rest} chooses. Not used on the CPU",
        group="LAUNCH",
        effect="schedule",
        unit="threads",
        minimum=0,
        maximum=1024,
        multiple=32,
        auto=0,
        start=TRACE_BLOCK_SIZE,
    )


@dataclass(frozen=True, kw_only=True)
class MemorySettings:
    """How much of the scene's geometry and images is on the device, and where the rest is."""

    geometry_budget: int = setting(
        0,
        "Geometry",
        "Memory that trees and triangles may take on the device; the rest waits behind it. {rest}: all of it where it "
        "fits, else what rays leave free",
        group="MEMORY",
        effect="schedule",
        unit=BYTES,
        minimum=0,
        maximum=2**62,
        auto=0,
        start=10**9,
    )
    geometry_store: str = setting(
        "AUTO",
        "Overflow To",
        "Where geometry is kept that has no room on the device",
        group="MEMORY",
        effect="schedule",
        auto="AUTO",
        choices=(
            ("AUTO", "Auto", "Host memory of a CUDA device where that is large enough, else disk"),
            ("HOST", "Host RAM", "The host's memory, page-locked for a CUDA device"),
            ("DISK", "Disk", "A file beside the cache of compiled kernels, written once and used again"),
            # last: files of Blender keep the place in this list
            (
                "PEERS",
                "Other GPUs",
                "Memory of all devices of one model that render, each of which holds a share; the host's where that "
                "is not enough",
            ),
        ),
    )
    texture_budget: int = setting(
        0,
        "Images",
        "Memory that images of materials may take on the device; what has no room comes in tiles, for which rays wait. "
        "{rest}: all of them on the CPU, where they lie in its memory anyway; half of what is free on a GPU",
        group="MEMORY",
        effect="schedule",
        unit=BYTES,
        minimum=0,
        maximum=2**62,
        auto=0,
        start=10**9,
    )
    texture_tile_size: int = setting(
        128,
        "Image Tiles",
        "Edge of a tile of an image of four bytes a texel, a power of two; tiles of others have as many bytes. For "
        "images that have no room",
        group="MEMORY",
        effect="schedule",
        unit="texels",
        minimum=16,
        maximum=1024,
    )
