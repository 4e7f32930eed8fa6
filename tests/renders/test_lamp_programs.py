"""Lights without mesh whose radiance comes from programs."""

import dataclasses

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import specialised_out_of_line
from raybatch_addon.core.errors import SceneError
from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.ops.values.math import MathOperation
from raybatch_addon.core.scene.archive import load_scene, save_scene
from raybatch_addon.core.scene.description import Frame, Instruction, Light, LightKind, Program, Scene, Visibility
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.scene.geometry import Geometry
from raybatch_addon.core.scene.validate import checked_scene
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.shading.images.textures import ImageTable
from raybatch_addon.core.shading.lights.lamp_program import upload_lamp_programs
from raybatch_addon.core.shading.lights.table import upload_lights
from raybatch_addon.core.wavefront.estimates.launch import brightness_of_lamps
from raybatch_addon.core.wavefront.kernels import StageKernels
from raybatch_addon.core.wavefront.scene.shading_data import SceneData
from raybatch_addon.core.wavefront.stages.connect import make_connect
from raybatch_addon.core.wavefront.stages.stage import stage_kernel
from raybatch_addon.core.wavefront.stages.work import ShadingStage
from tests.stability.bench import WAITING, rays_wait
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels")
SETTINGS = RenderSettings(sample_count=4, bounce_max=3)


def program(build=lambda builder: (1.0, 1.0, 1.0)) -> Program:
    """One emission of what `build(builder)` returns."""
    builder = ProgramBuilder()
    builder.closure("emission", build(builder))
    return builder.finish()


def computed(builder: ProgramBuilder, operation: MathOperation, a, b):
    return builder.value("math", int(operation), 0, a, b, 0.0)


def grey(builder: ProgramBuilder, number):
    return builder.value("combine_xyz", number, number, number)


def by_programs(scene: Scene, factor: float = 2.0) -> Scene:
    """`scene` with programs that multiply the light of its lamps by `factor`, and lamps of so much less."""
    lights = tuple(
        dataclasses.replace(
            light, emission=tuple(c / factor for c in light.emission), program=program(lambda builder: (factor,) * 3)
        )
        for light in scene.lights
    )
    return dataclasses.replace(scene, lights=lights)


def every_lamp(**change) -> Scene:
    """Balls, glass and a veil under lights of all kinds and shapes, which rays meet."""
    above = scenes.translation(0.4, 0.2, 2)
    spot = Light("spot", LightKind.SPOT, above, (3.0, 2.0, 1.0), radius=0.2, angle=1.2, blend=0.3, soft_falloff=False)
    ellipse = Light(
        "ellipse", LightKind.ELLIPSE, scenes.translation(-1, 0, 2.5), (2.0,) * 3, size=(0.5, 0.9), spread=2.0
    )
    hidden = dataclasses.replace(
        ellipse, name="hidden", transform=scenes.translation(0, 1, 2), visibility=int(Visibility.DIFFUSE)
    )
    free = dataclasses.replace(spot, name="free", radius=0.0, casts_shadow=False)
    mixed = scenes.mixed(Frame(12, 10))
    return dataclasses.replace(mixed, lights=(*mixed.lights, spot, ellipse, hidden, free), **change)


def picture(session, scene: Scene, settings: RenderSettings = SETTINGS) -> np.ndarray:
    film = session.render(scene, settings)
    assert film.statistics["invalid_samples"] == 0
    return film.passes["Combined"][..., :3]


def test_a_program_that_gives_a_constant_is_that_constant(session):
    plain, programs = picture(session, every_lamp()), picture(session, by_programs(every_lamp()))
    np.testing.assert_allclose(programs, plain, rtol=2e-4, atol=1e-6)


def test_films_of_all_schedules_are_the_same(session):
    def varied(builder):
        return builder.value("parametric", 0)

    scene = every_lamp()
    scene = dataclasses.replace(
        scene, lights=tuple(dataclasses.replace(light, program=program(varied)) for light in scene.lights)
    )
    alone = picture(session, scene)
    assert alone.max() > 0
    with rays_wait():
        waiting = picture(session, scene, SETTINGS.replace(**WAITING))
    assert waiting.tobytes() == alone.tobytes()
    assert picture(session, scene, SETTINGS.replace(ray_count=64, tile_size=8)).tobytes() == alone.tobytes()


def test_light_that_is_met_and_light_that_is_aimed_at_agree(session):
    def by_place(builder):
        return builder.value("parametric", 0)

    lit = dict(emission=(4.0,) * 3, program=program(by_place))
    lamps = [
        Light("ball", LightKind.POINT, scenes.translation(0, 0.5, 1.2), radius=0.5, soft_falloff=False, **lit),
        Light("panel", LightKind.RECTANGLE, scenes.translation(0, -0.5, 1.0), size=(1.0, 0.6), **lit),
    ]
    view = scenes.camera(eye=(0, -2, 2), half_width=0.3)
    scene = scenes.scene(
        [(scenes.plane(size=6), scenes.IDENTITY, scenes.diffuse())], view=view, frame=Frame(8, 8), lights=lamps
    )
    settings = RenderSettings(sample_count=1024, bounce_max=1)
    means = [
        picture(session, scene, settings.replace(**change)).mean((0, 1))
        for change in ({}, {"nee": "OFF"}, {"mis": "OFF"})
    ]
    np.testing.assert_allclose(means[1], means[0], rtol=0.02)
    np.testing.assert_allclose(means[2], means[0], rtol=0.02)


@pytest.mark.parametrize("output, power", ((0, 0), (1, 1), (2, 2)))
def test_falloff_changes_how_light_fades(session, output, power):
    def falloff(builder):
        return grey(builder, builder.value("light_falloff", 3.0, 0.0)[output])

    lamp = Light("lamp", LightKind.POINT, scenes.translation(0.3, 0.2, 0.8), (1.0, 2.0, 3.0), program=program(falloff))
    view = scenes.camera(eye=(0, 0, 5), half_width=0.2, up=(0, 1, 0))
    floor = (scenes.plane(size=6), scenes.IDENTITY, scenes.diffuse(1.0))
    scene = scenes.scene([floor], view=view, frame=Frame(16, 16, passes=("Combined", "Position")), lights=[lamp])
    film = session.render(scene, RenderSettings(sample_count=1, bounce_max=0))
    place = film.passes["Position"].astype(float)
    offset = np.array([0.3, 0.2, 0.8]) - place
    distance = np.linalg.norm(offset, axis=-1)
    expected = 3.0 / np.pi * offset[..., 2] / distance**3 * distance**power
    np.testing.assert_allclose(film.passes["Combined"][..., :3], expected[..., None] * (1.0, 2.0, 3.0), rtol=1e-4)


def test_light_that_is_no_number_is_none(session):
    def too_much(builder):
        distance = builder.value("light_path")[6]
        large = computed(builder, MathOperation.MULTIPLY, distance, 1e30)
        huge = computed(builder, MathOperation.MULTIPLY, large, large)
        none = computed(builder, MathOperation.SUBTRACT, huge, huge)
        return builder.value("combine_xyz", huge, none, computed(builder, MathOperation.MULTIPLY, distance, -1.0))

    scene = every_lamp()
    lights = tuple(dataclasses.replace(light, program=program(too_much)) for light in scene.lights)
    assert np.isfinite(picture(session, dataclasses.replace(scene, lights=lights))).all()


def test_saved_scenes_keep_programs(session, tmp_path):
    matrix = scenes.translation(1, 2, 3, 2.0)
    scene = by_programs(every_lamp())
    lamp = dataclasses.replace(scene.lights[0], object_transform=matrix, info=(0.1, 0.2, 0.3, 1.0, 4.0, 0.5))
    scene = dataclasses.replace(scene, lights=(lamp, *scene.lights[1:]))
    save_scene(tmp_path / "scene.npz", scene, SETTINGS)
    loaded, settings = load_scene(tmp_path / "scene.npz")
    assert loaded.lights[0].info == lamp.info and np.array_equal(loaded.lights[0].object_transform, matrix)
    assert loaded.lights[0].program.instructions == lamp.program.instructions
    assert picture(session, loaded, settings).tobytes() == picture(session, scene).tobytes()


def test_scenes_pay_for_programs_of_lamps_only_where_there_are_some():
    plain, programs = (derive_features(scene, SETTINGS) for scene in (every_lamp(), by_programs(every_lamp())))
    assert not plain.lamp_program and not plain.light_programs and "programs of lights" in plain.left_out()
    assert (
        programs.lamp_program.ops == ("emission",)
        and programs.light_programs
        and "programs of lights" not in programs.left_out()
    )
    changed = derive_features(by_programs(every_lamp(), 3.0), SETTINGS)
    assert changed == programs  # values compile nothing
    kernels, others = (StageKernels.choose(each, wp.get_device("cpu")).shading for each in (plain, programs))
    assert (
        kernels[ShadingStage.CONNECT]
        is stage_kernel(make_connect(False, False, False), ShadingStage.CONNECT, specialised_out_of_line())
        and kernels[ShadingStage.LIGHT_HITS] is not others[ShadingStage.LIGHT_HITS]
    )


def test_brightness_of_lamps():
    def edge(builder):  # lit in a fiftieth of a lamp's directions
        x = builder.value("separate_xyz", builder.value("normals")[2])[0]
        return grey(builder, computed(builder, MathOperation.GREATER_THAN, x, 0.96))

    def somewhere(builder):
        x = builder.value("separate_xyz", builder.value("normals")[2])[0]
        return grey(builder, computed(builder, MathOperation.GREATER_THAN, x, 0.999999))

    base = Light("lamp", LightKind.POINT, scenes.translation(0, 0, 1), (1.0,) * 3)
    programs = (
        None,
        program(lambda builder: (3.0, 3.0, 3.0)),
        program(edge),
        program(somewhere),
        program(lambda builder: (0.0, 0.0, 0.0)),
    )
    scene = scenes.scene(lights=[dataclasses.replace(base, program=each) for each in programs])
    device = wp.get_device("cpu")
    features = derive_features(scene, SETTINGS)
    data = SceneData()
    data.lamp_nodes = upload_lamp_programs(scene, features.lamp_program, Geometry(), ImageTable(), device)
    found = brightness_of_lamps(scene, data, features, device, upload_lights(scene, device).table)
    assert found[:2] == pytest.approx([1, 3], rel=1e-6)
    assert 0.005 < found[2] < 0.06 and found[3] > 0 and found[4] == 0


def test_what_cannot_be_used_is_reported():
    lamp = Light("Lampe", LightKind.POINT, scenes.translation(0, 0, 1), (1.0,) * 3, program=program())
    bad = np.full((3, 4), np.nan, np.float32)
    checked = checked_scene(scenes.scene(lights=[dataclasses.replace(lamp, object_transform=bad)]))
    assert not checked.lights and "Lampe" in checked.warnings[0]


@pytest.mark.parametrize("step", (Instruction("emission", (5,)), Instruction("emission", ())))
def test_a_program_that_is_not_valid_is_an_error(session, step):
    lamp = Light(
        "lamp",
        LightKind.POINT,
        scenes.translation(0, 0, 1),
        (1.0,) * 3,
        program=Program((step,), np.zeros(3, np.float32), 0, 1),
    )
    scene = scenes.scene([(scenes.plane(), scenes.IDENTITY, scenes.diffuse())], lights=[lamp])
    with pytest.raises(SceneError):
        session.render(scene, SETTINGS)
