"""The pass Vector: how far what is seen moves in the picture, from the frame before and to the frame after."""

from __future__ import annotations

import numpy as np
import warp as wp

from ...programs.inputs_data import corner_values
from ...scene.description import Camera, CameraKind, Scene


@wp.struct
class VectorInputs:
    """Where things are a frame before (0) and a frame after (1); arrays have no entries where nothing of that moves."""

    to_picture: wp.array(dtype=wp.mat44)  # [3]: world to pixels now, before and after; x and y are over w
    maps: wp.array(dtype=wp.mat44)  # [2 * instances]: from the world of now to that of these frames
    turns: wp.array(
        dtype=wp.mat33
    )  # [2 * instances]: from steps in object space to those in the worlds of these frames
    first: wp.array(dtype=int)  # of each instance: its first corner in `steps`; -1: it does not deform
    steps: wp.array(dtype=wp.vec3)  # [2 * corners]: from a vertex to where it is in these frames [m], in object space


@wp.func
def in_picture(to_picture: wp.mat44, position: wp.vec3) -> wp.vec2:
    """Where a point is seen [pixels]; 0 where it is not before the camera."""
    p = to_picture * wp.vec4(position[0], position[1], position[2], 1.0)
    seen = wp.vec2(0.0, 0.0)
    if p[3] > 0.0:
        seen = wp.vec2(p[0] / p[3], p[1] / p[3])
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


@wp.func
def motion_vector(
    vectors: VectorInputs, instance: int, primitive: int, barycentric: wp.vec2, position: wp.vec3
) -> wp.vec4:
    """From where a point of a surface is seen to where it is in the frame before, and back to there from where it is in
    the frame after [pixels], as in Cycles.
    """
    motion = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if vectors.to_picture.shape[0] > 0:
        now = in_picture(vectors.to_picture[0], position)
        for frame in range(2):
            there = moved_to(vectors, frame, instance, primitive, barycentric, position)
            seen = in_picture(vectors.to_picture[1 + frame], there)
            sign = 1.0 - 2.0 * float(frame)
            motion[2 * frame] = sign * (seen[0] - now[0])
            motion[2 * frame + 1] = sign * (seen[1] - now[1])
    return motion


def upload_vectors(scene: Scene, device: wp.Device) -> VectorInputs:
    """What the pass reads of `scene`; nothing where its camera is a panorama, whose vectors are 0."""
    vectors, camera, instances = VectorInputs(), scene.camera, scene.instances
    if camera.kind.is_panorama:
        return vectors
    transforms, windows = [camera.transform] * 3, [camera.window] * 3
    if camera.frames is not None:
        transforms[1:] = camera.frames
    if camera.window_frames is not None:
        windows[1:] = camera.window_frames
    pictures = [_to_picture(camera, *each, scene.frame.width, scene.frame.height) for each in zip(transforms, windows)]
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
    left, right, bottom, top = (float(each) for each in window)
    x, y = width / (right - left), height / (top - bottom)
    if camera.kind == CameraKind.PERSPECTIVE:
        rows = [[x, 0, x * left, 0], [0, y, y * bottom, 0], [0, 0, 1, 0], [0, 0, -1, 0]]
    else:
        rows = [[x, 0, 0, -x * left], [0, y, 0, -y * bottom], [0, 0, 1, 0], [0, 0, 0, 1]]
    return np.array(rows) @ np.linalg.inv(_square(np.asarray(transform)))
