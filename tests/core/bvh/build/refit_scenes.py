"""Scenes that move from frame to frame, and caches whose trees follow them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.device.devices import find_device
from raybatch_addon.core.scene.description import Frame, Mesh, Visibility
from raybatch_addon.core.scene.features import needs_instancing
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.plan.plan import Method, TracingPlan
from raybatch_addon.core.wavefront.scene.geometry_request import GeometryRequest
from raybatch_addon.core.wavefront.scene.scene_cache import SceneCache
from tests.support import scenes
from tests.support.paged_scenes import strands
from tests.support.under_test import DEVICE

SETTINGS = RenderSettings(device=DEVICE, sample_count=2, bounce_max=3, spatial_splits="OFF")
FRAME = Frame(20, 16, passes=("Combined", "Depth", "Normal", "Position"))
BALL, SMOOTH_BALL, FLOOR, CUBE = (
    scenes.sphere(segments=16, rings=8),
    scenes.sphere("smooth", 16, 8, smooth=True),
    scenes.plane(size=8),
    scenes.box(),
)
NOT_CAMERA = int(Visibility.ALL & ~Visibility.CAMERA)
STATM = Path("/proc/self/statm")
# What the resident memory may grow by over 150 frames [bytes]: the allocator's own unrest; a tree kept from every frame
# takes ten times this
MEMORY_TOLERANCE = 12 * 2**20

layouts = pytest.mark.parametrize("layout", list(Layout) if DEVICE == "cpu" else [Layout.QUANTISED])


def waved(mesh: Mesh, time: float) -> Mesh:
    """`mesh` with a wave through it, normals and all."""
    x, y, z = mesh.positions.T
    positions = np.stack([x + 0.1 * np.sin(5 * y + time), y, z * (1 + 0.2 * np.sin(4 * x + 3 * time))], 1).astype(
        np.float32
    )
    normals = mesh.corner_normals
    if normals is not None:
        normals = normals + 0.05 * np.sin(time)
        normals = (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).astype(np.float32)
    return replace(mesh, positions=positions, corner_normals=normals)


def turned(angle: float, *place, scale=0.6) -> np.ndarray:
    """A matrix that turns about z."""
    matrix = scenes.translation(*place, scale)
    c, s = np.cos(angle), np.sin(angle)
    matrix[:, :3] = scale * np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return matrix


def several(time: float):
    """A waving mesh and one that moves, both baked; a mesh placed twice that moves, one that waves, one that stands
    still.
    """
    colors = [scenes.diffuse((0.8, 0.3, 0.2)), scenes.diffuse((0.2, 0.7, 0.4)), scenes.diffuse(0.6)]
    shared = waved(BALL, time)
    return scenes.scene(
        [
            (FLOOR, scenes.translation(0, 0, -1), colors[2]),
            (waved(SMOOTH_BALL, time), turned(0.3, -1.2, 0, 0), colors[0]),
            (scenes.plane("moving", 1.0), turned(time, 0.3 * time, 1, 0.4, scale=1.0), colors[1]),
            (
                scenes.plane("hidden", 1.5),
                scenes.translation(0, -2.5, 0.2 + 0.1 * time),
                scenes.emitter(2.0),
                NOT_CAMERA,
            ),
            (CUBE, turned(time, 1.2, 0.2 * time, 0, scale=0.3), colors[1]),
            (CUBE, turned(-time, 0.4, -1, 0.1 * time, scale=0.2), colors[0]),
            (shared, turned(0, -0.2, 1.5, 0.5, scale=0.4), colors[0]),
            (shared, turned(0, 1.8, 1.0, 0.3, scale=0.4), colors[1]),
        ],
        view=scenes.camera(eye=(0.2, -6, 1.5), half_width=0.5),
        frame=FRAME,
        lights=[scenes.area_light(3.0)],
        world=0.3,
    )


def hairy(time: float):
    """Strands among triangles, baked, and a tuft that is placed twice: all of it waves."""
    tuft = waved(strands("tuft", 40, seed=4), time)
    return scenes.scene(
        [
            (FLOOR, scenes.translation(0, 0, -1), scenes.diffuse(0.6)),
            (waved(BALL, time), turned(0.3, -1.2, 0, 0), scenes.diffuse((0.8, 0.3, 0.2))),
            (waved(strands("hair", 120, ribbons=True), time), turned(0, 0.8, 0, 0, scale=0.8), scenes.diffuse(0.7)),
            (tuft, turned(time, -0.2, 1.5, 0.5, scale=0.5), scenes.diffuse(0.5)),
            (tuft, turned(0, -1.2, -1.0, 0.3, scale=0.6), scenes.diffuse(0.5)),
        ],
        view=scenes.camera(eye=(0.2, -6, 1.5), half_width=0.5),
        frame=FRAME,
        world=(0.4, 0.5, 0.7),
    )


def single(time: float):
    """All in one tree."""
    return scenes.scene(
        [
            (FLOOR, scenes.translation(0, 0, -1), scenes.diffuse(0.6)),
            (waved(BALL, time), turned(time, 0.2 * time, 0, 0, scale=0.8), scenes.diffuse((0.8, 0.3, 0.2))),
        ],
        view=scenes.camera(eye=(0.2, -6, 1.5), half_width=0.5),
        frame=FRAME,
        world=0.5,
    )


def opened(layout: Layout) -> Session:
    session = Session(DEVICE, SETTINGS)
    session._at[0].layout = layout
    return session


def assert_same(film, expected):
    assert film.passes.keys() == expected.passes.keys()
    for name, values in expected.passes.items():
        assert np.array_equal(film.passes[name], values), name


def counts(statistics) -> tuple[int, int]:
    return statistics["built"], statistics["refitted"]


def followed(cache: SceneCache, scene, layout=Layout.QUANTISED, settings=SETTINGS):
    plan = TracingPlan(Method.REFERENCE if settings.batching == "REFERENCE" else Method.UNBATCHED)
    request = GeometryRequest(
        settings=settings, plan=plan, layout=layout, instancing=needs_instancing(scene), page_folder=Path("unused")
    )
    return cache.get(scene, request, find_device(DEVICE)).built
