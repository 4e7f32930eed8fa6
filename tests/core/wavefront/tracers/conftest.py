"""Fixtures of the tests of tracers."""

import pytest

from raybatch_addon.core.bvh.pages.residency import Residency, page_transfer
from tests.core.wavefront.tracers.paged_rays import device


@pytest.fixture
def open_pool():
    """Opens pools with so many places for pages of a scene, and `more` bytes; they are closed when the test ends."""
    pools: list[Residency] = []

    def opened(paged, slots: int, more: int = 0, make_transfer=page_transfer) -> Residency:
        pools.append(
            Residency(paged, paged.resident_bytes + slots * paged.page_bytes_max + more, device(), make_transfer)
        )
        return pools[-1]

    yield opened
    for pool in pools:
        pool.close()
