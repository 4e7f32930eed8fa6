"""What rays read: of each ray the nodes and triangles of a quantised tree, in the order in which it comes to them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from benchmarking.orders import sort_keys
from lib.command import UsageError

NODE_WORDS, TRIANGLE_WORDS = 5, 3  # of 16 bytes (`core/bvh/node.py`)
WORD_BYTES, SECTOR_BYTES = 16, 32
FORMAT = 1


@dataclass(frozen=True, kw_only=True)
class Traces:
    """Items that rays read. An item is a node n >= 0, or ~t for a triangle t."""

    items: np.ndarray  # int32, ray after ray
    first: np.ndarray  # int64, shape [ray_count + 1]: where a ray's items begin
    node_count: int
    triangle_count: int
    origin: np.ndarray  # of the rays [m], float32, shape [ray_count, 3]
    direction: np.ndarray  # float32, shape [ray_count, 3]

    @property
    def ray_count(self) -> int:
        """How many rays there are."""
        return len(self.first) - 1

    @property
    def lengths(self) -> np.ndarray:
        """Items of each ray, int64."""
        return np.diff(self.first)

    def taken(self, order: np.ndarray) -> Traces:
        """The rays `order`, indices, in that order."""
        lengths = self.lengths[order]
        first = np.concatenate([[0], np.cumsum(lengths)])
        where = np.repeat(self.first[:-1][order] - first[:-1], lengths) + np.arange(first[-1])
        return replace(
            self, items=self.items[where], first=first, origin=self.origin[order], direction=self.direction[order]
        )

    def order(self, name: str) -> np.ndarray:
        """Indices of rays: `natural`, `shuffled` or `sorted`, as `benchmarking/orders.py` has them."""
        if name == "natural":
            return np.arange(self.ray_count)
        if name == "shuffled":
            return np.random.default_rng(1).permutation(self.ray_count)
        return np.argsort(sort_keys(self.origin, self.direction), kind="stable")

    def save(self, path: Path) -> None:
        """Write an NPZ archive."""
        np.savez_compressed(path, format=FORMAT, **vars(self))


def load_traces(path: Path) -> Traces:
    """What `Traces.save` wrote; raises `UsageError`."""
    try:
        with np.load(path) as file:
            found = {name: file[name] for name in file.files}
        if int(found.pop("format")) != FORMAT:
            raise ValueError
        counts: dict[str, Any] = {name: int(found.pop(name)) for name in ("node_count", "triangle_count")}
        traces = Traces(**found, **counts)
        if traces.first[-1] != len(traces.items) or len(traces.origin) != traces.ray_count:
            raise ValueError
    except (OSError, ValueError, KeyError, TypeError, EOFError):
        raise UsageError(f"{path} holds no traces of this version: record them again") from None
    return traces


@dataclass(frozen=True)
class Addresses:
    """Where items lie in memory, in words of 16 bytes."""

    node: np.ndarray  # int32, shape [node_count]: the first word of each node
    triangle: np.ndarray  # int32, shape [triangle_count]
    word_count: int  # of all there is

    @property
    def byte_count(self) -> int:
        """Of nodes and triangles together."""
        return self.word_count * WORD_BYTES

    def spans(self, items: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First word of each of `items`, and the word behind its last."""
        is_node = items >= 0
        first = np.where(is_node, self.node[np.where(is_node, items, 0)], 0)
        if len(self.triangle):
            first = np.where(is_node, first, self.triangle[np.where(is_node, 0, ~items)])
        return first, first + np.where(is_node, NODE_WORDS, TRIANGLE_WORDS)

    def parts(self, items: np.ndarray, part_bytes: int) -> tuple[np.ndarray, np.ndarray]:
        """Sectors or lines, parts of memory of so many bytes, that `items` read one after another; and how many of
        them each item reads.
        """
        begin, end = self.spans(items)
        words = part_bytes // WORD_BYTES
        low, counts = begin // words, (end - 1) // words - begin // words + 1
        ends = np.cumsum(counts)
        return np.repeat(low - (ends - counts), counts) + np.arange(ends[-1] if len(ends) else 0), counts


def tree_addresses(node_count: int, triangle_count: int) -> Addresses:
    """As the tree lies on a device: all nodes, and all triangles from the next line of 128 bytes on."""
    begin = -(-node_count * NODE_WORDS // 8) * 8
    node = np.arange(node_count, dtype=np.int32) * NODE_WORDS
    triangle = begin + np.arange(triangle_count, dtype=np.int32) * TRIANGLE_WORDS
    return Addresses(node, triangle.astype(np.int32), begin + triangle_count * TRIANGLE_WORDS)
