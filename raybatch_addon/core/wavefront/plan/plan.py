"""How a render traces its rays: batched or not, where its geometry lies, and why (pure policy, without a device).

The setting `batching` decides; where it is AUTO, and for every setting that is left to RayBatch, a choice is made here
before memory is asked for, from counts of the scene, the memory that is free, and a small model of what rays cost
(`cost_model.py`). Every choice is reported with its reason.
"""

from __future__ import annotations

import enum
import math
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any

from ...bvh.build.scene_tree import splits_triangles
from ...bvh.memory import GeometrySize
from ...bvh.node import Layout
from ...bvh.treelets.cut import CutRule
from ...host_memory import size_text
from ...settings.settings import RenderSettings
from .cost_model import batching_cost, costs_of, split_seconds, unbatched_cost

# Shares of the free memory: a scene is kept whole where its geometry and the build take no more than the first; else
# the tree gets the second, and rays the rest
WHOLE_SHARE = 0.85
PAGED_SHARE = 0.5
# What instances take is said where it is no less than this share of what they leave
_BESIDE_LEAST = 0.01
# Share of the host's free memory that pages may take
HOST_SHARE = 0.7
# The queues of a GPU are swept bucket by bucket; a treelet of a CPU should fit its core's cache
TREELET_BYTES = {Layout.BOXES: 1 << 20, Layout.QUANTISED: 8 << 20}


class Method(enum.Enum):
    """How rays meet the scene."""

    REFERENCE = "Warp's own tree"
    UNBATCHED = "each ray visits the whole tree at once"
    BATCHED = "rays wait at treelets; all geometry is in memory"
    PAGED = "rays wait for pages of geometry that are brought in for many of them"


@dataclass(frozen=True)
class Choice:
    """The value chosen for a setting that was left to RayBatch."""

    value: Any
    why: str


@dataclass(frozen=True)
class TracingPlan:
    """The plan of a render: how its rays meet the scene, and with what memory."""

    method: Method
    _: KW_ONLY
    geometry_budget: int = 0  # PAGED: tree and triangles on the device [bytes]
    geometry_store: str = "HOST"  # PAGED: what is behind it
    treelet_bytes: int = 0  # BATCHED: most of a treelet's; 0: no limit
    treelet_size: int = 0  # most nodes of a treelet; 0: no limit
    choices: dict[str, Choice] = field(default_factory=dict)  # by setting
    splits: bool = False  # whether a tree that is built for this render splits triangles
    complaints: tuple[str, ...] = ()  # what is not as the settings ask for


def report_of(choices: dict[str, Choice]) -> dict[str, dict[str, Any]]:
    """The plan as the statistics hold it."""
    return {name: {"value": choice.value, "why": choice.why} for name, choice in choices.items()}


def has_tiers(settings: RenderSettings) -> bool:
    """Whether treelets are in large ones. With a cache, rays go on through all that it holds; the schedule STREAMING
    has queues at treelets alone.
    """
    return settings.treelet_tier_bytes > 0 and not settings.treelet_cache and settings.schedule != "STREAMING"


def cut_rule(plan: TracingPlan, settings: RenderSettings) -> CutRule:
    """Where trees are cut into treelets."""
    tier_bytes = settings.treelet_tier_bytes if plan.method is Method.BATCHED and has_tiers(settings) else 0
    sizes = plan.treelet_size, settings.treelet_size_min, settings.top_level_depth_max, plan.treelet_bytes
    return CutRule(*sizes, tier_bytes=tier_bytes)


@dataclass(frozen=True)
class Memory:
    """The memory that there is, and that a scene takes when it is kept whole [bytes]."""

    needed: int  # geometry, trees and their build, on the device
    free: int  # of the device
    host_free: int
    beside: int = 0  # what instances take of the device's where trees lie behind it
    peers: int = 1  # devices that render, where they can hold pages for each other
    apart: str = "one device renders"  # else why they cannot


def plan_tracing(
    settings: RenderSettings,
    size: GeometrySize,
    layout: Layout,
    is_cuda: bool,
    memory: Memory,
    samples: float = math.inf,
    moving: bool = False,
) -> TracingPlan:
    """The plan for a scene of `size`, of which `samples` are taken in all pixels together; `moving`: it has things that
    move.
    """
    plan = _plan_of_rays(settings, size, layout, is_cuda, memory)
    if plan.method is Method.REFERENCE and (size.curves or moving):
        has = "things that move" if moving else "hair, curves or points"
        why = f"the scene has {has}, and Warp's tree holds triangles that stand still alone"
        complaint = f"batching is OFF, not REFERENCE: {why}"
        plan = TracingPlan(Method.UNBATCHED, choices={"batching": Choice("OFF", why)}, complaints=(complaint,))
    if plan.method is Method.REFERENCE or settings.spatial_splits != "AUTO":
        return replace(plan, splits=settings.is_on("spatial_splits"))
    if not splits_triangles("AUTO", layout) or plan.method is Method.PAGED:
        choice = Choice("OFF", "the builder that is used here is faster without")
    else:
        cost, gain = split_seconds(size.triangles, samples)
        choice = Choice(
            "ON" if gain >= cost else "OFF",
            f"to split triangles is expected to take {cost:.2g} s of processors, and to save "
            + (f"{gain:.2g} s of rays" if math.isfinite(gain) else "more"),
        )
    return replace(plan, splits=choice.value == "ON", choices={**plan.choices, "spatial_splits": choice})


def _plan_of_rays(
    settings: RenderSettings, size: GeometrySize, layout: Layout, is_cuda: bool, memory: Memory
) -> TracingPlan:
    mode = settings.batching
    if mode == "REFERENCE":
        return TracingPlan(Method.REFERENCE)
    if mode == "OFF":
        return TracingPlan(Method.UNBATCHED)
    needed, free = memory.needed, memory.free
    tree = size.tree_bytes_most(layout)
    budget, choices = settings.geometry_budget, {}
    device = "the device" if is_cuda else "the machine"
    if budget:
        wanted = tree
        fits, why = tree <= budget, f"geometry_budget is {size_text(budget)}"
    else:
        budget = int(free * WHOLE_SHARE)
        wanted = max(tree, needed)
        fits, why = needed <= budget, f"{device} has {size_text(free)} free"
    if not fits:
        reason = f"the scene needs up to {size_text(wanted)}, and {why}"
        return _paged(settings, layout, is_cuda, tree, memory, reason)
    if mode == "ON":
        return _batched(settings, layout, choices)
    costs = costs_of(is_cuda)
    meshes = size.mesh_bytes_most(layout)
    unbatched, batched = unbatched_cost(costs, meshes), batching_cost(costs, meshes, TREELET_BYTES[layout])
    choices["batching"] = Choice(
        "OFF" if unbatched <= batched else "ON",
        f"the scene needs up to {size_text(wanted)}, and {why}; inside memory a ray is expected to take "
        f"{_time(unbatched)} unbatched, and "
        f"{_time(batched)} batched",
    )
    if unbatched <= batched:
        return TracingPlan(Method.UNBATCHED, choices=choices)
    return _batched(settings, layout, choices)


def _batched(settings: RenderSettings, layout: Layout, choices: dict[str, Choice]) -> TracingPlan:
    treelet_bytes = settings.treelet_bytes
    if not treelet_bytes and not settings.treelet_size:
        treelet_bytes = TREELET_BYTES[layout]
        where = "a core's cache" if layout is Layout.BOXES else "a share of the cache, with enough rays for each"
        choices["treelet_bytes"] = Choice(treelet_bytes, f"fits {where}")
    return TracingPlan(Method.BATCHED, treelet_bytes=treelet_bytes, treelet_size=settings.treelet_size, choices=choices)


def _paged(settings: RenderSettings, layout: Layout, is_cuda: bool, tree: int, memory: Memory, why: str) -> TracingPlan:
    budget, store, choices = settings.geometry_budget, settings.geometry_store, {}
    if settings.batching == "AUTO":
        choices["batching"] = Choice("ON", f"{why}: its geometry is brought in by pages")
    if not budget:
        left = max(memory.free - memory.beside, 0)
        budget = int(left * PAGED_SHARE)
        beside = f" beside {size_text(memory.beside)} of instances" if memory.beside >= _BESIDE_LEAST * left else ""
        choices["geometry_budget"] = Choice(
            budget, f"half of the {size_text(left)} that are free{beside}; the rest is for rays"
        )
    complaints = []
    if store == "PEERS" and memory.peers < 2:
        complaints = [f"geometry_store is HOST, not PEERS: {memory.apart}"]
        store, choices["geometry_store"] = "HOST", Choice("HOST", memory.apart)
    if store == "AUTO":
        store, reason = "DISK", "memory is the device here, and what does not fit in it lies on disk"
        if is_cuda:
            fits_host = tree <= memory.host_free * HOST_SHARE
            store, reason = (
                ("HOST" if fits_host else "DISK"),
                f"the host has {size_text(memory.host_free)} free, and pages need up to {size_text(tree)}",
            )
        choices["geometry_store"] = Choice(store, reason)
    treelet_bytes = settings.treelet_bytes
    if not settings.treelet_size and not treelet_bytes:
        why = "no limit: each page is brought in for all rays that wait for any part of it"
        if has_tiers(settings):
            treelet_bytes, why = (TREELET_BYTES[layout], "fits a cache: rays wait at treelets of pages")
        choices["treelet_bytes"] = Choice(treelet_bytes, why)
    return TracingPlan(
        Method.PAGED,
        geometry_budget=budget,
        geometry_store=store,
        treelet_bytes=treelet_bytes,
        treelet_size=settings.treelet_size,
        choices=choices,
        complaints=tuple(complaints),
    )


def _time(nanoseconds: float) -> str:
    return f"{nanoseconds:.2f} ns" if nanoseconds < 10 else f"{nanoseconds:,.0f} ns"
