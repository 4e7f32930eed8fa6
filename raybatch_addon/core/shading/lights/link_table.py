"""Light linking as kernels read it: made of a scene, for the tree over its emitters."""

from __future__ import annotations

import numpy as np
import warp as wp

from ...native.structs import to_numpy
from ...scene.description import ALL_SHADOW_SETS, Scene
from ...scene.linking import lifts_shadow_rays, links_lights, links_shadows
from ...scene.passes import LIGHT_GROUP, light_group_passes
from .choice_table import BLOCK_WIDTH, ChoiceTable
from .emitters import EmissiveCells

_NO_LIMIT = np.iinfo(np.int32).max  # of bounces


def upload_links(
    scene: Scene, choice: ChoiceTable, cells: EmissiveCells | None, triangle_instance: np.ndarray, device: wp.Device
) -> None:
    """Fill in `choice.links` for the emitters of `scene`, whose tree `choice` has; nothing where none is linked.
    `cells`: those of volumes; `triangle_instance`: instances of the emissive triangles.
    """
    links, instances = choice.links, scene.instances
    links.instance_count = len(instances)
    world = scene.world
    cell_instance = np.zeros(0, np.int32) if cells is None else cells.instance

    def upload(values: np.ndarray, dtype: type) -> wp.array:
        return wp.array(values, dtype=dtype, device=device)

    linked = instances.links
    if linked is None:
        linked = np.zeros((len(instances), 3), np.uint64)
        linked[:, 1:] = np.iinfo(np.uint64).max
    everything = np.full(1, np.iinfo(np.uint64).max)
    if links_lights(scene):
        of_lamps = np.array([light.light_sets for light in scene.lights], np.uint64)
        owners = np.concatenate([of_lamps, linked[cell_instance, 1], linked[:, 1], everything])
        links.receiver, links.lights = upload(linked[:, 0].astype(np.int32), int), upload(owners, wp.uint64)
        links.nodes = upload(
            _of_nodes(choice, owners, len(scene.lights) + len(cell_instance), triangle_instance), wp.uint64
        )
    if links_shadows(scene):
        of_lamps = np.array([light.shadow_sets for light in scene.lights], np.uint64)
        owners = np.concatenate([of_lamps, linked[cell_instance, 2], linked[:, 2], everything]) & np.uint64(
            ALL_SHADOW_SETS
        )
        links.shadows = upload(owners.astype(np.int32), int)
    if lifts_shadow_rays(scene):
        is_mesh = np.array([mesh.radii is None for mesh in scene.meshes])[instances.mesh]
        links.terminator = upload(np.where(is_mesh, instances.terminator, 0).astype(np.float32), float)
    limits = [light.bounce_max for light in scene.lights] + [None] * len(cell_instance) + [world.bounce_max]
    if any(limit is not None for limit in limits):
        links.bounces = upload(np.array([_NO_LIMIT if each is None else each for each in limits], np.int32), int)
    passes = [name.removeprefix(LIGHT_GROUP) for name in light_group_passes(scene.frame.passes)]
    links.group_count = len(passes)
    if passes:
        numbers = [passes.index(name) if name in passes else -1 for name in scene.light_groups]
        number_of = np.array([*numbers, -1], np.int32)  # the last: of what is in no group
        of_lamps = np.array([light.light_group for light in scene.lights], np.int64)
        placed = instances.light_group
        placed = np.full(len(instances), -1) if placed is None else placed
        owners = np.concatenate([of_lamps, placed[cell_instance], placed, [world.light_group]])
        links.group = upload(number_of[owners.astype(np.int64)], int)


def _of_nodes(choice: ChoiceTable, owners: np.ndarray, first: int, triangle_instance: np.ndarray) -> np.ndarray:
    """Bits of the light sets that emitters below each node of `choice` light, uint64.

    `owners`: those of owners; `first`: number of the first emissive triangle.
    """
    below, leaf = to_numpy(choice.below), to_numpy(choice.leaf)
    owner = np.arange(len(leaf))
    owner[first : first + len(triangle_instance)] = first + triangle_instance
    nodes = np.zeros(len(below), np.uint64)
    placed = leaf >= 0
    nodes[leaf[placed]] = owners[owner[placed]]
    above = to_numpy(choice.above)
    for block in range(len(above) - 1, 0, -1):  # blocks nearer to the root come first
        nodes[above[block]] |= np.bitwise_or.reduce(nodes[block * BLOCK_WIDTH : (block + 1) * BLOCK_WIDTH])
    return nodes
