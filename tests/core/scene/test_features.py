"""A scene costs only its features: code, memory and uploads that it does not need are left out."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from raybatch_addon.core.bvh.build.scene_tree import layout_for
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.device.declared import declare_all
from raybatch_addon.core.device.devices import find_device
from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame, Light, LightKind, Visibility
from raybatch_addon.core.scene.features import SceneFeatures, derive_features
from raybatch_addon.core.scene.linking import catcher_bits
from raybatch_addon.core.scene.passes import CATCHER_PASS
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.kernels import StageKernels, tracing_kernels
from raybatch_addon.core.wavefront.plan.plan import Method, TracingPlan
from raybatch_addon.core.wavefront.plan.tracing import Tracing
from raybatch_addon.core.wavefront.rays import allocate_paths, bytes_per_path
from raybatch_addon.core.wavefront.scene.device_scene import DeviceScene
from raybatch_addon.core.wavefront.scene.geometry_request import GeometryRequest
from raybatch_addon.core.wavefront.scene.scene_cache import SceneCache
from tests.support import scenes

SETTINGS = RenderSettings()


def plain(**more):
    """A flat diffuse floor under a point light."""
    light = Light("point", LightKind.POINT, scenes.translation(0, 0, 2), (1.0,) * 3)
    given = dict(lights=[light], frame=Frame(8, 8)) | more
    return scenes.scene([(scenes.plane(), scenes.IDENTITY, scenes.diffuse())], **given)


def with_material(kind):
    return scenes.scene(
        [(scenes.plane(), scenes.IDENTITY, scenes.material(Closure(kind, (0.5, 0.5, 0.5), roughness=0.5)))],
        lights=plain().lights,
        frame=Frame(8, 8),
    )


def source(features: SceneFeatures) -> str:
    """All code that is compiled for `features`."""
    text = []
    tracing = tracing_kernels(
        features, SETTINGS, Tracing(Layout.QUANTISED, Method.UNBATCHED, features.instancing), find_device("cpu")
    )
    for kernel in StageKernels.choose(features, find_device("cpu")).all() + tracing:
        declare_all(kernel.module)
        builder = __import__("warp")._src.context.ModuleBuilder(
            kernel.module, {**kernel.module.options, "block_dim": 1, "mode": "release"}
        )
        text.append(builder.codegen("cpu"))
    return "\n".join(text)


def with_light(kind, **more):
    return plain(lights=[dataclasses.replace(plain().lights[0], kind=kind, **more)])


# feature -> (a scene that has it, a word that only its code has)
CODE = {
    "metal": (with_material(ClosureKind.METAL), "ggx_distribution"),
    "glossy": (with_material(ClosureKind.GLOSSY), "ggx_visible"),
    "glass": (with_material(ClosureKind.GLASS), "fresnel_dielectric"),
    "emission": (with_material(ClosureKind.EMISSION), "sample_triangle_light"),
    "transparency": (with_material(ClosureKind.TRANSPARENT), "connect_transparent"),
    "area light": (with_light(LightKind.RECTANGLE), "sample_area_light"),
    "sun": (with_light(LightKind.SUN, angle=0.1), "sample_sun"),
    "spot": (with_light(LightKind.SPOT, angle=1.0), "spot_attenuation"),
    "light that rays meet": (with_light(LightKind.POINT, radius=0.1), "light_hits"),
    "depth of field": (plain(view=scenes.camera(lens_radius=0.1)), "lens_point"),
    "instancing": (
        (
            lambda m: scenes.scene(
                [(m, scenes.IDENTITY, scenes.diffuse()), (m, scenes.translation(3, 0, 0), scenes.diffuse())]
            )
        )(scenes.plane()),
        "#define TWO_LEVEL 1",
    ),
    "hidden objects": (
        scenes.scene([(scenes.plane(), scenes.IDENTITY, scenes.diffuse(), Visibility.CAMERA)]),
        "#define TWO_LEVEL 1",
    ),
    "shadow catchers": (
        scenes.scene(
            [(scenes.plane(), scenes.IDENTITY, scenes.diffuse(), Visibility.ALL | catcher_bits(int(Visibility.ALL)))],
            frame=Frame(8, 8, passes=("Combined", CATCHER_PASS)),
        ),
        "lives_kernel",
    ),
    "transparent film through glass": (
        dataclasses.replace(with_material(ClosureKind.GLASS), frame=Frame(8, 8, transparent=True, glass_roughness=0.1)),
        "note_clear",
    ),
    "smooth normals": (
        scenes.scene([(scenes.sphere(smooth=True), scenes.IDENTITY, scenes.diffuse())]),
        "corner_normals[",
    ),
}


@pytest.fixture(scope="module")
def plain_source():
    return source(derive_features(plain(), SETTINGS))


@pytest.mark.parametrize("feature", CODE)
def test_code_of_a_feature_is_compiled_only_for_scenes_that_have_it(feature, plain_source):
    scene, word = CODE[feature]
    assert word not in plain_source
    assert word in source(derive_features(scene, SETTINGS))


def test_a_scene_without_surfaces_compiles_no_surface_code():
    empty = source(derive_features(scenes.scene(world=1.0), SETTINGS))
    for word in ("ShearedRay", "connect", "bsdf", "surface_point"):
        assert word not in empty


def test_settings_that_are_off_compile_nothing(plain_source):
    features = derive_features(plain(), SETTINGS)
    assert "clamped" not in plain_source and "clamped" in source(dataclasses.replace(features, clamping=True))
    assert "connect_light" in plain_source and "connect_light" not in source(dataclasses.replace(features, nee="OFF"))


def test_arrays_of_a_feature_are_allocated_only_for_scenes_that_have_it(device):
    where = find_device(device)
    base = SceneFeatures(surfaces=True, closures=(ClosureKind.DIFFUSE,))
    lean = allocate_paths(4, base, where)
    for field in ("shadow_light", "passed", "passed_t", "alpha", "clear", "normal"):
        assert getattr(lean, field).size == 0, field
    full = allocate_paths(
        4,
        dataclasses.replace(
            base,
            lights=(LightKind.POINT,),
            closures=(ClosureKind.DIFFUSE, ClosureKind.TRANSPARENT),
            film_transparent=True,
            film_glass=True,
            passes=("Combined", "Normal"),
        ),
        where,
    )
    assert all(
        getattr(full, field).size for field in ("shadow_light", "passed", "passed_t", "alpha", "clear", "normal")
    )
    assert bytes_per_path(base) < bytes_per_path(dataclasses.replace(base, lights=(LightKind.POINT,)))


def test_a_flat_scene_of_one_material_uploads_no_normals_and_no_slots(device):
    scene = plain()
    where = find_device(device)
    features = derive_features(scene, SETTINGS)
    request = GeometryRequest(
        settings=SETTINGS,
        plan=TracingPlan(Method.UNBATCHED),
        layout=layout_for(where),
        instancing=features.instancing,
        page_folder=Path("unused"),
    )
    built = DeviceScene.build(scene, features, request, where, SceneCache())
    assert built.data.geometry.corner_normals.size == 0 and built.data.geometry.triangle_slot.size == 0
    assert built.tree.top_entry.size == 0


def test_features_that_are_left_out_are_named():
    left_out = derive_features(plain(), SETTINGS).left_out()
    assert {
        "closure glass",
        "instancing",
        "depth of field",
        "world",
        "mesh lights",
        "smooth normals",
        "light sun",
    } <= set(left_out)
    assert not {"closure diffuse", "light point", "surfaces", "shadow rays"} & set(left_out)


def test_films_that_show_through_glass_need_glass():
    frame = Frame(4, 4, transparent=True, glass_roughness=0.1)
    for kind, expected in ((ClosureKind.DIFFUSE, False), (ClosureKind.GLASS, True), (ClosureKind.REFRACTION, True)):
        scene = scenes.scene(
            [(scenes.plane(), scenes.IDENTITY, scenes.material(Closure(kind, (1.0,) * 3)))], frame=frame
        )
        assert derive_features(scene, RenderSettings()).film_glass == expected


def test_kinds_count_by_node_and_not_by_value():
    """A slider at 0 leaves the kind among the features, so that moving it compiles nothing."""
    surface = scenes.material(Closure(ClosureKind.DIFFUSE, (1, 1, 1)), kinds=(ClosureKind.DIFFUSE, ClosureKind.GLASS))
    features = derive_features(scenes.scene([(scenes.plane(), scenes.IDENTITY, surface)]), SETTINGS)
    assert features.closures == (ClosureKind.DIFFUSE, ClosureKind.GLASS)


def test_lights_of_a_kind_without_a_rule_are_refused():
    with pytest.raises(ValueError, match="no rule for whether rays meet lights of kind 99"):
        derive_features(with_light(99), SETTINGS)


def test_a_render_without_surfaces_shows_the_world(session):
    picture = session.render(
        scenes.scene(world=(0.2, 0.4, 0.6), frame=Frame(8, 8)), RenderSettings(sample_count=3)
    ).passes["Combined"]
    assert np.allclose(picture, [0.2, 0.4, 0.6, 1.0], rtol=1e-6)
