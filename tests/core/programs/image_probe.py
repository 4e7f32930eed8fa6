"""Run of an op that reads images, at many coordinates."""

import functools

import numpy as np
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.programs.op import NodeData, op_named
from raybatch_addon.core.programs.point import ShadingPoint
from raybatch_addon.core.shading.images.image_upload import ImageCache
from tests.support.under_test import DEVICE


@functools.cache
def _kernel(name: str):
    function = op_named(name).function

    @wp.kernel(**KERNEL_OPTIONS)
    def run(data: NodeData, values: wp.array2d(dtype=float), out: wp.array2d(dtype=float)):
        i = wp.tid()
        stack = wp.zeros(16, dtype=float)
        for k in range(values.shape[1]):
            stack[k] = values[i, k]
        function(data, stack, 0, ShadingPoint())
        for k in range(4):
            out[i, k] = stack[8 + k]

    return run


def run_image_op(name: str, images, words, *vectors, constants=()) -> np.ndarray:
    """Colour and alpha, float64 [n, 4], of the op whose first words are `words`.

    Its vector operands are `vectors`, each [n, 3].
    """
    uploaded = ImageCache().upload(images, DEVICE)
    values = np.concatenate([np.asarray(each, np.float32).reshape(-1, 3) for each in vectors], 1)
    data = NodeData()
    code = [0, *(int(word) for word in words), *(3 * k for k in range(len(vectors))), 8, 11]
    data.code = wp.array(code, dtype=int, device=DEVICE)
    data.constants = wp.array(np.asarray(constants, np.float32), dtype=float, device=DEVICE)
    data.images = uploaded.table
    out = wp.zeros((len(values), 4), dtype=float, device=DEVICE)
    wp.launch(
        _kernel(name),
        len(values),
        [data, wp.array(np.ascontiguousarray(values), dtype=float, device=DEVICE), out],
        device=DEVICE,
    )
    return out.numpy().astype(float)
