"""Triangles from a NumPy archive as a `Scene`: with a default light, and a camera that is given or frames everything.

The archive holds `v`, float32 [n, 3], vertex positions; `f`, int32 [k, 3], triangles; and, if wanted, `m`, int16 [k], a
material id for each triangle. Coordinates stay the file's own; `up` says which axis points up.
"""

from __future__ import annotations

import math
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from raybatch_addon.core.errors import SceneError
from raybatch_addon.core.scene.description import (
    Camera,
    CameraKind,
    Closure,
    ClosureKind,
    Frame,
    Instances,
    Light,
    LightKind,
    Material,
    Mesh,
    Scene,
    Visibility,
    World,
)

UP_AXES = {"y": np.array([0.0, 1.0, 0.0]), "z": np.array([0.0, 0.0, 1.0])}
FOV_DEFAULT = math.radians(40)
# Default light: a sun over the viewer's left shoulder and a sky that fills the shadows
SUN_IRRADIANCE = 1.7  # [W/m²]
SUN_ANGLE = math.radians(3)
SKY_RADIANCE = (0.3, 0.36, 0.45)  # [W/(m² sr)]
GOLDEN_RATIO = (1 + math.sqrt(5)) / 2


@dataclass(frozen=True)
class View:
    """Where the camera of a geometry file stands."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    fov: float  # of the frame's longer side [rad]


def parse_view(text: str) -> View:
    """`ex,ey,ez,tx,ty,tz,fov_degrees` as a `View`; raises `SceneError`."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 7 or not all(map(math.isfinite, numbers)):
        raise SceneError(f"camera {text!r} is not seven numbers ex,ey,ez,tx,ty,tz,fov_degrees")
    eye, target = (numbers[0], numbers[1], numbers[2]), (numbers[3], numbers[4], numbers[5])
    fov = numbers[6]
    if not 0 < fov < 180:
        raise SceneError(f"the camera's field of view is {fov:g} degrees; it must be more than 0 and less than 180")
    if eye == target:
        raise SceneError("the camera's eye and target are the same point; move one of them")
    return View(eye, target, math.radians(fov))


def load_geometry(path: str | Path, *, width: int, height: int, view: View | None = None, up: str = "z") -> Scene:
    """The triangles of `path` in the default light, `width` x `height` pixels; `up` is "y" or "z".

    Raises `SceneError` that names the file and the array at fault.
    """
    mesh, materials = read_mesh(path)
    used = mesh.positions[np.unique(mesh.triangles)]
    low, high = used.min(0).astype(np.float64), used.max(0).astype(np.float64)
    view = view or framing_view(low, high, width, height, up)
    one = np.zeros(1, np.int32)
    return Scene(
        camera=look_at(view, up, width, height),
        frame=Frame(width, height),
        meshes=(mesh,),
        instances=Instances(
            one, np.eye(4, dtype=np.float32)[None, :3], one, np.array([int(Visibility.ALL)], np.int32), one
        ),
        slot_materials=np.arange(len(materials), dtype=np.int32),
        materials=materials,
        lights=(sun(view, up),),
        world=World(SKY_RADIANCE),
        object_names=(mesh.name,),
    )


def read_mesh(path: str | Path) -> tuple[Mesh, tuple[Material, ...]]:
    """The mesh of an archive and a material for each slot; raises `SceneError` that names the file and the array at
    fault.
    """
    path = Path(path)
    try:
        loaded = np.load(path, allow_pickle=False)
        if not isinstance(loaded, np.lib.npyio.NpzFile):
            raise SceneError(f"{path} is a single array; geometry is an archive with the arrays v and f")
        with loaded as archive:
            missing = [name for name in ("v", "f") if name not in archive]
            if missing:
                raise SceneError(
                    f"{path} has no array {' and no array '.join(missing)}; geometry needs v (positions) and f "
                    "(triangles)"
                )
            vertices, triangles = archive["v"], archive["f"]
            ids = archive.get("m", None)
    except FileNotFoundError:
        raise SceneError(f"there is no file {path}") from None
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile, zlib.error) as error:
        if isinstance(error, SceneError):
            raise
        raise SceneError(f"{path} cannot be read as a NumPy archive; is it damaged? ({error})") from error

    _check_shape(path, "v", vertices, "float", "fiu")
    _check_shape(path, "f", triangles, "int", "iu")
    if len(triangles) == 0:
        raise SceneError(f"{path}: array f has no triangles")
    with np.errstate(over="ignore"):  # what float32 cannot hold is reported below
        positions = np.ascontiguousarray(vertices, np.float32)
    bad = ~np.isfinite(positions).all(1)
    if bad.any():
        raise SceneError(
            f"{path}: array v has {int(bad.sum()):,} vertices that are not finite (the first is {int(np.argmax(bad))})"
        )
    low, high = int(triangles.min()), int(triangles.max())
    if low < 0 or high >= len(positions):
        raise SceneError(
            f"{path}: array f names vertices {low} to {high}, but v has {len(positions):,} (0 to {len(positions) - 1})"
        )
    slots, material_ids = _slots(path, ids, len(triangles))
    mesh = Mesh(path.stem, positions, np.ascontiguousarray(triangles, np.int32), slots)
    return mesh, tuple(_material(number) for number in material_ids)


def _check_shape(path: Path, name: str, array: np.ndarray, kind: str, kinds: str) -> None:
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in kinds:
        raise SceneError(
            f"{path}: array {name} is {array.dtype} of shape {list(array.shape)}; it must be {kind}32 of shape [n, 3]"
        )


def _slots(path: Path, ids: np.ndarray | None, count: int) -> tuple[np.ndarray | None, list[int | None]]:
    """Material slot of each triangle, and the id of each slot."""
    if ids is None:
        return None, [None]
    if ids.shape != (count,) or ids.dtype.kind not in "iu":
        raise SceneError(
            f"{path}: array m is {ids.dtype} of shape {list(ids.shape)}; it must be int16 of shape [{count}], as f has "
            f"{count} triangles"
        )
    found, slots = np.unique(ids, return_inverse=True)
    return slots.astype(np.int32).reshape(-1), found.tolist()


def _material(number: int | None) -> Material:
    """A diffuse material: white, or a muted colour of its own for each material id."""
    if number is None:
        color, name = (0.8, 0.8, 0.8), "White"
    else:
        # hues a golden ratio apart are never close for ids that are
        hue = 2 * math.pi * ((number / GOLDEN_RATIO) % 1)
        thirds = (0.0, 2 * math.pi / 3, 4 * math.pi / 3)
        red, green, blue = (0.55 + 0.2 * math.cos(hue - shift) for shift in thirds)
        color, name = (red, green, blue), f"Material {number}"
    return Material(name, (Closure(ClosureKind.DIFFUSE, color),), (ClosureKind.DIFFUSE,))


def framing_view(low: np.ndarray, high: np.ndarray, width: int, height: int, up: str) -> View:
    """A view from the front, above and a little right, of the whole box `low` to `high`."""
    centre = (low + high) / 2
    radius = float(np.linalg.norm(high - low)) / 2 or 1.0
    narrow = 2 * math.atan(math.tan(FOV_DEFAULT / 2) * min(width, height) / max(width, height))
    from_front = np.array([0.5, -1.0, 0.45]) if up == "z" else np.array([0.5, 0.45, 1.0])
    eye = centre + from_front / np.linalg.norm(from_front) * radius / math.sin(narrow / 2)
    return View(tuple(eye.tolist()), tuple(centre.tolist()), FOV_DEFAULT)


def view_axes(view: View, up: str) -> np.ndarray:
    """The camera's axes in the columns, float64, shape [3, 3]: right, up, back."""
    back = np.subtract(view.eye, view.target, dtype=np.float64)
    back /= np.linalg.norm(back)
    right = np.cross(UP_AXES[up], back)
    if np.linalg.norm(right) < math.sqrt(np.finfo(np.float64).eps):  # straight up or down: any right will do
        right = np.array([1.0, 0.0, 0.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back], axis=1)


def look_at(view: View, up: str, width: int, height: int) -> Camera:
    """A perspective camera of `view`; its field of view is that of the frame's longer side, as Blender's sensor fit
    AUTO has it.
    """
    half = math.tan(view.fov / 2)
    x, y = half * width / max(width, height), half * height / max(width, height)
    transform = np.concatenate([view_axes(view, up), np.reshape(view.eye, (3, 1))], axis=1)
    return Camera(CameraKind.PERSPECTIVE, transform.astype(np.float32), (-x, x, -y, y))


def sun_axes(view: View, up: str) -> np.ndarray:
    """Axes of the default sun in the columns, float64, shape [3, 3]: it shines along its -Z, from over the viewer's
    left shoulder.
    """
    right, _, back = view_axes(view, up).T
    above = UP_AXES[up]
    level_back = back - above * (back @ above)
    level = level_back / (np.linalg.norm(level_back) or 1.0) * 0.7 - right * 0.8
    towards = above * 1.2 + level
    towards /= np.linalg.norm(towards)
    side = np.cross(above, towards)
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(towards, side), towards], axis=1)


def sun(view: View, up: str) -> Light:
    """The default sun."""
    transform = np.concatenate([sun_axes(view, up), np.zeros((3, 1))], axis=1).astype(np.float32)
    return Light("Sun", LightKind.SUN, transform, (SUN_IRRADIANCE,) * 3, angle=SUN_ANGLE)
