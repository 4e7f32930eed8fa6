"""The choice among emitters: what it promises of each, it does; and it forgets none that shines."""

import functools

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.scene.description import (
    Closure,
    ClosureKind,
    Instances,
    Light,
    LightKind,
    Material,
    Mesh,
    Visibility,
)
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import Geometry, upload_geometry
from raybatch_addon.core.shading.lights.choice import ChoiceFeatures, lit_point, make_light_choice, packed_side
from raybatch_addon.core.shading.lights.choice_table import BLOCK_WIDTH, FIELDS
from raybatch_addon.core.shading.lights.emitters import EmissiveTriangles
from raybatch_addon.core.shading.lights.lights import LightFeatures, make_lights
from raybatch_addon.core.shading.lights.table import LightTable, upload_lights
from raybatch_addon.core.shading.lights.tree import fill, topology
from raybatch_addon.core.shading.lights.world import WorldLight, sampled_world
from tests.core.shading.lights.light_probe import facing, scene_of
from tests.support.running.shares import each_of
from tests.support.under_test import BLOCK_DIM, DEVICE

COUNT = 2**16
KINDS = tuple(sorted(LightKind))


@wp.struct
class Chosen:
    emitter: wp.array(dtype=int)
    pdf: wp.array(dtype=float)
    again: wp.array(dtype=float)


ALL = ChoiceFeatures(KINDS, True, True, True)


@functools.cache
def choice_kernel(features: ChoiceFeatures = ALL):
    choose, pdf = make_light_choice(features)

    @wp.kernel(**KERNEL_OPTIONS)
    def choose_many(table: LightTable, position: wp.vec3, side: wp.uint32, seed: int, chosen: Chosen):
        i = wp.tid()
        r = wp.rand_init(seed, i)
        u_choice = float(wp.randi(r) & 16777215) / 16777216.0
        u = wp.vec2(float(wp.randi(r) & 16777215) / 16777216.0, float(wp.randi(r) & 16777215) / 16777216.0)
        point = lit_point(position, side)
        choice = choose(table, point, u_choice, u)
        chosen.emitter[i] = choice.emitter
        chosen.pdf[i] = choice.pdf
        if choice.emitter >= 0:
            chosen.again[i] = pdf(table, point, choice.emitter)

    @wp.kernel(**KERNEL_OPTIONS)
    def pdf_of_all(table: LightTable, position: wp.vec3, side: wp.uint32, found: wp.array(dtype=float)):
        i = wp.tid()
        found[i] = pdf(table, lit_point(position, side), i)

    return choose_many, pdf_of_all


def lamps(count: int, seed: int) -> list[Light]:
    """Lamps of every kind around the origin, no two of the same power; a third of them turned at random."""
    rng = np.random.default_rng(seed)
    found = []
    for i in range(count):
        kind = KINDS[i % len(KINDS)]
        direction = rng.normal(size=3)
        place = facing(rng.normal(size=3) * 3, direction)
        size = dict(radius=float(rng.uniform(0, 0.3))) if kind in (LightKind.POINT, LightKind.SPOT) else {}
        if kind in (LightKind.RECTANGLE, LightKind.ELLIPSE):
            size = dict(size=tuple(rng.uniform(0.1, 1, 2)), spread=float(rng.choice([np.pi, 0.6])))
        if kind == LightKind.SPOT:
            size |= dict(angle=float(rng.uniform(0.2, 3.1)), blend=0.3)
        if kind == LightKind.SUN:
            size = dict(angle=float(rng.choice([0, 0.1])))
        power = float(10 ** rng.uniform(-2, 1))
        found.append(Light(name=f"lamp {i}", kind=kind, transform=place, emission=(power, power, power), **size))
    return found


def glowing(count: int, seed: int) -> Mesh:
    """`count` small triangles, spread over a box."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform(-4, 4, (count, 1, 3))
    corners = (middle + rng.normal(size=(count, 3, 3)) * 0.1).astype(np.float32)
    triangles = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    return Mesh("glowing", corners.reshape(-1, 3), triangles)


def world_of(device):
    """A sky that is bright on one side."""
    row, column = np.mgrid[0:32, 0:64]
    light = 1 + 20 * np.exp(-(((row - 6) / 3) ** 2) - ((column - 20) / 5) ** 2)
    return sampled_world(WorldLight(light.astype(np.float32)), device)


def uploaded(lights, triangle_count=0, world=False, copies=0):
    """Lights, a mesh of triangles that emit, and smaller `copies` of it, turned and stretched at random."""
    device = wp.get_device(DEVICE)
    rest = {}
    if triangle_count:
        transform = np.random.default_rng(7).normal(size=(1 + copies, 3, 4)).astype(np.float32) * np.float32(0.3)
        transform[0] = np.eye(3, 4)
        rest = dict(
            meshes=(glowing(triangle_count, 3),),
            instances=Instances(
                mesh=np.zeros(1 + copies, np.int32),
                transform=transform,
                slot_first=np.zeros(1 + copies, np.int32),
                visibility=np.full(1 + copies, int(Visibility.ALL), np.int32),
                object=np.zeros(1 + copies, np.int32),
            ),
            slot_materials=np.zeros(1, np.int32),
            materials=(Material("glow", (Closure(ClosureKind.EMISSION, (2.0, 1.0, 0.5)),)),),
            object_names=("glowing",),
        )
    scene = scene_of(*lights, **rest)
    geometry = upload_geometry(flatten(scene), scene, device)
    return upload_lights(scene, device, world=world_of(device) if world else None, geometry=geometry), geometry


def chosen_from(lights, position, normal, both_sides=False, count=COUNT, features=ALL):
    choose_many, pdf_of_all = choice_kernel(features)
    table = lights.table
    side = packed(normal, both_sides)
    chosen = Chosen()
    chosen.emitter = wp.zeros(count, dtype=int, device=DEVICE)
    chosen.pdf, chosen.again = (wp.zeros(count, dtype=float, device=DEVICE) for _ in range(2))
    wp.launch(choose_many, count, [table, wp.vec3(*position), side, 5, chosen], device=DEVICE, block_dim=BLOCK_DIM)
    found = wp.zeros(max(table.emitter_count, 1), dtype=float, device=DEVICE)
    wp.launch(
        pdf_of_all, table.emitter_count, [table, wp.vec3(*position), side, found], device=DEVICE, block_dim=BLOCK_DIM
    )
    return chosen.emitter.numpy(), chosen.pdf.numpy(), chosen.again.numpy(), found.numpy().astype(float)


@functools.cache
def packing_kernel():
    @wp.kernel(**KERNEL_OPTIONS)
    def pack(
        normals: wp.array(dtype=wp.vec3), both: int, bits: wp.array(dtype=wp.uint32), back: wp.array(dtype=wp.vec3)
    ):
        i = wp.tid()
        bits[i] = packed_side(normals[i], both != 0)
        point = lit_point(wp.vec3(0.0), bits[i])
        back[i] = point.normal * (1.0 + float(point.both_sides))

    return pack


def pack_all(normals, both_sides):
    count = len(normals)
    bits = wp.zeros(count, dtype=wp.uint32, device=DEVICE)
    back = wp.zeros(count, dtype=wp.vec3, device=DEVICE)
    given = wp.array(np.asarray(normals, np.float32), dtype=wp.vec3, device=DEVICE)
    wp.launch(packing_kernel(), count, [given, int(both_sides), bits, back], device=DEVICE, block_dim=BLOCK_DIM)
    return bits.numpy(), back.numpy()


def packed(normal, both_sides):
    normal = np.asarray(normal, float)
    return wp.uint32(pack_all([normal / np.linalg.norm(normal)], both_sides)[0][0])


CASES = {
    "one": (lamps(1, 1), 0, False),
    "few": (lamps(6, 2), 0, True),
    "as many as are compared": (lamps(8, 3), 0, False),
    "many": (lamps(300, 4), 0, True),
    "triangles": ([], 500, False),
    "all": (lamps(40, 5), 700, True),
    "placed again and again": (lamps(5, 6), 40, True, 30),
}


@pytest.fixture(autouse=True)
def joined_alike(monkeypatch):
    """Triangles that are placed again are joined alike, and blocks looked for side by side, however few there are."""
    monkeypatch.setattr(topology, "_MANY", 0)
    monkeypatch.setattr(fill, "_NODES_APART", 4)
    monkeypatch.setattr(fill, "_NODES_TOGETHER", 2)


POINTS = [((0, 0, 0), (0, 0, 1), False), ((3.1, -2, 0.5), (-1, 1, 0.2), True), ((40, 3, 9), (-1, 0, 0), False)]


@pytest.mark.parametrize("case", each_of(2, CASES))
def test_emitters_are_chosen_as_often_as_is_said(case):
    lights, _ = uploaded(*CASES[case])
    for position, normal, both_sides in POINTS:
        emitter, pdf, again, of_all = chosen_from(lights, position, normal, both_sides)
        found = emitter >= 0
        assert found.any() == (of_all.sum() > 0)
        np.testing.assert_allclose(pdf[found], again[found], rtol=2e-5)
        np.testing.assert_allclose(pdf[found], of_all[emitter[found]], rtol=2e-5)
        # a choice that ends where nothing shines is lost; it is no emitter's
        assert of_all.sum() <= 1 + 1e-4
        assert found.mean() == pytest.approx(of_all.sum(), abs=4 * np.sqrt(0.25 / COUNT) + 1e-4)
        count = np.bincount(emitter[found], minlength=len(of_all))
        error = np.sqrt(np.maximum(of_all * COUNT, 1))
        assert (np.abs(count - of_all * COUNT) < 5.5 * error + 1).all()


@pytest.mark.parametrize("count", [5, 300])
def test_code_for_lamps_without_direction_chooses_as_that_for_all_kinds(count):
    rng = np.random.default_rng(count)
    places = [facing(place, (0, 0, -1)) for place in rng.normal(size=(count, 3)) * 3]
    lights, _ = uploaded([Light("lamp", LightKind.POINT, place, (rng.random() + 0.1,) * 3) for place in places])
    few = ChoiceFeatures((LightKind.POINT,), True, False, False)
    for point in POINTS:
        found, expected = (chosen_from(lights, *point, count=4096, features=each) for each in (few, ALL))
        assert (found[0] >= 0).all()
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_array_equal(one, other)


@functools.cache
def every_draw_kernel():
    choose, _ = make_light_choice(ChoiceFeatures(KINDS, True, True, True))

    @wp.kernel(**KERNEL_OPTIONS)
    def every_draw(table: LightTable, side: wp.uint32, emitter: wp.array(dtype=int)):
        i = wp.tid()
        u = wp.vec2(float((i * 2654435) & 16777215) / 16777216.0, float((i * 40503) & 16777215) / 16777216.0)
        emitter[i] = choose(table, lit_point(wp.vec3(0.0), side), float(i) / 16777216.0, u).emitter

    return every_draw


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("powers", [(1.0, 1e3, 1e6, 1e9), (1.0, *(2.0**-20,) * 60)])
def test_small_shares_are_met_too(powers, turned):
    """All that a random number can be: each emitter is chosen as often as it says, however seldom that is."""
    powers = powers[::-1] if turned else powers
    place = facing((0, 0, 2), (0, 0, -1))
    lights, _ = uploaded([Light(f"lamp {i}", LightKind.POINT, place, (power,) * 3) for i, power in enumerate(powers)])
    emitter = wp.zeros(2**24, dtype=int, device=DEVICE)
    inputs = [lights.table, packed((0, 0, 1), False), emitter]
    wp.launch(every_draw_kernel(), 2**24, inputs, device=DEVICE, block_dim=BLOCK_DIM)
    expected = chosen_from(lights, (0, 0, 0), (0, 0, 1), count=1)[3] * 2**24
    count = np.bincount(emitter.numpy(), minlength=len(powers))
    assert count.sum() == 2**24 and (expected > 0).all()
    assert (np.abs(count - expected) <= 5 * np.sqrt(expected) + 1).all()


@functools.cache
def irradiance_kernel():
    sample, _ = make_lights(LightFeatures(lights=KINDS, light_sphere=True, mesh_lights=True))

    @wp.kernel(**KERNEL_OPTIONS)
    def irradiance(
        table: LightTable, geometry: Geometry, position: wp.vec3, side: wp.uint32, light: wp.array(dtype=float)
    ):
        i = wp.tid()
        r = wp.rand_init(11, i)
        u = wp.vec2(wp.randf(r), wp.randf(r))
        point = lit_point(position, side)
        s = sample(table, geometry, point, wp.randf(r), u)
        if s.pdf > 0.0:
            light[i] = wp.max(wp.dot(s.direction, point.normal), 0.0) * s.radiance[0] / s.pdf

    return irradiance


def irradiance_at(lights, geometry, position, normal):
    light = wp.zeros(COUNT, dtype=float, device=DEVICE)
    arguments = [lights.table, geometry, wp.vec3(*position), packed(normal, False), light]
    wp.launch(irradiance_kernel(), COUNT, arguments, device=DEVICE, block_dim=BLOCK_DIM)
    return light.numpy().astype(float)


def test_many_lamps_together_light_as_each_alone():
    """None that shines is left out, and none counts twice."""
    many = [lamp for lamp in lamps(90, 6) if lamp.kind != LightKind.SUN]
    assert len(many) > 4 * BLOCK_WIDTH
    for position, normal, _ in POINTS[:2]:
        together = irradiance_at(*uploaded(many), position, normal)
        alone = [irradiance_at(*uploaded([lamp]), position, normal) for lamp in many]
        expected = sum(each.mean() for each in alone)
        error = np.sqrt(sum(each.var() for each in [together, *alone]) / COUNT)
        assert abs(together.mean() - expected) < 4 * error + 1e-4 * expected
        # the choice follows what each brings to the point, not its power
        power = np.array([lamp.emission[0] for lamp in many])
        by_power = sum((each**2).mean() / share for each, share in zip(alone, power / power.sum()))
        assert together.var() < by_power - expected**2


@pytest.mark.parametrize("case", ["all", "placed again and again"])
def test_nodes_hold_what_lies_below(case):
    lights, _ = uploaded(*CASES[case])
    choice = lights.choice
    fields = choice.blocks.numpy().reshape(-1, len(FIELDS), BLOCK_WIDTH)
    below, above, leaf = choice.below.numpy(), choice.above.numpy(), choice.leaf.numpy()
    assert above[0] == -1 and len(fields) == len(above) == len(below) // BLOCK_WIDTH
    assert choice.distant_count == sum(lamp.kind == LightKind.SUN for lamp in CASES[case][0]) + 1

    def node_at(number):
        values = dict(zip(FIELDS, fields[number // BLOCK_WIDTH, :, number % BLOCK_WIDTH], strict=True))
        values["centre"] = np.array([values[name] for name in "xyz"])
        values["axis"] = np.array([values[f"axis_{name}"] for name in "xyz"])
        return values

    held, stack = [], [(number, []) for number in range(BLOCK_WIDTH)]
    while stack:
        at, over = stack.pop()
        node = node_at(at)
        if node["power"] == 0:
            continue
        assert node["cos_axis"] ** 2 + node["sin_axis"] ** 2 == pytest.approx(1, abs=1e-6)
        if below[at] >= 0:
            assert above[below[at]] == at
            lower = range(below[at] * BLOCK_WIDTH, (below[at] + 1) * BLOCK_WIDTH)
            stack += [(number, [*over, node]) for number in lower]
            powers = [node_at(number)["power"] for number in lower]
            assert sum(power > 0 for power in powers) >= 2
            assert node["power"] == pytest.approx(sum(powers), rel=1e-5)
            continue
        held.append(-1 - int(below[at]))
        assert leaf[held[-1]] == at
        for each in over:
            assert np.linalg.norm(node["centre"] - each["centre"]) <= each["radius"] + 1e-5
            if each["cos_axis"] > -1 and node["cos_axis"] > -1:
                cosine = node["axis"] @ each["axis"]
                cosine = abs(cosine) if each["two_sided"] else cosine
                assert cosine >= each["cos_axis"] - 1e-3
            assert each["cos_axis"] == -1 or node["cos_axis"] > -1
            assert each["cos_axis"] == -1 or each["cos_edge"] <= node["cos_edge"]
    # blocks are filled: a few nodes in each, however few emitters there are for the last ones
    assert len(fields) < lights.emitter_count / 4
    suns = [i for i, lamp in enumerate(CASES[case][0]) if lamp.kind == LightKind.SUN]
    assert sorted(held) == sorted(set(range(lights.emitter_count - 1)) - set(suns))


@pytest.mark.parametrize("power", [1e-30, 1.0, 1e25])
def test_extreme_places_and_powers_give_probabilities(power):
    lights = [
        Light(name="here", kind=LightKind.POINT, transform=facing((0, 0, 0), (0, 0, -1)), emission=(power,) * 3),
        Light(name="far", kind=LightKind.POINT, transform=facing((1e15, 0, 0), (0, 0, -1)), emission=(1.0,) * 3),
        Light(name="sun", kind=LightKind.SUN, transform=facing((0, 0, 0), (0, 0, -1)), emission=(1.0,) * 3),
        *(
            Light(name="pile", kind=LightKind.POINT, transform=facing((1, 1, 1), (0, 0, -1)), emission=(1e-3,) * 3)
            for _ in range(20)
        ),
    ]
    table, _ = uploaded(lights)
    for position in ((0, 0, 0), (1e-25, 0, 0), (1, 1, 1), (1e15, 1, 0), (3e18, 0, 0)):
        emitter, pdf, again, of_all = chosen_from(table, position, (0, 0, 1), count=4096)
        assert (emitter >= 0).all() and (pdf > 0).all() and (pdf <= 1).all()
        np.testing.assert_allclose(pdf, again, rtol=2e-5)
        assert np.isfinite(of_all).all() and of_all.sum() == pytest.approx(1, abs=1e-4)
        assert (of_all > 0).all(), "none is without a chance"


def test_sides_keep_normals():
    rng = np.random.default_rng(2)
    normals = rng.normal(size=(5000, 3))
    normals = np.concatenate([normals, np.eye(3), -np.eye(3)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for both_sides in (False, True):
        _, back = pack_all(normals, both_sides)
        back = back / (2 if both_sides else 1)
        np.testing.assert_allclose(np.linalg.norm(back, axis=1), 1, rtol=1e-6)
        assert np.abs(back - normals).max() < 2e-4


def test_the_same_triangles_of_a_mesh_in_several_places_are_joined_alike():
    primitives = [[0, 1, 4], [0, 1, 4], [0, 2, 4], [0, 1, 4], [0, 1, 4], [3]]  # of each instance
    mesh = np.array([0, 0, 0, 1, 0, 1], np.int32)
    count = np.array([len(each) for each in primitives])
    first = np.cumsum([0, *count]).astype(np.int32)
    triangles = EmissiveTriangles(
        np.repeat(np.arange(6), count).astype(np.int32),
        np.concatenate(primitives).astype(np.int32),
        np.ones((first[-1], 3), np.float32),
        np.ones(first[-1]),
        np.zeros(first[-1], np.int32),
        first,
    )
    (runs,) = topology.runs_alike(triangles, mesh, 5)
    assert (runs.first - 5).tolist() == [0, 3, 12] and runs.count == 3
