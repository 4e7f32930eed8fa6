"""A live render: the newest scene is the one that is shown, and it rests when all samples are there."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from raybatch_addon.core.denoise.library import DenoiseStoppedError
from raybatch_addon.core.errors import DeviceError
from raybatch_addon.core.live.render import LiveRender
from raybatch_addon.core.scene.description import Frame
from tests.core.live.lending import SECONDS, Source, request, wait_for
from tests.support.scenes import camera


@pytest.fixture
def live(session):
    """(live render, its source, pictures in the order in which they were shown)."""
    source, shown = Source(session), []

    def note():
        if render.picture is not None and (not shown or shown[-1] is not render.picture):
            shown.append(render.picture)

    render = LiveRender(source, note)
    yield render, source, shown
    source.free.set()
    render.close()
    assert render.join(SECONDS)


def test_a_picture_grows_and_ends_as_the_session_renders_it(live, session):
    render, _, shown = live
    asked = request(1)
    render.show(asked)
    wait_for(lambda: render.is_idle)
    sides = [each.side for each in shown]
    assert sides[0] > 1 and sides[-1] == 1 and sides == sorted(sides, reverse=True)
    fine = [each.samples for each in shown if each.side == 1]
    assert fine == sorted(set(fine)) and fine[0] == 1 and fine[-1] == 8
    film = session.render(asked.scene, asked.settings)
    assert shown[-1].pixels.tobytes() == film.passes["Combined"].tobytes()
    assert render.state.samples == 8 and not render.state.stage and not render.state.error


@pytest.mark.usefixtures("cpu_compiler")  # the host builds trees that split triangles
@pytest.mark.parametrize("asked, used", [("AUTO", "OFF"), ("ON", "ON")])
def test_trees_split_no_triangles_unless_that_is_asked_for(live, session, monkeypatch, asked, used):
    render, _, _ = live
    seen, real = [], session.render
    monkeypatch.setattr(
        session, "render", lambda scene, settings, **k: seen.append(settings) or real(scene, settings, **k)
    )
    first = request(1)
    render.show(replace(first, settings=first.settings.replace(spatial_splits=asked)))
    wait_for(lambda: render.is_idle)
    assert seen and {each.spatial_splits for each in seen} == {used}


def test_what_is_dropped_is_shown_no_more(live):
    render, _, shown = live
    for number in (1, 2):
        render.show(request(number, samples=1_000_000))
        wait_for(lambda: shown and shown[-1].request.number == number)
        render.drop()
        assert render.picture is None and render.is_idle
        wait_for(lambda: render._kept is None and not render.state.stage)
        at = len(shown)
        time.sleep(0.1)
        assert render.picture is None and len(shown) == at
    render.show(request(3, samples=2))
    wait_for(lambda: render.is_idle)
    assert shown[-1].request.number == 3 and shown[-1].samples == 2


def test_it_rests_when_all_samples_are_there(live):
    render, source, _ = live
    render.show(request(1, samples=2))
    wait_for(lambda: render.is_idle)
    lent, before = source.lent, time.process_time()
    time.sleep(0.3)
    assert source.lent == lent and time.process_time() - before < 0.15


def test_the_newest_request_is_the_one_that_is_finished(live):
    render, _, shown = live
    render.show(request(1, samples=1_000_000))
    wait_for(lambda: shown)
    for number in range(2, 6):
        render.show(request(number, samples=1_000_000, camera=camera((0, -4 - number, 0))))
    render.show(request(6, samples=4, camera=camera((0, -9, 1))))
    wait_for(lambda: render.is_idle)
    assert shown[-1].request.number == 6 and shown[-1].samples == 4
    numbers = [each.request.number for each in shown]
    assert numbers == sorted(numbers)


def test_the_first_picture_comes_whatever_follows(live):
    """Who moves a slider all the time sees pictures all the time."""
    render, _, shown = live
    end, number = time.monotonic() + SECONDS, 0
    while len({each.request.number for each in shown}) < 5:
        assert time.monotonic() < end, "pictures wait for the edits to end"
        number += 1
        render.show(request(number, samples=1_000_000))
        time.sleep(0.01)


def test_who_goes_first_gets_the_session_and_the_picture_goes_on(live, session):
    render, source, shown = live
    asked = request(1, samples=300)
    render.show(asked)
    wait_for(lambda: shown and shown[-1].side == 1 and shown[-1].samples >= 4)
    source.free.clear()
    source.wanted = True
    wait_for(lambda: render._kept is not None)
    at = len(shown)
    wait_for(lambda: "Waiting" in render.state.stage)
    time.sleep(0.2)
    assert len(shown) == at, "it renders on"
    source.wanted = False
    source.free.set()
    wait_for(lambda: render.is_idle)
    assert all(each.side == 1 for each in shown[at:]), "it began anew"
    film = session.render(asked.scene, asked.settings)
    assert shown[-1].pixels.tobytes() == film.passes["Combined"].tobytes()


def test_pixels_may_be_larger_than_those_of_the_screen(live, session):
    render, _, shown = live
    render.show(request(1, samples=2, side=2, size=(47, 41)))
    wait_for(lambda: render.is_idle)
    assert shown[-1].side == 2 and shown[-1].pixels.shape == (21, 24, 4) and shown[-1].box == (0, 0, 48, 42)


def test_an_error_is_reported_and_the_next_scene_is_rendered(live):
    render, source, shown = live
    opened, source.opened = source.opened, None

    class Broken:
        def render(self, *_, **__):
            raise DeviceError("the device\nis gone")

    source.opened = Broken()
    render.show(request(1))
    wait_for(lambda: render.is_idle)
    assert render.state.error == "the device is gone" and not shown
    source.opened = opened
    render.show(request(2, samples=1))
    wait_for(lambda: render.is_idle)
    assert not render.state.error and shown[-1].request.number == 2


def test_a_fault_is_reported_and_ends_nothing(live):
    render, source, _ = live

    class Broken:
        def render(self, *_, **__):
            raise ZeroDivisionError("division by zero")

    source.opened = Broken()
    render.show(request(1))
    wait_for(lambda: render.is_idle)
    assert "ZeroDivisionError" in render.state.error


def test_closing_ends_it_while_it_waits_and_while_it_renders(session):
    for is_free in (True, False):
        source = Source(session)
        if not is_free:
            source.free.clear()
        render = LiveRender(source)
        render.show(request(1, samples=1_000_000))
        time.sleep(0.1)
        render.close()
        assert render.join(SECONDS)
        render.show(request(2))  # does nothing any more
        assert render.join(0.0)


class Halves:
    """In place of the denoiser's library: pictures are half as bright."""

    def filtered(self, images, _flags, _quality, _given_up):
        return images["color"] * np.float32(0.5)


class Slow(Halves):
    """It takes until it is given up, as long as it is held up."""

    def __init__(self):
        self.is_free, self.begun = threading.Event(), 0

    def filtered(self, images, flags, quality, given_up):
        self.begun += 1
        while not self.is_free.is_set():
            if given_up():
                raise DenoiseStoppedError("denoising was stopped")
            time.sleep(0.002)
        return super().filtered(images, flags, quality, given_up)


def test_pictures_at_powers_of_two_are_denoised(live, session):
    render, _, shown = live
    asked = request(1, samples=6)
    settings = asked.settings.replace(denoise="ON", denoise_inputs="NONE")
    render.show(replace(asked, settings=settings, denoiser=Halves()))
    wait_for(lambda: render.is_idle)
    fine = [each for each in shown if each.side == 1]
    assert [each.samples for each in fine] == [1, 1, 2, 4, 6]
    film = session.render(asked.scene, asked.settings)
    combined = film.passes["Combined"]
    assert np.array_equal(fine[-1].pixels[..., :3], combined[..., :3] * np.float32(0.5))
    assert np.array_equal(fine[-1].pixels[..., 3], combined[..., 3])


def test_a_denoiser_ends_for_who_goes_first_and_its_picture_comes_without_another_render(live, session):
    render, source, shown = live
    asked = request(1, samples=1)
    slow, settings = Slow(), asked.settings.replace(denoise="ON", denoise_inputs="NONE")
    render.show(replace(asked, settings=settings, denoiser=slow))
    wait_for(lambda: slow.begun)
    source.free.clear()
    source.wanted = True
    wait_for(lambda: "Waiting" in render.state.stage)
    assert not render.is_idle
    source.opened, slow.is_free = object(), source.free  # nothing can be rendered
    source.wanted = False
    source.free.set()
    wait_for(lambda: render.is_idle)
    assert not render.state.error and render.state.samples == 1
    combined = session.render(asked.scene, asked.settings).passes["Combined"]
    assert np.array_equal(shown[-1].pixels[..., :3], combined[..., :3] * np.float32(0.5))


def test_the_pace_is_that_of_pixels_alone(live, session):
    """Whatever a scene's displacement, tree and kernels took."""
    render, source, _ = live
    noted, reported = (
        [],
        {"displacement": 64.0, "build": 32.0, "compile": 16.0, "kernels": 8.0, "paths": 1.0, "render": 2.0},
    )

    class Clocked:
        def render(self, *arguments, **options):
            film = session.render(*arguments, **options)
            film.statistics["seconds"] = reported
            return film

    source.opened, render._pace.note = Clocked(), lambda samples, seconds: noted.append(seconds)
    render.show(request(1, samples=1))
    wait_for(lambda: render.is_idle)
    assert noted[0] == 3.0 and 0 < noted[-1] <= 3.0


def test_frames_with_a_border_are_shown_where_they_are(live):
    render, _, shown = live
    asked = request(1, samples=1)
    scene = replace(asked.scene, frame=Frame(48, 40, border=(8, 4, 24, 20)))
    render.show(replace(asked, scene=scene))
    wait_for(lambda: render.is_idle)
    assert shown[-1].box == (8, 4, 24, 20) and shown[-1].pixels.shape == (16, 16, 4)
    assert np.isfinite(shown[-1].pixels).all()
