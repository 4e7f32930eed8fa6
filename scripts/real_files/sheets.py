"""Files without a camera: they are given one that sees all, and the materials of a library are put on balls."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import bpy
import numpy as np
from lib.node_trees import with_nodes
from mathutils import Vector

COLUMNS, ROWS = 4, 3  # balls of a sheet
SPACING = 2.4  # of balls with a radius of 1 [m]
TILT = math.radians(30)  # of the camera, from straight above
SEGMENTS, RINGS = 48, 24
WITH_MATERIALS = ("MESH", "CURVE", "CURVES", "SURFACE", "FONT", "META", "POINTCLOUD", "VOLUME")  # objects


@dataclass(frozen=True)
class Sheet:
    """Balls that are rendered together."""

    balls: tuple[bpy.types.Object, ...]

    def show(self, others: Sheets) -> None:
        """Leave the balls of all other sheets out."""
        for sheet in others.sheets:
            for ball in sheet.balls:
                ball.hide_render = sheet is not self


@dataclass
class Sheets:
    """The scene that a file without a camera is rendered as."""

    note: str  # what was done, for whoever reads of the file
    materials: list[str] = field(default_factory=list)  # by name, in their order on the sheets
    sheets: list[Sheet] = field(default_factory=list)  # none: the scene as it is

    def cells(self, size: tuple[int, int]) -> list[dict]:
        """Where each material is in the sheets, stacked from top to bottom, each of `size` pixels: `box` is
        [x0, y0, x1, y1], from the bottom left.
        """
        width, height = size
        return [
            {"material": name, "box": [*_box(number, width, height, len(self.sheets))]}
            for number, name in enumerate(self.materials)
        ]


def _box(number: int, width: int, height: int, sheets: int) -> tuple[int, int, int, int]:
    sheet, place = divmod(number, COLUMNS * ROWS)
    row, column = divmod(place, COLUMNS)
    bottom = (sheets - 1 - sheet) * height
    x0, x1 = (round(width * each / COLUMNS) for each in (column, column + 1))
    y0, y1 = (round(height * (ROWS - each) / ROWS) for each in (row + 1, row))
    return x0, bottom + y0, x1, bottom + y1


def sheets_of(scene: bpy.types.Scene) -> Sheets | None:
    """Give `scene`, which has no camera, one: of all that it shows, or of its file's materials, where most of them are
    on nothing in it. None where there is nothing to see.
    """
    shown = list(_shown(scene))
    used = {slot.material for each in shown for slot in each.material_slots if slot.material}
    materials = [each for each in bpy.data.materials if not each.is_grease_pencil]
    if len(used) < len(materials) / 2:
        return _library(scene, sorted(materials, key=lambda material: material.name_full.lower()))
    if not shown:
        return None
    if not _see_all(scene):
        return None
    return Sheets("the scene has no camera: it was given one that sees all of it")


def _shown(scene: bpy.types.Scene) -> Iterator[bpy.types.Object]:
    for each in scene.objects:
        if each.type in WITH_MATERIALS and not each.hide_render:
            yield each


def _see_all(scene: bpy.types.Scene) -> bool:
    """A camera as Blender's new scene has it: from the front, from the right and from above; False, and none, where
    all that renders would show is hidden in viewports.
    """
    graph = bpy.context.evaluated_depsgraph_get()
    corners = [
        instance.matrix_world @ Vector(corner)
        for instance in graph.object_instances
        if instance.object.type in WITH_MATERIALS and not instance.object.original.hide_render
        for corner in instance.object.bound_box
    ]
    if not corners:
        return False
    camera = _camera(scene)
    camera.rotation_euler = (math.radians(63.6), 0, math.radians(46.7))
    graph = bpy.context.evaluated_depsgraph_get()
    place, _ = camera.camera_fit_coords(graph, [value for corner in corners for value in corner])
    camera.location = place
    middle = sum(corners, Vector((0, 0, 0))) / len(corners)
    reach = max((corner - middle).length for corner in corners)
    distance = (place - middle).length
    camera.data.clip_start, camera.data.clip_end = max(distance - 2 * reach, 1e-3 * distance), distance + 2 * reach
    return True


def _library(scene: bpy.types.Scene, materials: list[bpy.types.Material]) -> Sheets:
    """The balls of all sheets, over a floor with a pattern, below a sun and a grey world."""
    for each in scene.objects:
        each.hide_render = True
    count = COLUMNS * ROWS
    mesh = _ball()
    sheets = [
        Sheet(tuple(_placed(scene, mesh, each, place) for place, each in enumerate(materials[first : first + count])))
        for first in range(0, len(materials), count)
    ]
    _floor(scene)
    sun = bpy.data.lights.new("Sun of the sheets", "SUN")
    sun.energy, sun.angle = 3.0, 0.2
    _linked(scene, sun).rotation_euler = (math.radians(40), math.radians(-25), 0)
    scene.world = with_nodes(bpy.data.worlds.new("World of the sheets"))
    background = next(node for node in scene.world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (0.4, 0.4, 0.4, 1)
    camera = _camera(scene)
    camera.data.type, camera.data.ortho_scale = "ORTHO", COLUMNS * SPACING
    camera.rotation_euler = (TILT, 0, 0)
    camera.location = (0, -20 * math.sin(TILT), 20 * math.cos(TILT))
    scene.render.resolution_x, scene.render.resolution_y = 100 * COLUMNS, 100 * ROWS
    scene.render.pixel_aspect_x = scene.render.pixel_aspect_y = 1
    note = (
        f"a library without a camera: its {len(materials)} materials are on balls over a chequered floor, "
        f"{count} a sheet"
    )
    return Sheets(note, [each.name_full for each in materials], sheets)


def _placed(scene: bpy.types.Scene, mesh: bpy.types.Mesh, material: bpy.types.Material, place: int):
    row, column = divmod(place, COLUMNS)
    ball = _linked(scene, mesh)
    ball.material_slots[0].link = "OBJECT"
    ball.material_slots[0].material = material
    # rows are as far apart in the picture as columns
    ball.location = ((column - (COLUMNS - 1) / 2) * SPACING, ((ROWS - 1) / 2 - row) * SPACING / math.cos(TILT), 0)
    return ball


def _ball() -> bpy.types.Mesh:
    """A smooth ball of radius 1 with a UV map and a slot for a material."""
    across, down = np.meshgrid(np.arange(SEGMENTS), np.arange(RINGS))
    corners = np.stack([[across, down], [across + 1, down], [across + 1, down + 1], [across, down + 1]])
    corners = corners.transpose(2, 3, 0, 1).reshape(-1, 4, 2)  # [face, corner, (segment, ring)]
    u, v = np.meshgrid(np.arange(SEGMENTS), np.arange(RINGS + 1))
    turn, rise = u.ravel() * 2 * math.pi / SEGMENTS, (v.ravel() / RINGS - 0.5) * math.pi
    positions = np.stack([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)], -1)
    faces = corners[..., 0] % SEGMENTS + corners[..., 1] * SEGMENTS
    made = bpy.data.meshes.new("Ball of the sheets")
    made.from_pydata(positions.tolist(), [], faces.tolist())
    layer = made.uv_layers.new(name="UVMap")
    layer.data.foreach_set("uv", (corners / (SEGMENTS, RINGS)).astype(np.float32).ravel())
    made.shade_smooth()
    made.materials.append(None)
    return made


def _floor(scene: bpy.types.Scene) -> None:
    made = bpy.data.meshes.new("Floor of the sheets")
    edge = 2.0 * COLUMNS * SPACING
    made.from_pydata([(-edge, -edge, -1), (edge, -edge, -1), (edge, edge, -1), (-edge, edge, -1)], [], [(0, 1, 2, 3)])
    material = with_nodes(bpy.data.materials.new("Floor of the sheets"))
    tree = material.node_tree
    tree.nodes.clear()
    kinds = ("NewGeometry", "TexChecker", "BsdfDiffuse", "OutputMaterial")
    geometry, checker, diffuse, output = (tree.nodes.new(f"ShaderNode{kind}") for kind in kinds)
    checker.inputs["Scale"].default_value = 1.5
    for name, grey in (("Color1", 0.6), ("Color2", 0.2)):
        checker.inputs[name].default_value = (grey, grey, grey, 1)
    for start, end in (
        (geometry.outputs["Position"], checker.inputs["Vector"]),
        (checker.outputs["Color"], diffuse.inputs["Color"]),
        (diffuse.outputs[0], output.inputs["Surface"]),
    ):
        tree.links.new(start, end)
    made.materials.append(material)
    _linked(scene, made)


def _camera(scene: bpy.types.Scene) -> bpy.types.Object:
    scene.camera = _linked(scene, bpy.data.cameras.new("Camera of the comparison"))
    return scene.camera


def _linked(scene: bpy.types.Scene, data) -> bpy.types.Object:
    made = bpy.data.objects.new(data.name, data)
    scene.collection.objects.link(made)
    return made
