"""Motion while the shutter is open: what moves, its keys, and how far it comes.

Between evenly spaced steps the map of an instance is taken apart into a rotation, a stretch and a translation (Shoemake
and Duff 1992, "Matrix animation and polar decomposition"); the rotation goes along great arcs, the others along lines.
Vertices go along lines. Cycles does both alike.
"""

from __future__ import annotations

import numpy as np

from ..device.bulk import in_slices
from .description import InstanceMaps, Scene

# Floats of a step: quaternion (real part last), translation, stretch row by row, and nothing up to the size of two maps
KEY_FLOATS = 24
# Parts of a step in which a rotation turns by at most so much [rad], where boxes are found; and the most parts of one
_TURN, _PARTS_MOST = 0.1, 64
# Maps whose least size is below this share of the largest one are measured by decomposition
_FLAT = 0.1
# Maps that a thread looks at together
_MAPS_AT_ONCE = 1 << 16


def instance_maps(maps: np.ndarray) -> InstanceMaps:
    """Maps of all instances, float32, shape [n, times, 3, 4]."""
    return InstanceMaps(np.arange(len(maps), dtype=np.int32), maps)


def moving_instances(scene: Scene) -> np.ndarray:
    """Whether the map of each instance is another at another time: bool, shape [n]."""
    moving = np.zeros(len(scene.instances), bool)
    moving[moving_maps(scene).instance] = True
    return moving


def moving_maps(scene: Scene) -> InstanceMaps:
    """The maps of the instances that `moving_instances` lists, in their order."""
    motion = scene.instances.motion
    if motion is None or motion.maps.shape[1] < 2:
        return InstanceMaps(np.zeros(0, np.int32), np.zeros((0, 2, 3, 4), np.float32))
    turns = (motion.maps != motion.maps[:, :1]).any((1, 2, 3))
    return motion if turns.all() else InstanceMaps(motion.instance[turns], motion.maps[turns])


def deforming_meshes(scene: Scene) -> np.ndarray:
    """Whether the vertices of each mesh move: bool, shape [mesh_count]."""
    return np.array([mesh.motion is not None and len(mesh.triangles) > 0 for mesh in scene.meshes], bool)


def apart(scene: Scene) -> np.ndarray:
    """Whether each instance needs a tree of its own, because it moves or its mesh deforms: bool, shape [n]."""
    return moving_instances(scene) | deforming_meshes(scene)[scene.instances.mesh]


def motion_keys(matrices: np.ndarray) -> np.ndarray:
    """The keys of maps [..., steps, 3, 4]: float32, shape [..., steps, KEY_FLOATS]."""
    matrices = np.asarray(matrices, np.float64)
    left, sizes, right = np.linalg.svd(matrices[..., :3])
    rotation = left @ right
    stretch = np.swapaxes(right, -1, -2) @ (sizes[..., None] * right)
    hand = np.where(np.linalg.det(rotation) < 0, -1.0, 1.0)[..., None, None]
    quaternion = _quaternions(rotation * hand)
    for step in range(1, quaternion.shape[-2]):  # the shorter way from each step to the next
        away = (quaternion[..., step, :] * quaternion[..., step - 1, :]).sum(-1, keepdims=True) < 0
        quaternion[..., step, :] *= np.where(away, -1.0, 1.0)
    flat = (stretch * hand).reshape(*matrices.shape[:-2], 9)
    unused = np.zeros((*matrices.shape[:-2], KEY_FLOATS - 16))
    return np.concatenate([quaternion, matrices[..., 3], flat, unused], -1).astype(np.float32)


def _quaternions(rotation: np.ndarray) -> np.ndarray:
    """Unit quaternions, real part last, of rotations [..., 3, 3] (Bar-Itzhack 2000): the largest eigenvector."""
    r = rotation
    k = np.zeros((*r.shape[:-2], 4, 4))
    for i in range(3):
        j, m = (i + 1) % 3, (i + 2) % 3
        k[..., i, i] = r[..., i, i] - r[..., j, j] - r[..., m, m]
        k[..., i, j] = k[..., j, i] = r[..., i, j] + r[..., j, i]
        k[..., i, 3] = k[..., 3, i] = r[..., m, j] - r[..., j, m]
    k[..., 3, 3] = np.trace(r, axis1=-2, axis2=-1)
    return np.linalg.eigh(k)[1][..., :, -1]


def maps_at(keys: np.ndarray, times: np.ndarray) -> np.ndarray:
    """The maps of keys [n, steps, KEY_FLOATS] at `times` [t], as in `native/math/motion.h`: float64, [n, t, 3, 4]."""
    keys = keys.astype(np.float64)
    steps = keys.shape[1]
    at = np.asarray(times, np.float64) * (steps - 1)
    step = np.clip(at.astype(int), 0, steps - 2)
    t = (at - step)[None, :, None]
    a, b = keys[:, step], keys[:, step + 1]
    cosine = (a[..., :4] * b[..., :4]).sum(-1, keepdims=True)
    angle = np.arccos(np.clip(cosine, -1, 1))
    sine = np.sin(angle)
    arc = (cosine < 0.9995) & (sine > 0)
    safe = np.where(arc, sine, 1)
    share_a = np.where(arc, np.sin(angle * (1 - t)) / safe, 1 - t)
    share_b = np.where(arc, np.sin(angle * t) / safe, t)
    q = share_a * a[..., :4] + share_b * b[..., :4]
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    x, y, z, w = np.moveaxis(q, -1, 0)
    rotation = np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        ],
        -2,
    )
    mixed = (1 - t) * a[..., 4:] + t * b[..., 4:]
    linear = rotation @ mixed[..., 3:12].reshape(*mixed.shape[:-1], 3, 3)
    return np.concatenate([linear, mixed[..., :3, None]], -1)


def knots(keys: np.ndarray) -> np.ndarray:
    """Times between which no rotation of keys [n, steps, KEY_FLOATS] turns far, from 0 to 1: shape [t]."""
    cosine = (keys[:, 1:, :4].astype(np.float64) * keys[:, :-1, :4]).sum(-1)
    turn = 2 * np.arccos(np.clip(cosine.min(initial=1.0), -1, 1))
    parts = int(np.clip(np.ceil(turn / _TURN), 1, _PARTS_MOST))
    return np.linspace(0, 1, parts * (keys.shape[1] - 1) + 1)


def way_off(keys: np.ndarray, reach: np.ndarray, parts: int) -> np.ndarray:
    """How far points within `reach` [n, m] of the origins are off the lines between their places at the ends of
    `parts` parts of each step of keys [n, steps, KEY_FLOATS] [m]: shape [n].

    A line is left by at most an eighth of the second derivative times the square of the time. With the angle w, the
    stretch S and its change D in a step that is |w|^2 |S| + 2 |w| |D|, times the reach. (A blend of quaternions that is
    normalised, for small angles, has less than twice as much.)
    """
    cosine = (keys[:, 1:, :4].astype(np.float64) * keys[:, :-1, :4]).sum(-1)
    turn = 2 * np.arccos(np.clip(cosine, -1, 1))
    stretch = keys[..., 7:16].astype(np.float64).reshape(*keys.shape[:2], 3, 3)
    size = np.linalg.norm(stretch, axis=(2, 3)).max(1, keepdims=True)
    change = np.linalg.norm(stretch[:, 1:] - stretch[:, :-1], axis=(2, 3))
    second = turn**2 * size + 2 * turn * change
    return 2 * second.max(1) * reach / (8 * parts**2)


def _singular_values(matrices: np.ndarray) -> np.ndarray:
    """Of matrices [n, 3, 3], float64, the largest first: those that are flat by decomposition, which takes four times
    as long, others by the eigenvalues of A^T A (Smith 1961). Cosines near 1 leave 1e-8 of the largest eigenvalue in
    doubt, so that those which are far smaller are not known.
    """
    a, b, c, d, e, f, g, h, i = np.ascontiguousarray(matrices.reshape(-1, 9).T)
    xx, yy, zz = a * a + d * d + g * g, b * b + e * e + h * h, c * c + f * f + i * i
    xy, xz, yz = a * b + d * e + g * h, a * c + d * f + g * i, b * c + e * f + h * i
    mean = (xx + yy + zz) / 3
    xx, yy, zz = xx - mean, yy - mean, zz - mean
    reach = np.sqrt((xx * xx + yy * yy + zz * zz + 2 * (xy * xy + xz * xz + yz * yz)) / 6)
    determinant = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        cosine = np.nan_to_num(determinant / (2 * reach**3))  # 0: all are the mean
    angle = np.arccos(np.clip(cosine, -1, 1)) / 3
    most = mean + 2 * reach * np.cos(angle)
    least = mean + 2 * reach * np.cos(angle + 2 * np.pi / 3)
    found = np.sqrt(np.maximum(np.stack([most, 3 * mean - most - least, least], 1), 0))
    flat = np.flatnonzero(~(found[:, 2] > _FLAT * found[:, 0]))
    found[flat] = np.linalg.svd(matrices[flat], compute_uv=False)
    return found


def map_sizes(maps: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of maps [..., 3, 4]: whether they are finite, their singular values, float64, the largest first, within 1e-5 of
    themselves, and whether they have an inverse in float32: the smallest one is not lost in the rounding of the
    largest.
    """
    shape, flat = maps.shape[:-2], maps.reshape(-1, 3, 4)
    finite, sizes = np.empty(len(flat), bool), np.empty((len(flat), 3))

    def measure(part: slice) -> None:
        finite[part] = np.isfinite(flat[part]).all((1, 2))
        linear = np.where(finite[part, None, None], flat[part, :, :3], 0).astype(np.float64)
        sizes[part] = _singular_values(linear)

    in_slices(len(flat), measure, _MAPS_AT_ONCE)
    regular = sizes[:, 2] > sizes[:, 0] * np.finfo(np.float32).eps
    return finite.reshape(shape), sizes.reshape(*shape, 3), regular.reshape(shape)
