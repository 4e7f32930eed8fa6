"""What is known of rays that wait for tiles of images."""

from __future__ import annotations

from enum import IntEnum

import warp as wp

from ...programs.op import NodeData
from ...scene.features import SceneFeatures

NOBODY = 2**31 - 1  # where no ray waits
# Rays whose surfaces were looked at the first time, and those of them whose tiles were not there; rays that wait now
LOOKED, WAITED, WAITING_NOW, WAIT_COUNTS = 0, 1, 2, 3
# Slots of the ray that is to go on next, and of that which is so in the next turn: the least of those that wait
LEADER, NEXT_LEADER = 0, 1


class WaitPhase(IntEnum):
    """Where a ray stands that came back from its tracer."""

    NONE = 0  # its surface is shaded, or there is none
    WAITING = 1  # tiles are missing
    BACK = 2  # of shadow rays: nobody has looked yet
    READY = 3  # of shadow rays: all tiles are there


@wp.struct
class TextureWaits:
    """Rays that wait for tiles, one entry a ray slot where it does not say otherwise."""

    nodes: NodeData  # programs that fetch: those of materials, and behind them of what shadow rays ask of them
    phase: wp.array(dtype=int)  # `WaitPhase`
    leader: wp.array(dtype=int)  # slots, shape [2]
    counts: wp.array(dtype=int)  # shape [WAIT_COUNTS]


def texture_bytes_per_path(features: SceneFeatures) -> int:
    """Device memory of what is known of one path, and of its entries in lists [bytes]; 0 where all images are whole."""
    if not features.fetch_program:
        return 0
    slots = 1 + features.shadow_rays
    return 4 * slots + (3 * 4 if has_shadows(features) else 0)


def has_shadows(features: SceneFeatures) -> bool:
    """Whether shadow rays may ask for tiles."""
    return features.shadow_rays and features.transparency
