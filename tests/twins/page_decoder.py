"""Packed triangles of pages expanded in NumPy, as the kernel expands them."""

import numpy as np

from raybatch_addon.core.bvh.node import QUANTISED_TRIANGLE


def decode_triangles(words: np.ndarray) -> np.ndarray:
    """The triangles of packed `words`, uint32: float32 [n, 12]."""
    count, bits, wide, table_at, corners_at, faces_at, vertices_at = (int(word) for word in words[:7])
    block = np.arange(count) >> bits
    table = words[table_at:corners_at].reshape(-1, 2)[block].astype(np.int64)
    packed = words[corners_at : corners_at + count]
    high = words[faces_at:vertices_at].view(np.uint32 if wide else np.uint16)[:count].astype(np.int64)
    vertices = words[vertices_at:].view(np.float32)
    vertices = vertices[: len(vertices) // 3 * 3].reshape(-1, 3)
    triangles = np.zeros((count, 12), np.float32)
    fields = triangles.view(QUANTISED_TRIANGLE)[:, 0]
    for k, name in enumerate("abc"):
        fields[name] = vertices[table[:, 0] + (packed >> 8 * k & 255)]
    fields["face"] = table[:, 1] + (high << 8 | packed >> 24)
    return triangles
