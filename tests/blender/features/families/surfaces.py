"""Features of surfaces: normals, transparency with textures, emitters, nested glass."""

import bpy
import numpy as np

from tests.blender.features.build import add_world, ball, box, diffuse, floor, lamp, look, material_graph, quad, studio
from tests.blender.features.graph import Graph
from tests.blender.features.images import image_of, pattern
from tests.blender.features.registry import feature
from tests.support.blender_builders import add_grid


def _sun(scene: bpy.types.Scene, world: float = 0.4, angle: float = 0.3) -> None:
    add_world(scene, world, (0.6, 0.75, 1.0))
    lamp("SUN", (0, 0, 5), target=(2, 3, 0), energy=2.0, angle=angle)


@feature("Smooth normals: the shadow's terminator", "Surface", "picture")
def terminator(scene: bpy.types.Scene) -> None:
    """A ball of few faces under a low light."""
    _sun(scene, 0.2)
    floor()
    diffuse(ball("Ball", (0, 0, 1), 1.0, segments=12, rings=6), (0.8, 0.6, 0.4))
    look(scene, (0, -4.5, 2.2), (0, 0, 0.85), lens=50)


@feature("Shadow Terminator: Geometry Offset", "Surface", "picture")
def geometry_offset(scene: bpy.types.Scene) -> None:
    """Balls of few faces under a low light: with an offset and without, of two sizes of one mesh, wider than high, and
    of a material that light comes through.
    """
    _sun(scene, 0.2)
    floor()
    for x, offset in ((-1.5, 0.4), (-0.5, 0.0)):
        made = diffuse(ball(f"Ball {x}", (x, 0, 0.5), 0.48, segments=10, rings=5), (0.8, 0.6, 0.4))
        made.shadow_terminator_geometry_offset = offset
    again = made.copy()
    again.location, again.scale, again.shadow_terminator_geometry_offset = (0.5, 0, 0.5), (1.0, 0.8, 0.7), 0.2
    scene.collection.objects.link(again)
    clear = ball("Clear", (1.5, 0, 0.5), 0.48, segments=10, rings=5)
    material_graph(clear, lambda graph: graph.value("ShaderNodeBsdfTranslucent", {"Color": (0.5, 0.8, 0.6)}))
    clear.scale = (0.9, 1.0, 1.1)
    look(scene, (0, -4.5, 1.8), (0, 0, 0.5), lens=45)


@feature("Smooth normals: glossy and glass", "Surface", "picture")
def terminator_glossy(scene: bpy.types.Scene) -> None:
    _sun(scene)
    floor()
    material_graph(
        ball("Left", (-0.8, 0, 0.75), 0.75, 12, 6),
        lambda graph: graph.value("ShaderNodeBsdfAnisotropic", {"Color": (0.9, 0.8, 0.6), "Roughness": 0.2}),
    )
    material_graph(
        ball("Right", (0.8, 0, 0.75), 0.75, 12, 6),
        lambda graph: graph.value("ShaderNodeBsdfGlass", {"Roughness": 0.1, "IOR": 1.4}),
    )
    look(scene, (0, -5, 2), (0, 0, 0.6), lens=50)


@feature("Custom normals", "Surface", "picture")
def custom_normals(scene: bpy.types.Scene) -> None:
    """A flat square with the normals of a dome."""
    _sun(scene)
    obj = add_grid("Square", 4)
    obj.scale = (1.6, 1.6, 1.0)
    mesh = obj.data
    normals = np.array([vertex.co for vertex in mesh.vertices]) + (0, 0, 1.2)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    mesh.normals_split_custom_set_from_vertices(normals.tolist())
    material_graph(
        obj, lambda graph: graph.value("ShaderNodeBsdfAnisotropic", {"Color": (0.9, 0.8, 0.6), "Roughness": 0.4})
    )
    floor().location.z = -0.5
    look(scene, (0, -4, 3), (0, 0, 0))


@feature("Auto-smoothed and flat faces in one mesh", "Surface", "picture")
def sharp_edges(scene: bpy.types.Scene) -> None:
    obj = studio(scene)
    for polygon in obj.data.polygons:
        polygon.use_smooth = polygon.center.z > 0.2
    for edge in obj.data.edges:
        edge.use_edge_sharp = edge.index % 3 == 0
    diffuse(obj, (0.8, 0.6, 0.4))


@feature("Strong bump in grazing light", "Surface", "picture")
def strong_bump(scene: bpy.types.Scene) -> None:
    """Bump that would turn normals away from the viewer."""

    def surface(graph: Graph):
        noise = graph.value(
            "ShaderNodeTexNoise", {"Vector": graph.value("ShaderNodeTexCoord", output="Object"), "Scale": 2.5}, "Fac"
        )
        bump = graph.value("ShaderNodeBump", {"Height": noise, "Distance": 3.0})
        return graph.value("ShaderNodeBsdfAnisotropic", {"Color": (0.8, 0.7, 0.5), "Roughness": 0.3, "Normal": bump})

    add_world(scene, 0.5, (0.6, 0.75, 1.0))
    lamp("SUN", (0, 0, 5), target=(6, 3, 4), energy=3.0, angle=0.3)
    obj = add_grid("Square", 1)
    obj.scale = (2, 2, 1)
    material_graph(obj, surface)
    look(scene, (0, -4, 1.2), (0, 0, 0), lens=45)


@feature("Strong bump on glass", "Surface", "picture")
def strong_bump_glass(scene: bpy.types.Scene) -> None:
    def surface(graph: Graph):
        noise = graph.value(
            "ShaderNodeTexNoise", {"Vector": graph.value("ShaderNodeTexCoord", output="Object"), "Scale": 3.0}, "Fac"
        )
        bump = graph.value("ShaderNodeBump", {"Height": noise, "Distance": 0.5})
        return graph.value(
            "ShaderNodeBsdfGlass", {"Color": (0.9, 0.9, 0.95), "Roughness": 0.1, "IOR": 1.4, "Normal": bump}
        )

    studio(scene, surface)


@feature("Strong normal map on a metal", "Surface", "picture")
def strong_normal_map(scene: bpy.types.Scene) -> None:
    def surface(graph: Graph):
        node = graph.node(
            "ShaderNodeTexImage", {"Vector": graph.value("ShaderNodeTexCoord", output="UV")}, interpolation="Linear"
        )
        node.image = image_of(pattern(), colorspace="Non-Color")
        normal = graph.value("ShaderNodeNormalMap", {"Color": node.outputs["Color"]})
        return graph.value("ShaderNodeBsdfAnisotropic", {"Color": (0.9, 0.8, 0.6), "Roughness": 0.25, "Normal": normal})

    studio(scene, surface)


@feature("Light from behind a bumped surface", "Surface", "picture")
def bump_leak(scene: bpy.types.Scene) -> None:
    """A closed room with bumped walls, bright outside: no light comes in."""

    def surface(graph: Graph):
        noise = graph.value(
            "ShaderNodeTexNoise", {"Vector": graph.value("ShaderNodeTexCoord", output="Object"), "Scale": 2.5}, "Fac"
        )
        bump = graph.value("ShaderNodeBump", {"Height": noise, "Distance": 2.0})
        return graph.value("ShaderNodeBsdfDiffuse", {"Color": (0.6, 0.6, 0.6), "Normal": bump})

    add_world(scene, 50.0)
    room = box("Room", (0, 0, 0), (3, 3, 3), 0.0, (0.6, 0.6, 0.6))
    room.data.materials.clear()
    material_graph(room, surface)
    lamp("POINT", (0.3, 0.2, 0.9), energy=30.0, shadow_soft_size=0.2)
    look(scene, (0, -1.4, 0), (0, 0, -0.1), lens=22)


@feature("Backfacing decides the shader", "Surface", "picture")
def backfacing(scene: bpy.types.Scene) -> None:
    _sun(scene)
    floor()
    for i, turn in enumerate((0.9, -0.9, 2.4)):
        obj = add_grid(f"Square {i}", 1)
        obj.scale, obj.location, obj.rotation_euler = (0.6, 0.6, 1), (1.4 * i - 1.4, 0, 0.9), (1.1 + 0.9 * i, turn, 0.3)

        def surface(graph: Graph):
            behind = graph.value("ShaderNodeNewGeometry", output="Backfacing")
            front = graph.value("ShaderNodeBsdfDiffuse", {"Color": (0.8, 0.3, 0.2)})
            back = graph.value("ShaderNodeBsdfAnisotropic", {"Color": (0.2, 0.5, 0.9), "Roughness": 0.3})
            return graph.value("ShaderNodeMixShader", {0: behind, 1: front, 2: back})

        material_graph(obj, surface)
    look(scene, (0, -5, 2.5), (0, 0, 0.6), lens=45)


@feature("Transparent shadows with alpha from a texture", "Surface", "picture", quick=True)
def alpha_shadow(scene: bpy.types.Scene) -> None:
    _sun(scene)
    floor()

    def surface(graph: Graph):
        checker = graph.value(
            "ShaderNodeTexChecker",
            {"Vector": graph.value("ShaderNodeTexCoord", output="Generated"), "Scale": 4.0},
            "Fac",
        )
        return graph.value(
            "ShaderNodeBsdfPrincipled",
            {"Base Color": (0.8, 0.4, 0.2), "Alpha": graph.math("MULTIPLY_ADD", checker, 0.8, 0.1)},
        )

    obj = add_grid("Veil", 1)
    obj.location, obj.scale = (0, 0, 1.2), (1.2, 1.2, 1)
    material_graph(obj, surface)
    look(scene, (0, -5, 3.5), (0, 0, 0.4), lens=45)


def veils(scene: bpy.types.Scene, sun_angle: float = 0.3) -> None:
    """Two squares of a colour that varies, one above the other, which light passes."""
    _sun(scene, angle=sun_angle)
    floor()

    def surface(graph: Graph):
        noise = graph.value(
            "ShaderNodeTexNoise", {"Vector": graph.value("ShaderNodeTexCoord", output="Object"), "Scale": 2.0}, "Color"
        )
        return graph.value("ShaderNodeBsdfTransparent", {"Color": noise})

    for i in range(2):
        obj = add_grid(f"Veil {i}", 1)
        obj.location, obj.scale = (0.4 * i, 0, 0.8 + 0.6 * i), (1.1, 1.1, 1)
        material_graph(obj, surface)
    look(scene, (0, -5, 3.5), (0, 0, 0.4), lens=45)


@feature("Coloured transparent shadows", "Surface", "picture")
def colored_shadow(scene: bpy.types.Scene) -> None:
    veils(scene)


@feature("Textured emitter", "Surface", "picture", quick=True)
def textured_emitter(scene: bpy.types.Scene) -> None:
    """A screen with a picture lights a floor."""

    def surface(graph: Graph):
        node = graph.node(
            "ShaderNodeTexImage", {"Vector": graph.value("ShaderNodeTexCoord", output="UV")}, interpolation="Linear"
        )
        node.image = image_of(pattern(4, 4))
        return graph.value("ShaderNodeEmission", {"Color": node.outputs["Color"], "Strength": 4.0})

    floor()
    obj = add_grid("Screen", 1)
    uv = obj.data.uv_layers.new(name="UVMap")
    for loop, layer in zip(obj.data.loops, uv.data):
        position = obj.data.vertices[loop.vertex_index].co
        layer.uv = (0.5 + 0.5 * position.x, 0.5 + 0.5 * position.y)
    obj.location, obj.scale, obj.rotation_euler = (0, 1.0, 0.8), (1.0, 0.7, 1.0), (1.4, 0, 0)
    material_graph(obj, surface)
    diffuse(ball("Ball", (0.4, -0.4, 0.35), 0.35), (0.8, 0.8, 0.8))
    look(scene, (0, -4, 2.2), (0, 0.2, 0.4), lens=40)


@feature("Emitter with procedural strength, one side dark", "Surface", "picture")
def procedural_emitter(scene: bpy.types.Scene) -> None:
    def surface(graph: Graph):
        wave = graph.value(
            "ShaderNodeTexWave", {"Vector": graph.value("ShaderNodeTexCoord", output="Object"), "Scale": 1.0}, "Fac"
        )
        front = graph.math("SUBTRACT", 1.0, graph.value("ShaderNodeNewGeometry", output="Backfacing"))
        return graph.value(
            "ShaderNodeEmission",
            {"Color": (1.0, 0.7, 0.4), "Strength": graph.math("MULTIPLY", graph.math("MULTIPLY", wave, 8.0), front)},
        )

    floor()
    diffuse(ball("Ball", (-0.6, 0.2, 0.5), 0.5), (0.8, 0.8, 0.8))
    obj = add_grid("Light", 1)
    obj.location, obj.scale, obj.rotation_euler = (0.6, 0, 1.0), (0.6, 0.6, 1.0), (0, 1.9, 0)
    material_graph(obj, surface)
    look(scene, (0, -4, 2.2), (0, 0.2, 0.4), lens=40)


@feature("Nested dielectrics", "Surface", "picture")
def nested(scene: bpy.types.Scene) -> None:
    """A ball of glass in a ball of water; surfaces are crossed one by one, as in Cycles."""

    def glass(color, ior: float):
        return lambda graph: graph.value("ShaderNodeBsdfGlass", {"Color": color, "Roughness": 0.0, "IOR": ior})

    add_world(scene, 0.8, (0.6, 0.75, 1.0))
    floor(4.0, (0.7, 0.6, 0.5))
    lamp("SUN", (0, 0, 5), target=(2, 3, 0), energy=1.0, angle=1.2)
    material_graph(ball("Outer", (0, 0, 1), 0.95, 48, 24), glass((0.95, 1.0, 0.98), 1.33))
    material_graph(ball("Inner", (0.1, 0, 1), 0.55, 48, 24), glass((1.0, 0.9, 0.85), 1.6))
    look(scene, (0, -4.5, 1.8), (0, 0, 0.9), lens=50)


@feature("Several materials, empty slots", "Surface", "picture")
def slots(scene: bpy.types.Scene) -> None:
    obj = studio(scene)
    diffuse(obj, (0.8, 0.3, 0.2))
    obj.data.materials.append(None)
    material_graph(
        obj,
        lambda graph: graph.value(
            "ShaderNodeBsdfDiffuse", {"Color": graph.value("ShaderNodeTexCoord", output="Generated")}
        ),
    )
    for polygon in obj.data.polygons:
        polygon.material_index = polygon.index % 3


@feature("Surface without shader", "Surface", "picture")
def without_shader(scene: bpy.types.Scene) -> None:
    """A surface without shader: black, and it casts a shadow."""
    obj = studio(scene, lambda graph: graph.value("ShaderNodeBsdfDiffuse", {"Color": (0.8, 0.6, 0.4)}))
    obj.data.materials[0].node_tree.links.clear()


@feature("Objects of several scales and mirrored", "Surface", "picture")
def scales(scene: bpy.types.Scene) -> None:
    """Object and generated coordinates, and bump, of objects that are stretched and mirrored."""
    _sun(scene)
    floor()

    def surface(graph: Graph):
        noise = graph.value(
            "ShaderNodeTexNoise", {"Vector": graph.value("ShaderNodeTexCoord", output="Object"), "Scale": 2.0}
        )
        bump = graph.value("ShaderNodeBump", {"Height": noise, "Distance": 0.2})
        color = graph.value("ShaderNodeTexCoord", output="Generated")
        return graph.value("ShaderNodeBsdfDiffuse", {"Color": color, "Normal": bump})

    for i, scale in enumerate(((0.6, 0.5, 0.9), (-0.5, 0.5, 0.5), (0.4, 0.8, -0.4))):
        obj = ball(f"Ball {i}", (1.4 * i - 1.4, 0, 0.8), 1.0)
        obj.scale, obj.rotation_euler = scale, (0.3 * i, 0.2, 0.5)
        material_graph(obj, surface)
    look(scene, (0, -5, 2.5), (0, 0, 0.6), lens=40)


@feature("Bounces between textured walls", "Surface", "picture")
def textured_room(scene: bpy.types.Scene) -> None:
    """A room with a floor of bricks."""
    white = (0.73, 0.73, 0.73)
    ground = quad("Floor", [(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1)], white)
    quad("Ceiling", [(-1, -1, 1), (-1, 1, 1), (1, 1, 1), (1, -1, 1)], white)
    quad("Back", [(-1, 1, -1), (1, 1, -1), (1, 1, 1), (-1, 1, 1)], white)
    quad("Left", [(-1, -1, -1), (-1, 1, -1), (-1, 1, 1), (-1, -1, 1)], (0.65, 0.05, 0.05))
    quad("Right", [(1, -1, -1), (1, -1, 1), (1, 1, 1), (1, 1, -1)], (0.12, 0.45, 0.15))
    ground.data.materials.clear()
    material_graph(
        ground,
        lambda graph: graph.value(
            "ShaderNodeBsdfDiffuse",
            {
                "Color": graph.value(
                    "ShaderNodeTexBrick",
                    {"Vector": graph.value("ShaderNodeTexCoord", output="Generated"), "Scale": 2.0},
                )
            },
        ),
    )
    lamp("AREA", (0, 0, 0.98), energy=40.0, shape="SQUARE", size=0.7, color=(1, 0.85, 0.6))
    look(scene, (0, -3.6, 0), (0, 0, 0), lens=42)


@feature("Generated coordinates along faces", "Surface", "picture")
def even_faces(scene: bpy.types.Scene) -> None:
    """Checkers whose squares end exactly in the planes of turned boxes and sheets; and transparency by one."""
    _sun(scene)
    floor()

    def surface(graph: Graph):
        return graph.value(
            "ShaderNodeBsdfDiffuse", {"Color": graph.value("ShaderNodeTexChecker", {"Scale": 4.0}, "Color")}
        )

    def sheet(graph: Graph):
        color = graph.value("ShaderNodeBsdfDiffuse", {"Color": (0.1, 0.5, 0.15)})
        factor = graph.value("ShaderNodeTexChecker", {"Scale": 8.0}, "Fac")
        return graph.value("ShaderNodeMixShader", {0: factor, 1: color, 2: graph.value("ShaderNodeBsdfTransparent")})

    for i in range(2):
        obj = box(f"Box {i}", (1.7 * i - 1.5, 0.3 * i, 0.8), (0.9, 0.9, 0.9), 0.0, (0.8, 0.8, 0.8))
        obj.rotation_euler = (0.4 + i, 0.2, 0.5 - 0.7 * i)
        obj.data.materials.clear()
        material_graph(obj, surface)
    obj = add_grid("Sheet", 3)
    obj.location, obj.rotation_euler, obj.scale = (1.7, -0.8, 0.7), (1.3, 0.2, -0.4), (0.6, 0.6, 0.6)
    material_graph(obj, sheet)
    look(scene, (0, -5, 2.5), (0, 0, 0.6), lens=40)


def wide_bump(width: float) -> None:
    """A feature of heights that are compared over `width` pixels, more than the height's own detail."""

    @feature(f"Bump compared over {width:g} pixels", "Surface", "picture")
    def build(scene: bpy.types.Scene) -> None:
        def surface(graph: Graph):
            noise = graph.value(
                "ShaderNodeTexNoise",
                {"Vector": graph.value("ShaderNodeTexCoord", output="Object"), "Scale": 9.0},
                "Fac",
            )
            bump = graph.value("ShaderNodeBump", {"Height": noise, "Distance": 0.4, "Filter Width": width})
            return graph.value("ShaderNodeBsdfDiffuse", {"Color": (0.8, 0.7, 0.5), "Normal": bump})

        studio(scene, surface)


wide_bump(1.0)
wide_bump(6.0)
