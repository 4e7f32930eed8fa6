"""What the choice among emitters reads."""

import warp as wp

# Nodes that are compared with each other at most: a scene with so few emitters is compared exactly
WIDTH = 16


@wp.struct
class LightNode:
    """What shines below a node of the tree over all emitters with a place: one emitter, or up to `WIDTH` nodes beside
    each other. 48 bytes, which a GPU loads in three steps.
    """

    centre: wp.vec3  # of a sphere around them [m]
    radius: float  # [m]
    # directions into which they shine: the middle of their normals' cone, the cosine of its half angle (-1: all
    # directions), and the cosine of how far beyond the normals light leaves
    axis: wp.vec3
    power: float  # irradiance at a distance of 1 m along the axis, in units of the scene's strongest emitter
    cos_axis: float
    cos_edge: float
    below: int  # number of the first node below; less than 0: -1 - the number of the emitter
    two_sided: wp.uint8  # 1: it shines into the opposite directions too
    count: wp.uint8  # of the nodes below


@wp.struct
class ChoiceTable:
    """What the choice among emitters reads."""

    root_count: int
    distant_count: int
    nodes: wp.array(dtype=LightNode)  # the first `root_count` together hold all emitters with a place
    parent: wp.array(dtype=int)  # node above each; -1: none
    leaf: wp.array(dtype=int)  # node of each emitter; -1: it has no place
    distant: wp.array(dtype=int)  # emitters without a place: suns, then the world if it is sampled
    distant_strength: wp.array(dtype=float)  # irradiance of a surface that faces each, in units as of `LightNode.power`
    # the world's irradiance of a surface with the normal n, in the same units: coefficients of 1, y, z, x, xy, yz,
    # 3 z² - 1, xz, x² - y²; shape [9]
    world_irradiance: wp.array(dtype=float)
