"""Settings of what rays wait in, and at which parts of trees: they change time, never the picture."""

from __future__ import annotations

from dataclasses import dataclass

from .info import BYTES, INT_MAX, setting


@dataclass(frozen=True, kw_only=True)
class QueueSettings:
    """Where rays wait, in renders that batch."""

    queue_size: int = setting(
        0,
        "Block Size",
        "Rays that a block of a queue holds; {rest} chooses by device and treelets",
        group="QUEUES",
        effect="schedule",
        unit="rays",
        minimum=0,
        maximum=2**24,
        auto=0,
        start=1024,
    )
    queue_count: int = setting(
        0,
        "Blocks",
        "Blocks that all queues of a worker share; {rest} chooses enough for Rays Alive. Where they run out, the "
        "fullest bucket is served first",
        group="QUEUES",
        effect="schedule",
        unit="blocks",
        minimum=0,
        maximum=2**28,
        auto=0,
        start=4096,
    )
    ray_storage: str = setting(
        "INDIRECT",
        "Storage",
        "What queues hold of a ray",
        group="QUEUES",
        effect="schedule",
        choices=(
            ("INDIRECT", "Indirect", "Its number: 4 bytes, and its state stays where it is"),
            (
                "DIRECT",
                "Direct",
                "Its whole state for traversal, copied: rays of a queue lie side by side, and take more memory",
            ),
        ),
    )
    debug_checks: str = setting(
        "OFF",
        "Check Queues",
        "Check after each step that every ray is in exactly one place and all counts agree; slow",
        group="QUEUES",
        effect="schedule",
        choices=(
            ("OFF", "Off", "Nothing is checked, and nothing is paid for it"),
            ("ON", "On", "The render fails with what is wrong"),
        ),
    )


@dataclass(frozen=True, kw_only=True)
class TreeletSettings:
    """How trees are cut into parts that rays visit together."""

    treelet_size: int = setting(
        0,
        "Max Nodes",
        "Most nodes of a treelet; {rest} chooses by device. Min Nodes comes first: where it keeps a node closed, a "
        "treelet is larger. As many as the tree has make it one treelet, as a control",
        group="TREELETS",
        effect="schedule",
        unit="nodes",
        minimum=0,
        maximum=INT_MAX,
        auto=0,
        start=4096,
    )
    treelet_size_min: int = setting(
        1,
        "Min Nodes",
        "No node is opened whose child would be a smaller treelet than this: it comes before Max Nodes",
        group="TREELETS",
        effect="schedule",
        unit="nodes",
        minimum=1,
        maximum=INT_MAX,
    )
    treelet_bytes: int = setting(
        0,
        "Max Size",
        "Most memory of a treelet's nodes and triangles, such as a cache's size; {rest} chooses by device, or sets no "
        "limit where Max Nodes is given",
        group="TREELETS",
        effect="schedule",
        unit=BYTES,
        minimum=0,
        maximum=INT_MAX,
        auto=0,
        start=2**20,
    )
    treelet_tier_bytes: int = setting(
        0,
        "Tier Size",
        "Most memory of a large treelet, such as the size of a larger cache: rays wait there, and then at the treelets "
        "in it; with {rest} treelets are in no others. Pages of geometry beyond memory are large treelets, whatever "
        "their size",
        group="TREELETS",
        effect="schedule",
        unit=BYTES,
        minimum=0,
        maximum=INT_MAX,
        off=0,
        start=2**25,
    )
    top_level_depth_max: int = setting(
        64,
        "Top Levels",
        "Levels of a mesh's tree that are above its treelets at most",
        group="TREELETS",
        effect="schedule",
        unit="levels",
        minimum=1,
        maximum=1024,
    )
