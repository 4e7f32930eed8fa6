"""Volume objects: the grids of an OpenVDB file, or those that modifiers and nodes made, in a box that holds them."""

from __future__ import annotations

import io
import itertools
import math
import os
from collections.abc import Iterable

import bpy
import numpy as np

from ...core.files import VOLUMES_PREFIX, temporary_folder
from ...core.scene.description import Grid, Mesh
from ...core.scene.frozen import freeze
from ...core.scene.notice import Notice, Weight
from ...core.shading.volumes.grids import CUBE_CORNERS, TILE, cut_into_tiles
from ...core.shading.volumes.vdb_header import header_is_whole
from ..motion.objects import object_steps
from ..motion.shutter import Exposure
from ..nodes.volume_builder import reads_smoothly
from .flows import enlarged, flow_names, flow_of_smoke, flow_of_volume, with_flow
from .smoke import SMOKE_VELOCITY, not_finite, smoke_domain, smoke_grids

# Most values of the tiles of a grid that hold any: more do not fit a computer's memory
_VALUES_MOST = 1 << 29
# Voxels along an edge of what is read of a grid at once, a multiple of a tile's
_BLOCK = 64
# To meet an active voxel takes as long as to read so many
_VOXELS_PER_STEP = 256
# Voxels that are so much longer than those of the file are not the file's: Simplify doubles their edges, or more
_COARSER = 1.5
# Faces of the box between `CUBE_CORNERS`, seen from outside
_QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
_TRIANGLES = np.concatenate([_QUADS[:, :3], _QUADS[:, [0, 2, 3]]]).astype(np.int32)


def export_volume(
    obj: bpy.types.Object, names: Iterable[str], frame: int, warnings: list[str], exposure: Exposure | None = None
) -> Mesh | None:
    """A box around the grids called `names` of `obj`, evaluated at `frame`, a volume object or smoke; with these grids,
    and how what they hold moves in the time of `exposure`.

    None where there is nothing to see; `warnings` gets a line for whatever cannot be read.
    """
    texts: list[str] = []
    mesh = _exported(obj, list(names), frame, texts, exposure)
    # what was not weighed is not in the picture
    warnings += [Notice(text, getattr(text, "weight", Weight.MISSING), objects=[obj.name]) for text in texts]
    return mesh


def _exported(
    obj: bpy.types.Object, names: list[str], frame: int, warnings: list[str], exposure: Exposure | None
) -> Mesh | None:
    volume = obj.data
    if exposure is not None and object_steps(obj, None) == 0:
        exposure = None
    flow = None
    is_smoke = obj.type != "VOLUME"
    label = f"{'smoke' if is_smoke else 'volume object'} “{obj.name}”"
    if is_smoke:
        found = smoke_grids(obj, names, frame, label, warnings)
        if exposure is not None and found and (domain := smoke_domain(obj)) is not None:
            velocities = smoke_grids(obj, [SMOKE_VELOCITY], frame, label, [])
            flow = flow_of_smoke(domain, velocities[0] if velocities else None, exposure)
        boxes = [_box(grid, np.zeros(3), np.array(grid.values.shape[:3]) - 1) for grid in found]
    else:
        reads = _read(obj, set(names), label, warnings, with_flows=exposure is not None)
        grids = {name: made for name, read in reads if (made := _grid(name, read, label, warnings)) is not None}
        asked = [grids[name] for name in grids if name in names]
        found, boxes = [grid for grid, _ in asked], [box for _, box in asked]
        if exposure is not None:
            flow = flow_of_volume(volume, {name: grid for name, (grid, _) in grids.items()}, exposure, label, warnings)
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
    mesh = Mesh(
        volume.name,
        (low + CUBE_CORNERS * (high - low)).astype(np.float32),
        _TRIANGLES,
        texture_space=space,
        grids=tuple(found),
        object_density=not is_smoke and volume.render.space == "OBJECT",
    )
    if any(reads_smoothly(slot.material) for slot in obj.material_slots):
        # a voxel counts one voxel farther off
        mesh = enlarged(mesh, np.max([np.abs(np.linalg.inv(grid.to_index[:, :3])).sum(1) for grid in found], 0))
    return mesh if exposure is None else with_flow(mesh, flow, exposure)


def _read(obj: bpy.types.Object, names: set[str], label: str, warnings: list[str], with_flows: bool):
    """Name and OpenVDB grid of those of `names` that the volume object `obj` has; `with_flows`: of velocities too."""
    volume = obj.data
    is_made = len(obj.modifiers) > 0 or not (volume.filepath or volume.packed_file)
    if not is_made and not volume.grids.is_loaded and not _has_header(volume):
        warnings.append(f"{label}: its file “{volume.filepath}” is cut off in its header; it is left out")
        return
    if not is_made and not volume.grids.is_loaded and not volume.grids.load():
        why = volume.grids.error_message or "why is not known"
        warnings.append(f"{label}: its file “{volume.filepath}” cannot be read ({why}); it is left out")
        return
    there = [grid.name for grid in volume.grids]
    names = names | flow_names(volume) if with_flows else names
    path = volume.grids.frame_filepath or bpy.path.abspath(volume.filepath, library=volume.library)
    try:
        openvdb = _openvdb()
    except ImportError:
        warnings.append(f"{label}: this Blender has no module openvdb to read its grids with; it is left out")
        return
    with temporary_folder(VOLUMES_PREFIX) as folder:
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
        for name in sorted(names):
            if name not in there:
                continue
            try:
                read = openvdb.read(path, name)
                coarse = os.path.join(folder, "coarse.vdb")
                if _is_coarser(volume.grids[name], read) and volume.grids.save(filepath=coarse):
                    read = openvdb.read(coarse, name)
                yield name, read
            except Exception as error:
                warnings.append(
                    f"{label}: its grid “{name}” cannot be read from “{path}” ({' '.join(str(error).split())}); it "
                    "counts as missing"
                )


def _has_header(volume: bpy.types.Volume) -> bool:
    """Whether the header of its file is whole; True where the file cannot be opened, of which Blender says more."""
    if volume.packed_file is not None:
        data = volume.packed_file.data
        return header_is_whole(io.BytesIO(data), len(data))
    path = volume.grids.frame_filepath or bpy.path.abspath(volume.filepath, library=volume.library)
    try:
        with open(path, "rb") as file:
            return header_is_whole(file, os.path.getsize(path))
    except OSError:
        return True


def _is_coarser(grid: bpy.types.VolumeGrid, read) -> bool:
    """Whether Blender has `grid` with larger voxels than its file, of which `read` is: Simplify makes them so."""
    voxels = np.linalg.norm(np.array(grid.matrix_object)[:3, :3], axis=0)
    return bool((voxels > _COARSER * np.array(read.transform.voxelSize())).any())


def _openvdb():
    bpy.utils.expose_bundled_modules()
    import openvdb

    return openvdb


def _grid(name: str, read, label: str, warnings: list[str]) -> tuple[Grid, np.ndarray] | None:
    """The tiles of an OpenVDB grid in which it is not 0, and the box of its active values."""
    if read.valueTypeName not in ("float", "double", "half", "vec3s", "vec3d"):
        warnings.append(
            f"{label}: its grid “{name}” holds values of type {read.valueTypeName}, which are not supported; it counts "
            "as missing"
        )
        return None
    if read.activeVoxelCount() == 0:
        return None
    first, last = (np.array(corner) for corner in read.evalActiveVoxelBoundingBox())
    begin = first - first % TILE  # of indices here: those of the file may be too large for float32
    found = _tiles(read, first, last, begin)
    if found is None:
        warnings.append(
            f"{label}: its grid “{name}” spans {' x '.join(map(str, (last - first + 1).tolist()))} voxels, and more "
            f"than {_VALUES_MOST:,} values are in tiles of {TILE} x {TILE} x {TILE} that are not empty, which is too "
            "many to render; it counts as missing"
        )
        return None
    origin = np.array(read.transform.indexToWorld(tuple(begin.tolist())))
    axes = [
        np.array(read.transform.indexToWorld(tuple((begin + step).tolist()))) - origin for step in np.eye(3, dtype=int)
    ]
    to_object = np.column_stack([*axes, origin])
    if abs(np.linalg.det(to_object[:, :3])) == 0 or not np.isfinite(to_object).all():
        text = f"{label}: its grid “{name}” is flattened to nothing; it counts as missing"
        warnings.append(Notice(text, Weight.REPAIRED))
        return None
    inverse = np.linalg.inv(to_object[:, :3])
    corners, values, lost = found
    if lost:
        warnings.append(not_finite(label, name, lost))
    grid = Grid(name, freeze(values), np.column_stack([inverse, -inverse @ origin]), freeze(corners))
    return grid, _box(grid, first - begin, last - begin)


def _tiles(read, first: np.ndarray, last: np.ndarray, begin: np.ndarray) -> tuple[np.ndarray, np.ndarray, int] | None:
    """Where tiles of the OpenVDB grid `read` begin, from `begin` on, and their values, as in `Grid`; and how many
    numbers are 0 there as float32 has them not. None where there are too many. `first`, `last`: of its active voxels.
    """
    width = (3,) if read.valueTypeName.startswith("vec3") else ()
    if read.activeVoxelCount() * max(3 * len(width), 1) > _VALUES_MOST:
        return None
    stored = np.float64 if read.valueTypeName in ("double", "vec3d") else np.float32
    corners, tiles, count = [np.zeros((0, 3), np.int32)], [np.zeros((0, TILE, TILE, TILE, *width), np.float32)], 0
    lost = 0
    for block in _blocks(read, first, last, begin):
        low = begin + np.array(block) * _BLOCK
        # what lies beyond the active voxels is empty, whatever the grid says of it
        start, end = np.maximum(low, first), np.minimum(low + _BLOCK - 1, last)
        values = np.zeros((*(end - start + 1).tolist(), *width), stored)
        read.copyToArray(values, ijk=tuple(start.tolist()))
        if not values.any():
            continue
        whole = np.zeros((_BLOCK,) * 3 + width, np.float32)
        part = tuple(slice(a, b) for a, b in zip((start - low).tolist(), (end - low + 1).tolist()))
        with np.errstate(over="ignore"):  # numbers of float64 that float32 has not
            whole[part] = values
        finite = np.isfinite(whole)
        if not finite.all():
            lost += int(np.count_nonzero(~finite))
            whole[~finite] = 0
        corner, cut = cut_into_tiles(whole)
        corners.append((corner + low - begin).astype(np.int32))
        tiles.append(cut)
        count += cut.size
        if count > _VALUES_MOST:
            return None
    return np.concatenate(corners), np.concatenate(tiles), lost


def _blocks(read, first: np.ndarray, last: np.ndarray, begin: np.ndarray) -> Iterable[tuple[int, int, int]]:
    """Numbers of the blocks from `begin` on that have active voxels, ascending; of all, where that takes less time."""
    counts = ((last - begin) // _BLOCK + 1).tolist()
    background = np.any(np.asarray(read.background) != 0)
    if background or math.prod(counts) * _BLOCK**3 <= _VOXELS_PER_STEP * read.activeVoxelCount():
        count_x, count_y, count_z = counts
        return itertools.product(range(count_x), range(count_y), range(count_z))
    found = set()
    x, y, z = begin.tolist()
    for value in read.citerOnValues():
        low, high = value.min, value.max
        key = (low[0] - x) // _BLOCK, (low[1] - y) // _BLOCK, (low[2] - z) // _BLOCK
        if value.count == 1:
            found.add(key)
        else:
            ends = ((high[0] - x) // _BLOCK, (high[1] - y) // _BLOCK, (high[2] - z) // _BLOCK)
            along_x, along_y, along_z = (range(a, b + 1) for a, b in zip(key, ends))
            found.update(itertools.product(along_x, along_y, along_z))
    return sorted(found)


def _box(grid: Grid, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Two corners of a box in object space in which a grid's values, between voxels too, are not 0 [m]; `first`,
    `last`: indices of voxels.
    """
    matrix = np.linalg.inv(grid.to_index[:, :3])
    corners = (first - 1 + CUBE_CORNERS * (last - first + 2) - grid.to_index[:, 3]) @ matrix.T
    return np.stack([corners.min(0), corners.max(0)])
