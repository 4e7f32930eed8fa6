"""Ops that make closures, and layers: on the device and folded on the host, with inputs of all kinds."""

import functools

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.op import NodeData, op_named, op_numbers
from raybatch_addon.core.programs.point import ShadingPoint
from raybatch_addon.core.programs.run import make_run
from raybatch_addon.core.programs.table import encode, upload_programs
from raybatch_addon.core.scene.description import ClosureKind as K
from raybatch_addon.core.scene.geometry import Geometry
from raybatch_addon.core.scene.program import ProgramFeatures
from raybatch_addon.core.shading.bsdf.albedo import upload_tables
from raybatch_addon.core.shading.bsdf.materials import ClosureRecord
from raybatch_addon.core.shading.images.textures import ImageTable
from tests.support import scenes
from tests.support.under_test import DEVICE

CLOSURES = (
    "emission",
    "transparent",
    "ray_portal",
    "holdout",
    "diffuse",
    "translucent",
    "rough_diffuse",
    "sheen",
    "velvet",
    "toon",
    "glossy",
    "ashikhmin_shirley",
    "metal",
    "conductor",
    "dielectric",
    "layered_diffuse",
    "glass",
    "refraction",
    "sheet",
)
LAYERS = (
    "layer_sheen",
    "layer_coat",
    "layer_specular",
    "layer_film",
    "layer_thin_glass",
    "layer_thin_glass_film",
    "specular_index",
    "refraction_tint",
    "forward_share",
    "glossy_aspect",
    "principled_aspect",
    "rotate_tangent",
)
OPS = (*CLOSURES, *LAYERS)
ROOM = 4
ODD = (np.nan, np.inf, -np.inf, -1.0, 0.0, 1e-30, 0.5, 1.0, 2.0, 1e30)


@functools.cache
def kernel():
    run = make_run(ProgramFeatures(OPS, 64, ROOM))

    @wp.kernel(**KERNEL_OPTIONS)
    def probe(
        data: NodeData,
        cosine: float,
        room: int,
        records: wp.array(dtype=ClosureRecord),
        out: wp.array(dtype=float),
        count: wp.array(dtype=int),
    ):
        stack = wp.zeros(64, dtype=float)
        closures = wp.zeros(ROOM, dtype=ClosureRecord)
        point = ShadingPoint()
        point.normal = wp.vec3(0.0, 0.0, 1.0)
        point.geometric_normal = point.normal
        point.incoming = wp.vec3(wp.sqrt(1.0 - cosine * cosine), 0.0, cosine)
        made = run(data, stack, 0, point, closures)
        count[0] = made
        for i in range(made):
            records[i] = closures[i]
        for i in range(64):
            out[i] = stack[i]

    return probe


@functools.cache
def tables():
    return upload_tables(DEVICE, reflection=True, coat=True, glass=False, sheen=True, film=True)


def on_device(code, constants, cosine=0.8):
    """Records and stack after a run on the device."""
    data = NodeData()
    data.code = wp.array(code, dtype=int, device=DEVICE)
    data.constants = wp.array(constants, dtype=float, device=DEVICE)
    data.albedo = tables()
    records, out, count = (
        wp.zeros(ROOM, dtype=ClosureRecord, device=DEVICE),
        wp.zeros(64, dtype=float, device=DEVICE),
        wp.zeros(1, dtype=int, device=DEVICE),
    )
    wp.launch(kernel(), 1, [data, cosine, ROOM, records, out, count], device=DEVICE)
    return records.numpy()[: count.numpy()[0]], out.numpy()


def run_layer(name, *operands, cosine=0.8):
    """Outputs of one op."""
    signature = op_named(name).signature
    words, constants, outputs, at = [], [], [], 0
    operands = list(operands)
    for letter in signature:
        if letter in "nv":
            words.append(-1 - len(constants))
            constants += np.atleast_1d(np.asarray(operands.pop(0), np.float32)).tolist()
        elif letter in "NV":
            width = 3 if letter == "V" else 1
            words.append(at)
            outputs.append(slice(at, at + width))
            at += width
        else:
            words.append(int(operands.pop(0)))
    code = [op_numbers()[name] | (len(words) + 1) << 16, *words, 0]
    stack = on_device(code, constants, cosine)[1]
    return [stack[register] for register in outputs]


def operands_of(name, rng, numbers):
    """Random operands of a closure op, its weight included."""
    made = []
    for letter in op_named(name).inputs:
        made.append(
            int(rng.integers(0, 3))
            if letter == "i"
            else tuple(rng.choice(numbers, 3))
            if letter == "v"
            else float(rng.choice(numbers))
        )
    return made


@pytest.mark.parametrize("name", CLOSURES)
def test_the_device_makes_the_closure_that_is_folded_on_the_host(name):
    rng = np.random.default_rng(1)
    for _ in range(8):
        builder = ProgramBuilder()
        builder.closure(name, *operands_of(name, rng, rng.uniform(0.1, 2.0, 16)))
        (record,) = builder.constant_closures()
        code, constants, _ = encode([builder.finish()], OPS)
        (made,), _ = on_device(code, constants)
        for field in made.dtype.names:
            folded = getattr(record, field)
            folded = [float(x) for x in folded] if hasattr(folded, "__len__") else float(folded)
            np.testing.assert_allclose(made[field], folded, rtol=1e-6, atol=1e-7, err_msg=field)
        assert K(made["kind"]).is_model


@pytest.mark.parametrize("name", CLOSURES)
def test_closures_are_valid_whatever_the_inputs(name):
    rng = np.random.default_rng(2)
    for _ in range(40):
        operands = operands_of(name, rng, ODD)
        operands[0] = (0.5, 0.0, 1.0)
        words, constants = [], []
        for operand in operands:
            if isinstance(operand, int):
                words.append(operand)
            else:
                words.append(-1 - len(constants))
                constants += np.atleast_1d(np.asarray(operand, np.float32)).tolist()
        made, _ = on_device([op_numbers()[name] | (len(words) + 1) << 16, *words, 0], constants)
        for record in made:
            for field in record.dtype.names:
                assert np.isfinite(record[field]).all(), (field, operands)
            assert 0 <= record["roughness"] <= 1 and record["aspect"] > 0 and record["ior"] > 0
            for field in ("normal", "tangent"):
                assert abs(np.linalg.norm(record[field]) - 1) < 1e-5 or not record[field].any()


def test_closures_never_go_beyond_their_room():
    builder = ProgramBuilder()
    for _ in range(ROOM + 3):
        builder.closure("diffuse", (0.5, 0.5, 0.5), (0.0, 0.0, 0.0))
    code, constants, _ = encode([builder.finish()], OPS)
    assert len(on_device(code, constants)[0]) == ROOM


def test_black_closures_are_left_out_of_programs_and_counted():
    """A constant that changes must change no kernel."""
    builder = ProgramBuilder()
    tint = builder.value("object_coordinates", 0)
    builder.closure("emission", (0.0, 0.0, 0.0))
    builder.closure("diffuse", tint, (0.0, 0.0, 0.0))
    program = builder.finish()
    assert [step.op for step in program.instructions] == ["object_coordinates", "diffuse"]
    assert "emission" in program.ops and program.closure_count == 2


@pytest.mark.parametrize("cosine", [1.0, 0.5, 0.1, 0.001])
def test_layers_take_no_more_than_there_is(cosine):
    rng = np.random.default_rng(3)
    zero = (0.0, 0.0, 0.0)
    for _ in range(20):
        weight, tint, u = rng.uniform(0, 1, 3).astype(np.float32), rng.uniform(0, 1, 3), rng.uniform(0, 1, 4)
        fibres, below, _ = run_layer("layer_sheen", weight, u[0], tint, u[1], zero, zero, 0.0, cosine=cosine)
        assert (below >= 0).all() and (below <= weight).all() and (fibres <= weight).all()
        _coat, below, _ = run_layer("layer_coat", weight, u[0], u[1], 1 + u[2], (1, 1, 1), zero, cosine=cosine)
        assert (below >= 0).all() and (below <= weight).all()
        below = run_layer("layer_specular", weight, tint, int(u[0] > 0.5), u[1], 1 + u[2], zero, cosine=cosine)[0]
        assert (below >= 0).all() and (below <= weight).all()
        below = run_layer("layer_film", weight, tint, 1 + u[2], zero, 500 * u[3], 1 + u[0], cosine=cosine)[0]
        assert (below >= 0).all() and (below <= weight).all()


def test_a_layer_takes_the_same_share_of_all_channels():
    (below,) = run_layer("layer_specular", (0.4, 0.2, 0.8), (1.0, 0.2, 0.1), 0, 0.0, 1.5, (0.0, 0.0, 0.0), cosine=1.0)
    np.testing.assert_allclose(below, 0.96 * np.array((0.4, 0.2, 0.8)), rtol=1e-5)


def test_a_coat_tints_by_the_way_through_it():
    ior, cosine = 1.5, 0.3
    inside = np.sqrt(1 - (1 - cosine**2) / ior**2)
    tint = np.array((1.0, 0.5, 0.0))
    clear, tinted = (
        run_layer("layer_coat", (1, 1, 1), 0.5, 0.2, ior, each, (0.0, 0.0, 0.0), cosine=cosine)[1]
        for each in ((1, 1, 1), tint)
    )
    np.testing.assert_allclose(tinted / clear, 0.5 + 0.5 * tint ** (1 / inside), rtol=1e-5)


@pytest.mark.parametrize("cosine", [1.0, 0.4, 0.01])
def test_clear_thin_glass_loses_nothing(cosine):
    sheet = ((1, 1, 1), (1, 1, 1), (1, 1, 1), 1.5, (0.0, 0.0, 0.0))
    clear = run_layer("layer_thin_glass", *sheet, cosine=cosine)
    np.testing.assert_array_equal(clear, run_layer("layer_thin_glass_film", *sheet, 0.0, 1.4, cosine=cosine))
    for reflected, passed in (clear, run_layer("layer_thin_glass_film", *sheet, 400.0, 1.4, cosine=cosine)):
        np.testing.assert_allclose(reflected + passed, 1, rtol=1e-5)
        assert (passed > 0).all() and (reflected > 0).all()


def test_layers_of_an_index_below_1_take_what_those_of_its_inverse_take():
    for cosine in (1.0, 0.5, 0.1):
        below = [
            run_layer("layer_specular", (1, 1, 1), (1, 1, 1), 0, 0.3, ior, (0.0, 0.0, 0.0), cosine=cosine)[0]
            for ior in (0.8, 1.25)
        ]
        np.testing.assert_allclose(*below, rtol=1e-6)
    coat = run_layer("layer_coat", (1, 1, 1), 1.0, 0.3, 0.8, (1, 1, 1), (0.0, 0.0, 0.0), cosine=0.5)
    np.testing.assert_array_equal(coat[1], (1, 1, 1))  # a coat has no index below 1
    assert coat[2] == 1


def test_rough_sheets_scatter_and_smooth_ones_are_transparent():
    for roughness, ior, kind in (
        (0.0, 1.5, K.TRANSPARENT),
        (0.5, 1.5, K.SHEET),
        (0.5, 0.8, K.TRANSPARENT),
        (0.5, 1.0, K.TRANSPARENT),
    ):
        builder = ProgramBuilder()
        builder.closure("sheet", (0.5, 0.5, 0.5), roughness, ior, (0.0, 0.0, 0.0))
        (record,) = builder.constant_closures()
        assert record.kind == kind
        if kind == K.SHEET:  # alpha, as in Cycles' bsdf_thin_glass_transmission_roughness
            assert record.roughness**2 == pytest.approx(
                roughness**2 * np.sqrt(3.4 * (ior - 1) * (ior - 0.5) ** 2 / ior**3), rel=1e-6
            )


@pytest.mark.parametrize("ior", [1.5, 2.2, 1.0])
def test_specular_levels_scale_the_reflectance_at_normal_incidence(ior):
    for level in (0.0, 0.25, 0.5, 1.0):
        (index,) = run_layer("specular_index", ior, level)
        assert ((index - 1) / (index + 1)) ** 2 == pytest.approx(
            2 * level * ((ior - 1) / (ior + 1)) ** 2, rel=1e-4, abs=1e-12
        )
    assert 1 / run_layer("specular_index", 1 / 1.5, 1.0)[0] == pytest.approx(
        run_layer("specular_index", 1.5, 1.0)[0], rel=1e-5
    )


def test_tangents_turn_about_the_normal():
    (turned,) = run_layer("rotate_tangent", (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.25)
    np.testing.assert_allclose(turned, (0, 1, 0), atol=1e-6)


def test_anisotropy_has_the_aspects_of_blender():
    assert run_layer("glossy_aspect", 0.6)[0] == pytest.approx(0.4)
    assert run_layer("glossy_aspect", -0.5)[0] == pytest.approx(2)
    assert run_layer("principled_aspect", 1.0)[0] == pytest.approx(1 / np.sqrt(0.1))


def test_tables_that_ops_read_are_uploaded_for_each_of_them():
    """Each op's tables are uploaded whatever other ops the scene has."""
    scene = scenes.scene()
    for name, table in {
        "layer_thin_glass_film": "film",
        "layer_film": "film",
        "layer_sheen": "sheen",
        "layer_coat": "coat",
        "layer_specular": "reflection",
    }.items():
        data = upload_programs(
            [None], ProgramFeatures((name,), 32, 1), scene, Geometry(), ImageTable(), wp.get_device(DEVICE)
        )
        assert getattr(data.albedo, table).size > 0, name
