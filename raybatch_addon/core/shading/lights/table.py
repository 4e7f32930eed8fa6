"""Tables on the device: lights, and what the choice among all emitters reads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from ...device.bulk import digest_of, large_empty
from ...native.structs import record_type, upload_records, upload_struct
from ...scene.description import Light, LightKind, Scene, Visibility
from ...scene.geometry import Geometry
from .choice_table import ChoiceTable
from .emissive.arrays import KeepArrays, set_triangles
from .emitters import (
    CELL,
    EmissiveCells,
    EmissiveTriangles,
    find_emissive_triangles,
    light_area,
    light_strengths,
    triangle_strengths,
)
from .link_table import upload_links
from .met.boxes import BoxBlock, box_tree
from .tree.fill import fill_blocks, launch_parts
from .tree.kernels import EmitterBoxes, EmittingTriangles, LightNode, bound_triangles_kernel
from .tree.topology import Alike, runs_alike
from .world import SampledWorld, WorldTable

_FLOAT = np.finfo(np.float32)

# The square of a sphere's angular radius must stay a normal float32 up to this distance; smaller spheres act as points
_DISTANCE_MAX = 1e9  # [m]
_RADIUS_MIN = float(np.sqrt(_FLOAT.tiny)) * _DISTANCE_MAX  # [m], about 1e-10
# Rounding of a direction; light that spreads less than this is parallel
_ANGLE_MIN = float(_FLOAT.eps)  # [rad]
# Strength of a lamp that seems black, beside the scene's strongest emitter
_UNSEEN = 1e-4
# Least strength of what shines at all, beside the same
_LEAST = 1e-36

KeepTree = Callable[[tuple[list[np.ndarray], object], Callable[[], ChoiceTable]], ChoiceTable]


@wp.struct
class LightRecord:
    """One light without mesh; fields that its kind does not use are 0."""

    kind: int  # `LightKind`, or CELL
    visibility: int  # `Visibility` bits
    casts_shadow: int
    delta: int  # 1: no ray meets it by chance
    sphere: int  # POINT, SPOT: 1: a sphere; 0: a disk that faces the shaded point; CELL: instance of its volume
    program: int  # 1: `emission` is multiplied by the result of a program
    position: wp.vec3  # [m]
    axis_x: wp.vec3  # unit
    axis_y: wp.vec3  # unit
    axis: wp.vec3  # unit, the direction in which it shines
    # radiance, before spread and cone [W/(m² sr)]; of delta lights POINT, SPOT: radiant intensity [W/sr]; of other
    # delta lights: irradiance of a surface that faces it [W/m²]; CELL: one over its rate [m]
    emission: wp.vec3
    radius: float  # POINT, SPOT [m]; CELL: half its edge along `axis`
    one_minus_cos: float  # SUN: 1 - cos of half its angular diameter
    cos_half: float  # SPOT: cosine of half the cone's angle
    inverse_blend: float  # SPOT: one over the span of the cosine that is softened; 0: a hard edge
    squeeze_x: float  # SPOT: one over the width of the cone relative to z
    squeeze_y: float
    half_x: float  # RECTANGLE, ELLIPSE, CELL: half width [m]
    half_y: float
    tan_half_spread: float  # RECTANGLE, ELLIPSE: tangent of half the spread
    spread_scale: float  # RECTANGLE, ELLIPSE: one over that tangent, or 0; CELL: 1 / sqrt(rate * volume) [1/m]


@wp.struct
class LightTable:
    """All emitters: lights without mesh, cells of volumes, emissive triangles, and the world if it is sampled."""

    emitter_count: int
    light_count: int  # cells among them
    choice: wp.array(dtype=ChoiceTable)  # [1]: kernels have the table in their parameters, whose size is limited
    lights: wp.array(dtype=LightRecord)  # [light_count], and behind them the portals of the world, if it is sampled
    sun_count: int
    suns: wp.array(dtype=int)  # numbers of the suns with a size; [sun_count]
    tree: wp.array(dtype=BoxBlock)  # over the boxes of the lights that rays can meet; no entries where there is none
    tree_leaf: int  # its first block of items
    tree_visibility: int  # `Visibility` bits that any of them has
    triangle_instance: wp.array(dtype=int)  # [emitter_count - light_count], ascending
    triangle_primitive: wp.array(dtype=int)  # ascending within an instance
    triangle_radiance: wp.array(dtype=wp.vec3)  # [W/(m² sr)]
    instance_first: wp.array(dtype=int)  # first triangle of each instance in the three above; [instance_count + 1]
    instance_visibility: wp.array(dtype=int)  # `Visibility` bits
    triangle_program: wp.array(dtype=int)  # 1: the radiance comes from a program; no entries where none does
    world_emitter: int  # -1: the world is not sampled
    world_visibility: int  # `Visibility` bits
    world_casts_shadow: int
    world: WorldTable


@dataclass
class UploadedLights:
    """A `LightTable`, with the objects that must outlive it."""

    table: LightTable
    choice: ChoiceTable
    triangle_count: int  # number of emissive triangles

    @property
    def emitter_count(self) -> int:
        """Number of lights and emissive triangles together."""
        return self.table.emitter_count


def upload_lights(
    scene: Scene,
    device: wp.Device,
    emitted: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
    world: SampledWorld | None = None,
    lamps: Callable[[LightTable], np.ndarray] | None = None,
    triangles: EmissiveTriangles | None = None,
    geometry: Geometry | None = None,
    cells: EmissiveCells | None = None,
    keep: KeepTree = lambda key, make: make(),
    keep_triangles: KeepArrays = lambda key, make: make(),
) -> UploadedLights:
    """The emitters of `scene` on `device`; raises `SceneError` for emission that is not finite.

    Args:
        emitted: computes the mean radiance of triangles (instances, primitives) whose material is a program, float32,
            shape [n, 3].
        world: the world, if it is sampled.
        lamps: computes the factor by which programs change the brightness of each light, float64, shape [light_count],
            from a table that holds lights, and portals behind them, alone.
        triangles: the emissive triangles, where they are known.
        geometry: that of `scene` on `device`; needed where triangles emit.
        cells: those of volumes; the first is the emitter behind the last light without mesh.
        keep: returns the tree over emitters that `make` makes, or one that it made before of the same arrays, if they
            are frozen, and values.
        keep_triangles: the same for what the table has of emissive triangles and of instances.
    """
    if triangles is None:
        triangles = find_emissive_triangles(scene, emitted)
    if len(triangles) and geometry is None:
        raise ValueError("triangles emit: give the scene's geometry too")
    strength = light_strengths(scene.lights)
    records = np.zeros(len(scene.lights), record_type(LightRecord))
    for i, light in enumerate(scene.lights):
        _fill_record(records[i, ...], light)
    records = records if cells is None else np.concatenate([records, _cell_records(cells)])

    def upload(values, dtype) -> wp.array:
        return wp.array(values, dtype=dtype, device=device)

    sized = np.where(records["delta"] == 0, records["kind"], CELL)
    suns = np.flatnonzero(sized == LightKind.SUN).astype(np.int32)
    placed = np.flatnonzero((sized != LightKind.SUN) & (sized != CELL)).astype(np.int32)

    table = LightTable()
    table.emitter_count = len(records) + len(triangles) + (world is not None)
    table.light_count = len(records)
    table.lights = upload_records(np.concatenate([records, _portals(scene, world)]), LightRecord, device)
    if lamps is not None:
        strength *= lamps(table)
    strength = strength if cells is None else np.concatenate([strength, cells.strength])
    table.sun_count = len(suns)
    table.suns = upload(suns, int)
    table.tree, table.tree_leaf = box_tree(*_boxes(records[placed]), placed, device)
    table.tree_visibility = int(np.bitwise_or.reduce(records["visibility"][placed], initial=0))
    # the rays that see an instance; its other bits say whose light it blocks or catches
    visibility = scene.instances.visibility.astype(np.int32) & int(Visibility.ALL)
    set_triangles(table, triangles, visibility, device, keep_triangles)
    table.world_emitter = -1
    if world is not None:
        table.world_emitter = table.emitter_count - 1
        table.world_visibility = int(scene.world.visibility)
        table.world_casts_shadow = int(scene.world.casts_shadow)
        table.world = world.table
    choice = _choice_table(table, records, strength, triangles, scene=scene, geometry=geometry, world=world, keep=keep)
    upload_links(scene, choice, cells, triangles.instance, device)
    table.choice = upload_struct(choice, device)
    return UploadedLights(table, choice, len(triangles))


def _portals(scene: Scene, world: SampledWorld | None) -> np.ndarray:
    """Records of the portals through which `world` is sampled; none where it is not."""
    portals = scene.world.portals if world is not None else ()
    records = np.zeros(len(portals), record_type(LightRecord))
    for i, portal in enumerate(portals):
        _fill_record(records[i, ...], portal)
    return records[records["delta"] == 0]


def _choice_table(
    table: LightTable,
    records: np.ndarray,
    strength: np.ndarray,
    triangles: EmissiveTriangles,
    *,
    scene: Scene,
    geometry: Geometry | None,
    world: SampledWorld | None,
    keep: KeepTree,
) -> ChoiceTable:
    """What the choice among the emitters of `table` reads; `strength` is that of lights without mesh."""
    device = table.lights.device
    irradiance = np.zeros(9) if world is None else world.irradiance
    largest = max(strength.max(initial=0), triangles.strength_most, irradiance[0])
    largest = largest if largest > 0 else 1.0
    # a lamp whose program was black at every point that was looked at may still shine
    may_shine = (records["program"] != 0) & (strength == 0) & records["emission"].any(1)
    strength = np.where(may_shine, _UNSEEN, _in_range(strength / largest))

    is_sun = records["kind"] == LightKind.SUN
    local = np.flatnonzero(~is_sun)
    lamps = _lamp_nodes(records, local, strength)

    def make() -> ChoiceTable:
        power = _in_range(triangle_strengths(triangles) / largest)
        alike = [] if device.is_cuda else runs_alike(triangles, scene.instances.mesh, len(lamps))
        return _tree_alone(table, _boxes(records[local]), lamps, power, geometry, alike)

    # triangles that are the same array have the same places too
    followed = digest_of([records, lamps]), largest, table.emitter_count, device.alias
    tree = keep(([triangles.radiance] if len(triangles) else [], followed), make)
    choice = ChoiceTable()
    choice.blocks, choice.below, choice.above, choice.leaf = tree.blocks, tree.below, tree.above, tree.leaf
    choice.hidden_with, choice.group_count, choice.top_count = tree.hidden_with, tree.group_count, tree.top_count
    choice.world_irradiance = wp.array(irradiance / largest, dtype=float, device=device)
    distant = np.flatnonzero(is_sun)
    brightness = strength[distant]
    if world is not None:
        distant, brightness = np.append(distant, table.world_emitter), np.append(brightness, irradiance[0] / largest)
    choice.distant_count = len(distant)
    choice.distant = wp.array(distant, dtype=int, device=device)
    choice.distant_strength = wp.array(brightness, dtype=float, device=device)
    return choice


def _tree_alone(
    table: LightTable,
    boxes_of_lamps: tuple[np.ndarray, np.ndarray],
    lamps: np.ndarray,
    power: np.ndarray,
    geometry: Geometry | None,
    alike: Sequence[Alike],
) -> ChoiceTable:
    """A table that has only the tree: over `lamps`, leaves of those with a place, and the triangles of `table`, which
    have `power`. Runs of leaves that are `alike` are joined alike.
    """
    device, count = table.lights.device, len(lamps) + len(power)
    boxes = EmitterBoxes()
    boxes.nodes = large_empty(count, LightNode, device)
    boxes.low, boxes.high = (large_empty(count, wp.vec3, device) for _ in range(2))
    if len(lamps):
        for target, values in zip((boxes.nodes, boxes.low, boxes.high), (lamps, *boxes_of_lamps), strict=True):
            wp.copy(target, wp.array(values, dtype=target.dtype, device=device), count=len(lamps))
    if len(power):
        emitting = EmittingTriangles()
        emitting.instance, emitting.primitive = table.triangle_instance, table.triangle_primitive
        emitting.power = wp.array(power, dtype=float, device=device)
        emitting.emitter_first, emitting.node_first = table.light_count, len(lamps)
        launch_parts(bound_triangles_kernel, len(power), lambda at: [geometry, emitting, boxes, at], device)
    tree = ChoiceTable()
    tree.leaf = wp.full(table.emitter_count, -1, dtype=int, device=device)
    fill_blocks(tree, boxes, alike)
    return tree


def _in_range(values: np.ndarray) -> np.ndarray:
    """What is above 0 stays above in float32."""
    return np.where(values > 0, np.maximum(values, _LEAST), 0)


def _lamp_nodes(records: np.ndarray, local: np.ndarray, strength: np.ndarray) -> np.ndarray:
    """Leaves for the lights numbered `local`: where they are, and where they shine."""
    lamps = records[local]
    nodes = np.zeros(len(local), record_type(LightNode))
    nodes["centre"], nodes["axis"] = lamps["position"], lamps["axis"]
    beside = np.hypot(lamps["half_x"], lamps["half_y"])
    nodes["radius"] = np.maximum(lamps["radius"], beside)
    nodes["power"], nodes["emitter"] = strength[local], local
    spot, point, cell = (lamps["kind"] == kind for kind in (LightKind.SPOT, LightKind.POINT, CELL))
    nodes["radius"][cell] = np.hypot(lamps["radius"], beside)[cell]
    nodes["cos_axis"] = np.where(point | cell, -1, 1)
    # a spot's cone is squeezed along its width and height; at its widest it is `wide` times as wide
    cosine = lamps["cos_half"].astype(np.float64)
    squeeze = np.minimum(lamps["squeeze_x"], lamps["squeeze_y"]).astype(np.float64)
    wide = 1 / np.minimum(np.where(spot, squeeze, 1), 1)
    tangent = wide * np.sqrt(np.maximum(1 - cosine**2, 0)) / np.maximum(cosine, 1e-6)
    nodes["cos_edge"] = np.where(spot, 1 / np.hypot(1, tangent), 0)
    narrow = lamps["tan_half_spread"] > 0
    nodes["cos_edge"][narrow] = 1 / np.hypot(1, lamps["tan_half_spread"][narrow].astype(np.float64))
    return nodes


def _cell_records(cells: EmissiveCells) -> np.ndarray:
    """Records of cells; rays meet their light in volumes."""
    records = np.zeros(len(cells), record_type(LightRecord))
    length = np.maximum(np.linalg.norm(cells.half, axis=2), float(_FLOAT.tiny))
    axes = cells.half / length[:, :, None]
    records["kind"], records["visibility"], records["casts_shadow"] = CELL, int(Visibility.ALL), 1
    records["axis_x"], records["axis_y"], records["axis"] = np.moveaxis(axes, 1, 0)
    records["half_x"], records["half_y"], records["radius"] = length.T
    records["position"], records["emission"], records["sphere"] = cells.middle, 1 / cells.rate[:, None], cells.instance
    volume = 8 * np.abs(np.linalg.det(cells.half))
    records["spread_scale"] = np.minimum(1 / np.sqrt(cells.rate * volume), _FLOAT.max)
    return records


def _fill_record(record: np.ndarray, light: Light) -> None:
    """Write `light` to `record`, an entry of zeros of a table that exists: to make the type of one takes longer."""
    matrix = np.asarray(light.transform, np.float64)
    record["kind"] = int(light.kind)
    record["visibility"] = int(light.visibility)
    record["casts_shadow"] = int(light.casts_shadow)
    record["program"] = int(light.program is not None)
    record["axis_x"], record["axis_y"], record["axis"] = matrix[:, 0], matrix[:, 1], -matrix[:, 2]
    record["position"] = matrix[:, 3]
    emission = np.asarray(light.emission, np.float64)
    if light.kind in (LightKind.POINT, LightKind.SPOT):
        emission = emission * _round_light(record, light)
    elif light.kind == LightKind.SUN:
        emission = emission * _sun(record, light)
    elif light.kind in (LightKind.RECTANGLE, LightKind.ELLIPSE):
        emission = emission * _area_light(record, light)
    else:
        raise ValueError(f"there is no record of lights of kind {light.kind!r}: add one here")
    # a light of 1e30 W on a speck is beyond float32: the largest finite number stands for it
    record["emission"] = np.clip(emission, 0, _FLOAT.max)


def _round_light(record: np.ndarray, light: Light) -> float:
    """Fill in a POINT or SPOT; returns the factor from intensity to `LightRecord.emission`."""
    if light.kind == LightKind.SPOT:
        cos_half = np.cos(np.clip(light.angle, 0, np.pi) / 2)
        span = (1 - cos_half) * np.clip(light.blend, 0, 1)
        record["cos_half"] = cos_half
        # below the rounding of a cosine the edge is hard
        record["inverse_blend"] = 1 / span if span > _FLOAT.eps else 0
        width = np.maximum(np.abs(light.spot_scale), float(_FLOAT.tiny))
        record["squeeze_x"], record["squeeze_y"] = 1 / width
    if light.radius < _RADIUS_MIN:
        record["delta"] = 1
        return 1.0
    record["radius"] = light.radius
    record["sphere"] = int(not light.soft_falloff)
    return 1 / (np.pi * float(light.radius) ** 2)


def _sun(record: np.ndarray, light: Light) -> float:
    """Fill in a SUN; returns the factor from irradiance to `LightRecord.emission`."""
    half = np.clip(light.angle, 0, np.pi) / 2
    if half < _ANGLE_MIN:
        record["delta"] = 1
        return 1.0
    record["one_minus_cos"] = 2 * np.sin(half / 2) ** 2
    return 1 / (np.pi * np.sin(half) ** 2)


def _area_light(record: np.ndarray, light: Light) -> float:
    """Fill in a RECTANGLE or ELLIPSE; returns the factor from radiosity / pi to `LightRecord.emission`."""
    record["half_x"], record["half_y"] = np.abs(np.asarray(light.size, np.float64)) / 2
    if light_area(light) < _FLOAT.tiny:
        record["delta"] = 1
        return 0.0
    half = np.clip(light.spread, 0, np.pi) / 2
    if half < _ANGLE_MIN:
        record["delta"] = 1
        return np.pi
    if light.spread >= np.pi:
        return 1.0
    tangent = np.tan(half)
    # tan(a) - a, by its series where the difference would cancel
    excess = tangent - half if half > 1e-2 else half**3 / 3 * (1 + half**2 * (2 / 5 + half**2 * 17 / 105))
    record["tan_half_spread"] = tangent
    # radiance falls linearly with the tangent, from tan(a) / (tan(a) - a) on the axis to 0 at half the spread a,
    # and adds up to the same radiosity for every spread
    record["spread_scale"] = 1 / tangent
    return tangent / excess


def _boxes(records: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World boxes of lights, float32, shape [n, 3] each."""
    reach = np.repeat(records["radius"][:, None].astype(np.float64), 3, 1)
    for axis, half in (("axis_x", "half_x"), ("axis_y", "half_y")):
        reach += np.abs(records[axis].astype(np.float64)) * records[half][:, None]
    centre = records["position"].astype(np.float64)
    # a slab's distance carries three roundings of the coordinates, and flat boxes need a thickness
    margin = 4 * float(_FLOAT.eps) * (np.abs(centre) + reach).max(1, keepdims=True) + float(_FLOAT.tiny)
    return (centre - reach - margin).astype(np.float32), (centre + reach + margin).astype(np.float32)
