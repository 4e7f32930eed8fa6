"""Places where more volumes of meshes overlap than a ray keeps in mind, found before a render."""

from __future__ import annotations

import numpy as np

from ...float32 import UNIT_ROUNDOFF
from ...scene.description import Scene
from ...scene.motion import knots, maps_at, motion_keys, moving_maps
from ...scene.notice import Notice, Weight, quoted
from .enclosures import VolumeSlots, box_corners

# Volumes of meshes that a ray is in at once; those that it enters beyond them are not noticed
INSIDE_MOST = 4
# Parts of space that are looked at, at most, for each box: that many are needed where many boxes overlap
_PARTS_PER_BOX = 16
# Boxes that share less than this part of their edges, or of their coordinates in roundings, only touch
_TOUCHING, _ROUNDINGS = 1e-5, 64.0


def volume_numbers(scene: Scene) -> np.ndarray:
    """Number of the volume of each material, as `scene_volumes` counts them; -1: it has none. int32."""
    filled = np.array([material.volume is not None for material in scene.materials], bool)
    return np.where(filled, np.cumsum(filled) - 1, -1).astype(np.int32)


def crowded_volumes(scene: Scene) -> list[Notice]:
    """A notice where more volumes of meshes may overlap than a ray keeps in mind, by their boxes; or none."""
    numbers = volume_numbers(scene)
    if (numbers < 0).all() or len(scene.instances) == 0:
        return []
    slots = VolumeSlots(scene, numbers)
    bounded = [each for instance in range(len(scene.instances)) for each in slots.of_instance(instance)]
    if len(bounded) <= INSIDE_MOST:
        return []
    boxes = np.array([each.box for each in bounded])
    moves = np.array([each.moves for each in bounded])
    if moves.any():
        boxes[moves] = _swept_boxes(scene, np.array([each.instance for each in bounded])[moves])
    crowd = crowded(boxes, INSIDE_MOST)
    for k in crowd[~moves[crowd]].tolist():  # boxes of boxes are too large
        boxes[k] = slots.exact_box(bounded[k])
    crowd = crowd[crowded(boxes[crowd], INSIDE_MOST)]
    if not len(crowd):
        return []
    owners = scene.instances.object[[bounded[k].instance for k in crowd]]
    names = [scene.object_names[k] for k in np.unique(owners).tolist() if 0 <= k < len(scene.object_names)]
    text = (
        f"more than {INSIDE_MOST} volumes may overlap in one place, and a ray is in {INSIDE_MOST} of them at most: "
        f"those that it enters beyond them are not in the picture (among {quoted(names) or 'objects without name'})"
    )
    remedy = "move these objects apart, or fill one object with the volume of several"
    return [Notice(text, Weight.MISSING, objects=names, remedy=remedy)]


def crowded(boxes: np.ndarray, most: int) -> np.ndarray:
    """Which of `boxes` [n, 2, 3] lie in some place with more than `most` of them, this one among them: indices,
    ascending. Boxes that touch do not overlap; those that are not finite are nowhere.

    Space is halved at faces of boxes until no more than `most` are left in a part, or more than that fill it. Where
    that takes too long, those that are left in a part are taken to overlap.
    """
    margin = _TOUCHING * (boxes[:, 1] - boxes[:, 0]) + _ROUNDINGS * UNIT_ROUNDOFF * np.abs(boxes).max(1)
    low, high = boxes[:, 0] + margin, boxes[:, 1] - margin
    good = np.flatnonzero((np.isfinite([low, high]).all((0, 2))) & (high > low).all(1))
    found = np.zeros(len(boxes), bool)
    parts = [(np.full(3, -np.inf), np.full(3, np.inf), good)]
    looked = 0
    while parts:
        start, end, inside = parts.pop()
        if len(inside) <= most or found[inside].all():
            continue
        looked += 1
        fill = (low[inside] <= start).all(1) & (high[inside] >= end).all(1)
        if fill.sum() > most or looked > _PARTS_PER_BOX * len(boxes):
            found[inside] = True
            continue
        faces = [np.concatenate([low[inside, k], high[inside, k]]) for k in range(3)]
        faces = [each[(each > start[k]) & (each < end[k])] for k, each in enumerate(faces)]
        axis = int(np.argmax([len(each) for each in faces]))
        middle = np.partition(faces[axis], len(faces[axis]) // 2)[len(faces[axis]) // 2]
        for side in (0, 1):
            begin, stop = start.copy(), end.copy()
            (stop if side == 0 else begin)[axis] = middle
            meets = (low[inside, axis] < middle) if side == 0 else (high[inside, axis] > middle)
            parts.append((begin, stop, inside[meets]))
    return np.flatnonzero(found)


def _swept_boxes(scene: Scene, which: np.ndarray) -> np.ndarray:
    """Boxes around the instances `which` over the time in which the shutter is open [m]: float64, shape [n, 2, 3]."""
    moving = moving_maps(scene)
    row_of = {instance: row for row, instance in enumerate(moving.instance.tolist())}
    boxes = np.zeros((len(which), 2, 3))
    for box, instance in zip(boxes, which.tolist()):
        mesh = scene.meshes[int(scene.instances.mesh[instance])]
        steps = [mesh.positions] if mesh.motion is None else list(mesh.motion)
        corners = np.concatenate([box_corners(step) for step in steps])
        maps = np.asarray(scene.instances.transform[instance], np.float64)[None]
        if instance in row_of:
            keys = motion_keys(moving.maps[row_of[instance]][None])
            maps = maps_at(keys, knots(keys))[0]
        places = corners @ np.swapaxes(maps[:, :, :3], 1, 2) + maps[:, None, :, 3]
        box[:] = places.min((0, 1)), places.max((0, 1))
    return boxes
