"""Functions that take structs by reference: they compute what they do by value, also where they write to them."""

import re

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.ahead.request import GeneralRequest
from raybatch_addon.core.device.codegen.by_reference import by_reference
from raybatch_addon.core.device.devices import find_device, start_warp
from raybatch_addon.core.device.kernel import MODULE_OPTIONS, OUT_OF_LINE_OPTIONS, is_general
from tests.support.running.general_kernels import general_source


@wp.struct
class Inner:
    direction: wp.vec3
    weight: float


@wp.struct
class Outer:
    values: wp.array(dtype=float)
    inner: Inner
    number: int


@wp.func
def read(outer: Outer, i: int) -> float:
    return outer.values[i] * outer.inner.weight + outer.inner.direction[1] + float(outer.number)


@wp.func
def member(outer: Outer, i: int) -> float:
    outer.number = 7
    return read(outer, i)


@wp.func
def member_of_member(outer: Outer, i: int) -> float:
    outer.inner.weight = 5.0
    return read(outer, i)


@wp.func
def component(outer: Outer, i: int) -> float:
    outer.inner.direction[1] = 11.0
    return read(outer, i)


@wp.func
def component_added(outer: Outer, i: int) -> float:
    outer.inner.direction[1] += 3.0
    return read(outer, i)


@wp.func
def added(outer: Outer, i: int) -> float:
    outer.inner.weight += 2.0
    return read(outer, i)


@wp.func
def handed_on(outer: Outer, i: int) -> float:
    return member(outer, i) + read(outer, i)


@wp.func
def element(outer: Outer, i: int) -> float:
    outer.values[i] = outer.values[i] + 1.0
    return read(outer, i)


FUNCTIONS = (read, member, member_of_member, component, component_added, added, handed_on, element)


def kernel_of(options):
    def compute(outer: Outer, out: wp.array2d(dtype=float)):
        i = wp.tid()
        out[i, 0] = read(outer, i)
        out[i, 1] = member(outer, i)
        out[i, 2] = member_of_member(outer, i)
        out[i, 3] = component(outer, i)
        out[i, 4] = component_added(outer, i)
        out[i, 5] = added(outer, i)
        out[i, 6] = handed_on(outer, i)
        out[i, 7] = element(outer, i)
        out[i, 8] = read(outer, i)

    return wp.kernel(compute, module="unique", module_options=options, enable_backward=False)


def source_of(kernel):
    module = kernel.module
    module.get_module_hash(1)
    return module._run_codegen(module.resolved_options[1] | {"output_arch": None}, True)[0]


def test_what_a_function_writes_to_is_its_own():
    start_warp()
    found = []
    for options in (MODULE_OPTIONS, OUT_OF_LINE_OPTIONS):
        outer = Outer()
        outer.values = wp.array(np.arange(4, dtype=np.float32), device="cpu")
        outer.inner.direction, outer.inner.weight, outer.number = wp.vec3(1.0, 2.0, 3.0), 0.5, 1
        out = wp.zeros((4, len(FUNCTIONS) + 1), dtype=float, device="cpu")
        wp.launch(kernel_of(options), dim=4, inputs=[outer, out], device="cpu")
        found.append(out.numpy())
    np.testing.assert_array_equal(*found)
    i = np.arange(4)
    np.testing.assert_allclose(found[0][:, 1], i * 0.5 + 2 + 7)  # that the functions do write
    np.testing.assert_allclose(found[0][:, 3], i * 0.5 + 11 + 1)
    np.testing.assert_allclose(found[0][:, 5], i * 2.5 + 2 + 1)
    np.testing.assert_allclose(found[0][:, 8], (i + 1) * 0.5 + 2 + 1)


def test_only_what_is_read_is_taken_by_reference():
    start_warp()
    source = source_of(kernel_of(OUT_OF_LINE_OPTIONS))
    for function in FUNCTIONS:
        header = re.search(rf"^static [^\n]* {function.key}_\d+\(\n([^)]*)\)", source, re.MULTILINE)[1]
        assert ("& __restrict var_outer" in header) == (function in (read, handed_on, element)), function.key
    assert "& __restrict var_outer" not in source_of(kernel_of(MODULE_OPTIONS))


@pytest.mark.parametrize(
    "line",
    [
        "    var_outer.inner.weight = var_3;",
        "    if (var_1) { var_outer.number = var_3; }",
        "    wp::assign_inplace(var_outer.inner.direction, var_2, var_3);",
        "    var_4 = &((var_outer).inner);\n    var_5 = &(var_4->weight);\n    wp::store(var_5, var_3);",
        "    var_4 = &(var_outer.inner);\n    var_4->weight = var_3;",
        "    var_4 = &(var_outer.inner);\n    var_5 = wp::indexref(var_4, var_2);\n    wp::assign(var_5, var_3);",
    ],
)
def test_whatever_way_it_is_written_to(line):
    source = f"static float f_0(\n    Outer_1 var_outer,\n    float var_x)\n{{\n{line}\n}}\n"
    assert by_reference(source, {"var_outer": "Outer_1"}) == source
    assert "Outer_1 & __restrict var_outer," in by_reference(
        source.replace(line, "    var_6 = var_3;"), {"var_outer": "Outer_1"}
    )


def test_large_structs_of_the_general_tier_are_taken_by_reference():
    start_warp()
    kernels = GeneralRequest().kernels(find_device("cpu"))
    general = {each.module.name: each for each in kernels if is_general(each.module)}
    assert len(general) == 3
    smallest = next(kernel for name, kernel in general.items() if "estimates" in name)
    large = re.findall(
        r"^    (?:Lights|Geometry|SurfacePoint|Paths)_\w+ (& __restrict )?var_\w+[,)]",
        general_source(smallest),
        re.MULTILINE,
    )
    assert len(large) > 10
    assert all(large)
