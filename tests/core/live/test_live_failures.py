"""A device that fails at any launch or allocation of a live render: that is shown, and the next edit is rendered."""

import re
from dataclasses import replace

import numpy as np
import pytest

from raybatch_addon.core.live.render import LiveRender
from raybatch_addon.core.session import Session
from tests.core.device.faults import KINDS, Faults
from tests.core.live.lending import SECONDS, Source, request, wait_for
from tests.support.scenes import camera
from tests.support.under_test import DEVICE

pytestmark = [
    pytest.mark.usefixtures("general_kernels"),
    pytest.mark.skipif(DEVICE != "cpu", reason="on the CPU alone"),
]
# With so few samples pictures are shown at the same counts, and the same is launched, however long a sample takes
FIRST = request(1, samples=2)
NEXT = request(2, samples=2, camera=camera(eye=(0.5, -4, 1.6)))
FIRST, NEXT = (replace(each, settings=each.settings.replace(thread_count=1)) for each in (FIRST, NEXT))


def shown(render, asked):
    """What is shown of `asked` once nothing is left to do; None where that is an error."""
    render.show(asked)
    wait_for(lambda: render.is_idle)
    if render.state.error:
        return None
    assert render.picture.request is asked and render.picture.side == 1 and render.picture.samples == 2
    return render.picture.pixels


def closed(render, session):
    render.close()
    assert render.join(SECONDS)
    session.close()


@pytest.mark.parametrize("kind, said", [(kind, said) for kind, _, said in KINDS])
def test_a_failure_anywhere_is_shown_and_the_next_edit_is_rendered(kind, said, monkeypatch, pytestconfig):
    faults = Faults(monkeypatch)
    with_no_fault = Session("cpu")
    expected = [with_no_fault.render(each.scene, each.settings).passes["Combined"] for each in (FIRST, NEXT)]
    with_no_fault.close()
    session = Session("cpu")
    render = LiveRender(Source(session))
    faults.begin(kind)
    np.testing.assert_array_equal(shown(render, FIRST), expected[0])
    places = faults.places(pytestconfig.option.thorough)
    closed(render, session)
    failed = 0
    for at in places:
        session = Session("cpu")
        render = LiveRender(Source(session))
        faults.begin(kind, at)
        pixels = shown(render, FIRST)
        if pixels is None:
            failed += 1
            assert re.search(said, render.state.error), render.state.error
        else:  # what is allocated for speed alone may be done without
            assert kind == "allocation", f"{kind} {at} failed, and nothing is said"
            np.testing.assert_array_equal(pixels, expected[0])
        faults.begin("")
        np.testing.assert_array_equal(shown(render, NEXT), expected[1], err_msg=f"after {kind} {at}")
        np.testing.assert_array_equal(shown(render, replace(FIRST, number=3)), expected[0], err_msg=f"{kind} {at}")
        closed(render, session)
    assert failed
