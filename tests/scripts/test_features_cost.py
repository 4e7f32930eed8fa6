"""A scene pays for nothing that it does not have: what its kernels hold, and what its statistics list as left out."""

from dataclasses import replace

import pytest
from features_cost import every_feature, functions_of, plain_scene

from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.settings.settings import RenderSettings

# Where the code of features lies that a matt ball under a sun has not
NOT_NEEDED = (
    "programs.ops.",
    "shading.bsdf.facets",
    "shading.bsdf.fresnel",
    "shading.bsdf.albedo",
    "shading.images.textures",
    "shading.bsdf.ggx",
    "shading.bsdf.thin_film",
    "shading.bsdf.sheen",
    "shading.bsdf.beckmann",
    "shading.bsdf.ashikhmin_shirley",
    "shading.lights.emitters",
    "wavefront.estimates",
    "wavefront.stages.emitted",
)
LEFT_OUT = (
    "closure glass",
    "closure thin_film",
    "image textures",
    "sampling of the world",
    "shader programs",
    "smooth normals",
    "world program",
)


def test_modules_of_a_plain_scene_hold_no_code_of_other_features():
    features = derive_features(plain_scene(), RenderSettings())
    held = set().union(*functions_of(features, "cpu").values())
    assert "shading.camera.camera_ray" in held
    assert [name for name in sorted(held) if name.startswith(NOT_NEEDED)] == []
    assert set(LEFT_OUT) <= set(features.left_out())


@pytest.mark.thorough  # compiles everything there is for one scene
def test_kernels_can_have_all_features_at_once():
    """Source is made of them, and not compiled: that takes minutes. With instances, general kernels have them all."""
    every = every_feature(derive_features(plain_scene(), RenderSettings()))
    every = replace(every, film_transparent=True, clamping=True, depth_of_field=True, instancing=False)
    held = set().union(*functions_of(every, "cpu").values())
    assert {"programs.ops.textures.noise.signed_noise_3d", "wavefront.stages.connect.arrived"} & held
