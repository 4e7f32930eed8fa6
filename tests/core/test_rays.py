"""Lists of rays on the way to kernels."""

from dataclasses import replace

import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.rays import NO_ANY_HIT, DeviceRayList, RayList, fill_list


@wp.kernel(**KERNEL_OPTIONS)
def read_kernel(listed: DeviceRayList, found: wp.array(dtype=int)):
    found[0] = listed.slots[0]
    found[1] = listed.count[0]
    found[2] = listed.locations[0]
    found[3] = listed.any_first


def test_a_kept_list_holds_what_it_was_filled_with_last():
    """Whatever stayed the same from one fill to the next."""

    def array(value: int) -> wp.array:
        return wp.array([value], dtype=int, device="cpu")

    first = RayList(array(1), array(2), 1, array(3))
    filled = [
        (first, NO_ANY_HIT, [1, 2, 3, NO_ANY_HIT]),
        (first, NO_ANY_HIT, [1, 2, 3, NO_ANY_HIT]),
        (first, 7, [1, 2, 3, 7]),
        (replace(first, slots=array(4)), 7, [4, 2, 3, 7]),
        (replace(first, count=array(5)), 0, [1, 5, 3, 0]),
        (replace(first, locations=array(6)), 0, [1, 2, 6, 0]),
        (replace(first, slots=array(8), locations=None), 7, [8, 2, 6, 7]),
    ]
    listed, found = DeviceRayList(), wp.zeros(4, dtype=int, device="cpu")
    command = None
    for rays, any_first, expected in filled:
        fill_list(listed, rays, any_first)
        # a recorded launch sees what the struct holds now
        command = command or wp.launch(read_kernel, 1, [listed, found], device="cpu", record_cmd=True)
        command.launch()
        assert found.numpy().tolist() == expected
