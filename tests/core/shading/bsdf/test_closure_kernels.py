"""Closures as they are compiled: extremes stay finite, one kind alone gives the same numbers, nothing more is there."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.errors import SceneError
from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.description import Closure, Material
from raybatch_addon.core.scene.program import Instruction
from raybatch_addon.core.shading.bsdf.bsdf import ClosureFeatures, upload_materials
from tests.core.shading.bsdf.closure_probe import (
    EVERYTHING,
    ROUGH,
    SMOOTH,
    WHITE,
    K,
    evaluate,
    frame_of,
    kernels,
    sample,
    table_of,
    toward,
)
from tests.support.running.shares import each_of
from tests.support.under_test import BLOCK_DIM, DEVICE, SOURCE_SUFFIX


def test_extremes_stay_finite():
    """Grazing and degenerate directions, every roughness and index: finite, never negative, bounded energy."""
    normal_ish = [toward(c, a) for c in (1.0, 0.5, 1e-3, 1e-7, 0.0) for a in (0.0, 2.0)]
    wis = np.array(normal_ish + [-d for d in normal_ish] + [[-d[0], -d[1], d[2]] for d in normal_ish])
    corner = np.array(list(itertools.product((0.0, 0.5, 1 - 2.0**-24), repeat=3)), np.float32)
    kinds = [k for k in EVERYTHING.kinds if k.is_model and k not in (K.EMISSION, K.TRANSPARENT)]
    for kind, roughness in itertools.product(kinds, (0.0, SMOOTH, 1.12 * SMOOTH, 0.1, 1.0)):
        refracts = kind in (K.GLASS, K.DIELECTRIC, K.LAYERED_DIFFUSE, K.REFRACTION)
        # velvet of the least sigma is 1e4 / pi times as bright as its mean along the surface, and its samples are
        # uniform; grooves that are lit and seen along the surface have a BSDF of one over the cosine
        largest = 2e4 if kind in (K.VELVET, K.ROUGH_DIFFUSE) else 200
        for ior in (0.0, 0.5, 1.0, 1.0 + 1e-6, 1.0005, 1.5, 1e9) if refracts else (1.5,):
            closures = [Closure(kind, WHITE, roughness, ior)]
            for wo, entering in itertools.product(normal_ish, (0, 1)):
                frame = frame_of(entering=entering)
                value, pdf = evaluate(closures, wo, wis, frame)
                assert np.isfinite(value).all() and np.isfinite(pdf).all() and (value >= 0).all() and (pdf >= 0).all()
                direction, weight, pdf, lobe = sample(closures, wo, 0, frame, u=corner)
                assert np.isfinite(direction).all() and np.isfinite(weight).all() and np.isfinite(pdf).all()
                assert (weight >= 0).all() and (weight < largest).all()
                np.testing.assert_allclose(np.linalg.norm(direction[lobe != 0], axis=1), 1, atol=1e-5)


@pytest.mark.parametrize(
    "kind", each_of(4, [((k,),) for k in EVERYTHING.kinds if k.is_model and k != K.EMISSION] + [((),)]), ids=str
)
def test_a_module_for_one_kind_gives_the_same_numbers(kind):
    """Kinds that a module is compiled for besides a material's change none of its samples."""
    closures = tuple(Closure(k, (0.5, 0.7, 0.9), 0.4, 1.5) for k in kind)
    needs = tuple(sorted({need for closure in closures for need in closure.needs}))
    narrow = sample(closures, toward(0.4), 256, features=ClosureFeatures(needs))
    for a, b in zip(narrow, sample(closures, toward(0.4), 256), strict=True):
        np.testing.assert_array_equal(a, b)


def source_of(features):
    """Generated C++ of the sampling and evaluation kernels."""
    sample((), toward(0.5), 1, features=features)
    evaluate((), toward(0.5), toward(0.5), features=features)
    loaded = kernels(features)
    folders = [
        Path(wp.config.kernel_cache_dir) / kernel.module.get_module_identifier(block_dim=BLOCK_DIM)
        for kernel in (loaded.evaluate, loaded.sample)
    ]
    return "\n".join(path.read_text() for folder in folders for path in folder.glob(f"*.{SOURCE_SUFFIX}"))


def test_only_what_is_needed_is_compiled_and_allocated():
    """A diffuse material's module holds no function of facets, and its table no albedos of them."""
    source, everything = source_of(ClosureFeatures((K.DIFFUSE,))), source_of(EVERYTHING)
    assert "sample_cosine_hemisphere" in source
    names = (
        "ggx_",
        "fresnel_dielectric",
        "fresnel_f82",
        "visible_normal",
        "_albedo_",
        "facet_normal",
        "refracted",
        "beckmann",
        "phong",
        "velvet_bsdf_0",
        "sheen_lobe_0",
        "rough_diffuse",
        "fresnel_conductor",
        "film_on",
    )
    for name in (*names, "reflected"):
        assert name not in source and name in everything, name
    table = table_of(Closure(K.DIFFUSE, WHITE), features=ClosureFeatures((K.DIFFUSE,)))
    for array in (table.albedo.reflection, table.albedo.coat, table.albedo.glass):
        assert array.size == 0
    glossy = table_of(Closure(K.GLOSSY, WHITE, 0.3), features=ClosureFeatures((K.GLOSSY,)))
    assert glossy.albedo.reflection.size > 0 and glossy.albedo.coat.size == 0 and glossy.albedo.glass.size == 0


def test_bad_materials_are_named():
    for closure in (
        Closure(K.DIFFUSE, (np.nan, 0, 0)),
        Closure(K.DIFFUSE, (-1.0, 0, 0)),
        Closure(K.GLASS, WHITE, np.inf),
    ):
        with pytest.raises(SceneError, match="Marble"):
            upload_materials([Material("Marble", (closure,))], EVERYTHING, DEVICE)
    with pytest.raises(ValueError, match="GLASS"):
        upload_materials([Material("Marble", (Closure(K.GLASS, WHITE),))], ClosureFeatures((K.DIFFUSE,)), DEVICE)


def test_materials_say_whether_light_may_pass_straight_on():
    """Shadow rays thereby end at the other materials without a look at what these are made of."""

    def made(*names):
        builder = ProgramBuilder()
        for name in names:
            builder.closure(name, WHITE)
        return Material("made", (), (), builder.finish())

    def with_op(name):
        material = made("emission")
        return replace(material, program=replace(material.program, instructions=(Instruction(name, ()),)))

    clear, opaque = Closure(K.TRANSPARENT, WHITE), Closure(K.DIFFUSE, WHITE)
    materials = [Material("", (opaque,)), Material("", (opaque, clear)), Material("", ())]
    materials += [made("emission", "transparent"), made("emission"), *map(with_op, ("sheet", "facet_hair", "diffuse"))]
    table = upload_materials(materials, EVERYTHING, DEVICE)
    assert table.records.numpy()["is_clear"].tolist() == [0, 1, 0, 1, 0, 1, 1, 0]
    table = upload_materials([replace(each, shadow_opaque=True) for each in materials], EVERYTHING, DEVICE)
    assert not table.records.numpy()["is_clear"].any()


@pytest.mark.skipif(not wp.is_cuda_available(), reason="no CUDA device")
@pytest.mark.parametrize("name", ROUGH)
def test_cuda_agrees_with_the_cpu(name):
    """The same samples to rounding: only sines and cosines differ between the devices."""
    host, device = (sample(ROUGH[name], toward(0.5), 4096, device=d) for d in (DEVICE, "cuda:0"))
    assert np.mean(host[3] != device[3]) < 1e-3
    same = host[3] == device[3]
    for a, b, tolerance in zip(host[:3], device[:3], (1e-5, 1e-3, 1e-2), strict=True):
        np.testing.assert_allclose(a[same], b[same], rtol=tolerance, atol=1e-5)
