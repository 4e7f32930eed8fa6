"""Entries of a scene whose mesh trees are built in chunks: every instance of a mesh has one for each chunk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scene.flatten import FlatGeometry, Merged
from .entries import Entries, entries_of


@dataclass(frozen=True)
class ChunkInstances:
    """Which baked instances have triangles in which chunk. Chunks of meshes that are placed more often have none."""

    first: np.ndarray  # int64, shape [chunk_count + 1]
    place: np.ndarray  # int32: in `Merged.instance` of the chunk's group, rising

    @staticmethod
    def of(places: list[np.ndarray]) -> ChunkInstances:
        """Of the places of each chunk."""
        first = np.cumsum([0, *(len(each) for each in places)], dtype=np.int64)
        return ChunkInstances(first, np.concatenate([np.zeros(0, np.int32), *places]).astype(np.int32))


def instances_in(group: Merged, faces: np.ndarray) -> np.ndarray:
    """Places in `group.instance` of those that have any of the triangles `faces` of the group, which rise."""
    ends = np.append(np.searchsorted(faces, group.instance_triangle_first), len(faces))
    return np.flatnonzero(np.diff(ends)).astype(np.int32)


def chunk_entries(flat: FlatGeometry, visibility: np.ndarray, chunk_first: np.ndarray, baked: ChunkInstances) -> Entries:
    """As `entries_of`, over chunks in place of mesh trees.

    Args:
        chunk_first: first chunk of each of `mesh_parts`, then their count, int64.
        baked: of all chunks.
    """
    whole = entries_of(flat, visibility)
    count = np.diff(chunk_first)[whole.mesh]
    source = np.repeat(np.arange(len(whole.mesh)), count)
    chunk = np.arange(len(source)) - np.repeat(np.cumsum(count) - count - chunk_first[whole.mesh], count)
    instance = whole.instance[source]
    held, held_instance, held_first = np.zeros(len(source), np.int64), [], []
    # groups are the first entries, and in their order the first parts
    for e in range(int(np.count_nonzero(whole.instance[source] < 0))):
        group = flat.merged[source[e]]
        places = baked.place[baked.first[chunk[e]] : baked.first[chunk[e] + 1]]
        if len(places) == 1 and group.instance_triangle_first[places[0]] == 0:
            instance[e] = group.instance[places[0]]  # its triangles have the same numbers
            continue
        held[e] = len(places)
        held_instance.append(group.instance[places])
        held_first.append(group.instance_triangle_first[places])
    none = np.zeros(0, np.int32)
    return Entries(
        mesh=chunk,
        instance=instance,
        visibility=whole.visibility[source],
        to_world=whole.to_world[source],
        from_world=whole.from_world[source],
        merged_first=np.concatenate([[0], np.cumsum(held)]),
        merged_instance=np.concatenate([none, *held_instance]),
        merged_triangle_first=np.concatenate([none, *held_first]),
    )
