"""Whether a render batches, and where its geometry lies: by counts, memory and settings alone, each choice with its
reason.
"""

import dataclasses
import math
import re

import pytest

from raybatch_addon.core.bvh.memory import COPY_BYTES, NODES_OVER_TIME, TREE_BYTES_MOST, GeometrySize
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.plan.cost_model import split_seconds
from raybatch_addon.core.wavefront.plan.plan import (
    PAGED_SHARE,
    TREELET_BYTES,
    Memory,
    Method,
    TracingPlan,
    plan_tracing,
    report_of,
)

GB = 10**9
TRIANGLES = 10**7
LAYOUTS = [(Layout.BOXES, False), (Layout.QUANTISED, True)]


def plan_of(
    layout: Layout, is_cuda: bool, needed: int = GB, free: int = 100 * GB, host_free: int = 100 * GB, **settings
) -> TracingPlan:
    size = GeometrySize(TRIANGLES, TRIANGLES // 2, TRIANGLES, smooth=True)
    return plan_tracing(RenderSettings(**settings), size, layout, is_cuda, Memory(needed, free, host_free))


@pytest.mark.parametrize(("layout", "is_cuda"), LAYOUTS)
def test_what_is_asked_for_is_done(layout, is_cuda):
    assert plan_of(layout, is_cuda, batching="REFERENCE") == TracingPlan(Method.REFERENCE)
    off = plan_of(layout, is_cuda, needed=200 * GB, batching="OFF", spatial_splits="OFF")
    assert off == TracingPlan(Method.UNBATCHED)
    batched = plan_of(layout, is_cuda, batching="ON")
    assert (
        batched.method is Method.BATCHED
        and batched.treelet_bytes == TREELET_BYTES[layout] == batched.choices["treelet_bytes"].value
    )
    own = plan_of(layout, is_cuda, batching="ON", treelet_size=800, spatial_splits="OFF")
    assert (own.treelet_size, own.treelet_bytes, own.choices) == (800, 0, {})


@pytest.mark.parametrize(("layout", "is_cuda"), LAYOUTS)
@pytest.mark.parametrize(("curves", "moving"), [(True, False), (False, True), (True, True)])
def test_curves_and_things_that_move_wait_like_all_others(layout, is_cuda, curves, moving):
    """But for Warp's own tree, which says that it cannot have them."""
    size = GeometrySize(TRIANGLES, TRIANGLES // 2, TRIANGLES, smooth=True, curves=curves, copies=moving * TRIANGLES)

    def plan_of(free: int, **settings) -> TracingPlan:
        return plan_tracing(RenderSettings(**settings), size, layout, is_cuda, Memory(GB, free, free), moving=moving)

    assert plan_of(100 * GB, batching="ON").method is Method.BATCHED
    assert plan_of(100 * GB, batching="AUTO", geometry_budget=GB // 10).method is Method.PAGED
    # a copy of each triangle counts, and so do nodes for ranges of time
    copies = COPY_BYTES[layout] * TRIANGLES * moving
    needed = (TREE_BYTES_MOST[layout] * TRIANGLES, copies, NODES_OVER_TIME * copies)
    assert plan_of(100 * GB, batching="ON", geometry_budget=sum(needed)).method is Method.BATCHED
    assert plan_of(100 * GB, batching="ON", geometry_budget=sum(needed) - 1).method is Method.PAGED
    reference = plan_of(100 * GB, batching="REFERENCE")
    assert reference.method is Method.UNBATCHED and "Warp's tree" in reference.choices["batching"].why
    assert "not REFERENCE" in reference.complaints[0]


@pytest.mark.parametrize(("layout", "is_cuda"), LAYOUTS)
@pytest.mark.parametrize("batching", ["AUTO", "ON"])
def test_what_does_not_fit_is_brought_in_by_pages(layout, is_cuda, batching):
    """The whole of what is free is not enough for a scene that needs nearly as much, and rays."""
    plan = plan_of(layout, is_cuda, needed=90 * GB, free=100 * GB, batching=batching)
    assert (
        plan.method is Method.PAGED
        and plan.geometry_budget == int(100 * GB * PAGED_SHARE) == plan.choices["geometry_budget"].value
    )
    assert plan.geometry_store == ("HOST" if is_cuda else "DISK") == plan.choices["geometry_store"].value
    assert ("batching" in plan.choices) == (batching == "AUTO")
    assert plan_of(layout, is_cuda, needed=84 * GB, free=100 * GB, batching=batching).method is not Method.PAGED


@pytest.mark.parametrize(("layout", "is_cuda"), LAYOUTS)
def test_a_budget_counts_the_tree_alone(layout, is_cuda):
    tree = TREE_BYTES_MOST[layout] * TRIANGLES
    whole, paged = (plan_of(layout, is_cuda, batching="ON", geometry_budget=budget) for budget in (tree, tree - 1))
    assert (whole.method, paged.method) == (Method.BATCHED, Method.PAGED)
    assert paged.geometry_budget == tree - 1 and "geometry_budget" not in paged.choices


def test_pages_lie_on_disk_where_the_host_has_no_room():
    found = plan_of(Layout.QUANTISED, True, needed=90 * GB, host_free=GB // 2, batching="ON")
    assert found.geometry_store == "DISK" and "500 MB free" in found.choices["geometry_store"].why
    assert (
        plan_of(
            Layout.QUANTISED, True, needed=90 * GB, host_free=0, batching="ON", geometry_store="HOST"
        ).geometry_store
        == "HOST"
    )


def peers_plan(free: int = 100 * GB, peers: int = 2, apart: str = "", is_cuda: bool = True, **settings) -> TracingPlan:
    size = GeometrySize(TRIANGLES, TRIANGLES // 2, TRIANGLES, smooth=True)
    layout = Layout.QUANTISED if is_cuda else Layout.BOXES
    memory = Memory(90 * GB, free, 0, peers=peers, apart=apart)
    return plan_tracing(RenderSettings(batching="ON", **settings), size, layout, is_cuda, memory)


def test_devices_hold_pages_for_each_other_where_that_is_asked_for():
    """What that gains was not measured, so AUTO leaves it alone."""
    found = peers_plan(geometry_store="PEERS")
    assert found.geometry_store == "PEERS" and not found.complaints
    assert peers_plan().geometry_store == "DISK"
    assert peers_plan(geometry_store="HOST").geometry_store == "HOST"


def test_devices_that_cannot_hold_pages_for_each_other_say_why():
    why = "cuda:1 cannot read the memory of cuda:0"
    found = peers_plan(peers=1, apart=why, geometry_store="PEERS")
    assert found.geometry_store == "HOST" == found.choices["geometry_store"].value
    assert found.complaints == (f"geometry_store is HOST, not PEERS: {why}",)


@pytest.mark.parametrize(("layout", "is_cuda"), LAYOUTS)
def test_inside_memory_rays_go_alone_and_the_reason_is_reported(layout, is_cuda):
    """What was compared is reported: all that the scene needs, with what is free. People read numbers without powers of
    ten.
    """
    plan = plan_of(layout, is_cuda, needed=3 * GB)
    assert plan.method is Method.UNBATCHED
    why = report_of(plan.choices)["batching"]["why"]
    assert "3.00 GB, and the " in why and "has 100 GB free" in why
    assert len(re.findall(r"\b[\d,]+(?:\.\d+)? ns\b", why)) == 2 and "e+" not in why


def split_plan(layout=Layout.BOXES, samples=math.inf, **settings):
    size = GeometrySize(10**6, 10**6, 10**6, smooth=True)
    return plan_tracing(RenderSettings(**settings), size, layout, False, Memory(GB, 100 * GB, 100 * GB), samples)


def test_trees_split_triangles_where_the_render_is_long_enough():
    cost, gain = split_seconds(10**6, 10**6)
    break_even = math.ceil(10**6 * cost / gain)
    short, long, endless = (split_plan(samples=count) for count in (break_even - 1, break_even + 1, math.inf))
    assert [plan.splits for plan in (short, long, endless)] == [False, True, True]
    assert [plan.choices["spatial_splits"].value for plan in (short, long)] == ["OFF", "ON"]
    assert "2.5 s of processors" in short.choices["spatial_splits"].why
    assert not split_plan(Layout.QUANTISED).splits, "built on the device"
    assert split_plan(samples=1, spatial_splits="ON").splits and not split_plan(spatial_splits="OFF").splits
    assert "spatial_splits" not in split_plan(samples=1, spatial_splits="ON").choices
    paged = split_plan(geometry_budget=10**6)
    assert paged.method is Method.PAGED and not paged.splits


@pytest.mark.parametrize(("layout", "is_cuda"), LAYOUTS)
def test_instances_count(layout, is_cuda):
    """A budget that holds the triangles, and not what is known of ten million instances; and what is left of memory."""
    few = GeometrySize(TRIANGLES, TRIANGLES // 2, TRIANGLES, smooth=True)
    many = dataclasses.replace(few, instances=10**7, entries=10**7)
    budget = few.tree_bytes_most(layout) + GB // 10

    def plan_of(size: GeometrySize, beside: int = 0, needed: int = GB, **settings) -> TracingPlan:
        memory = Memory(needed, 100 * GB, 100 * GB, beside=beside)
        return plan_tracing(RenderSettings(**settings), size, layout, is_cuda, memory)

    assert plan_of(few, geometry_budget=budget).method is Method.UNBATCHED
    assert plan_of(many, geometry_budget=budget).method is Method.PAGED
    left, all_of_it = plan_of(many, 20 * GB, 200 * GB), plan_of(many, 0, 200 * GB)
    assert (left.geometry_budget, all_of_it.geometry_budget) == (40 * GB, 50 * GB)
    assert "beside 20.0 GB of instances" in left.choices["geometry_budget"].why
    assert "instances" not in all_of_it.choices["geometry_budget"].why
