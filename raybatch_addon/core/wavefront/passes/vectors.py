"""The pass Vector: how far what is seen moves in the picture, from the frame before and to the frame after."""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
import warp as wp

from ...programs.inputs_data import corner_values
from ...scene.description import Camera, CameraKind, Panorama, Scene
from ...shading.panorama import panorama_numbers, panorama_place_of


@wp.struct
class VectorInputs:
    """Where things are a frame before (0) and a frame after (1); arrays have no entries where nothing of that moves."""

    # [3]: world to pixels now, before and after; x and y are over w; of panoramas: world to camera
    to_picture: wp.array(dtype=wp.mat44)
    panorama: int  # `CameraKind` of a panorama, else 0
    projection: wp.vec4  # of a panorama (`panorama_numbers`)
    projection_more: wp.vec4
    size: wp.vec2  # of a panorama's picture [pixels]
    maps: wp.array(dtype=wp.mat44)  # [2 * instances]: from the world of now to that of these frames
    turns: wp.array(
        dtype=wp.mat33
    )  # [2 * instances]: from steps in object space to those in the worlds of these frames
    first: wp.array(dtype=int)  # of each instance: its first corner in `steps`; -1: it does not deform
    steps: wp.array(dtype=wp.vec3)  # [2 * corners]: from a vertex to where it is in these frames [m], in object space


@wp.func
def in_picture(to_picture: wp.mat44, point: wp.vec4) -> wp.vec2:
    """Where a point is seen [pixels]: a position and 1, or a direction and 0 for what is infinitely far away; 0 where
    it is not before the camera, and for directions in pictures without perspective.
    """
    p = to_picture * point
    seen = wp.vec2(0.0, 0.0)
    if p[3] > 0.0:
        seen = wp.vec2(p[0] / p[3], p[1] / p[3])
    return seen


@wp.func
def in_panorama(vectors: VectorInputs, which: int, point: wp.vec4) -> wp.vec2:
    """`in_picture` of a panorama."""
    p = vectors.to_picture[which] * point
    place = panorama_place_of(
        vectors.panorama, vectors.projection, vectors.projection_more, wp.normalize(wp.vec3(p[0], p[1], p[2]))
    )
    seen = wp.cw_mul(place, vectors.size)
    if not (wp.abs(seen[0]) < wp.inf and wp.abs(seen[1]) < wp.inf):
        seen = wp.vec2(0.0, 0.0)
    return seen


@wp.func
def moved_to(
    vectors: VectorInputs, frame: int, instance: int, primitive: int, barycentric: wp.vec2, position: wp.vec3
) -> wp.vec3:
    """Where a point of a surface is in the frame before (0) or after (1)."""
    moved = position
    if vectors.maps.shape[0] > 0:
        p = vectors.maps[2 * instance + frame] * wp.vec4(position[0], position[1], position[2], 1.0)
        moved = wp.vec3(p[0], p[1], p[2])
    if vectors.first.shape[0] > 0:
        first = vectors.first[instance]
        if first >= 0:
            corner = 2 * (first + 3 * primitive) + frame
            a = vectors.steps[corner]
            step = (
                a + barycentric[0] * (vectors.steps[corner + 2] - a) + barycentric[1] * (vectors.steps[corner + 4] - a)
            )
            moved = moved + vectors.turns[2 * instance + frame] * step
    return moved


class MotionVectors(NamedTuple):
    """Functions that give a vec4: from where something is seen to where it is in the frame before, and back to there
    from where it is in the frame after [pixels], as in Cycles.
    """

    of_surface: wp.Function  # (vectors, instance: int, primitive: int, barycentric: vec2, position: vec3)
    of_background: wp.Function  # (vectors, direction: vec3), of the ray that leaves the scene


@functools.cache
def make_motion_vectors(panoramas: bool) -> MotionVectors:
    """`panoramas`: the camera may be one."""

    @wp.func
    def seen_at(vectors: VectorInputs, which: int, point: wp.vec4) -> wp.vec2:
        if wp.static(panoramas):
            if vectors.panorama != 0:
                return in_panorama(vectors, which, point)
        return in_picture(vectors.to_picture[which], point)

    @wp.func
    def motion(vectors: VectorInputs, now: wp.vec4, before: wp.vec4, after: wp.vec4) -> wp.vec4:
        seen = seen_at(vectors, 0, now)
        back = seen_at(vectors, 1, before) - seen
        on = seen - seen_at(vectors, 2, after)
        return wp.vec4(back[0], back[1], on[0], on[1])

    @wp.func
    def place(position: wp.vec3) -> wp.vec4:
        return wp.vec4(position[0], position[1], position[2], 1.0)

    @wp.func
    def of_surface(
        vectors: VectorInputs, instance: int, primitive: int, barycentric: wp.vec2, position: wp.vec3
    ) -> wp.vec4:
        before = moved_to(vectors, 0, instance, primitive, barycentric, position)
        after = moved_to(vectors, 1, instance, primitive, barycentric, position)
        return motion(vectors, place(position), place(before), place(after))

    @wp.func
    def of_background(vectors: VectorInputs, direction: wp.vec3) -> wp.vec4:
        far = wp.vec4(direction[0], direction[1], direction[2], 0.0)
        return motion(vectors, far, far, far)

    return MotionVectors(of_surface, of_background)


def upload_vectors(scene: Scene, device: wp.Device) -> VectorInputs:
    """What the pass reads of `scene`."""
    vectors, camera, instances = VectorInputs(), scene.camera, scene.instances
    transforms, windows = [camera.transform] * 3, [camera.window] * 3
    if camera.frames is not None:
        transforms[1:] = camera.frames
    if camera.window_frames is not None:
        windows[1:] = camera.window_frames
    pictures = [_to_picture(camera, *each, scene.frame.width, scene.frame.height) for each in zip(transforms, windows)]
    if camera.kind.is_panorama:
        numbers = panorama_numbers(camera.kind, camera.panorama or Panorama())
        vectors.panorama = int(camera.kind)
        vectors.projection, vectors.projection_more = wp.vec4(*numbers[:4]), wp.vec4(*numbers[4:])
        left, right, bottom, top = (float(each) for each in camera.window)
        vectors.size = wp.vec2(scene.frame.width / (right - left), scene.frame.height / (top - bottom))
    vectors.to_picture = wp.array(np.array(pictures, np.float32), dtype=wp.mat44, device=device)
    deforming = {i: mesh for i, mesh in enumerate(scene.meshes) if mesh.frames is not None}
    if len(instances) and (instances.frames is not None or deforming):
        maps = np.tile(np.eye(4, dtype=np.float32), (len(instances), 2, 1, 1))
        turns = np.repeat(instances.transform[:, None, :, :3].astype(np.float32), 2, 1)
        if instances.frames is not None:
            which, then = instances.frames.instance, _square(instances.frames.maps)
            maps[which] = then @ np.linalg.inv(_square(instances.transform[which]))[:, None]
            turns[which] = then[..., :3, :3]
        vectors.maps = wp.array(maps.reshape(-1, 4, 4), dtype=wp.mat44, device=device)
        vectors.turns = wp.array(turns.reshape(-1, 3, 3), dtype=wp.mat33, device=device)
    if deforming:
        values = {}
        for i, mesh in deforming.items():
            steps = np.asarray(mesh.frames, np.float32) - mesh.positions
            values[i] = np.concatenate([each[mesh.triangles] for each in steps], axis=-1)  # [triangles, 3, 2 * 3]
        first, corners = corner_values(scene, values, 6)
        vectors.first = wp.array(first, dtype=int, device=device)
        vectors.steps = wp.array(np.asarray(corners, np.float32).reshape(-1, 3), dtype=wp.vec3, device=device)
    return vectors


def _square(maps: np.ndarray) -> np.ndarray:
    """Maps [..., 3, 4] as float64 [..., 4, 4]."""
    bottom = np.broadcast_to(np.array([0, 0, 0, 1.0]), (*maps.shape[:-2], 1, 4))
    return np.concatenate([np.asarray(maps, np.float64), bottom], axis=-2)


def _to_picture(camera: Camera, transform: np.ndarray, window: tuple, width: int, height: int) -> np.ndarray:
    if camera.kind.is_panorama:
        return np.linalg.inv(_square(np.asarray(transform)))
    left, right, bottom, top = (float(each) for each in window)
    x, y = width / (right - left), height / (top - bottom)
    if camera.kind == CameraKind.PERSPECTIVE:
        rows = [[x, 0, x * left, 0], [0, y, y * bottom, 0], [0, 0, 1, 0], [0, 0, -1, 0]]
    else:
        rows = [[x, 0, 0, -x * left], [0, y, 0, -y * bottom], [0, 0, 1, 0], [0, 0, 0, 1]]
    return np.array(rows) @ np.linalg.inv(_square(np.asarray(transform)))
