"""Blender's world as the core's `World`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ..core.programs.builder import ProgramBuilder
from ..core.scene.description import ClosureKind, Light, Program, SkySun, Visibility, Volume, World
from ..core.scene.notice import Notice, Weight, about
from .kept_graphs import KeptGraphs
from .nodes.collections import Collections
from .nodes.compile import compile_graph, compile_volume

_MAX_BOUNCES = 1024  # of lights in Cycles at first, which means no limit
# Texels around a world that varies, by whose brightness it is sampled: Cycles' number unless an image asks for more
_SAMPLING_SIZE = 1024
_SAMPLING_SIZE_MOST = 8192
_SUN_SIZE_MOST = 2048  # most texels for the sake of suns alone; a larger table takes seconds to fill


@dataclass(frozen=True)
class _WorldGraph:
    """The nodes of a world, compiled."""

    radiance: tuple[float, float, float]  # without `program`
    program: Program | None
    volume: Volume | None
    notes: tuple[str, ...]  # parts that are left out or approximated
    environments: frozenset[int]  # images all around, by index


def export_world(
    world: bpy.types.World | None,
    warnings: list[str],
    collections: Collections | None = None,
    kept: KeptGraphs | None = None,
) -> World:
    """`world` as it lights the scene, black if there is none.

    `collections` gets the images and attributes that its nodes refer to, `warnings` a line for everything that was
    replaced; `kept`: graphs of earlier exports, which ask `collections` too.
    """
    collections = collections or Collections()
    if world is None:
        return World()
    radiance, program, volume = tuple(world.color[:3]), None, None
    if has_nodes(world):
        graph = (kept or KeptGraphs(collections)).graph(world, lambda: _world_graph(world, collections))
        collections.environments |= graph.environments
        warnings += [about(note, f"world “{world.name}”") for note in graph.notes]
        radiance, program, volume = graph.radiance, graph.program, graph.volume
    usable = usable_emission(np.array(radiance, float), f"world “{world.name}”", warnings)
    sun = _sun(collections)
    size = _sampling_size(world, collections, sun)
    own = getattr(world.original, "cycles", None)  # there as long as that add-on is enabled
    return World(
        usable,
        _visibility(world),
        program,
        size,
        sun=sun,
        volume=volume,
        casts_shadow=getattr(own, "use_shadows", True),
        bounce_max=limit_of_bounces(own),
    )


def limit_of_bounces(own) -> int | None:
    """`bounce_max` of the light whose settings of Cycles are `own`; None where it has no limit, or no such settings."""
    limit = getattr(own, "max_bounces", _MAX_BOUNCES)
    return limit if limit < _MAX_BOUNCES else None


def _world_graph(world: bpy.types.World, collections: Collections) -> _WorldGraph:
    """The nodes of `world`, compiled."""
    output = collections.output(world.node_tree)
    compiled = compile_graph(output.inputs["Surface"] if output else None, world, collections)
    lit = [closure.weight for closure in compiled.closures if closure.kind == ClosureKind.EMISSION]
    radiance = np.sum(lit, axis=0) if lit else np.zeros(3)
    volume, notes = compile_volume(output.inputs.get("Volume") if output else None, world, collections)
    environments = frozenset(collections.environments)
    return _WorldGraph(tuple(radiance), compiled.program, volume, (*compiled.notes, *notes), environments)


def with_portals(world: World, portals: Sequence[Light]) -> World:
    """`world` with openings through which it is sampled, unless it is not sampled at all or black."""
    if not portals or world.sampling_size == 0 or (world.program is None and not any(world.radiance)):
        return world
    program = world.program
    if program is None:
        builder = ProgramBuilder()
        builder.closure("emission", world.radiance)
        program = builder.finish()
    return replace(world, program=program, portals=tuple(portals))


def _sun(collections: Collections) -> SkySun | None:
    """The one sun of the world's skies, where there is one and it is known in which direction it stands."""
    if len(collections.suns) != 1:
        return None
    ((direction, size),) = collections.suns
    return None if direction is None else SkySun(direction, min(size, math.pi))


def _sampling_size(world: bpy.types.World, collections: Collections, sun: SkySun | None) -> int:
    own = getattr(world, "cycles", None)
    method = getattr(own, "sampling_method", "AUTOMATIC")
    if method == "NONE":
        return 0
    # where the table alone aims at suns, the smallest is two texels wide, whatever table size the rest asks for
    alone = collections.suns if sun is None else ()
    least = min(max((math.ceil(4.0 * math.pi / size) for _, size in alone), default=0), _SUN_SIZE_MOST)
    if own is not None and method == "MANUAL":
        return min(max(int(own.sample_map_resolution), 4, least), _SAMPLING_SIZE_MOST)
    return min(max(_SAMPLING_SIZE, collections.environment_width, least), _SAMPLING_SIZE_MOST)


def has_nodes(owner) -> bool:
    """Whether a material, light or world is described by its nodes; from Blender 5.0 on, whether it has a tree."""
    return owner.node_tree is not None and (bpy.app.version >= (5, 0) or owner.use_nodes)


def usable_emission(emission: np.ndarray, name: str, warnings: list[str]) -> tuple[float, float, float]:
    """`emission` with unusable values replaced; each repair adds a line to `warnings`."""
    if not np.isfinite(emission).all():
        warnings.append(Notice(f"{name}: its strength is not a finite number; it is taken as 0", Weight.REPAIRED))
        emission = np.where(np.isfinite(emission), emission, 0)
    if (emission < 0).any():
        warnings.append(f"{name}: negative strength is not supported; it is taken as 0")
        emission = np.maximum(emission, 0)
    red, green, blue = (float(c) for c in emission)
    return red, green, blue


def _visibility(world: bpy.types.World) -> int:
    # these settings belong to Cycles, and are there as long as that add-on is enabled
    flags = getattr(world, "cycles_visibility", None)
    seen = Visibility.SHADOW
    for name in ("camera", "diffuse", "glossy", "transmission"):
        if getattr(flags, name, True):
            seen |= Visibility[name.upper()]
    if getattr(flags, "scatter", True):
        seen |= Visibility.VOLUME_SCATTER
    return int(seen)
