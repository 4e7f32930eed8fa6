"""Blender without a window: what its command line asks for, the lines that it prints, the code that it ends with."""

import itertools
import re
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import exit_code, frame, reports
from raybatch_addon.blender.status import status, terminal
from raybatch_addon.blender.status.text import status_text
from raybatch_addon.core.errors import SettingsError
from raybatch_addon.core.observers import Progress
from raybatch_addon.export.asked import asked
from raybatch_addon.export.settings import settings_from
from tests.support.blender_builders import add_grid


def test_device_settings_and_threads_are_asked_for_on_the_command_line():
    line = "blender -b x.blend -t 3 -E RAYBATCH -f 1 --"
    read = asked([*line.split(), "--raybatch-device", "cuda:1", "--raybatch-set", "sample_count=7"])
    assert read.settings == {"thread_count": 3, "device": "cuda:1", "sample_count": 7}
    read = asked(
        ["blender", "--threads", "0", "--", "--raybatch-set", "nee=half", "--raybatch-set", "geometry_budget=2G"]
    )
    assert read.settings == {"nee": "HALF", "geometry_budget": 2_000_000_000}
    assert asked(["script.py", "-t", "3"]).settings == {}, "options of a script are its own"
    assert asked(["blender", "-b", "--raybatch-set", "seed=1"]).settings == {}, "Blender's own stand before --"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--raybatch-set", "sample_cuont=7"], "did you mean sample_count"),
        (["--raybatch-set", "sample_count"], "NAME=VALUE"),
        (["--raybatch-set", "sample_count=-1"], "must be 1 to"),
        (["--raybatch-device"], "takes the name of a device"),
        (["--raybatch-devize", "cpu"], "no option --raybatch-devize: the options are --raybatch-device"),
    ],
)
def test_options_that_are_not_understood_are_reported(options, words):
    with pytest.raises(SettingsError, match=words):
        asked(["blender", "--", *options])


def test_the_command_line_comes_before_the_file(scene, monkeypatch):
    scene.raybatch.sample_count, scene.raybatch.seed = 5, 6
    monkeypatch.setattr(sys, "argv", ["blender", "-t", "1", "--", "--raybatch-set", "sample_count=7"])
    settings = settings_from(scene)
    assert (settings.sample_count, settings.seed, settings.thread_count) == (7, 6, 1)


@pytest.fixture
def animated(scene, tmp_path):
    """A scene of which frames 1, 3 and 5 are asked for, as by `-s 1 -e 5 -j 2 -a`."""
    add_grid("Grid", 4)
    scene.frame_start, scene.frame_end, scene.frame_step = 1, 5, 2
    scene.render.filepath = f"{tmp_path}/"
    scene.render.image_settings.file_format = "PNG"
    scene.raybatch.sample_count = 1
    return scene


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_frames_are_those_that_were_asked_for(animated, tmp_path):
    bpy.ops.render.render(animation=True)
    assert names(tmp_path) == ["0001.png", "0003.png", "0005.png"]


@contextmanager
def looking(look):
    """`look()` is called as each view layer begins."""

    def listen(_layer, _scene, _settings):
        look()

    frame.scene_listeners.append(listen)
    try:
        yield
    finally:
        frame.scene_listeners.remove(listen)


def test_frames_that_are_there_are_left_alone_without_overwrite(animated, tmp_path):
    (tmp_path / "0003.png").write_bytes(b"there")
    animated.render.use_overwrite = False
    rendered = []
    with looking(lambda: rendered.append(animated.frame_current)):
        bpy.ops.render.render(animation=True)
    assert rendered == [1, 5] and (tmp_path / "0003.png").read_bytes() == b"there"


def test_placeholders_are_there_while_a_frame_renders(animated, tmp_path):
    animated.render.use_placeholder = True
    seen = []
    with looking(lambda: seen.append(names(tmp_path))):
        bpy.ops.render.render(animation=True)
    assert seen[0] == ["0001.png"] and seen[-1] == ["0001.png", "0003.png", "0005.png"]
    assert (tmp_path / "0005.png").stat().st_size > 0


def test_extensions_are_left_out_where_asked(animated, tmp_path):
    animated.render.use_file_extension = False  # as by `-x 0`
    bpy.ops.render.render(animation=True)
    assert names(tmp_path) == ["0001", "0003", "0005"]


class Said:
    """What is said of renders, by a clock of its own."""

    def __init__(self, monkeypatch):
        self.clock, self.lines, self.timers = 100.0, [], []
        monkeypatch.setattr(terminal, "WAITS", True)  # as in a Blender that is no module
        monkeypatch.setattr(terminal.time, "perf_counter", lambda: self.clock)
        monkeypatch.setattr(terminal.threading, "Timer", self._timer)
        self.plain_lines = terminal.PlainLines(self._note)
        monkeypatch.setattr(status, "plain_lines", self.plain_lines)
        monkeypatch.setattr(frame, "plain_lines", self.plain_lines)
        names = ("update_progress", "update_memory_stats", "report")
        self.engine = type("Engine", (), {name: lambda *_, **__: None for name in names})()
        self.engine.update_stats = lambda _layer, text: self._note(text)

    def _note(self, text):
        self.lines.append((round(self.clock, 3), text))

    def _timer(self, seconds, function):
        timer = SimpleNamespace(at=self.clock + seconds, function=function, daemon=False, start=lambda: None)
        timer.cancel = lambda: self.timers.remove(timer)
        timer.join = lambda: None
        self.timers.append(timer)
        return timer

    def wait(self, seconds):
        self.clock += seconds
        for timer in [each for each in self.timers if each.at <= self.clock]:
            timer.function()

    def layer(self, frame_number):
        return status.RenderStatus(self.engine, "ViewLayer", frame_number)

    @property
    def least_seconds(self):
        times = [time for time, _ in self.lines]
        return min(later - time for time, later in itertools.pairwise(times))


@pytest.fixture
def said(monkeypatch):
    return Said(monkeypatch)


FINISHED = SimpleNamespace(complete=True)
SAMPLES = dict(samples_done=3, samples_total=16, rays_per_second=1e6, seconds_elapsed=1.0, seconds_left=None)
PROGRESS = Progress(stage="render", fraction=0.5, message="", memory_bytes=0, memory_peak=0, **SAMPLES)


def test_lines_of_progress_come_at_most_every_five_seconds(said):
    layer = said.layer(1)
    layer.show("Reading the scene")
    for _ in range(120):
        said.wait(0.1)
        layer.update(PROGRESS)
        layer.show("another stage")
    assert len(said.lines) == 3 and said.least_seconds >= 5
    assert said.lines[1][1].startswith("Sample 3/16 | "), "as Cycles has it, for those who read it"


def test_the_bar_of_a_render_that_goes_on_begins_where_its_samples_are(said):
    shares = []
    said.engine.update_progress = shares.append
    layer = said.layer(1)
    for fraction, samples in ((0.5, 3), (0.0, 12), (1.0, 16)):
        said.wait(6)
        layer.update(replace(PROGRESS, fraction=fraction, samples_done=samples))
    assert shares == [0.5, 0.75, 1.0]


def test_short_frames_have_a_line_in_five_seconds_together_and_the_end_is_said(said):
    for frame_number in range(1, 41):
        layer = said.layer(frame_number)
        layer.show("Reading the scene")
        said.wait(0.2)
        layer.update(PROGRESS)
        said.wait(0.1)
        layer.end(FINISHED, 16)
    assert len(said.lines) == 3
    said.wait(5)
    assert len(said.lines) == 4 and said.least_seconds >= 5
    assert said.lines[-1][1] == terminal.line_of_frame(40, "Sample 16/16 | Finished")
    said.wait(10)
    assert len(said.lines) == 4 and not said.timers


def test_the_end_of_a_long_frame_is_said_at_once(said):
    layer = said.layer(1)
    layer.show("Reading the scene")
    said.wait(7)
    layer.end(FINISHED, 16)
    assert said.lines[-1] == (107.0, "Sample 16/16 | Finished")


def test_a_timer_that_is_late_does_not_print_the_line_of_another(said):
    said.plain_lines.note()
    said.plain_lines.wait_with("frame 1")
    (late,) = said.timers
    said.wait(1)
    said.plain_lines.note()
    said.plain_lines.wait_with("frame 2")
    late.function()  # it ran out before it was cancelled
    assert not said.lines
    said.wait(5)
    assert said.lines == [(106.0, "frame 2")]


def test_behind_an_error_no_end_is_said(said):
    for frame_number in (1, 2):
        layer = said.layer(frame_number)
        layer.show("Reading the scene")
        layer.end(FINISHED, 16)
    frame._fail(said.engine, reports.RenderReport("Scene", 3), "no camera")
    said.wait(60)
    assert [text for _, text in said.lines] == ["Reading the scene"] and not said.timers


ENDS = """
import atexit, sys
from raybatch_addon.blender import exit_code
from raybatch_addon.blender.status import terminal
from raybatch_addon.blender.status.terminal import line_of_frame, plain_lines
terminal.WAITS = "module" not in sys.argv
if "failed" in sys.argv:
    exit_code.end_with(1)
plain_lines.note()
plain_lines.wait_with("frame 1")
plain_lines.wait_with(line_of_frame(2, "Sample 16/16 | Finished"))
print("said")
"""


@pytest.mark.parametrize("words", [[], ["failed"], ["module"]])
def test_the_end_is_said_where_blender_ends_before_it_is_due(words):
    done = subprocess.run([sys.executable, "-c", ENDS, *words], capture_output=True, text=True, check=False)
    last = [] if "module" in words else [terminal.line_of_frame(2, "Sample 16/16 | Finished")]
    lines = done.stdout.splitlines()
    assert lines[lines.index("said") :] == ["said", *last], done.stderr
    assert done.returncode == words.count("failed")


def test_an_animation_of_short_frames_prints_few_lines_and_its_end(animated, tmp_path):
    animated.frame_step = 1
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"), copy=True)
    code = (
        "import bpy, raybatch_addon; raybatch_addon.register(); "
        "from raybatch_addon.blender.status import terminal; terminal.WAITS = True; "
        f"bpy.ops.wm.open_mainfile(filepath={str(tmp_path / 'a.blend')!r}); bpy.ops.render.render(animation=True)"
    )
    begun = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    seconds = time.perf_counter() - begun
    assert names(tmp_path)[:5] == [f"000{number}.png" for number in range(1, 6)], done.stderr
    printed = [line for line in done.stdout.splitlines() if re.search(r"Reading the scene|Sample \d+/\d+", line)]
    assert len(printed) <= 2 + seconds / terminal.PLAIN_SECONDS, printed
    assert re.search(r"Fra: ?5 .*Sample 1/1 \| Finished", printed[-1]), printed


def test_the_status_line_says_that_kernels_are_compiled_beside():
    tier = replace(PROGRESS, kernels="general")
    assert status_text(tier).endswith(" | general kernels")
    beside = replace(tier, compiles=True)
    assert status_text(beside).endswith(" | general kernels, compiling specialised ones")


@pytest.mark.parametrize(("codes", "left"), [([1], 1), ([3], 3), ([1, 3], 3), ([3, 1], 3)])
def test_the_exit_code_says_what_became_of_renders(codes, left):
    code = f"import raybatch_addon.blender.exit_code as e; [e.end_with(each) for each in {codes}]; print('all')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.strip()) == (left, "all")


def test_a_failed_render_ends_blender_with_1_and_no_script(scene, monkeypatch):
    codes = []
    monkeypatch.setattr(exit_code, "end_with", codes.append)
    scene.raybatch.device = "cuda:99"
    with pytest.raises(RuntimeError):
        bpy.ops.render.render()
    assert reports.last().errors and codes == [], "a script has its own"
    is_module = type("App", (), {"background": True, "module": False})
    monkeypatch.setattr(frame, "bpy", type("Blender", (), {"app": is_module, "types": bpy.types}))
    frame._fail(type("Engine", (), {"report": lambda *_: None})(), reports.RenderReport("Scene", 1), "no camera")
    assert codes == [exit_code.RENDER_FAILED]
