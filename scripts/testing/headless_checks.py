"""What `headless.py` holds of Blender's program without a window, one function for each row."""

from __future__ import annotations

import itertools
import os
import re
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lib.command import UsageError

from testing.blender_program import REPORTS, BlenderProcess, BlenderProgram, EndedBlender

LINE_SECONDS = 5.0  # from one line of progress to the next, at least
JITTER_SECONDS = 0.5  # by which a pipe and a busy machine may bring them nearer
LONG_SECONDS = 14.0  # that a frame is to render whose lines are counted
SHORT_FRAMES = 30
PNG = b"\x89PNG\r\n\x1a\n"
# Makes the files, in the folder that is the last argument
MAKE = """
import sys
import bpy
folder = sys.argv[-1]
scene = bpy.context.scene
render = scene.render
render.resolution_x, render.resolution_y, render.resolution_percentage = 64, 48, 100
scene.frame_start, scene.frame_end, scene.frame_step = 1, 3, 1
def save(name):
    bpy.ops.wm.save_as_mainfile(filepath=f"{folder}/{name}.blend", check_existing=False, copy=True)
save("plain")
render.use_overwrite, render.use_placeholder = False, True
save("shared")
render.use_overwrite, render.use_placeholder = True, False
smoke = bpy.data.volumes.new("Smoke")
smoke.filepath = f"{folder}/nowhere.vdb"
scene.collection.objects.link(bpy.data.objects.new("Smoke", smoke))
save("lacking")
scene.camera = None
save("blind")
print("MADE " + bpy.app.version_string)
"""


class Wrong(Exception):
    """Something is not as it should be."""


def hold(good: object, wrong: str) -> None:
    """Raise `Wrong` unless `good`."""
    if not good:
        raise Wrong(wrong)


@dataclass
class HeadlessFiles:
    """The files that are rendered, and what renders them."""

    blender: BlenderProgram
    folder: Path
    device: str
    version: str  # of Blender
    _numbers: itertools.count[int] = field(default_factory=itertools.count)

    def place(self) -> Path:
        """A new folder."""
        made = self.folder / f"out{next(self._numbers)}"
        made.mkdir()
        return made

    def options(
        self, out: Path | str, *which: object, file: str = "plain", own: Sequence[str] = (), samples: int = 2
    ) -> list[object]:
        """Options of Blender for a render of `file` into `out`, in Blender's order, and behind `--` RayBatch's."""
        more = [] if any(each.startswith("sample_count") for each in own) else [f"sample_count={samples}"]
        more = [word for each in more for word in ("--raybatch-set", each)]
        target = out / "f_####" if isinstance(out, Path) else out
        given: list[object] = [self.folder / f"{file}.blend", "-E", "RAYBATCH", "-o", target, "-F", "PNG"]
        device = [] if "--raybatch-device" in own else ["--raybatch-device", self.device]
        return [*given, *which, "--python-expr", REPORTS, "--", *device, *more, *own]

    def render(
        self, out: Path | str, *which: object, beside: Callable[[BlenderProcess], object] | None = None, **more: Any
    ) -> EndedBlender:
        """A render by these options, which are those of `options`."""
        return self.blender.run(self.options(out, *which, **more), beside)

    def rendered(self, out: Path, *which: object, **more: Any) -> EndedBlender:
        """The same of one that has to go well."""
        ended = self.render(out, *which, **more)
        hold(ended.code == 0, f"the exit code is {ended.code}: {_end_of(ended)}")
        return ended


def make_files(blender: BlenderProgram, folder: Path, device: str) -> HeadlessFiles:
    """The files, made by `blender` in `folder`; raises `UsageError` where RayBatch is not there."""
    made = blender.run(["--factory-startup", "--python-exit-code", 1, "--python-expr", MAKE, "--", folder])
    version = [line.removeprefix("MADE ") for _, line in made.lines if line.startswith("MADE ")]
    if made.code or not version:
        raise UsageError(f"{blender.path} made no files to render: {_end_of(made)}")
    files = HeadlessFiles(blender, folder, device, f"Blender {version[0]}")
    first = files.render(files.place(), "-f", 1)  # it may compile
    if not first.statistics or first.statistics[0]["engine"] != "RayBatch":
        raise UsageError(f"{blender.path} does not render with RayBatch: install and enable it. {_end_of(first)}")
    return files


def _end_of(ended: EndedBlender) -> str:
    return " / ".join([line for _, line in ended.lines if line.strip()][-4:])


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def _hold_names(folder: Path, *expected: str) -> None:
    there = _names(folder)
    hold(
        there == sorted(expected), f"files are {', '.join(there) or 'none'} instead of {', '.join(expected) or 'none'}"
    )


def _hold_pictures(folder: Path, *expected: str) -> None:
    _hold_names(folder, *expected)
    for name in expected:
        hold((folder / name).read_bytes()[:8] == PNG, f"{name} is no PNG")


def frames_by_name(files: HeadlessFiles) -> None:
    """`-f 1`, `-f 1,3` and `-f 2..3` write these frames, where `-o` says."""
    for which, numbers in (("1", (1,)), ("1,3", (1, 3)), ("2..3", (2, 3))):
        out = files.place()
        files.rendered(out, "-x", 1, "-f", which)
        _hold_pictures(out, *(f"f_{number:04d}.png" for number in numbers))


def extensions(files: HeadlessFiles) -> None:
    """With `-x 1` names end with that of the format, with `-x 0` they do not."""
    for option, name in ((1, "f_0001.png"), (0, "f_0001")):
        out = files.place()
        files.rendered(out, "-x", option, "-f", 1)
        _hold_pictures(out, name)


def animations(files: HeadlessFiles) -> None:
    """`-a` writes the frames of the file, or those from `-s` to `-e` in steps of `-j`."""
    out = files.place()
    files.rendered(out, "-a")
    _hold_pictures(out, *(f"f_{number:04d}.png" for number in (1, 2, 3)))
    out = files.place()
    files.rendered(out, "-s", 2, "-e", 8, "-j", 3, "-a")
    _hold_pictures(out, *(f"f_{number:04d}.png" for number in (2, 5, 8)))


def threads(files: HeadlessFiles) -> None:
    """`-t 1` and `-t 3` are the threads that RayBatch renders by on a CPU; `-t 0` are all there are."""
    for given, expected in ((1, 1), (3, 3), (0, os.cpu_count())):
        own = ["--raybatch-device", "cpu", "--raybatch-set", "tile_size=8"]  # more tiles than threads
        options = files.options(files.place(), "-f", 1, own=own)
        ended = files.blender.run(["-t", given, *options])
        hold(ended.code == 0 and ended.statistics, f"-t {given} does not render: {_end_of(ended)}")
        workers = ended.statistics[-1]["schedule"]["workers"]
        hold(workers == expected, f"-t {given}: RayBatch has {workers} threads instead of {expected}")


def own_options(files: HeadlessFiles) -> None:
    """`--raybatch-device` and `--raybatch-set` come before what the file says, which stays as it is."""
    before = (files.folder / "plain.blend").read_bytes()
    own = ["--raybatch-set", "sample_count=7", "--raybatch-set", "seed=5", "--raybatch-set", "nee=half"]
    ended = files.rendered(files.place(), "-f", 1, own=["--raybatch-device", "cpu", *own])
    statistics = ended.statistics[-1]
    found = {name: statistics["settings"][name] for name in ("sample_count", "seed", "nee")}
    hold(found == {"sample_count": 7, "seed": 5, "nee": "HALF"}, f"it rendered with {found}")
    hold(statistics["device"]["alias"] == "cpu", f"it rendered on {statistics['device']['alias']}")
    hold((files.folder / "plain.blend").read_bytes() == before, "the file is another one now")


def without_overwrite(files: HeadlessFiles) -> None:
    """A file that is there is left alone without *Overwrite*, and its frame is not rendered."""
    out = files.place()
    (out / "f_0002.png").write_bytes(b"there")
    ended = files.rendered(out, "-a", file="shared")
    _hold_names(out, "f_0001.png", "f_0002.png", "f_0003.png")
    hold((out / "f_0002.png").read_bytes() == b"there", "it was written over")
    hold(all(frame != 2 for _, frame, _ in ended.progress), "its frame was rendered")
    (out / "f_0001.png").write_bytes(b"there")
    files.rendered(out, "-s", 1, "-e", 1, "-a")
    hold((out / "f_0001.png").read_bytes()[:8] == PNG, "with Overwrite it is left alone too")


def placeholders(files: HeadlessFiles) -> None:
    """With *Placeholders* an empty file stands for a frame while it renders, and none stays behind one that failed."""
    out, seen = files.place(), set[str]()

    def look(_process: BlenderProcess) -> None:
        seen.update(path.name for path in out.iterdir() if not path.stat().st_size)

    files.rendered(out, "-a", file="shared", samples=64, beside=look)
    hold(seen == {f"f_{number:04d}.png" for number in (1, 2, 3)}, f"seen were {', '.join(sorted(seen)) or 'none'}")
    _hold_pictures(out, *sorted(seen))
    out = files.place()
    files.render(out, "-a", file="shared", own=["--raybatch-device", "cuda:99"])
    _hold_names(out)


def two_blenders(files: HeadlessFiles) -> None:
    """Two Blenders share an animation by *Placeholders* and no *Overwrite*: each frame is rendered once."""
    out, other = files.place(), list[BlenderProcess]()
    options = files.options(out, "-s", 1, "-e", 8, "-a", file="shared", samples=64)

    def start_other(_process: BlenderProcess) -> None:
        if not other and any(out.iterdir()):
            other.append(files.blender.start(options))

    both = [files.blender.run(options, start_other)]
    both += [each.ended() for each in other]
    hold([each.code for each in both] == [0, 0], f"exit codes are {[each.code for each in both]}")
    _hold_pictures(out, *(f"f_{number:04d}.png" for number in range(1, 9)))
    saved = [re.findall(r"Saved: .*f_(\d+)\.png", each.text) for each in both]
    all_saved = sorted(number for each in saved for number in each)
    hold(all_saved == [f"{number:04d}" for number in range(1, 9)], f"they saved {saved}")


def _hold_seldom(ended: EndedBlender) -> None:
    """No two lines of progress are nearer than they may be; the last one does not wait where Blender ends."""
    times = [seconds for seconds, _, _ in ended.progress[:-1]]
    least = min((later - sooner for sooner, later in itertools.pairwise(times)), default=LINE_SECONDS)
    hold(least >= LINE_SECONDS - JITTER_SECONDS, f"two lines of progress come within {least:.1f} seconds")


def lines_of_a_long_frame(files: HeadlessFiles) -> None:
    """Lines of progress come at most every five seconds, as Cycles has them: `Fra: 1 | Sample 9/64 | ...`. The last
    one says that all samples are there.
    """
    samples = 256
    for _ in range(2):  # few samples say little of how long many take
        ended = files.rendered(files.place(), "-f", 1, samples=samples)
        seconds = max(ended.statistics[-1]["seconds"]["render"], 0.01)
        samples = min(max(samples, int(samples * LONG_SECONDS / seconds)), 1 << 20)
    ended = files.rendered(files.place(), "-f", 1, samples=samples)
    _hold_seldom(ended)
    counts = [re.search(rf"\bSample (\d+)/{samples}\b", text) for _, _, text in ended.progress]
    done = [int(count[1]) for count in counts if count]
    hold(len(done) >= 3, f"there are {len(done)} lines with samples: {[text for _, _, text in ended.progress]}")
    hold(done == sorted(done) and done[-1] == samples, f"samples are {done} of {samples}")
    hold("Finished" in ended.progress[-1][2], f"the last line is {ended.progress[-1][2]!r}")
    hold(all(frame == 1 for _, frame, _ in ended.progress), "a line names another frame")


def lines_of_short_frames(files: HeadlessFiles) -> None:
    """Frames that are short have a line in five seconds together, and the end of the last one is said, when Blender
    ends at the latest.
    """
    ended = files.rendered(files.place(), "-s", 1, "-e", SHORT_FRAMES, "-a")
    _hold_seldom(ended)
    most = 2 + ended.seconds / LINE_SECONDS
    hold(len(ended.progress) <= most, f"there are {len(ended.progress)} lines in {ended.seconds:.0f} seconds")
    last = ended.progress[-1]
    hold(last[1] == SHORT_FRAMES and "Finished" in last[2], f"the last line is of frame {last[1]}: {last[2]}")


def wrong_options(files: HeadlessFiles) -> None:
    """What is wrong behind `--` is named, nothing is read or rendered, and the exit code is 1."""
    for own, words in (
        (["--raybatch-set", "sample_cuont=7"], "did you mean sample_count"),
        (["--raybatch-set", "sample_count=many"], "sample_count"),
        (["--raybatch-set", "sample_count=-1"], "sample_count = '-1' is not valid: it must be 1 to"),
        (["--raybatch-set", "seed"], "NAME=VALUE"),
        (["--raybatch-devize", "cpu"], "no option --raybatch-devize"),
    ):
        out = files.place()
        ended = files.render(out, "-a", own=own)
        hold(ended.code == 1, f"{' '.join(own)}: the exit code is {ended.code}")
        hold(words in ended.text, f"{' '.join(own)}: {words!r} is not said: {_end_of(ended)}")
        hold(not ended.progress, f"{' '.join(own)}: {ended.progress[:1]} is under way before")
        hold(ended.text.count("Error: RayBatch: ") <= 1, f"{' '.join(own)}: other frames are tried too")
        _hold_names(out)


def failed_renders(files: HeadlessFiles) -> None:
    """A render that fails is not saved, ends the animation, and has exit code 1: no such device, no camera."""
    for file, own, words in (("plain", ["--raybatch-device", "cuda:99"], "cuda:99"), ("blind", [], "camera")):
        for which in (["-f", 1], ["-a"]):
            out = files.place()
            ended = files.render(out, *which, file=file, own=own)
            hold(ended.code == 1, f"{words}, {which[0]}: the exit code is {ended.code}")
            hold(words in ended.text, f"{words} is not named: {_end_of(ended)}")
            _hold_names(out)


def refused_renders(files: HeadlessFiles) -> None:
    """What `--raybatch-strict` refuses is not saved and has exit code 3; without it the same file is rendered."""
    out = files.place()
    files.rendered(out, "-f", 1, file="lacking")
    _hold_names(out, "f_0001.png")
    out = files.place()
    ended = files.render(out, "-f", 1, file="lacking", own=["--raybatch-strict"])
    hold(ended.code == 3, f"the exit code is {ended.code}")
    _hold_names(out)


def unwritable_folders(files: HeadlessFiles) -> None:
    """Pictures that cannot be written, as their folder is a file, have exit code 1, and the animation ends with the
    first of them.
    """
    barred = files.place() / "barred"
    barred.write_bytes(b"a file")
    for which in (["-f", 1], ["-a"]):
        ended = files.render(barred, *which)
        hold(ended.code == 1, f"{which[0]}: the exit code is {ended.code}: {_end_of(ended)}")
        hold(all(frame == 1 for _, frame, _ in ended.progress), "it goes on to other frames")
    hold(barred.read_bytes() == b"a file", "the file is another one now")


def interrupts(files: HeadlessFiles) -> None:
    """An interrupt (Ctrl-C) in an animation ends it with a code that is not 0, and leaves whole pictures alone."""
    out, sent = files.place(), list[int]()

    def interrupt(process: BlenderProcess) -> None:
        if not sent and (out / "f_0001.png").exists():
            sent.append(1)
            process.send(signal.SIGINT)

    ended = files.render(out, "-s", 1, "-e", 200, "-a", samples=64, beside=interrupt)
    hold(sent, f"no picture came: {_end_of(ended)}")
    hold(ended.code != 0, "the exit code is 0")
    there = _names(out)
    hold(len(there) < 100, "it went on to the end")
    _hold_pictures(out, *there)


CHECKS: dict[str, Callable[[HeadlessFiles], None]] = {
    "frames": frames_by_name,
    "extensions": extensions,
    "animations": animations,
    "threads": threads,
    "own options": own_options,
    "overwrite": without_overwrite,
    "placeholders": placeholders,
    "two Blenders": two_blenders,
    "lines of a long frame": lines_of_a_long_frame,
    "lines of short frames": lines_of_short_frames,
    "wrong options": wrong_options,
    "failed renders": failed_renders,
    "refused renders": refused_renders,
    "folders that cannot be written": unwritable_folders,
    "interrupts": interrupts,
}
