"""Copies of pages run beside launches, and none overwrites what a launch sees."""

import numpy as np
import pytest

from raybatch_addon.core.bvh.pages.residency import Residency
from raybatch_addon.core.rays import RayKind
from raybatch_addon.core.settings.settings import RenderSettings
from tests.core.wavefront.tracers.paged_rays import (
    ON_CPU,
    ONE,
    PATHS,
    list_of,
    new_rays,
    paged_of,
    require_right,
    run,
    tracer_of,
)


class NotedTransfer:
    """Fills slots at once, as a device may at the earliest, and notes what its streams were asked to do."""

    def __init__(self, scene, pool, slot_bytes, device):
        self.scene, self.memory, self.slot_bytes = scene, pool.numpy().reshape(-1), slot_bytes
        self.marks = 0  # launches so far
        self.fills: list[
            tuple[int, int, int, int]
        ] = []  # page, slot, launches that the copy waits for, launches so far
        self.completed: list[tuple[int, int]] = []  # page, launches before
        self.on_their_way = 0

    def fill(self, number, slot, used, arrived):
        page, start = self.scene.pages[number], slot * self.slot_bytes
        self.scene.store.read_into(page, self.memory[start : start + page.byte_count], direct=False)
        self.fills.append((number, slot, used or 0, self.marks))
        arrived(number, len(self.fills), None)

    def room(self):
        return 1000

    def mark(self):
        self.marks += 1
        return self.marks

    def complete(self, number, slot, filled):
        assert self.fills[filled - 1][:2] == (number, slot)
        self.completed.append((number, self.marks))

    def close(self):
        pass


def pipelined(open_pool, paged, slots: int, zero_copy: bool = False, monkeypatch=None):
    """A tracer that is run as on CUDA: counts are one step old, and copies are ordered by marks."""
    transfers, shown = [], []

    def make_transfer(*given):
        transfers.append(NotedTransfer(*given))
        return transfers[0]

    pool = open_pool(paged, slots, make_transfer=make_transfer)
    if zero_copy:
        monkeypatch.setattr(Residency, "has_zero_copy", True)
    rays = new_rays()
    tracer = tracer_of(pool, rays, settings=RenderSettings())
    tracer._lag = 1
    launch = tracer._stage.launch

    class Stage:
        def launch(self, *given):
            shown.append({page: int(pool._slot[page]) for page in tracer._view.shown})
            launch(*given)

    tracer._stage = Stage()
    return rays, tracer, transfers[0], shown


@ON_CPU
@pytest.mark.parametrize("slots", [1, 2, 3, 8])
def test_no_copy_overwrites_what_a_launch_sees(open_pool, slots):
    paged = paged_of(ONE, many=True)
    rays, tracer, transfer, shown = pipelined(open_pool, paged, slots)
    run(tracer)
    require_right(rays)
    assert len(shown) == transfer.marks > 3 and len(transfer.fills) > slots
    for page, slot, waits_for, launched in transfer.fills:
        saw = [i + 1 for i in range(launched) if slot in shown[i].values()]
        assert waits_for >= max(saw, default=0), f"page {page} is copied over what launch {max(saw)} sees"
    for i, pages in enumerate(shown):
        for page in pages:
            last = max(k for k, fill in enumerate(transfer.fills) if fill[0] == page and fill[3] <= i)
            assert any(
                number == page and transfer.fills[last][3] <= before <= i for number, before in transfer.completed
            ), "a launch sees a page that has not completed"


@ON_CPU
def test_copies_do_not_wait_for_the_launch_that_runs(open_pool):
    """What is chosen while launch i is under way is copied into slots that it does not see."""
    paged = paged_of(ONE, many=True)
    assert len(paged.pages) > 10
    _rays, tracer, transfer, _shown = pipelined(open_pool, paged, 8)
    tracer.submit(RayKind.CLOSEST, list_of(np.arange(PATHS)))
    tracer.submit(RayKind.OCCLUSION, list_of(PATHS + np.arange(PATHS)))
    for _ in range(12):
        tracer._step()
    behind = [launched - waits_for for _, _, waits_for, launched in transfer.fills]
    assert len(behind) > 8 and min(behind) >= 1


@ON_CPU
def test_too_few_rays_go_on_where_pages_lie(open_pool, monkeypatch):
    paged = paged_of(ONE)
    rays, tracer, _transfer, _shown = pipelined(open_pool, paged, 1, True, monkeypatch)
    run(tracer)
    require_right(rays)
    totals = tracer.totals()
    # a page of 31 kB is copied while 4 rays go on
    assert totals.rays_unbatched > 0 and totals.rays == totals.finished == 2 * PATHS
