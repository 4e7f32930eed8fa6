"""Entries of a scene whose mesh trees are built in chunks: every instance of a mesh has one for each chunk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...scene.flatten import FlatGeometry, Merged
from ..build.entries import Entries, entries_at, int32_joined, placed_meshes


@dataclass(frozen=True)
class ChunkInstances:
    """Which baked instances have triangles in which chunk. Chunks of meshes that are placed more often have none."""

    first: np.ndarray  # int64, shape [chunk_count + 1]
    place: np.ndarray  # int32: indices in `Merged.instance` of the chunk's group, rising

    @staticmethod
    def of(indices: list[np.ndarray]) -> ChunkInstances:
        """The instances of all chunks, from the indices of each."""
        first = np.cumsum([0, *(len(each) for each in indices)], dtype=np.int64)
        return ChunkInstances(first, np.concatenate([np.zeros(0, np.int32), *indices]).astype(np.int32))


def instances_in(group: Merged, faces: np.ndarray) -> np.ndarray:
    """Places in `group.instance` of those that have any of the triangles `faces` of the group, which rise."""
    ends = np.append(np.searchsorted(faces, group.instance_triangle_first), len(faces))
    return np.flatnonzero(np.diff(ends)).astype(np.int32)


def chunk_entries(
    flat: FlatGeometry, visibility: np.ndarray, chunk_first: np.ndarray, baked: ChunkInstances
) -> Entries:
    """Entries as those of `entries_of`, over chunks instead of mesh trees.

    Args:
        chunk_first: first chunk of each of `mesh_parts`, then their count, int64.
        baked: of all chunks.
    """
    mesh, instance, seen = placed_meshes(flat, visibility)
    count = np.diff(chunk_first)[mesh]
    source = np.repeat(np.arange(len(mesh), dtype=np.int32), count)
    chunk = np.arange(len(source)) - np.repeat(np.cumsum(count) - count - chunk_first[mesh], count)
    instance = instance[source]
    held, held_instance, held_first = np.zeros(len(source) + 1, np.int32), [], []
    # groups are the first entries, and in their order the first parts
    for e in range(int(np.count_nonzero(instance < 0))):
        group = flat.merged[source[e]]
        indices = baked.place[baked.first[chunk[e]] : baked.first[chunk[e] + 1]]
        if len(indices) == 1 and group.instance_triangle_first[indices[0]] == 0:
            instance[e] = group.instance[indices[0]]  # its triangles have the same numbers
            continue
        held[e + 1] = len(indices)
        held_instance.append(group.instance[indices])
        held_first.append(group.instance_triangle_first[indices])
    return entries_at(
        flat,
        mesh=chunk.astype(np.int32),
        instance=instance,
        visibility=seen[source],
        merged_first=np.cumsum(held, dtype=np.int32),
        merged_instance=int32_joined(*held_instance),
        merged_triangle_first=int32_joined(*held_first),
    )
