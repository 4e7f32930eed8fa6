"""Which of the volumes that emit are aimed at.

Shadow rays and scattered rays must agree on which volumes they are in, and so must see the same of those that may emit:
one that they see differently is left to scattered rays, with all that may lie in it.
"""

from __future__ import annotations

import numpy as np

from ....scene.description import ALL_SHADOW_SETS, SCATTERED_RAYS, Scene, Visibility
from ....scene.features import emits_somewhere, is_emissive, scene_volumes
from ....scene.motion import apart
from ..bounds import Bounded, bounded_volumes

# The rays by which light of volumes is found
_LIGHT_RAYS = SCATTERED_RAYS | int(Visibility.SHADOW | Visibility.VOLUME_SCATTER)


def aimed_volumes(scene: Scene, volume_of: np.ndarray) -> tuple[list[Bounded], list[Bounded]]:
    """The volumes of `scene` that are aimed at, of each instance one, and those that may emit and that shadow rays and
    scattered rays see differently.

    `volume_of`: volume of each material, -1: none.
    """
    filling = scene_volumes(scene)
    shining = bounded_volumes(scene, volume_of, [emits_somewhere(each) for each in filling], np.zeros((2, 3)))
    shining = [each for each in shining if each.instance >= 0]
    if not shining:
        return [], []
    instance = np.array([each.instance for each in shining])
    seen = scene.instances.visibility[instance] & int(Visibility.ALL)
    agrees = (seen & _LIGHT_RAYS == _LIGHT_RAYS) | (seen == 0)
    emissive = np.array([is_emissive(each) for each in filling])[[each.volume for each in shining]]
    aimed = emissive & agrees & (seen > 0) & ~apart(scene)[instance] & _has_inside(shining)
    if scene.instances.links is not None:
        # of what blocks the light of some emitters alone, scattered rays know nothing
        aimed &= scene.instances.links[instance, 2] & np.uint64(ALL_SHADOW_SETS) == np.uint64(ALL_SHADOW_SETS)
    unlike = np.flatnonzero(~agrees)
    left = np.flatnonzero(aimed)
    if len(unlike) and len(left):
        low, high = _world_boxes(shining)
        for number in unlike:
            first, last = _swept_box(scene, shining[number]) if shining[number].moves else (low[number], high[number])
            left = left[(low[left] > last).any(1) | (high[left] < first).any(1)]
            if not len(left):
                break
    return [shining[k] for k in left], [shining[k] for k in unlike]


def _has_inside(volumes: list[Bounded]) -> np.ndarray:
    """Whether each of these has places inside that float32 can tell: bool, shape [n]."""
    placed = np.stack([each.to_world for each in volumes])
    boxes = np.stack([each.box for each in volumes])
    size = boxes[:, 1] - boxes[:, 0]
    with np.errstate(all="ignore"):
        edges = placed[:, :, :3] * size[:, None]
        there = np.isfinite(placed.astype(np.float32)).all((1, 2)) & np.isfinite(edges.astype(np.float32)).all((1, 2))
        volume = np.linalg.det(np.where(there[:, None, None], edges, 0.0))
    return there & np.isfinite(volume) & (volume != 0)


def _world_boxes(volumes: list[Bounded]) -> tuple[np.ndarray, np.ndarray]:
    """Corners of boxes around volumes in the world [m], float64, shape [n, 3] each."""
    placed, boxes = np.stack([each.to_world for each in volumes]), np.stack([each.box for each in volumes])
    middle = np.einsum("nij,nj->ni", placed[:, :, :3], boxes.mean(1)) + placed[:, :, 3]
    reach = np.einsum("nij,nj->ni", np.abs(placed[:, :, :3]), (boxes[:, 1] - boxes[:, 0]) / 2)
    return middle - reach, middle + reach


def _swept_box(scene: Scene, volume: Bounded) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a box around a volume that moves [m], whichever way it turns; float64, shape [3] each."""
    motion = scene.instances.motion
    assert motion is not None
    maps = motion.maps[motion.instance == volume.instance][0].astype(np.float64)
    reach = np.linalg.norm(maps[:, :, :3], axis=(1, 2)).max() * np.linalg.norm(np.abs(volume.box).max(0))
    return maps[:, :, 3].min(0) - reach, maps[:, :, 3].max(0) + reach
