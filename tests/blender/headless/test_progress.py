"""Lines of progress of render.py, where standard error is no terminal: seldom, and as farm managers read them."""

import io
import itertools
import re

import pytest
from rendering.progress import PLAIN_SECONDS, ProgressBar

from raybatch_addon.core.observers import Progress

SECONDS = 60.0
STEP = 0.25  # from one report to the next


def progress(seconds: float, stage: str = "render") -> Progress:
    return Progress(
        stage=stage,
        fraction=seconds / SECONDS,
        message="Building the scene",
        samples_done=64 * seconds / SECONDS,
        samples_total=64,
        rays_per_second=1.5e6,
        seconds_elapsed=seconds,
        seconds_left=None if seconds < 8 else 4000 - seconds,
        memory_bytes=2**20,
        memory_peak=3 * 2**20,
        kernels="general",
        compiles=seconds < 10,
    )


@pytest.mark.parametrize("frame", [None, 7])
def test_lines_come_at_most_every_five_seconds_and_are_those_of_the_addon(frame):
    now, printed = 100.0, []

    class Stream(io.StringIO):
        def write(self, text):
            if text.strip():
                printed.append((now, text))
            return len(text)

    bar = ProgressBar(Stream(), clock=lambda: now)
    while (seconds := now - 100.0) < SECONDS:
        bar.show(progress(seconds, "build" if seconds < 6 else "render"), frame)
        now += STEP
    bar.close()
    times = [time for time, _ in printed]
    assert times[0] == 100 + PLAIN_SECONDS and len(times) == SECONDS / PLAIN_SECONDS - 1
    assert min(later - time for time, later in itertools.pairwise(times)) >= PLAIN_SECONDS == 5
    beginning = "" if frame is None else "Fra: 7 | "
    lines = [line for _, line in printed]
    assert lines[0] == f"{beginning}Building the scene | Mem: 1M, Peak: 3M"
    assert lines[1] == (f"{beginning}Sample 11/64 | 1.50 Mrays/s | 1:06:30 left | Mem: 1M, Peak: 3M | general kernels")
    for line in lines[1:]:
        assert re.match(rf"{re.escape(beginning)}Sample \d+/64 \| ", line), "as Cycles has it, for those who read it"
