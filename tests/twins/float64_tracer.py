"""A small path tracer in float64 and NumPy: an implementation of its own, whose pictures are the truth for others.

It shares nothing with the core but the description of scenes. Light that reaches a surface from emissive triangles
comes from points sampled on them, alone; light of the world from scattered directions, alone: no two strategies share a
path, so there are no weights to get wrong. Paths have a fixed length and no Russian roulette. Every ray is tested
against every triangle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from raybatch_addon.core.scene.description import CameraKind, ClosureKind, Scene, Visibility

# Distances from a surface, relative to the extent of the scene, below which a ray does not hit: float64 is that good a
# million times over
CLOSE = 1e-9
# Random numbers of a path: two for the pixel, and five at each surface (triangle and place of light, direction)
PIXEL_NUMBERS, SURFACE_NUMBERS = 2, 5


@dataclass(frozen=True)
class Triangles:
    """All triangles of a scene in world space, one entry each."""

    corner: np.ndarray  # [m], float64, shape [n, 3]
    edges: np.ndarray  # from the corner to the other two, float64, shape [n, 2, 3]
    normal: np.ndarray  # unit, shape [n, 3]
    area: np.ndarray  # [m²], shape [n]
    albedo: np.ndarray  # linear RGB, shape [n, 3]
    emission: np.ndarray  # radiance of both sides, linear RGB, shape [n, 3]
    extent: float  # of the scene [m]


def render(scene: Scene, sample_count: int, bounce_max: int, seed: int = 0) -> np.ndarray:
    """The picture of `scene`, float64, shape [height, width, 3], bottom row first, through a box filter of one pixel.

    Samples of a pixel are a lattice (Kronecker's, by the roots of the generalised golden ratio), shifted at random for
    every pixel: their mean is unbiased, and pictures of other seeds are independent. Raises `ValueError` for what this
    tracer does not know.
    """
    triangles = triangles_of(scene)
    frame = scene.frame
    x0, y0, x1, y1 = frame.region
    rows, columns = np.mgrid[y0:y1, x0:x1]
    dimensions = PIXEL_NUMBERS + SURFACE_NUMBERS * (bounce_max + 1)
    shift = np.random.default_rng(seed).random((rows.size, dimensions))
    total = np.zeros((rows.size, 3))
    step = max(1, 40_000 // rows.size)  # samples of every pixel at once: some ten MB of rays times triangles
    for first in range(0, sample_count, step):
        index = np.arange(first, min(first + step, sample_count))
        numbers = (shift[:, None] + index[:, None] * _lattice(dimensions)) % 1.0
        pixels = np.stack([np.repeat(columns.ravel(), len(index)), np.repeat(rows.ravel(), len(index))], -1)
        light = _radiance(scene, triangles, pixels, numbers.reshape(-1, dimensions), bounce_max)
        total += light.reshape(rows.size, -1, 3).sum(axis=1)
    return (total / sample_count).reshape(y1 - y0, x1 - x0, 3)


def render_runs(scene: Scene, sample_count: int, bounce_max: int, runs: int, seed: int = 0) -> np.ndarray:
    """Independent pictures, shape [runs, height, width, 3], that have `sample_count` samples together."""
    return np.stack([render(scene, sample_count // runs, bounce_max, seed + run) for run in range(runs)])


def triangles_of(scene: Scene) -> Triangles:
    """The triangles of all instances; raises `ValueError` for what this tracer does not know."""
    if (
        scene.lights
        or scene.world.visibility != Visibility.ALL
        or (scene.instances.visibility != int(Visibility.ALL)).any()
    ):
        raise ValueError("this tracer knows emissive triangles and a world that every ray sees, no other lights")
    corners, albedos, emissions = [], [], []
    instances = scene.instances
    for mesh_index, transform, slot_first in zip(instances.mesh, instances.transform, instances.slot_first):
        mesh = scene.meshes[mesh_index]
        if mesh.corner_normals is not None:
            raise ValueError("this tracer knows flat triangles only")
        matrix = np.asarray(transform, np.float64)
        places = np.asarray(mesh.positions, np.float64) @ matrix[:, :3].T + matrix[:, 3]
        corners.append(places[mesh.triangles])
        slots = mesh.triangle_slot if mesh.triangle_slot is not None else np.zeros(len(mesh.triangles), np.int32)
        looks = [_look(scene.materials[scene.slot_materials[slot_first + slot]]) for slot in slots]
        albedos += [look[0] for look in looks]
        emissions += [look[1] for look in looks]
    places = np.concatenate(corners) if corners else np.zeros((0, 3, 3))
    edges = places[:, 1:] - places[:, :1]
    normal = np.cross(edges[:, 0], edges[:, 1])
    length = np.linalg.norm(normal, axis=-1)
    if (length == 0).any():
        raise ValueError("this tracer knows no triangles without area")
    extent = float(np.ptp(places.reshape(-1, 3), axis=0).max()) if len(places) else 1.0
    return Triangles(
        places[:, 0],
        edges,
        normal / length[:, None],
        length / 2,
        np.reshape(albedos, (-1, 3)),
        np.reshape(emissions, (-1, 3)),
        extent,
    )


def _look(material) -> tuple[np.ndarray, np.ndarray]:
    """Albedo and emission."""
    look = {ClosureKind.DIFFUSE: np.zeros(3), ClosureKind.EMISSION: np.zeros(3)}
    for closure in material.closures:
        if closure.kind not in look:
            raise ValueError(
                f"this tracer knows diffuse and emissive surfaces, and {material.name} is {closure.kind.name}"
            )
        look[closure.kind] = look[closure.kind] + np.asarray(closure.weight, np.float64)
    return look[ClosureKind.DIFFUSE], look[ClosureKind.EMISSION]


def _lattice(dimensions: int) -> np.ndarray:
    """Powers of 1 / g with g^(d + 1) = g + 1: the most even direction known of a lattice without end (Roberts 2018)."""
    g = 2.0
    for _ in range(60):
        g = (1 + g) ** (1 / (dimensions + 1))
    return (1 / g) ** np.arange(1, dimensions + 1) % 1.0


def _camera_rays(scene: Scene, pixels: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    camera, frame = scene.camera, scene.frame
    if camera.kind != CameraKind.PERSPECTIVE or camera.lens_radius or camera.clip_start or np.isfinite(camera.clip_end):
        raise ValueError("this tracer knows pinhole cameras without clipping only")
    left, right, bottom, top = camera.window
    place = (pixels + u) / (frame.width, frame.height)
    matrix = np.asarray(camera.transform, np.float64)
    view = np.column_stack(
        [left + place[:, 0] * (right - left), bottom + place[:, 1] * (top - bottom), -np.ones(len(place))]
    )
    direction = view @ matrix[:, :3].T
    return np.broadcast_to(matrix[:, 3], direction.shape), direction / np.linalg.norm(direction, axis=-1, keepdims=True)


def closest_hits(triangles: Triangles, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index of the closest triangle of each ray (-1: none), and its distance in lengths of `direction`."""
    hit, best = np.full(len(origin), -1), np.full(len(origin), np.inf)
    for i in range(len(triangles.area)):
        t = _distance(triangles, i, origin, direction)
        closer = t < best
        hit[closer], best[closer] = i, t[closer]
    return hit, best


def is_hidden(triangles: Triangles, origin: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Whether a triangle lies between two points, seen from neither end."""
    way = target - origin
    end = 1 - CLOSE * triangles.extent / np.linalg.norm(way, axis=-1)
    hidden = np.zeros(len(origin), bool)
    for i in range(len(triangles.area)):
        hidden |= _distance(triangles, i, origin, way) < end
    return hidden


def _distance(triangles: Triangles, i: int, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Where rays meet the plane of triangle `i`, in lengths of `direction`; infinite for those that miss the triangle,
    or start on it.
    """
    normal, (a, b) = triangles.normal[i], triangles.edges[i]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = ((triangles.corner[i] - origin) @ normal) / (direction @ normal)
        place = origin + t[:, None] * direction - triangles.corner[i]
        # barycentric coordinates by the rows that are reciprocal to the edges
        u = place @ (np.cross(b, normal) / np.dot(a, np.cross(b, normal)))
        v = place @ (np.cross(a, normal) / np.dot(b, np.cross(a, normal)))
        met = (t > CLOSE * triangles.extent) & (u >= 0) & (v >= 0) & (u + v <= 1)
    return np.where(met, t, np.inf)


def _radiance(
    scene: Scene, triangles: Triangles, pixels: np.ndarray, numbers: np.ndarray, bounce_max: int
) -> np.ndarray:
    """What each path brings, shape [paths, 3]."""
    world = np.asarray(scene.world.radiance, np.float64)
    origin, direction = _camera_rays(scene, pixels, numbers[:, :PIXEL_NUMBERS])
    light, throughput = np.zeros((len(pixels), 3)), np.ones((len(pixels), 3))
    alive = np.arange(len(pixels))
    for bounce in range(bounce_max + 2):
        hit, t = closest_hits(triangles, origin, direction)
        left = hit < 0
        light[alive[left]] += throughput[left] * world
        kept = ~left
        alive, hit, throughput, direction = alive[kept], hit[kept], throughput[kept], direction[kept]
        place = origin[kept] + t[kept, None] * direction
        if bounce == 0:
            light[alive] += triangles.emission[hit]
        if bounce > bounce_max or not len(alive):
            break
        first = PIXEL_NUMBERS + SURFACE_NUMBERS * bounce
        u = numbers[alive, first : first + SURFACE_NUMBERS]
        # the side that is seen
        normal = (
            triangles.normal[hit]
            * np.where(np.einsum("ij,ij->i", direction, triangles.normal[hit]) < 0, 1.0, -1.0)[:, None]
        )
        throughput = throughput * triangles.albedo[hit]
        light[alive] += throughput * _from_lamps(triangles, place, normal, u[:, :3]) / np.pi
        origin, direction = place, _cosine_directions(normal, u[:, 3:])
    return light


def _from_lamps(triangles: Triangles, place: np.ndarray, normal: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Irradiance from one point on an emissive triangle, chosen by power: an estimate of that from all, shape [paths,
    3].
    """
    power = triangles.area * triangles.emission.sum(axis=1)
    if not power.any():
        return np.zeros((len(place), 3))
    ends = np.cumsum(power) / power.sum()
    chosen = np.minimum(np.searchsorted(ends, u[:, 0], side="right"), np.flatnonzero(power)[-1])
    root = np.sqrt(u[:, 1])
    across = np.stack([root * (1 - u[:, 2]), root * u[:, 2]], -1)
    target = triangles.corner[chosen] + np.einsum("ij,ijk->ik", across, triangles.edges[chosen])
    way = target - place
    squared = np.einsum("ij,ij->i", way, way)
    near = np.einsum("ij,ij->i", way, normal)
    far = np.abs(np.einsum("ij,ij->i", way, triangles.normal[chosen]))
    seen = (near > 0) & (squared > (CLOSE * triangles.extent) ** 2)
    result = np.zeros((len(place), 3))
    seen[seen] = ~is_hidden(triangles, place[seen], target[seen])
    density = power[chosen[seen]] / power.sum() / triangles.area[chosen[seen]]
    result[seen] = triangles.emission[chosen[seen]] * (near[seen] * far[seen] / squared[seen] ** 2 / density)[:, None]
    return result


def _cosine_directions(normal: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Directions about `normal` with density cos / pi."""
    helper = np.where(np.abs(normal[:, :1]) > 0.6, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]])
    tangent = np.cross(normal, helper)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    radius, angle = np.sqrt(u[:, 0]), 2 * np.pi * u[:, 1]
    flat = tangent * np.cos(angle)[:, None] + np.cross(normal, tangent) * np.sin(angle)[:, None]
    return radius[:, None] * flat + np.sqrt(1 - u[:, 0])[:, None] * normal
