"""The arrays that the choice among emitters reads."""

import warp as wp

# Emitters, or groups of them, that are compared with each other: a scene with so few is compared exactly
BLOCK_WIDTH = 16
# Numbers of a node in `ChoiceTable.blocks`, in this order: the middle of a sphere around its emitters and its radius
# [m]; the middle of the cone of their normals, the cosine and sine of its half angle (-1 and 0: all directions), the
# cosine of how far beyond the normals light leaves, 1 where light leaves into the opposite directions too; and the
# irradiance at a distance of 1 m along the axis, in units of the scene's strongest emitter
FIELDS = (
    "x",
    "y",
    "z",
    "radius",
    "axis_x",
    "axis_y",
    "axis_z",
    "cos_axis",
    "sin_axis",
    "cos_edge",
    "two_sided",
    "power",
)


@wp.struct
class LightLinks:
    """Receivers of emitters' light, how shadow rays to them begin, and the groups that emitters are in; arrays that a
    scene does not need have no entries.

    Owners of light are lights without mesh, cells of volumes among them, then instances, and last the world.
    """

    receiver: wp.array(dtype=int)  # the light set that each instance is lit as
    lights: wp.array(dtype=wp.uint64)  # of each owner: bits of the light sets that it lights
    nodes: wp.array(dtype=wp.uint64)  # the same of all that lies below each node of `ChoiceTable.blocks`
    shadows: wp.array(dtype=int)  # of each owner: bits of the shadow sets that block its light
    group: wp.array(dtype=int)  # of each owner: the number of its group among the passes of groups; -1: none
    group_count: int
    instance_count: int
    terminator: wp.array(dtype=float)  # of each instance: `Instances.terminator`
    # of each light without mesh, and last of the world: most bounces of paths from which it is aimed at
    bounces: wp.array(dtype=int)


@wp.struct
class ChoiceTable:
    """The arrays that the choice among emitters reads: a tree over all that have a place, and the distant ones.

    A block holds up to `BLOCK_WIDTH` nodes that lie below one; nodes are numbered through all blocks. The first block
    is the top; it is there in any case.
    """

    # each number of all nodes of a block side by side, shape [blocks, FIELDS, BLOCK_WIDTH] flattened; power 0: no node
    blocks: wp.array(dtype=float)
    below: wp.array(dtype=int)  # of each node: the block below it; less than 0: -1 - the number of the emitter
    above: wp.array(dtype=int)  # of each block: the node above it; -1: none
    leaf: wp.array(dtype=int)  # node of each emitter; -1: it has no place
    # of each node of the top: the first one of its group (`top_groups`); [BLOCK_WIDTH]
    hidden_with: wp.array(dtype=int)
    group_count: int  # of those groups
    top_count: int  # nodes of the top
    distant_count: int
    distant: wp.array(dtype=int)  # emitters without a place: suns, then the world if it is sampled
    distant_strength: wp.array(dtype=float)  # irradiance of a surface that faces each, in units as of a node's power
    # the world's irradiance of a surface with the normal n, in the same units: coefficients of 1, y, z, x, xy, yz,
    # 3 z² - 1, xz, x² - y²; shape [9]
    world_irradiance: wp.array(dtype=float)
    links: LightLinks


def choice_tree_bytes(choice: ChoiceTable) -> int:
    """Memory that the tree of `choice` takes on its device [bytes]."""
    return sum(int(each.capacity) for each in choice_tree(choice))


def choice_tree(choice: ChoiceTable) -> list[wp.array]:
    """The arrays of `choice` that are its tree."""
    return [choice.blocks, choice.below, choice.above, choice.leaf, choice.hidden_with]
