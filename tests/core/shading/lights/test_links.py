"""Light linking: who lights what, who blocks what, and passes of groups, in scenes small enough to be computed."""

import dataclasses

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.scene.description import ALL_LIGHT_SETS, ALL_SHADOW_SETS, Frame, Visibility
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import upload_geometry
from raybatch_addon.core.scene.linking import catcher_bits, shadow_bit
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.shading.lights.table import upload_lights
from tests.support import scenes
from tests.support.under_test import DEVICE

pytestmark = pytest.mark.usefixtures("general_kernels")

SETTINGS = RenderSettings(sample_count=16, bounce_max=0)


def floors(lights, links=None, blockers=None, passes=("Combined",), **more):
    """Two white floors side by side, seen from above, the right one below a roof that the camera does not see."""
    places = [(scenes.plane("left", 2), -1, 0), (scenes.plane("right", 2), 1, 0), (scenes.plane("roof", 2), 1, 1)]
    made = scenes.scene(
        [(mesh, scenes.translation(x, 0, z), scenes.diffuse(0.5)) for mesh, x, z in places],
        view=scenes.camera(eye=(0, 0, 8), target=(0, 0, 0), half_width=0.24, up=(0, 1, 0)),
        frame=Frame(8, 8, passes=passes),
        lights=lights,
        **more,
    )
    visibility = np.array([int(Visibility.ALL), int(Visibility.ALL), int(Visibility.SHADOW)], np.int32)
    if blockers is not None:
        visibility |= np.array([shadow_bit(each) for each in blockers], np.int32)
    instances = dataclasses.replace(made.instances, visibility=visibility)
    if links is not None:
        full = [(each, ALL_LIGHT_SETS, ALL_SHADOW_SETS) for each in links]
        instances = dataclasses.replace(instances, links=np.array(full, np.uint64))
    return dataclasses.replace(made, instances=instances)


def on_floors(session, scene, name="Combined", **changes):
    """Means of the left and the right floor in a pass."""
    pixels = session.render(scene, SETTINGS.replace(**changes)).passes[name][..., :3]
    return pixels[3:5, 1:3].mean(), pixels[3:5, 5:7].mean()


def test_lights_light_their_receivers_and_are_blocked_by_their_blockers(session):
    """Suns of 1, 2 and 4 W/m² from straight above: the roof shades the right floor."""
    white = 0.5 / np.pi
    alike = [dataclasses.replace(scenes.sun(2.0), name=name) for name in "abc"]  # chosen by what they bring: no noise
    assert on_floors(session, floors(alike)) == pytest.approx((6 * white, 0), rel=1e-4)
    suns = [dataclasses.replace(scenes.sun(strength), name=str(strength)) for strength in (1.0, 2.0, 4.0)]
    suns[0] = dataclasses.replace(suns[0], light_sets=0b10)  # the left floor alone
    suns[1] = dataclasses.replace(suns[1], light_sets=ALL_LIGHT_SETS & ~0b10, shadow_sets=ALL_SHADOW_SETS & ~0b1)
    suns[2] = dataclasses.replace(suns[2], shadow_sets=ALL_SHADOW_SETS & ~0b1)
    linked = floors(suns, links=(1, 0, 0), blockers=(1, 1, 0))
    assert on_floors(session, linked, sample_count=64) == pytest.approx((5 * white, 6 * white), rel=1e-2)


def test_a_mesh_that_shines_is_blocked_by_its_blockers_alone(session):
    """A lamp above the roof, which blocks the lamp's light only where it is among its blockers; lamp and roof are in
    the same shadow set, which says nothing of the lamp's own light.
    """

    def right_floor(shadow_sets: int, roof: Visibility = Visibility.SHADOW) -> float:
        places = [
            (scenes.plane("right", 2), 0.0, scenes.diffuse(0.5)),
            (scenes.plane("roof", 2), 1.0, scenes.diffuse()),
        ]
        lamp = scenes.plane("lamp", 0.5), 2.0, scenes.emitter(10.0)
        made = scenes.scene(
            [(mesh, scenes.translation(0, 0, z), material) for mesh, z, material in (*places, lamp)],
            view=scenes.camera(eye=(0, 0, 8), target=(0, 0, 0), half_width=0.12, up=(0, 1, 0)),
            frame=Frame(4, 4, passes=("Combined",)),
        )
        bits = np.array([shadow_bit(1), shadow_bit(0), shadow_bit(0)], np.int32)
        visibility = np.array([int(Visibility.ALL), int(roof), int(Visibility.DIFFUSE)], np.int32) | bits
        links = np.full((3, 3), ALL_LIGHT_SETS, np.uint64)
        links[:, 0], links[:, 2] = 0, ALL_SHADOW_SETS
        links[2, 2] = shadow_sets
        instances = dataclasses.replace(made.instances, visibility=visibility, links=links)
        return (
            session.render(dataclasses.replace(made, instances=instances), SETTINGS).passes["Combined"][..., :3].mean()
        )

    assert right_floor(ALL_SHADOW_SETS) == 0
    no_roof = right_floor(ALL_SHADOW_SETS, roof=Visibility(0))
    assert no_roof > 0.05
    assert right_floor(ALL_SHADOW_SETS & ~0b1) == pytest.approx(no_roof, rel=0.02)


def test_what_sees_an_emitter_is_apart_from_what_it_blocks_and_catches():
    shining = scenes.plane("lamp", 0.5), scenes.IDENTITY, scenes.emitter(1.0)
    made = scenes.scene([shining], frame=Frame(4, 4))
    bits = np.array([int(Visibility.ALL) | shadow_bit(3) | catcher_bits(int(Visibility.ALL))], np.int32)
    made = dataclasses.replace(made, instances=dataclasses.replace(made.instances, visibility=bits))
    device = wp.get_device(DEVICE)
    uploaded = upload_lights(made, device, geometry=upload_geometry(flatten(made), made, device))
    assert uploaded.table.instance_visibility.numpy().tolist() == [int(Visibility.ALL)]


def test_a_scene_without_links_has_none_of_it():
    features = derive_features(floors([scenes.sun(1.0)]), SETTINGS)
    assert not (features.light_links or features.shadow_links or features.light_groups)
    assert {"light linking", "shadow linking", "light groups"} <= set(features.left_out())


@pytest.mark.thorough
@pytest.mark.parametrize("changes", [{}, dict(nee="OFF"), dict(mis="OFF")], ids=str)
def test_ways_to_find_linked_light_agree(session, changes):
    """A lamp that lights one floor, found by any strategy."""
    lamp = dataclasses.replace(
        scenes.area_light(3.0, 1.0, scenes.look_at((-1, 0, 2), (-1, 0, 0))), light_sets=0b10, visibility=30
    )
    scene = floors([lamp], links=(1, 2, 0), blockers=None)
    plain = dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, links=None), lights=(lamp,))
    found = on_floors(session, scene, sample_count=512, bounce_max=1, **changes)
    alone = dataclasses.replace(lamp, light_sets=ALL_LIGHT_SETS)
    expected = on_floors(session, dataclasses.replace(plain, lights=(alone,)), sample_count=512, bounce_max=1)
    assert found[1] < 0.2 * expected[1] + 1e-3
    assert found[0] == pytest.approx(expected[0], rel=0.05)


def test_passes_of_groups_are_the_light_of_their_emitters(session):
    lights = [dataclasses.replace(scenes.sun(1.0), light_group=1), dataclasses.replace(scenes.sun(2.0), light_group=0)]
    passes = ("Combined", "Combined_a", "Combined_b", "Combined_c")
    scene = floors([*lights, scenes.sun(4.0)], passes=passes, world=0.25)
    scene = dataclasses.replace(
        scene, light_groups=("a", "b", "c"), world=dataclasses.replace(scene.world, light_group=2)
    )
    found = session.render(scene, SETTINGS.replace(bounce_max=2, sample_count=64)).passes
    left = {name: found[name][3:5, 1:3, :3].mean() for name in passes}
    white = 0.5 / np.pi
    assert left["Combined_a"] == pytest.approx(2 * white, rel=0.15)
    assert left["Combined_b"] == pytest.approx(0.5 * left["Combined_a"], rel=0.1)
    assert left["Combined_c"] == pytest.approx(0.125, rel=0.15)
    parts = left["Combined_a"] + left["Combined_b"] + left["Combined_c"]
    assert parts + 2 * left["Combined_a"] == pytest.approx(left["Combined"], rel=0.15)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "changes", [dict(batching="ON", treelet_size=1024), dict(batching="ON", queue_size=8)], ids=str
)
def test_schedules_do_not_change_linked_light(session, changes):
    suns = [dataclasses.replace(scenes.sun(strength, 0.2), name=str(strength)) for strength in (1.0, 2.0)]
    suns[0] = dataclasses.replace(suns[0], light_sets=0b10, light_group=0)
    suns[1] = dataclasses.replace(suns[1], shadow_sets=ALL_SHADOW_SETS & ~0b1)
    passes = ("Combined", "Combined_a")
    scene = dataclasses.replace(
        floors(suns, links=(1, 0, 0), blockers=(1, 1, 0), passes=passes, world=0.2), light_groups=("a",)
    )
    plain = session.render(scene, SETTINGS.replace(bounce_max=3, batching="OFF")).passes
    other = session.render(scene, SETTINGS.replace(bounce_max=3, **changes)).passes
    for name in passes:
        assert np.array_equal(plain[name], other[name]), name
