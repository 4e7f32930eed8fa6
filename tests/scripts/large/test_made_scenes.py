"""Large scenes that are made by rule: the same from one seed, valid, on the ground, and as many instances as wanted."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from made_scenes.forest import TWIGS, forest
from made_scenes.island import SIZE, island
from made_scenes.noise import fractal_noise
from made_scenes.placing import Placements, composed, standing
from made_scenes.terrain import Terrain

from raybatch_addon.core.scene.archive import load_scene
from raybatch_addon.core.scene.validate import checked_scene
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support.command_line import ROOT

MADE = {"forest": forest, "island": island}


@pytest.mark.parametrize("kind", MADE)
def test_a_seed_makes_one_scene_that_is_valid(kind):
    made, again, other = (MADE[kind](3000, 65, 1, seed, 32, 18) for seed in (1, 1, 2))
    for name in ("mesh", "transform", "slot_first"):
        assert np.array_equal(getattr(made.instances, name), getattr(again.instances, name))
    for mesh, same in zip(made.meshes, again.meshes, strict=True):
        assert np.array_equal(mesh.positions, same.positions) and np.array_equal(mesh.triangles, same.triangles)
    assert not np.array_equal(made.instances.transform[:100], other.instances.transform[:100])
    checked = checked_scene(made)
    assert not checked.warnings and len(checked.instances) == len(made.instances)
    assert 0.95 * 3000 <= len(made.instances) <= 3001
    assert np.bincount(made.instances.mesh, minlength=len(made.meshes)).min() > 0
    sizes = [len(mesh.triangles) for mesh in made.meshes]
    assert made.triangles_placed == sum(sizes[i] for i in made.instances.mesh.tolist())


@pytest.mark.usefixtures("general_kernels")
@pytest.mark.parametrize("kind", MADE)
def test_it_renders(kind, device):
    session = Session(device)
    film = session.render(MADE[kind](500, 33, 1, 1, 24, 16), RenderSettings(sample_count=2))
    session.close()
    assert film.complete and np.isfinite(film.passes["Combined"]).all() and film.passes["Combined"].max() > 0


def test_things_stand_on_the_ground_and_not_in_the_sea():
    made = island(4000, 129, 1, 1, 32, 18)
    terrain = Terrain.of(SIZE, 129, 1, island=True, height=300.0)
    alone = [
        i for i, mesh in enumerate(made.meshes) if mesh.name.startswith(("Rock", "Shrub", "Fern", "Grass", "Palm "))
    ]
    leaves = [i for i, mesh in enumerate(made.meshes) if mesh.name.startswith("Palm Leaf")]
    placed = made.instances.transform[np.isin(made.instances.mesh, np.setdiff1d(alone, leaves)), :, 3]
    heights, normals = terrain.at(placed[:, :2].astype(np.float64))
    assert np.allclose(placed[:, 2], heights, atol=0.01) and heights.min() > -3.01
    assert np.allclose(np.linalg.norm(normals, axis=1), 1)


def test_the_ground_is_where_its_triangles_are():
    terrain = Terrain.of(10.0, 9, 3, island=False, height=2.0)
    mesh, random = terrain.mesh("Ground"), np.random.default_rng(1)
    weights = random.dirichlet((1, 1, 1), len(mesh.triangles))
    corners = mesh.positions[mesh.triangles].astype(np.float64)
    inside = (weights[:, :, None] * corners).sum(1)
    heights, normals = terrain.at(inside[:, :2])
    assert np.allclose(heights, inside[:, 2], atol=1e-5)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.allclose(normals, across / np.linalg.norm(across, axis=1, keepdims=True), atol=1e-4)


def test_maps_within_maps_and_those_of_things_that_stand():
    random = np.random.default_rng(2)
    outer, inner = random.normal(size=(5, 3, 4)), random.normal(size=(4, 3, 4)).astype(np.float32)
    last = np.array([[0, 0, 0, 1.0]])
    found = composed(outer.astype(np.float32), inner).reshape(5, 4, 3, 4)
    for i in range(5):
        for k in range(4):
            expected = np.concatenate([outer[i], last]) @ np.concatenate([inner[k], last])
            assert np.allclose(found[i, k], expected[:3], atol=1e-5)
    up = random.normal(size=(6, 3)) + [0, 0, 3]
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    maps = standing(random.normal(size=(6, 3)), random.uniform(0, 6, 6), np.full(6, 2.0), up)
    assert np.allclose(maps[:, :, :3].transpose(0, 2, 1) @ maps[:, :, :3], 4 * np.eye(3), atol=1e-4)
    assert np.allclose(maps[:, :, 2], 2 * up, atol=1e-5) and (np.linalg.det(maps[:, :, :3]) > 0).all()


def test_no_more_is_placed_than_there_is_room_for():
    placements = Placements(5)
    placements.add(np.array([1, 2, 1], np.int32), np.zeros((3, 3, 4)))
    placements.add(3, np.ones((4, 3, 4)))
    made = placements.instances(np.array([7, 8, 9, 10], np.int32))
    assert made.mesh.tolist() == [1, 2, 1, 3, 3] and made.slot_first.tolist() == [8, 9, 8, 10, 10]
    assert placements.left == 0


def test_noise_is_smooth_and_bounded():
    x = np.linspace(-50, 50, 20_001)
    values = fractal_noise(x, 0.3 * x, 1, 1)
    assert np.abs(values).max() <= 0.5 and values.std() > 0.05 and np.abs(np.diff(values)).max() < 0.02


def test_the_command_writes_a_scene_that_can_be_read(tmp_path):
    def run(*arguments: str) -> subprocess.CompletedProcess:
        command = [sys.executable, "scripts/made_scenes/make_scene.py", *arguments]
        return subprocess.run(command, cwd=ROOT, env=dict(os.environ), capture_output=True, text=True)

    out = tmp_path / "forest.scene.npz"
    done = run("forest", "-o", str(out), "--instances", "600", "--terrain", "9", "--size", "40x30")
    report = json.loads(done.stdout)
    scene, _ = load_scene(out)
    assert report["instances"] == len(scene.instances) == 1 + 3 * TWIGS and scene.frame.width == 40
    assert report["triangles_placed"] == scene.triangles_placed > report["triangles"]

    np.savez(tmp_path / "mesh.npz", v=np.eye(3, dtype=np.float32), f=np.array([[0, 1, 2]], np.int32))
    out = tmp_path / "grid.scene.npz"
    done = run("grid", "-o", str(out), "--mesh", str(tmp_path / "mesh.npz"), "--copies", "3")
    assert json.loads(done.stdout)["triangles"] == 9 == len(load_scene(out)[0].meshes[0].triangles)

    for wrong, why in (
        (("grid", "-o", str(out)), "give it with --mesh"),
        (("island", "-o", "x.png"), "must end in .scene.npz"),
        (("island", "-o", str(out), "--instances", "1"), "must be 10 or more"),
    ):
        done = run(*wrong)
        assert done.returncode == 1 and why in done.stderr
