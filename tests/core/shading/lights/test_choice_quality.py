"""How near the choice among emitters comes to what each brings."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.scene.description import Light, LightKind, Mesh
from raybatch_addon.core.shading.lights.choice import VOLUME_SIDE
from raybatch_addon.core.shading.lights.choice_table import BLOCK_WIDTH, FIELDS
from raybatch_addon.core.shading.lights.table import upload_lights
from raybatch_addon.core.shading.lights.tree.fill import top_groups
from raybatch_addon.core.shading.lights.world import WorldLight, sampled_world
from tests.core.shading.lights import test_light_choice
from tests.core.shading.lights.light_probe import facing, scene_of
from tests.support.under_test import BLOCK_DIM, DEVICE


def ceiling(count: int, kind: str):
    """Alike lamps, or glowing triangles of one mesh, jittered over a square of 16 m at a height of 3 m, and their
    places.
    """
    rng = np.random.default_rng(count)
    rows = int(np.sqrt(count))
    cell = np.arange(count)
    x, y = (16 * (each + rng.random(count)) / rows - 8 for each in (cell % rows, cell // rows))
    places = np.stack([x, y, np.full(count, 3.0)], 1)
    if kind == "lamps":
        return [Light("lamp", LightKind.POINT, facing(place, (0, 0, -1)), (1.0,) * 3) for place in places], None, places
    corners = places[:, None] + 0.01 * np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0]])
    triangles = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    return [], Mesh("glowing", corners.reshape(-1, 3).astype(np.float32), triangles), places


# a GPU's tree, of neighbours along a curve, is not as good as the CPU's
MOST = {"lamps": (0.006, 0.02), "triangles": (0.014, 0.04)}


@pytest.mark.parametrize("kind", MOST)
def test_many_emitters_are_chosen_about_as_what_they_bring(kind, monkeypatch):
    """The variance that the choice adds to light without shadows, beside the square of the light."""
    lights, mesh, places = ceiling(2500, kind)
    monkeypatch.setattr(test_light_choice, "glowing", lambda count, seed: mesh)
    lit, _ = test_light_choice.uploaded(lights, 0 if mesh is None else 2500)
    variance = []
    for point in np.random.default_rng(3).uniform(-9, 9, (40, 2)):
        offset = places - (*point, 0.0)
        square = (offset**2).sum(1)
        brings = 3.0 / square**1.5 * (1.0 if mesh is None else 3.0 / square**0.5)
        pdf = test_light_choice.chosen_from(lit, (*point, 0.0), (0, 0, 1), count=1)[3]
        variance.append((brings**2 / pdf).sum() / brings.sum() ** 2 - 1)
    assert 0 <= np.mean(variance) < MOST[kind][wp.get_device(DEVICE).is_cuda]


def spheres(*nodes):
    """The top's block with lamps: (x, radius, power) each."""
    fields = np.zeros((len(FIELDS), BLOCK_WIDTH), np.float32)
    for k, node in enumerate(nodes):
        fields[[FIELDS.index(name) for name in ("x", "radius", "power")], k] = node
    return fields.reshape(-1)


def test_nodes_that_are_near_each_other_are_a_group():
    alone, chain = (-10, 0.1, 1.0), [(each, 0.45, 1e-3) for each in range(5)]
    groups, there = top_groups(spheres(alone, *chain))
    assert there.tolist() == [*range(6)]
    assert groups.tolist() == [0, 1, 1, 1, 1, 1, *range(6, BLOCK_WIDTH)]
    # what has no power joins nothing
    groups, there = top_groups(spheres(alone, (0, 0.1, 1.0), (-5, 6.0, 0.0), (-9.5, 0.1, 2.0)))
    assert groups.tolist()[:4] == [0, 1, 2, 0] and there.tolist() == [0, 1, 3]
    # as near, but there is nothing farther away
    assert top_groups(spheres(*chain))[0].tolist()[:5] == [0] * 5
    assert top_groups(spheres((0, 0, 1), (0.1, 0, 1)))[0].tolist()[:2] == [0, 1]
    assert top_groups(spheres())[0].tolist() == [*range(BLOCK_WIDTH)]


def counted(light):
    """What groups that bring `light` count for."""
    light = np.asarray(light, float)
    return np.sqrt(light * (light + 0.3 * light.sum() / (len(light) - 1)))


@pytest.mark.parametrize("parts", [1, 12])
def test_what_may_be_hidden_by_itself_is_chosen_more_often_where_it_is_dim(parts):
    """A dim pile of lamps beside a bright one and a sun: it does not matter in how many parts it is."""
    places = [(2.0, 0.0, 3.0 + 0.01 * i) for i in range(parts)]
    lamps = [Light("bright", LightKind.POINT, facing((-2, 0, 3), (0, 0, -1)), (1.0,) * 3)]
    lamps += [Light("dim", LightKind.POINT, facing(place, (0, 0, -1)), (0.02 / parts,) * 3) for place in places]
    lamps += [Light("sun", LightKind.SUN, facing((0, 0, 0), (0, 0, -1)), (0.01,) * 3)]
    lit, _ = test_light_choice.uploaded(lamps)
    pdf = test_light_choice.chosen_from(lit, (0, 0, 0), (0, 0, 1), count=1)[3]
    brings = [
        sum(power * z / (4 + z * z) ** 1.5 for z in heights)
        for power, heights in ((1.0, [3.0]), (0.02 / parts, [place[2] for place in places]))
    ]
    expected = counted([*brings, 0.01])
    np.testing.assert_allclose([pdf[0], pdf[1:-1].sum(), pdf[-1]], expected / expected.sum(), rtol=2e-3)


def test_many_dim_lamps_take_hardly_more_from_a_bright_one_than_one_that_is_as_bright_as_all():
    def bright_share(count):
        places = [(6.0 * np.cos(angle), 6.0 * np.sin(angle), 3.0) for angle in range(count)]
        lamps = [Light("bright", LightKind.POINT, facing((0, 0, 3), (0, 0, -1)), (1.0,) * 3)]
        lamps += [Light("dim", LightKind.POINT, facing(place, (0, 0, -1)), (1 / count,) * 3) for place in places]
        lit, _ = test_light_choice.uploaded(lamps)
        share = test_light_choice.chosen_from(lit, (0, 0, 0), (0, 0, 1), count=1)[3][0]
        expected = counted([3 / 9**1.5, *[3 / 45**1.5 / count] * count])
        np.testing.assert_allclose(share, expected[0] / expected.sum(), rtol=2e-3)
        return share

    assert bright_share(1) - 0.02 < bright_share(6) < bright_share(1) < 0.9


def test_in_a_volume_emitters_count_by_what_comes_from_all_sides():
    """A lamp, a sun that brings as much, and a white world."""
    pdf_of_all = test_light_choice.choice_kernel()[1]
    lamps = [
        Light("lamp", LightKind.POINT, facing((0, 0, 2), (0, 0, -1)), (4.0,) * 3),
        Light("sun", LightKind.SUN, facing((0, 0, 0), (1, 0, 0)), (1.0,) * 3),
    ]
    device = wp.get_device(DEVICE)
    white = sampled_world(WorldLight(np.full((64, 128), 0.25 / np.pi, np.float32)), device)
    lights = upload_lights(scene_of(*lamps), device, world=white)
    found = wp.zeros(3, dtype=float, device=device)
    inputs = [lights.table, wp.vec3(0.0, 0.0, 0.0), wp.uint32(VOLUME_SIDE), found]
    wp.launch(pdf_of_all, 3, inputs, device=device, block_dim=BLOCK_DIM)
    np.testing.assert_allclose(found.numpy(), 1 / 3, rtol=2e-3)
