"""Attributes: values that meshes and objects have by name."""

import warp as wp

from ...inputs_data import PER_CORNER
from ...op import NodeData, op, put_number, put_vector
from ...point import ShadingPoint, shifted_barycentric

_WIDTH = PER_CORNER - 1


@wp.func
def attribute_width(data: NodeData, point: ShadingPoint, attribute: int) -> int:
    """How many numbers the attribute has at every point, 1 to 4; 0 if the mesh has none of that name."""
    if point.instance < 0 or attribute < 0 or attribute >= data.inputs.attribute_first.shape[1]:
        return 0
    row = data.inputs.attribute_row[point.instance]
    if data.inputs.attribute_first[row, attribute] < 0:
        return 0
    return data.inputs.attribute_layout[row, attribute] & wp.static(_WIDTH)


@wp.func
def attribute_value(data: NodeData, point: ShadingPoint, attribute: int, width: int, barycentric: wp.vec2) -> wp.vec4:
    """The attribute's `width` >= 1 numbers, and 0 beyond.

    They are linear across triangles where corners have values of their own.
    """
    row = data.inputs.attribute_row[point.instance]
    at = data.inputs.attribute_first[row, attribute]
    value = wp.vec4(0.0)
    if (data.inputs.attribute_layout[row, attribute] & wp.static(PER_CORNER)) != 0:
        at += 3 * width * point.primitive
        first = 1.0 - barycentric[0] - barycentric[1]
        for k in range(width):
            a = data.inputs.attribute_values[at + k]
            b = data.inputs.attribute_values[at + width + k]
            c = data.inputs.attribute_values[at + 2 * width + k]
            value[k] = first * a + barycentric[0] * b + barycentric[1] * c
    else:
        at += width * point.primitive
        for k in range(width):
            value[k] = data.inputs.attribute_values[at + k]
    return value


@wp.func
def mean(v: wp.vec4) -> float:
    """Mean of the first three components."""
    return (v[0] + v[1] + v[2]) * wp.static(1.0 / 3.0)


@op("attribute", "asi>VNN", foldable=False)
@wp.func
def attribute(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Attribute of a mesh as colour, number and alpha.

    Words 2 and 3 are the shift, and the alpha of a mesh that lacks the attribute.
    """
    which = data.code[pc + 1]
    width = attribute_width(data, point, which)
    color = wp.vec3(0.0)
    number = float(0.0)
    alpha = float(data.code[pc + 3])
    if width > 0:
        value = attribute_value(data, point, which, width, shifted_barycentric(point, data.code[pc + 2]))
        color = wp.vec3(value[0], value[1], value[2])
        number = value[0]
        alpha = 1.0
        if width == 1:
            color = wp.vec3(value[0])
        elif width >= 3:
            number = mean(value)
        if width == 4:
            alpha = value[3]
    put_vector(data, stack, pc + 4, color)
    put_number(data, stack, pc + 5, number)
    put_number(data, stack, pc + 6, alpha)


@op("object_attribute", "i>VNN", foldable=False)
@wp.func
def object_attribute(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Attribute of an object, by its column in `Instances.attributes`, as colour, number and alpha; 0 without it."""
    value = wp.vec4(0.0)
    column = data.code[pc + 1]
    if point.instance >= 0 and column >= 0 and column < data.inputs.object_attributes.shape[1]:
        value = data.inputs.object_attributes[point.instance, column]
    put_vector(data, stack, pc + 2, wp.vec3(value[0], value[1], value[2]))
    put_number(data, stack, pc + 3, mean(value))
    put_number(data, stack, pc + 4, value[3])
