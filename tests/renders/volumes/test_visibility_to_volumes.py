"""Objects, lamps and worlds that rays scattered by volumes do not see, or that these rays alone see."""

import dataclasses

import numpy as np
import pytest

from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.description import Frame, Scene, Visibility, World
from tests.renders.volumes.test_volumes import filled, medium, picture, varying
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels")

UNSEEN = int(Visibility.ALL & ~Visibility.CAMERA & ~Visibility.VOLUME_SCATTER)
SEEN = int(Visibility.ALL & ~Visibility.CAMERA)
ALONE = int(Visibility.VOLUME_SCATTER | Visibility.SHADOW)
DOWN = np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 2.0]], np.float32)
LIGHTS = ("object", "lamp", "sun", "world", "world of a program")


def program_world(radiance: float, visibility: int) -> World:
    builder = ProgramBuilder()
    builder.closure("emission", builder.value("splat", builder.value("math", 0, False, radiance, 0.0, 0.0)))
    return World((0.0, 0.0, 0.0), visibility, builder.finish(), sampling_size=64)


def lit_by(kind: str, visibility: int, content, material) -> Scene:
    """A box with `material`, and above it a light of `kind` that rays see by `visibility`."""
    view = scenes.camera(eye=(0, -4, 0.5), half_width=0.2)
    things = [(content, scenes.IDENTITY, material)]
    lights = []
    if kind == "object":
        things.append((scenes.plane("lamp", 2.0), DOWN, scenes.emitter(3.0), visibility))
    if kind == "lamp":
        lights = [dataclasses.replace(scenes.area_light(3.0, 2.0, scenes.translation(0, 0, 2)), visibility=visibility)]
    if kind == "sun":
        lights = [dataclasses.replace(scenes.sun(1.0, angle=0.3), visibility=visibility)]
    made = scenes.scene(things, frame=Frame(8, 8), view=view, lights=lights)
    if kind == "world":
        made = dataclasses.replace(made, world=World((1.0, 1.0, 1.0), visibility))
    if kind == "world of a program":
        made = dataclasses.replace(made, world=program_world(1.0, visibility))
    return made


def means(session, scene, nee: str, runs: int = 4) -> np.ndarray:
    few = dict(sample_count=64, bounce_max=8, nee=nee)
    return np.array([picture(session, scene, seed=seed, **few).mean() for seed in range(runs)])


@pytest.mark.parametrize("nee", ["ON", "OFF"])
@pytest.mark.parametrize("kind", LIGHTS)
@pytest.mark.parametrize("volume", [medium(scattering=1.0), varying(scattering=1.0)], ids=["constant", "varying"])
def test_light_that_volumes_do_not_see_does_not_shine_into_them(session, volume, kind, nee):
    def found(visibility):
        return means(session, lit_by(kind, visibility, scenes.box(), filled(volume)), nee)

    whole, alone = found(SEEN), found(ALONE)
    assert whole.mean() > 0.02
    assert (found(UNSEEN) == 0.0).all()
    error = np.sqrt((whole.var(ddof=1) + alone.var(ddof=1)) / len(whole))
    assert abs(whole.mean() - alone.mean()) < 4 * error + 1e-3 * whole.mean()


@pytest.mark.parametrize("nee", ["ON", "OFF"])
@pytest.mark.parametrize("kind", LIGHTS)
def test_light_that_volumes_alone_see_does_not_shine_on_surfaces(session, kind, nee):
    """Also where there is a volume, elsewhere."""
    beside = scenes.box("beside", 1.0), scenes.translation(9, 0, 0), filled(medium(scattering=1.0))
    plane = scenes.plane("floor", 4.0)

    def found(visibility):
        made = lit_by(kind, visibility, plane, scenes.diffuse(0.8))
        apart = scenes.scene([beside])
        return means(session, joined(made, apart), nee)

    assert (found(ALONE) == 0.0).all()
    np.testing.assert_allclose(found(UNSEEN).mean(), found(SEEN).mean(), rtol=0.02)


def joined(first: Scene, second: Scene) -> Scene:
    """The objects of both, with all else of the first."""
    a, b = first.instances, second.instances
    instances = dataclasses.replace(
        a,
        mesh=np.concatenate([a.mesh, b.mesh + len(first.meshes)]).astype(a.mesh.dtype),
        transform=np.concatenate([a.transform, b.transform]),
        slot_first=np.concatenate([a.slot_first, b.slot_first + len(first.slot_materials)]).astype(a.slot_first.dtype),
        visibility=np.concatenate([a.visibility, b.visibility]),
        object=np.concatenate([a.object, b.object]),
    )
    slots = np.concatenate([first.slot_materials, second.slot_materials + len(first.materials)])
    return dataclasses.replace(
        first,
        instances=instances,
        meshes=(*first.meshes, *second.meshes),
        materials=(*first.materials, *second.materials),
        slot_materials=slots.astype(first.slot_materials.dtype),
    )


def test_an_object_that_volumes_do_not_see_hides_nothing_from_what_they_scatter(session):
    """A black lid between a volume and a bright ceiling: by rays alone the volume is as bright as without it."""

    def found(visibility):
        box = scenes.box(), scenes.IDENTITY, filled(medium(scattering=1.0))
        lid = scenes.plane("lid", 8.0), scenes.translation(0, 0, 1.5), scenes.diffuse(0.0), visibility
        ceiling = scenes.plane("ceiling", 8.0), DOWN, scenes.emitter(3.0), SEEN
        view = scenes.camera(eye=(0, -4, 0.5), half_width=0.2)
        return means(session, scenes.scene([box, lid, ceiling], frame=Frame(8, 8), view=view), "OFF").mean()

    covered, open_ = found(SEEN), found(UNSEEN)
    assert found(0) > 2 * covered
    np.testing.assert_allclose(open_, found(0), rtol=0.05)
