"""Smoke: the grids of a gas domain, as its simulation or cache has them at the frame, and which objects have grids."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from ...core.scene.description import Grid
from ...core.scene.frozen import freeze
from ...core.scene.notice import Notice, Weight

SMOKE_VELOCITY = "velocity"
# By name of an attribute: the domain's property, its numbers a voxel, and whether noise makes it finer
_GRIDS = {
    "density": ("density_grid", 1, True),
    "flame": ("flame_grid", 1, True),
    "color": ("color_grid", 4, True),
    "temperature": ("temperature_grid", 1, True),
    "heat": ("heat_grid", 1, False),
    SMOKE_VELOCITY: ("velocity_grid", 3, False),
}
# Nodes that make volumes
_VOLUME_NODES = ("ToVolume", "VolumeCube", "StoreNamedGrid", "SetGridBackground", "ImportVDB")
# Alpha below which a colour is as it is stored, as in Cycles
_ALPHA_LEAST = 1e-6


def smoke_domain(obj: bpy.types.Object) -> bpy.types.FluidDomainSettings | None:
    """The settings of the gas domain that `obj` is; None if it is none."""
    for modifier in obj.modifiers:
        if modifier.type == "FLUID" and modifier.fluid_type == "DOMAIN":
            settings = modifier.domain_settings
            if settings is not None and settings.domain_type == "GAS":
                return settings
    return None


def any_grids(objects) -> bool:
    """Whether any of `objects` may have grids: volume objects, smoke, and what geometry nodes make into volumes."""
    trees: dict[int, bool] = {}
    for obj in objects:
        if obj.type == "VOLUME":
            return True
        for modifier in obj.modifiers:
            if modifier.type == "NODES" and modifier.node_group and _makes_volumes(modifier.node_group, trees):
                return True
        if obj.type == "MESH" and smoke_domain(obj) is not None:
            return True
    return False


def _makes_volumes(tree: bpy.types.NodeTree, known: dict[int, bool]) -> bool:
    key = tree.as_pointer()
    if key not in known:
        known[key] = False  # of a tree in itself
        known[key] = any(
            any(name in node.bl_idname for name in _VOLUME_NODES)
            or (getattr(node, "node_tree", None) is not None and _makes_volumes(node.node_tree, known))
            for node in tree.nodes
        )
    return known[key]


def smoke_grids(obj: bpy.types.Object, names: list[str], frame: int, label: str, warnings: list[str]) -> list[Grid]:
    """The grids called `names` that the smoke of `obj`, evaluated at `frame`, has and that are not 0
    everywhere.

    They fill the box of the mesh's texture space, a value in the middle of each cell.
    """
    domain = smoke_domain(obj)
    assert domain is not None, f"{label} is no domain"
    center, half = (np.array(each, float) for each in (obj.data.texspace_location, obj.data.texspace_size))
    found = []
    for name in sorted(set(names) & set(_GRIDS)):
        source, width, is_fine = _GRIDS[name]
        shape = np.array(domain.domain_resolution) * (domain.noise_scale if is_fine and domain.use_noise else 1)
        stored = getattr(domain, source)
        if len(stored) != width * shape.prod() or shape.prod() == 0:
            continue  # not simulated
        flat = np.empty(len(stored), np.float32)
        stored.foreach_get(flat)
        values = flat.reshape(*shape[::-1], width).transpose(2, 1, 0, 3)
        if width == 4:
            values = _straight(values)
        finite = np.isfinite(values)
        if not finite.all():
            warnings.append(not_finite(label, name, int(np.count_nonzero(~finite))))
            values = np.where(finite, values, np.float32(0))
        if not values.any():
            continue
        if not (np.isfinite([center, half]).all() and (half > 0).all()):
            warnings.append(Notice(f"{label}: its domain is flat; it is left out", Weight.REPAIRED))
            return []
        scale = shape / (2 * half)
        to_index = np.column_stack([np.diag(scale), -scale * (center - half) - 0.5])
        found.append(Grid(name, freeze(values[..., 0] if width == 1 else values), to_index))
    if not found and not (_is_clear(domain, frame) and set(names) & set(_GRIDS)):
        cache = bpy.path.abspath(domain.cache_directory)
        warnings.append(
            f"{label}: its simulation has no values at this frame (its cache is “{cache}”); it is left out. Bake the "
            "domain again, or choose a frame of the cache"
        )
    return found


def not_finite(label: str, name: str, count: int) -> Notice:
    """That `count` numbers of the grid `name` of what is called `label` are not finite."""
    return Notice(f"{label}: {count:,} numbers of its grid “{name}” are not finite; they are 0", Weight.REPAIRED)


def _is_clear(domain: bpy.types.FluidDomainSettings, frame: int) -> bool:
    """Whether a frame without values has no smoke yet: it is simulated, or lies before the simulation begins. A domain
    that was never simulated has as many zeros.
    """
    number = frame - domain.cache_frame_offset
    if number < domain.cache_frame_start:
        return True
    folder = Path(bpy.path.abspath(domain.cache_directory)) / "data"
    return any(folder.glob(f"fluid_data_{number:04}.*"))


def _straight(values: np.ndarray) -> np.ndarray:
    """Colours that are stored times their alpha."""
    alpha = values[..., 3:]
    divisor = np.where((alpha > _ALPHA_LEAST) & (alpha != 1.0), alpha, 1.0)
    return values[..., :3] / divisor
