"""The scenes that are measured: archives, and meshes that are repeated in a grid, with a light and a camera."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lib.command import UsageError
from lib.geometry_files import UP_AXES, View, load_geometry, look_at, parse_view, sun
from rendering.request import ARCHIVE, NPZ, kind_of
from rendering.standalone import resized

from raybatch_addon.core.scene.archive import load_scene
from raybatch_addon.core.scene.description import Camera, Closure, ClosureKind, Frame, Material, Mesh, Scene
from raybatch_addon.core.scene.features import SCATTERING, derive_features
from raybatch_addon.core.scene.flatten import FlatGeometry, flatten
from raybatch_addon.core.scene.frozen import freeze
from raybatch_addon.core.scene.validate import checked_scene
from raybatch_addon.core.settings.settings import RenderSettings

GRID_SPACING = 1.02  # of the mesh's extent
GRID_FOV = 2 * math.atan(0.5)  # at a distance of the grid's width it shows that width
INDEX_MAX = 2**31 - 1


@dataclass(frozen=True)
class SceneRequest:
    """The scene asked for on the command line."""

    path: Path
    grid: int = 1  # copies along each of two axes
    camera: str | None = None
    up: str | None = None

    @property
    def name(self) -> str:
        """The scene's name in reports."""
        return self.path.name + (f" {self.grid} x {self.grid}" if self.grid > 1 else "")


@dataclass(frozen=True)
class BenchmarkScene:
    """A scene with light and camera, checked, and its geometry as trees take it."""

    name: str
    scene: Scene
    settings: RenderSettings
    flat: FlatGeometry
    instancing: bool  # more than one tree, or objects that some rays do not see

    @property
    def triangle_count(self) -> int:
        """Triangles as they are placed: those of a mesh count once for each of its instances."""
        return sum(len(self.scene.meshes[i].triangles) for i in self.scene.instances.mesh)

    def box(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Least and largest world coordinates of all placed triangles [m]."""
        flat, corners = self.flat, []
        baked = flat.positions
        if len(flat.shared):  # shared meshes are not in their places
            parts = [
                flat.triangles[group.triangle_first : group.triangle_first + group.triangle_count]
                for group in flat.merged
            ]
            baked = flat.positions[np.concatenate([*parts, np.zeros((0, 3), np.int32)])].reshape(-1, 3)
        if len(baked):
            corners += [baked.min(0), baked.max(0)]
        for i in flat.shared.tolist():
            first, end = flat.mesh_triangle_first[flat.instance_mesh[i] : flat.instance_mesh[i] + 2]
            used = flat.positions[flat.triangles[first:end]].reshape(-1, 3)
            placed = used @ flat.instance_transform[i][:, :3].T + flat.instance_transform[i][:, 3]
            corners += [placed.min(0), placed.max(0)]
        return tuple(np.min(corners, 0).tolist()), tuple(np.max(corners, 0).tolist())


def load_benchmark_scene(request: SceneRequest, pixel_count: int) -> BenchmarkScene:
    """The scene of `request`, in a frame of about `pixel_count` pixels; raises `RayBatchError`."""
    kind = kind_of(request.path)
    if kind == NPZ:
        edge = max(2, math.isqrt(pixel_count - 1) + 1)
        scene, settings = geometry_scene(request, edge, edge), RenderSettings()
    elif kind == ARCHIVE:
        refuse_geometry_options(request)
        scene, settings = load_scene(request.path)
        scene = _of_pixels(scene, pixel_count)
        settings = settings.replace(device="AUTO", thread_count=0)
    else:
        raise UsageError(
            f"{request.path} cannot be measured: give geometry (.npz), or a scene that render.py --save-scene wrote "
            "(.scene.npz)"
        )
    for mesh in scene.meshes:  # as an export's are: what is known of them stays true
        freeze(mesh.positions)
        freeze(mesh.triangles)
    scene = checked_scene(with_paths(scene, settings, request.up or "z"))
    features = derive_features(scene, settings)
    if not features.surfaces:
        raise UsageError(f"{request.path} has no triangles to trace rays against")
    return BenchmarkScene(request.name, scene, settings, flatten(scene), features.instancing)


def with_paths(scene: Scene, settings: RenderSettings, up: str) -> Scene:
    """`scene`; where nothing in it shines a sun is added, and where nothing scatters light all becomes white."""
    features = derive_features(scene, settings)
    if not set(features.closures) & set(SCATTERING):
        white = Material("White", (Closure(ClosureKind.DIFFUSE, (0.8,) * 3),), (ClosureKind.DIFFUSE,))
        scene = dataclasses.replace(scene, materials=(white,) * max(1, len(scene.materials)))
    if not features.lights and not features.mesh_lights:
        scene = dataclasses.replace(scene, lights=(sun(_view_of(scene.camera), up),))
    return scene


def _view_of(camera: Camera) -> View:
    """Where `camera` stands and looks, for the sun over the viewer's shoulder."""
    eye, back = np.asarray(camera.transform, np.float64)[:, 3], np.asarray(camera.transform, np.float64)[:, 2]
    return View(tuple(eye.tolist()), tuple((eye - back).tolist()), GRID_FOV)


def refuse_geometry_options(request: SceneRequest) -> None:
    """Raise `UsageError` where a scene that is whole is to be repeated, turned, or seen from elsewhere."""
    if request.grid != 1 or request.camera or request.up:
        raise UsageError(f"{request.path} is a whole scene; --grid, --camera and --up are for geometry")


def geometry_scene(request: SceneRequest, width: int, height: int) -> Scene:
    """The geometry of `request` in its light, repeated where that is asked for, in a frame of `width` x `height`
    pixels; raises `RayBatchError`.
    """
    if request.grid < 1:
        raise UsageError(f"--grid {request.grid} is not valid: it must be 1 or more")
    up = request.up or "z"
    view = parse_view(request.camera) if request.camera else None
    scene = load_geometry(request.path, width=width, height=height, view=view, up=up)
    if request.grid == 1:
        return scene
    mesh = repeated(scene.meshes[0], request.grid, up)
    view = view or grid_view(mesh, up)
    return dataclasses.replace(scene, meshes=(mesh,), camera=look_at(view, up, width, height), lights=(sun(view, up),))


def repeated(mesh: Mesh, grid: int, up: str) -> Mesh:
    """`mesh` copied `grid` x `grid` times over the two axes that are level, as triangles of their own."""
    used = mesh.positions[np.unique(mesh.triangles)]
    extent = used.max(0).astype(np.float64) - used.min(0)
    count, vertices = grid * grid, len(mesh.positions)
    if count * max(vertices, len(mesh.triangles)) > INDEX_MAX:
        raise UsageError(f"--grid {grid} makes {count * len(mesh.triangles):,} triangles, more than {INDEX_MAX:,}")
    first, second = np.flatnonzero(UP_AXES[up] == 0)
    offsets = np.zeros((grid, grid, 1, 3), np.float32)
    offsets[..., 0, first] = GRID_SPACING * extent[first] * np.arange(grid)[:, None]
    offsets[..., 0, second] = GRID_SPACING * extent[second] * np.arange(grid)
    positions = (mesh.positions + offsets).reshape(-1, 3)
    triangles = (mesh.triangles + (np.arange(count, dtype=np.int32) * vertices)[:, None, None]).reshape(-1, 3)
    slots = None if mesh.triangle_slot is None else np.tile(mesh.triangle_slot, count)
    return Mesh(mesh.name, positions, triangles, slots)


def grid_view(mesh: Mesh, up: str) -> View:
    """A view down on the middle of a grid, from as far away as it is wide."""
    low, high = mesh.positions.min(0).astype(np.float64), mesh.positions.max(0).astype(np.float64)
    centre, width = (low + high) / 2, float((high - low).max())
    front = np.array([0.0, -1.0, 0.0]) if up == "z" else np.array([0.0, 0.0, 1.0])
    eye = centre + width * (0.8 * UP_AXES[up] + 0.6 * front)
    return View(tuple(eye.tolist()), tuple(centre.tolist()), GRID_FOV)


def _of_pixels(scene: Scene, pixel_count: int) -> Scene:
    """`scene` in a whole frame of the same shape with at least `pixel_count` pixels, and the picture alone."""
    frame = scene.frame
    scale = math.sqrt(pixel_count / (frame.width * frame.height))
    width, height = max(1, math.ceil(frame.width * scale)), max(1, math.ceil(frame.height * scale))
    scene = resized(dataclasses.replace(scene, frame=Frame(frame.width, frame.height)), width, height)
    return dataclasses.replace(scene, frame=Frame(width, height))
