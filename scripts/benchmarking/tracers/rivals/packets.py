"""Rivals that carry packets of rays through the tree of `off`."""

from __future__ import annotations

import warp as wp

from benchmarking.tracers.rivals.native_stage import PARTITION, RANGED, PacketTracer
from benchmarking.tracers.stages import SceneTrees


class RangedTracer(PacketTracer):
    """Packets with a first active ray, and frusta: Wald, Boulos and Shirley 2007, "Ray tracing deformable scenes using
    dynamic bounding volume hierarchies".

    A node is visited by the rays from the first one on that meets its box. That ray is tried first; where it misses,
    interval arithmetic over all rays of the packet tells whether any can meet the box, and only then the others are
    asked until one does.

    Their tree is binary, ours has eight children. So the first ray meets all eight at once, and the others are asked
    for those that are left, eight rays a box; children are visited in the order of the distances at which the rays that
    found them enter. A packet is consecutive rays of the list, of any directions: an axis along which they differ in
    sign is left out of the bounds. In a leaf, the rays whose eighth meets its box are tested one by one against eight
    triangles, as ours are; they tested four rays against one triangle, and culled triangles by the frustum's corners.
    """

    def __init__(self, name: str, trees: SceneTrees, device: wp.Device, size: int):
        """`size`: rays of a packet."""
        super().__init__(name, trees, device, RANGED, size=size)


class PartitionTracer(PacketTracer):
    """Large packets that are partitioned: Overbeck, Ramamoorthi and Mark 2008, "Large ray packets for real-time Whitted
    ray tracing".

    At each box the list of rays is partitioned, so that those that meet it come first, and go on. What is partitioned
    here, as there, are groups of rays that fill a vector: eight with ours, four with theirs. Boxes that the bounds of
    all rays miss are culled first. Children are in the order in which one ray of the first active group enters them, or
    would if their boxes were larger; theirs in that of a direction and an axis of splitting. In a leaf, rays whose box
    test succeeded are tested one by one against eight triangles.
    """

    def __init__(self, name: str, trees: SceneTrees, device: wp.Device, size: int):
        """`size`: rays of a packet."""
        super().__init__(name, trees, device, PARTITION, size=size)
