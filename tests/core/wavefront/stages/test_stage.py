"""Kernels of stages: each slot of a list is shaded once, however many threads a launch has."""

import functools

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.film.tile import FilmTile
from raybatch_addon.core.rays import Rays
from raybatch_addon.core.scene.geometry import Geometry
from raybatch_addon.core.wavefront.rays import Paths
from raybatch_addon.core.wavefront.scene.shading_data import SceneData
from raybatch_addon.core.wavefront.stages.limits import PathLimits
from raybatch_addon.core.wavefront.stages.stage import stage_kernel, stage_thread_count
from raybatch_addon.core.wavefront.stages.work import ShadingStage, TileWork

PATHS = 40
LISTED = np.array([0, 3, 4, 5, 11, 12, 20, 21, 22, 23, 30, 31, 39], np.int32)


@functools.cache
def counting_stage() -> wp.Function:
    @wp.func
    def count_slot(
        data: SceneData, work: TileWork, limits: PathLimits, paths: Paths, rays: Rays, film: FilmTile, path: int
    ):
        wp.atomic_add(paths.status, path, 1)

    return count_slot


def geometry(device, indexed: bool) -> Geometry:
    """Two triangles, whose corners may have indices."""
    made = Geometry()
    made.positions = wp.zeros(6, dtype=wp.vec3, device=device)
    made.triangles = wp.array(
        np.arange(6, dtype=np.int32).reshape(2, 3)[: 2 if indexed else 0], dtype=wp.vec3i, device=device
    )
    made.mesh_triangle_first = wp.array([0, 2], dtype=int, device=device)
    made.instance_mesh = wp.zeros(1, dtype=int, device=device)
    return made


@pytest.mark.parametrize("indexed", [False, True])
@pytest.mark.parametrize("of", [ShadingStage.SURFACE, ShadingStage.BACKGROUND])
@pytest.mark.parametrize("listed", [0, 1, len(LISTED)])
def test_each_slot_is_shaded_once(device, of, listed, indexed):
    data, paths, rays = SceneData(), Paths(), Rays()
    data.geometry = geometry(device, indexed)
    hits = np.arange(PATHS, dtype=np.int32)
    rays.hit_instance = wp.array(np.where(hits % 3, 0, -1).astype(np.int32), dtype=int, device=device)
    rays.hit_primitive = wp.array(hits % 2, dtype=int, device=device)
    slots = wp.array(LISTED, dtype=int, device=device)
    expected = np.isin(hits, LISTED[:listed]).astype(np.int32)
    for threads in {
        stage_thread_count(len(LISTED), wp.get_device(device)),
        len(LISTED),
    }:  # lists may be shorter than their bounds
        paths.status = wp.zeros(PATHS, dtype=int, device=device)
        inputs = [data, TileWork(), PathLimits(), paths, rays, FilmTile(), slots]
        count = wp.array([listed], dtype=int, device=device)
        wp.launch(stage_kernel(counting_stage(), of), threads, [*inputs, count], device=device)
        np.testing.assert_array_equal(paths.status.numpy(), expected)


def test_a_cpu_has_one_thread_and_a_gpu_one_for_each_slot(device):
    there = wp.get_device(device)
    assert stage_thread_count(0, there) == 0
    assert stage_thread_count(500, there) == (500 if there.is_cuda else 1)
