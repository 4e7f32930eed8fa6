"""Volume objects: the grids of an OpenVDB file, or those that modifiers and nodes made, in a box that holds them."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable

import bpy
import numpy as np

from ...core.scene.description import Grid, Mesh
from ...core.scene.notice import Notice, Weight
from .smoke import smoke_grids

# Most values of a grid: larger ones do not fit a computer's memory when they are read
_VALUES_MOST = 1 << 29
# Corners of a unit box, and its faces, seen from outside
_CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
_QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
_TRIANGLES = np.concatenate([_QUADS[:, :3], _QUADS[:, [0, 2, 3]]]).astype(np.int32)


def export_volume(obj: bpy.types.Object, names: Iterable[str], frame: int, warnings: list[str]) -> Mesh | None:
    """A box around the grids called `names` of `obj`, evaluated at `frame`, a volume object or smoke; with these grids.

    None where there is nothing to see; `warnings` gets a line for whatever cannot be read.
    """
    told: list[str] = []
    mesh = _exported(obj, list(names), frame, told)
    # what was not weighed is not in the picture
    warnings += [Notice(text, getattr(text, "weight", Weight.MISSING), objects=[obj.name]) for text in told]
    return mesh


def _exported(obj: bpy.types.Object, names: list[str], frame: int, warnings: list[str]) -> Mesh | None:
    volume = obj.data
    is_smoke = obj.type != "VOLUME"
    label = f"{'smoke' if is_smoke else 'volume object'} “{obj.name}”"
    if is_smoke:
        found = smoke_grids(obj, names, frame, label, warnings)
    else:
        reads = _read(obj, sorted(set(names)), label, warnings)
        grids = [_grid(name, read, label, warnings) for name, read in reads]
        found = [grid for grid in grids if grid is not None]
    boxes = [_box(grid) for grid in found]
    if not boxes:
        if not warnings and not is_smoke:
            named = ", ".join(f"“{name}”" for name in names) or "that its material reads"
            warnings.append(f"{label}: it has no values in grids {named}; there is nothing to render")
        return None
    low, high = np.min([box[0] for box in boxes], 0), np.max([box[1] for box in boxes], 0)
    if not (np.isfinite([low, high]).all() and (high > low).all()):
        warnings.append(Notice(f"{label}: the place of its grids is not finite; it is left out", Weight.REPAIRED))
        return None
    space = (tuple((0.5 * (low + high)).tolist()), tuple((0.5 * (high - low)).tolist()))
    return Mesh(
        volume.name,
        (low + _CORNERS * (high - low)).astype(np.float32),
        _TRIANGLES,
        texture_space=space,
        grids=tuple(found),
        object_density=not is_smoke and volume.render.space == "OBJECT",
    )


def _read(obj: bpy.types.Object, names: list[str], label: str, warnings: list[str]):
    """Name and OpenVDB grid of those of `names` that the volume object `obj` has."""
    volume = obj.data
    is_made = len(obj.modifiers) > 0 or not (volume.filepath or volume.packed_file)
    if not is_made and not volume.grids.is_loaded and not volume.grids.load():
        why = volume.grids.error_message or "why is not known"
        warnings.append(f"{label}: its file “{volume.filepath}” cannot be read ({why}); it is left out")
        return
    there = [grid.name for grid in volume.grids]
    path = volume.grids.frame_filepath or bpy.path.abspath(volume.filepath, library=volume.library)
    try:
        openvdb = _openvdb()
    except ImportError:
        warnings.append(f"{label}: this Blender has no module openvdb to read its grids with; it is left out")
        return
    with tempfile.TemporaryDirectory() as folder:
        if is_made:
            path = os.path.join(folder, "made.vdb")
            if there and not volume.grids.save(filepath=path):
                why = volume.grids.error_message or "why is not known"
                warnings.append(f"{label}: its grids cannot be read ({why}); it is left out")
                return
        elif volume.packed_file is not None:
            path = os.path.join(folder, "packed.vdb")
            with open(path, "wb") as file:
                file.write(volume.packed_file.data)
        for name in names:
            if name not in there:
                continue
            try:
                yield name, openvdb.read(path, name)
            except Exception as error:
                warnings.append(
                    f"{label}: its grid “{name}” cannot be read from “{path}” ({' '.join(str(error).split())}); it "
                    "counts as missing"
                )


def _openvdb():
    bpy.utils.expose_bundled_modules()
    import openvdb

    return openvdb


def _grid(name: str, read, label: str, warnings: list[str]) -> Grid | None:
    """An OpenVDB grid as a dense block of its active values."""
    if read.valueTypeName not in ("float", "double", "half", "vec3s", "vec3d"):
        warnings.append(
            f"{label}: its grid “{name}” holds values of type {read.valueTypeName}, which are not supported; it counts "
            "as missing"
        )
        return None
    if read.activeVoxelCount() == 0:
        return None
    first, last = (np.array(corner) for corner in read.evalActiveVoxelBoundingBox())
    shape = tuple((last - first + 1).tolist())
    if np.prod(shape, dtype=float) > _VALUES_MOST:
        warnings.append(
            f"{label}: its grid “{name}” spans {' x '.join(map(str, shape))} voxels, and at most {_VALUES_MOST:,} can "
            "be rendered; it counts as missing"
        )
        return None
    width = (3,) if read.valueTypeName.startswith("vec3") else ()
    values = np.zeros(shape + width, np.float64 if read.valueTypeName in ("double", "vec3d") else np.float32)
    read.copyToArray(values, ijk=tuple(first.tolist()))
    values = np.nan_to_num(values.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    origin = np.array(read.transform.indexToWorld(tuple(first.tolist())))
    axes = [
        np.array(read.transform.indexToWorld(tuple((first + step).tolist()))) - origin for step in np.eye(3, dtype=int)
    ]
    to_object = np.column_stack([*axes, origin])
    if abs(np.linalg.det(to_object[:, :3])) == 0 or not np.isfinite(to_object).all():
        text = f"{label}: its grid “{name}” is flattened to nothing; it counts as missing"
        warnings.append(Notice(text, Weight.REPAIRED))
        return None
    inverse = np.linalg.inv(to_object[:, :3])
    return Grid(name, values, np.column_stack([inverse, -inverse @ origin]))


def _box(grid: Grid) -> np.ndarray:
    """Two corners of a box in object space in which a grid's values, between voxels too, are not 0 [m]."""
    matrix = np.linalg.inv(grid.to_index[:, :3])
    size = np.array(grid.values.shape[:3])
    corners = (-1 + _CORNERS * (size + 1) - grid.to_index[:, 3]) @ matrix.T
    return np.stack([corners.min(0), corners.max(0)])
