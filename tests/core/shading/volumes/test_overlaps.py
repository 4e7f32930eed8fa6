"""Volumes that overlap more than a ray keeps in mind: by boxes, by scenes, and in the warnings of a film."""

from dataclasses import replace

import numpy as np
import pytest

from raybatch_addon.core.scene.description import Frame
from raybatch_addon.core.scene.motion import instance_maps
from raybatch_addon.core.scene.notice import Weight
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.shading.volumes.overlaps import crowded, crowded_volumes
from tests.renders.volumes.test_volumes import filled, medium
from tests.support import scenes


def _cubes(places, **more):
    """Cubes of edge 2 in `places`, each with a volume of its own, called “cube 0” and so on."""
    boxes = [
        (scenes.box(f"box {k}"), scenes.translation(*place), filled(medium(0.1 * (k + 1))))
        for k, place in enumerate(places)
    ]
    scene = scenes.scene(boxes, world=1.0, frame=Frame(8, 8), **more)
    return replace(scene, object_names=tuple(f"cube {k}" for k in range(len(places))))


def _by_points(boxes: np.ndarray, most: int) -> list[int]:
    """The same as `crowded`: in the middle of each of the parts that the faces of all boxes cut space into."""
    middles = []
    for axis in range(3):
        faces = np.unique(boxes[:, :, axis])
        middles.append((faces[1:] + faces[:-1]) / 2)
    points = np.stack(np.meshgrid(*middles, indexing="ij"), -1).reshape(-1, 1, 3)
    inside = ((boxes[:, 0] < points) & (boxes[:, 1] > points)).all(2)
    return np.flatnonzero(inside[inside.sum(1) > most].any(0)).tolist()


@pytest.mark.parametrize("count, most", [(6, 1), (12, 2), (14, 4), (16, 3)])
def test_boxes_that_share_places_are_those_that_points_find(count, most):
    random = np.random.default_rng(count)
    seen = set()
    for _ in range(40):
        low = random.random((count, 3)) * 2
        boxes = np.stack([low, low + 0.1 + random.random((count, 3))], 1)
        found = crowded(boxes, most).tolist()
        assert found == _by_points(boxes, most)
        seen.add(0 < len(found) < count)
    assert True in seen


def test_boxes_that_touch_do_not_overlap():
    """A block of cubes, eight of which share each corner; and one that is nowhere."""
    places = np.stack(np.meshgrid(*[np.arange(10.0)] * 3), -1).reshape(-1, 3)
    boxes = np.stack([places, places + 1], 1)
    boxes[7] = np.nan
    assert len(crowded(boxes, 1)) == 0
    # a thousand times their edge from the origin, to a few roundings of float32
    far = (boxes + 1000 + 4e-4 * np.random.default_rng(1).random(boxes.shape)).astype(np.float32)
    assert len(crowded(far.astype(float), 4)) == 0


def test_six_cubes_in_one_place_are_named_and_four_are_not():
    assert crowded_volumes(_cubes([(0.1 * k, 0, 0) for k in range(4)])) == []
    assert crowded_volumes(_cubes([(3 * k, 0, 0) for k in range(6)])) == []
    scene = _cubes([(0.1 * k, 0, 0) for k in range(6)] + [(9, 0, 0)])
    (notice,) = crowded_volumes(scene)
    assert notice.objects == tuple(f"cube {k}" for k in range(6)) and notice.weight == Weight.MISSING
    assert "“cube 5”" in notice and "cube 6" not in notice and notice.remedy
    surfaces = tuple(replace(material, volume=None) for material in scene.materials)
    assert crowded_volumes(replace(scene, materials=surfaces)) == []


def test_cubes_that_move_into_one_place_are_named():
    scene = _cubes([(3 * k, 0, 0) for k in range(6)])
    maps = np.repeat(scene.instances.transform[:, None], 3, 1)
    maps[:, 0, 0, 3] = 0
    moving = replace(scene, instances=replace(scene.instances, motion=instance_maps(maps)))
    assert crowded_volumes(scene) == []
    (notice,) = crowded_volumes(moving)
    assert len(notice.objects) == 6


def test_a_film_says_what_a_ray_did_not_notice(session, general_kernels):
    """Its warnings name the cubes; a scene whose exporter has said so already does not say it twice."""
    settings = RenderSettings(sample_count=1)
    scene = _cubes([(0.1 * k, 0, 0) for k in range(6)])
    said = [text for text in session.render(scene, settings).statistics["warnings"] if "volumes may overlap" in text]
    assert len(said) == 1 and "“cube 0”" in said[0]
    again = replace(scene, warnings=tuple(crowded_volumes(scene)))
    said = [text for text in session.render(again, settings).statistics["warnings"] if "volumes may overlap" in text]
    assert len(said) == 1
    four = _cubes([(0.1 * k, 0, 0) for k in range(4)])
    assert not any("overlap" in text for text in session.render(four, settings).statistics["warnings"])
