"""What follows an edit in a live render: what is rendered ends at once, and the first picture is drawn undisturbed."""

import math
import time

import pytest

from raybatch_addon.core.live import render as live_module
from raybatch_addon.core.live.render import LiveRender
from raybatch_addon.core.observers import Cancel
from tests.core.live.lending import SECONDS, Source, request, wait_for


@pytest.fixture
def live(session):
    """(live render, its source, pictures at the times when somebody was told that there is something new)."""
    source, told = Source(session), []
    render = LiveRender(source, lambda: told.append(render.picture))
    yield render, source, told
    source.free.set()
    render.close()
    assert render.join(SECONDS)


@pytest.fixture
def ends(session, monkeypatch):
    """What each render was told that ended before its end, and whether another can go on from its film."""
    found, real = [], session.render

    def noted(scene, settings, *, cancelled, **options):
        told = []
        film = real(scene, settings, cancelled=lambda: told.append(cancelled()) or told[-1], **options)
        if not film.complete:
            found.append((next(each for each in told if each), film.resume_state is not None))
        return film

    monkeypatch.setattr(session, "render", noted)
    return found


def has_fine_picture(render, number):
    picture = render.picture
    return picture is not None and picture.request.number == number and picture.side == 1


def test_what_nobody_asks_for_any_more_ends_at_once(live, ends):
    render, _, _ = live
    render.show(request(1, samples=1_000_000))
    wait_for(lambda: has_fine_picture(render, 1))
    render.show(request(2, samples=2))
    wait_for(lambda: render.is_idle)
    assert [told for told, _ in ends] == [Cancel.AT_ONCE]


def test_what_makes_way_for_another_render_goes_on_later(live, ends):
    render, source, _ = live
    render.show(request(1, samples=1_000_000))
    wait_for(lambda: has_fine_picture(render, 1))
    source.free.clear()
    source.wanted = True
    wait_for(lambda: ends)
    assert ends == [(True, True)]


def test_the_first_picture_is_drawn_before_the_next_one_is_rendered(live, monkeypatch):
    monkeypatch.setattr(live_module, "REST_SECONDS", SECONDS)
    render, _, told = live
    render.show(request(1, samples=2))
    wait_for(lambda: render.is_idle)  # nobody has told of a draw: nothing waits for one
    render.note_drawn(render.picture)
    del told[:]
    monkeypatch.setattr(render._pace, "divisors", lambda _pixels: [4, 2, 1])  # however fast the device is
    render.show(request(2, samples=2))
    wait_for(lambda: render.picture.request.number == 2)
    first = render.picture
    time.sleep(0.1)
    assert first.side > 1 and render.picture is first and not render.is_idle
    render.note_drawn(first)
    wait_for(lambda: render.is_idle)
    assert render.picture.side == 1


def test_a_newer_edit_waits_for_no_draw(live, monkeypatch):
    monkeypatch.setattr(live_module, "REST_SECONDS", SECONDS)
    render, _, _ = live
    render.show(request(1, samples=2))
    wait_for(lambda: render.is_idle)
    render.note_drawn(render.picture)
    monkeypatch.setattr(render._pace, "divisors", lambda _pixels: [4, 2, 1])
    render.show(request(2, samples=2))
    wait_for(lambda: render.picture.request.number == 2)
    render.show(request(3, samples=2))
    wait_for(lambda: render.picture.request.number == 3)
    render.note_drawn(render.picture)
    wait_for(lambda: render.is_idle)


@pytest.mark.parametrize("quiet, tells", [(-1.0, True), (math.inf, False)])
def test_what_comes_before_the_first_ray_is_told_where_it_takes_long(live, monkeypatch, quiet, tells):
    monkeypatch.setattr(live_module, "QUIET_SECONDS", quiet)
    render, _, told = live
    render.show(request(1, samples=2))
    wait_for(lambda: render.is_idle)
    assert (told[0] is None) == tells, "that there is no picture yet"
