"""How the kernels of traversals are launched."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import warp as wp

from ...bvh.traverse.cuda import persistent_count
from ...device.kernel import KERNEL_OPTIONS, with_block_size
from ...settings.device import TRACE_BLOCK_SIZE
from ...settings.settings import RenderSettings

WARP_SIZE = 32


@dataclass(frozen=True, kw_only=True)
class Launch:
    """Schedule settings of one device's launches: they change time, never a hit. On CPUs `register_cap` and
    `block_size` are not used. `RenderSettings` checks their values.
    """

    # 32 x so many lanes share the work (CPU, BOXES: so many slices, one after another); 0: as suits the device
    warp_count: int = 0
    single_lane: bool = False  # one ray at a time in the whole device, for debugging
    register_cap: int = 0  # most registers of a lane, 16..255; 0: as the compiler likes
    block_size: int = TRACE_BLOCK_SIZE  # lanes of a block: 32..1024, a multiple of 32

    @staticmethod
    def of(settings: RenderSettings) -> Launch:
        """What the settings of the group LAUNCH ask for."""
        return Launch(
            warp_count=settings.warp_count,
            single_lane=settings.is_on("single_lane"),
            register_cap=settings.register_cap,
            block_size=settings.block_size or Launch.block_size,
        )

    def lane_count(self, ray_bound: int, device: wp.Device) -> int:
        """Lanes to launch for at most `ray_bound` rays that are handed out to persistent warps. On a CPU one lane
        traces all rays.
        """
        if not device.is_cuda:
            return 1
        if self.single_lane:
            return WARP_SIZE
        if self.warp_count:
            return WARP_SIZE * self.warp_count
        return persistent_count(ray_bound, device, self.block_size)

    @property
    def slice_count(self) -> int:
        """On a CPU, BOXES: slices of a list that are traced one after another."""
        return max(1, self.warp_count)

    def block_size_on(self, device: wp.Device) -> int:
        """The `block_dim` of launches."""
        return self.block_size if device.is_cuda else 1

    def declare(self, kernel: wp.Kernel) -> wp.Kernel:
        """`kernel` as it is compiled for these launches: the same, or one of its own where registers are capped."""
        if self.register_cap:
            kernel = _capped(kernel, self.register_cap)
        return with_block_size(kernel, self.block_size)


@functools.cache
def _capped(kernel: wp.Kernel, registers: int) -> wp.Kernel:
    return wp.kernel(**KERNEL_OPTIONS, cuda_max_registers=registers)(kernel.func)


@wp.func
def slice_first(count: int, part: int, part_count: int) -> int:
    """First of `count` things that belongs to `part` of `part_count` parts of equal size."""
    return int(wp.int64(count) * wp.int64(part) / wp.int64(part_count))
