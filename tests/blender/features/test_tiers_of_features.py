"""Every feature that is compared with Cycles gives the same bits by general and by specialised kernels.

Specialised kernels are compiled for several features at once, where these differ in closures and programs alone: those
of a scene that has the materials of all of them.
"""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
if bpy.app.version < (5, 2):
    pytest.skip("features are those of Blender 5.2", allow_module_level=True)

import warp as wp

from raybatch_addon.core import session as session_module
from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.requests import prepared_scene
from raybatch_addon.core.scene.description import ClosureKind as K
from raybatch_addon.core.scene.description import Frame, Material, Scene
from raybatch_addon.core.scene.features import SceneFeatures, derive_features
from raybatch_addon.core.scene.passes import AOV_COLOR
from raybatch_addon.core.scene.program import ProgramFeatures
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.tier import VARIABLE, general_features, why_not_general
from tests.blender.features.compare import RenderFailed, by_raybatch, empty_scene, set_alike
from tests.blender.features.registry import FAMILIES, Feature, chosen_features
from tests.blender.features.runner import sheets
from tests.blender.features.sheet import build_sheet
from tests.support import scenes

pytestmark = pytest.mark.thorough  # compiles specialised kernels for each group
PROGRAMS = ("programs", "world_program", "lamp_program", "volume_program")
SAMPLES = 2
# Features that have no general kernels, and why; tests/core/ahead/outside_general.py has a scene of each reason
NOT_GENERAL = {
    "Light Path: Portal Depth": "few graphs ask for it",
    "World: transparent to the camera through glass": "Transparent Glass: few films have it",
    "Curves: Principled Hair by Huang, round": "its closure is as long as many others together",
    "Curves: Principled Hair by Huang, elliptical ribbons": "the same",
}
# of fibres and of displacement: tests/core/ahead/test_tiers.py renders these
OPS_ELSEWHERE = {"hair_reflection", "hair_transmission", "vertex_offset"}


class Exported(NamedTuple):
    """What a render of a feature would begin with."""

    name: str
    scene: Scene
    settings: RenderSettings
    features: SceneFeatures


class NotRenderedError(RayBatchError):
    """Raised in the place of a render, whose scene is all that is wanted."""


@pytest.fixture
def exported(addon, monkeypatch):
    """A function that returns each scene of some features."""
    found: list[tuple[Scene, RenderSettings]] = []

    def note(_session, scene, settings=None, **_):
        found.append((scene, settings))
        raise NotRenderedError("not rendered")

    def of(features: list[Feature]) -> Iterator[Exported]:
        for name, scene in _scenes(features):
            found.clear()
            with monkeypatch.context() as patch:
                patch.setattr(Session, "render", note)
                with pytest.raises(RenderFailed):
                    by_raybatch(scene, 1, SAMPLES)
            ((core_scene, settings),) = found
            prepared = prepared_scene(core_scene, settings)
            yield Exported(name, core_scene, settings, derive_features(prepared, settings))

    return of


def _scenes(features: list[Feature]) -> Iterator[tuple[str, bpy.types.Scene]]:
    for some in sheets([each for each in features if each.kind == "node"]):
        yield f"sheet of {some[0].name} and {len(some) - 1} more", build_sheet(some)[0]
    for each in features:
        if each.kind == "picture":
            scene = empty_scene()
            set_alike(scene, each.resolution)
            each.build(scene)
            yield each.name, scene


def of_rare_ops() -> Exported:
    """A scene of the ops that programs of features do not have: closures that are constants there, and numbers."""
    builder = ProgramBuilder()
    place = builder.value("object_coordinates", 0)
    x, y, z = builder.value("separate_xyz", place)
    normal = builder.value("normals")[0]
    share = builder.value("forward_share", x, y)
    alpha = builder.value("math", 0, False, builder.value("roughness_of_alpha", share), 0.1, 0.0)
    index = builder.value("math", 0, False, builder.value("specular_index", 1.4, z), 0.1, 0.0)
    aspect = builder.value(
        "math", 2, False, *(builder.value(f"{each}_aspect", y) for each in ("glossy", "principled")), 0.0
    )
    sides = builder.value("math", 0, False, builder.value("truncate", x), 5.0, 0.0)
    tile = builder.value("radial_tiling", False, place, sides, 0.2)
    across = builder.value("curve_tangent_normal")
    bright = builder.value("math", 0, False, builder.value("is_positive", z), 0.2, 0.0)
    weight = builder.value("combine_xyz", bright, builder.value("math", 4, False, bright, 0.3, 0.0), 0.1)
    builder.closure("ashikhmin_shirley", weight, alpha, aspect, place, normal)
    builder.closure("conductor", weight, (0.2, 0.9, 1.1), (3.9, 2.4, 2.1), 0, alpha, 1.0, across, normal, 0.0, 1.3)
    builder.closure("refraction", weight, 0, alpha, index, normal)
    builder.closure("toon", weight, 0, share, 0.2, normal)
    builder.closure("translucent", weight, normal)
    builder.closure("velvet", weight, alpha, normal)
    builder.closure("holdout", weight)
    builder.closure("aov", tile[0], 0)
    kinds = (K.ASHIKHMIN_SHIRLEY, K.CONDUCTOR, K.ANISOTROPIC, K.REFRACTION, K.TOON, K.TRANSLUCENT, K.VELVET, K.HOLDOUT)
    surface = Material("rare", kinds=(*kinds, K.OWN_NORMAL), program=builder.finish())
    objects = [
        (scenes.plane(size=4), scenes.translation(0, 0, -1), scenes.diffuse()),
        (scenes.sphere(), scenes.IDENTITY, surface),
    ]
    frame = Frame(32, 32, passes=("Combined", f"{AOV_COLOR}tile"), transparent=True)
    scene = scenes.scene(objects, frame=frame, lights=[scenes.area_light(3.0)], world=0.2)
    settings = RenderSettings(sample_count=SAMPLES)
    return Exported("rare ops", scene, settings, derive_features(scene, settings))


def _widened(group: list[SceneFeatures]) -> dict:
    """The closures and programs of all of a group."""

    def joined(programs: list[ProgramFeatures]) -> ProgramFeatures:
        most = {
            field.name: max(getattr(each, field.name) for each in programs)
            for field in dataclasses.fields(ProgramFeatures)
        }
        return ProgramFeatures(**{**most, "ops": tuple(sorted(set().union(*(each.ops for each in programs))))})

    return {
        "closures": tuple(sorted(set().union(*(each.closures for each in group)))),
        "closure_count": max(each.closure_count for each in group),
        **{name: joined([getattr(each, name) for each in group]) for name in PROGRAMS},
    }


def _kind(features: SceneFeatures) -> SceneFeatures:
    """`features` without what differs within a group."""
    lacks = {name: ProgramFeatures(("some",)) if getattr(features, name) else ProgramFeatures() for name in PROGRAMS}
    return replace(features, closures=(), closure_count=0, **lacks)


def assert_same_films(group: list[Exported], patch: pytest.MonkeyPatch) -> None:
    """By general kernels, and by those that are specialised on the whole group."""
    patch.delenv(VARIABLE, raising=False)
    wide = _widened([each.features for each in group])
    patch.setattr(
        session_module, "derive_features", lambda scene, settings: replace(derive_features(scene, settings), **wide)
    )
    session = Session("cpu")
    for each in group:
        films = [
            session.render(each.scene, each.settings.replace(kernel_tier=tier, sample_count=SAMPLES))
            for tier in ("GENERAL", "SPECIALISED")
        ]
        assert [film.statistics["kernels"]["tier"] for film in films] == ["GENERAL", "SPECIALISED"]
        general, specialised = (film.passes for film in films)
        assert general.keys() == specialised.keys()
        for name, values in specialised.items():
            assert np.array_equal(general[name], values, equal_nan=True), f"{each.name}: {name}"
    session.close()


@pytest.mark.parametrize("family", FAMILIES)
def test_features_give_the_same_film_by_both_tiers(family, exported, monkeypatch):
    device = wp.get_device("cpu")
    groups: dict[SceneFeatures, list[Exported]] = defaultdict(list)
    for each in exported(chosen_features([family])):
        if not why_not_general(each.features, device):
            groups[_kind(each.features)].append(each)
    assert groups
    for group in groups.values():
        assert_same_films(group, monkeypatch)


def test_ops_that_features_lack_give_the_same_film_by_both_tiers(monkeypatch):
    rare = of_rare_ops()
    assert not why_not_general(rare.features, wp.get_device("cpu"))
    assert_same_films([rare], monkeypatch)


def test_features_are_those_of_general_kernels(exported):
    """None that is not named is left out above, and features have every op, closure and light of general kernels."""
    device = wp.get_device("cpu")
    most = general_features(device)
    every = list(exported(chosen_features()))
    reasons = {each.name: why for each in every if (why := why_not_general(each.features, device))}
    assert reasons.keys() == NOT_GENERAL.keys(), reasons
    found = [of_rare_ops().features, *(each.features for each in every)]
    ops = set().union(*(getattr(each, name).ops for each in found for name in PROGRAMS))
    assert sorted(set(most.programs.ops) - ops) == sorted(OPS_ELSEWHERE)
    assert set(most.closures) - {K.HAIR_REFLECTION, K.HAIR_TRANSMISSION} <= set().union(
        *(each.closures for each in found)
    )
    assert set(most.lights) <= set().union(*(each.lights for each in found))
