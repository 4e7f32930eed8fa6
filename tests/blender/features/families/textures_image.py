"""Image, Environment and Sky textures, alone."""

import bpy

from tests.blender.features.build import studio
from tests.blender.features.graph import Graph
from tests.blender.features.images import file_of, image_of, pattern, sky_map, tiles
from tests.blender.features.registry import feature

INTERPOLATIONS = ("Linear", "Closest", "Cubic", "Smart")


def _look_up(graph: Graph, image: bpy.types.Image, coordinates=None, **properties):
    vector = coordinates or graph.vector_math("MULTIPLY", graph.point, (0.75, 0.75, 0.75))
    node = graph.node("ShaderNodeTexImage", {"Vector": vector}, **properties)
    node.image = image
    return node


@feature("Image Texture: interpolation", "Textures", "node", variants=INTERPOLATIONS, quick=True)
def interpolation(graph: Graph, kind: str):
    return _look_up(graph, image_of(pattern()), interpolation=kind).outputs["Color"]


@feature(
    "Image Texture: extension",
    "Textures",
    "node",
    variants=tuple(
        (each, kind) for each in ("REPEAT", "EXTEND", "CLIP", "MIRROR") for kind in ("Linear", "Closest", "Cubic")
    ),
)
def extension(graph: Graph, variant: tuple):
    image = image_of(pattern(alpha=True), alpha=True)
    return graph.outputs(_look_up(graph, image, extension=variant[0], interpolation=variant[1]))


@feature(
    "Image Texture: alpha", "Textures", "node", variants=("STRAIGHT", "PREMUL", "CHANNEL_PACKED", "NONE"), quick=True
)
def alpha(graph: Graph, mode: str):
    image = bpy.data.images.load(str(file_of(pattern(alpha=True), "alpha.png", "PNG")))
    image.alpha_mode = mode
    outputs = graph.outputs(_look_up(graph, image))
    return outputs if mode != "NONE" else {"Color": outputs["Color"]}


@feature("Image Texture: float with alpha", "Textures", "node", variants=("STRAIGHT", "PREMUL", "NONE"))
def alpha_float(graph: Graph, mode: str):
    image = bpy.data.images.load(str(file_of(pattern(alpha=True), "alpha.exr", "OPEN_EXR")))
    image.alpha_mode = mode
    outputs = graph.outputs(_look_up(graph, image))
    return outputs if mode != "NONE" else {"Color": outputs["Color"]}


COLORSPACES = (
    "sRGB",
    "Non-Color",
    "Linear Rec.709",
    "Linear Rec.2020",
    "Linear DCI-P3 D65",
    "Display P3",
    "Rec.1886",
    "ACEScg",
    "Filmic sRGB",
    "Rec.2020",
)


def _available(names: tuple[str, ...]) -> tuple[str, ...]:
    known = bpy.types.ColorManagedInputColorspaceSettings.bl_rna.properties["name"].enum_items
    return tuple(name for name in names if name in known)


@feature("Image Texture: colour spaces of bytes", "Textures", "node", variants=_available(COLORSPACES), quick=True)
def colorspaces(graph: Graph, name: str):
    image = bpy.data.images.load(str(file_of(pattern(), "bytes.png", "PNG")))
    image.colorspace_settings.name = name
    return _look_up(graph, image).outputs["Color"]


@feature("Image Texture: colour spaces of floats", "Textures", "node", variants=_available(COLORSPACES[:5]))
def colorspaces_float(graph: Graph, name: str):
    image = bpy.data.images.load(str(file_of(4 * pattern(), "floats.exr", "OPEN_EXR")))
    image.colorspace_settings.name = name
    return _look_up(graph, image).outputs["Color"]


@feature("Image Texture: HDR file", "Textures", "node")
def hdr(graph: Graph):
    return _look_up(graph, bpy.data.images.load(str(file_of(5 * pattern(), "light.hdr", "HDR")))).outputs["Color"]


@feature("Image Texture: JPEG file", "Textures", "node")
def jpeg(graph: Graph):
    return _look_up(graph, bpy.data.images.load(str(file_of(pattern(), "picture.jpg", "JPEG")))).outputs["Color"]


@feature("Image Texture: packed floats", "Textures", "node")
def packed(graph: Graph):
    return _look_up(graph, image_of(3 * pattern(), float_buffer=True)).outputs["Color"]


@feature("Image Texture: generated", "Textures", "node", variants=("BLANK", "UV_GRID", "COLOR_GRID"))
def generated(graph: Graph, kind: str):
    image = bpy.data.images.new("Generated", 32, 32)
    image.generated_type = kind
    image.generated_color = (0.2, 0.5, 0.7, 1.0)
    output = _look_up(graph, image).outputs["Color"]
    # one colour everywhere could not be distinguished from a missing texture
    return graph.vector_math("ADD", output, graph.unit) if kind == "BLANK" else output


@feature("Image Texture: UDIM tiles", "Textures", "node")
def udim(graph: Graph):
    return _look_up(
        graph, tiles(), graph.vector_math("MULTIPLY_ADD", graph.point, (0.6, 0.6, 0.0), (1.0, 1.0, 0.0))
    ).outputs["Color"]


@feature(
    "Image Texture: projections",
    "Textures",
    "node",
    variants=(("BOX", 0.0), ("BOX", 0.4), ("SPHERE", 0.0), ("TUBE", 0.0)),
)
def projection(graph: Graph, variant: tuple):
    return _look_up(graph, image_of(pattern()), graph.unit, projection=variant[0], projection_blend=variant[1]).outputs[
        "Color"
    ]


@feature("Image Texture: missing file", "Textures", "node", flat=True)
def missing(graph: Graph):
    image = bpy.data.images.new("Gone", 4, 4)
    image.source, image.filepath = "FILE", "//there/is/no/such/file.png"
    return _look_up(graph, image).outputs["Color"]


@feature("Image Texture: no image", "Textures", "node", flat=True)
def no_image(graph: Graph):
    return graph.outputs(graph.node("ShaderNodeTexImage", {"Vector": graph.point}))


@feature(
    "Environment Texture",
    "Textures",
    "node",
    variants=tuple((each, kind) for each in ("EQUIRECTANGULAR", "MIRROR_BALL") for kind in ("Linear", "Closest")),
    quick=True,
)
def environment(graph: Graph, variant: tuple):
    node = graph.node(
        "ShaderNodeTexEnvironment",
        {"Vector": graph.vector_math("NORMALIZE", graph.point)},
        projection=variant[0],
        interpolation=variant[1],
    )
    node.image = image_of(sky_map(32), float_buffer=True)
    return node.outputs["Color"]


@feature("IES Texture", "Textures", "node")
def ies(graph: Graph):
    text = bpy.data.texts.new("Lamp")
    candelas = " ".join(str(round(1000 * (1 - i / 12), 1)) for i in range(10))
    angles = " ".join(str(10 * i) for i in range(10))
    text.write(f"IESNA:LM-63-1995\nTILT=NONE\n1 1000 1.0 10 1 1 2 0 0 0\n1.0 1.0 100\n{angles}\n0\n{candelas}\n")
    vector = graph.vector_math("MULTIPLY_ADD", graph.point, (1.0, 1.0, 0.2), (0.0, 0.0, -1.0))
    node = graph.node("ShaderNodeTexIES", {"Vector": vector, "Strength": 0.05}, mode="INTERNAL")
    node.ies = text
    return node.outputs[0]


@feature("Missing images in normals, heights and roughness", "Textures", "picture")
def missing_in_nodes(scene: bpy.types.Scene) -> None:
    """An image that is not there is magenta in every node that reads it, also where that makes odd normals."""

    def absent(graph: Graph, colorspace: str, **properties):
        image = bpy.data.images.new("Gone", 4, 4)
        image.source, image.filepath = "FILE", "//not/there.png"
        image.colorspace_settings.name = colorspace
        node = graph.node(
            "ShaderNodeTexImage", {"Vector": graph.value("ShaderNodeTexCoord", output="UV")}, **properties
        )
        node.image = image
        return node

    def surface(graph: Graph):
        mapped = graph.value(
            "ShaderNodeNormalMap", {"Color": absent(graph, "Non-Color").outputs["Color"], "Strength": 0.5}
        )
        raised = {"Height": absent(graph, "Non-Color").outputs["Color"], "Normal": mapped, "Distance": 0.3}
        return graph.value(
            "ShaderNodeBsdfPrincipled",
            {
                "Base Color": absent(graph, "sRGB", projection="BOX").outputs["Color"],
                "Roughness": absent(graph, "Non-Color").outputs["Color"],
                "Metallic": absent(graph, "sRGB").outputs["Alpha"],
                "Normal": graph.value("ShaderNodeBump", raised),
            },
        )

    studio(scene, surface)


@feature("Normal maps without an image", "Textures", "picture")
def without_image(scene: bpy.types.Scene) -> None:
    """A node that has no image at all gives magenta too, and a map of object space takes it for a direction."""

    def surface(graph: Graph):
        empty = graph.node("ShaderNodeTexImage")
        mapped = graph.value("ShaderNodeNormalMap", {"Color": empty.outputs["Color"]}, space="OBJECT")
        return graph.value("ShaderNodeBsdfDiffuse", {"Color": empty.outputs["Color"], "Normal": mapped})

    studio(scene, surface)
