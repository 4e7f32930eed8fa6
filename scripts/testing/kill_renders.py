#!/usr/bin/env python3
"""Kill renders at random moments, and see whether their checkpoints go on. `kill_renders.py --help` says how."""

from __future__ import annotations

import argparse
import functools
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

for folder in Path(__file__).resolve().parents[1:3]:  # of the scripts, and of the package
    sys.path.insert(0, str(folder))

import numpy as np
from lib.command import UsageError, run_command
from lib.films import differing_passes
from lib.output import OutputFolders, leave

from testing.report import heading, of_chance, publish

DESCRIPTION = """\
Kill renders at random moments by SIGKILL, let each go on from its checkpoint, and compare the films with those of
renders that nobody killed, bit for bit.

SCENE.scene.npz is a scene written by render.py --save-scene; where none is named, those of
tests/support/schedule_scenes.py are rendered, with all passes, mattes, hair and motion blur. Films of all scenes and
of these settings take turns: plain, in halves (error_estimate), to an error target, and with adaptive sampling. Each
render that goes on has another schedule. Most renders are processes forked from one that has loaded the kernels; every
tenth is render.py itself. SCENE.blend is rendered by processes of Blender (the module bpy), with the checkpoint of the
panel, each of which is killed once it has kept samples. Runs on the CPU, on systems that can fork. The exit code is 0,
or 1 if a film differs or a checkpoint cannot be read.
"""
MARKS = ("<!-- kills: made by scripts/testing/kill_renders.py -->", "<!-- end of kills -->")
INTERVAL = 0.05  # of checkpoints [s]
RENDER_SECONDS = 1.5  # of a film that nobody kills, about
KILL_SECONDS = 0.6  # a render is killed at most so long after its start, and one of render.py after its first ray
COMMAND_EVERY = 10
BLENDER_SECONDS = 6.0  # of a film by Blender that nobody kills, about: its checkpoints come once a second
# A process that renders a file and prints how long; arguments: this project, the file, the path of the output, settings
BLENDER = """
import json, os, sys
sys.path.insert(0, sys.argv.pop(1))
import bpy
import raybatch_addon
from raybatch_addon.blender import frame
from raybatch_addon.export.settings import assign_setting
raybatch_addon.register()
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
scene = bpy.context.scene
scene.render.engine, scene.render.filepath = "RAYBATCH", sys.argv[2]
scene.raybatch_checkpoint.use, scene.raybatch_checkpoint.interval = True, 1.0
for name, value in json.loads(sys.argv[3]).items():
    assign_setting(scene.raybatch, name, value)
frame.note_listeners.append(lambda text: print(text, file=sys.stderr))
frame.film_listeners.append(lambda *found: print(json.dumps(found[-1].statistics["seconds"])))
bpy.ops.render.render()
sys.stdout.flush()
sys.stderr.flush()
os._exit(0)
"""
VARIANTS: dict[str, dict[str, Any]] = {
    "plain": {},
    "halves": {"error_estimate": "ON"},
    "error target": {"error_target": 1e-12},
    "adaptive": {"adaptive_sampling": "ON", "noise_threshold": 0.05, "adaptive_samples_min": 8},
}


@dataclass
class KillOutcome:
    """The result of the renders of one scene with the settings of one variant."""

    scene: str
    variant: str
    kills: int = 0
    films: int = 0
    goings_on: int = 0  # renders that found samples
    kills_of_writers: int = 0  # that left a file half written
    faults: list[str] = field(default_factory=list)


class Killed:
    """Renders of one scene and variant, killed."""

    def __init__(self, session: Any, path: Path, variant: str, folder: Path):
        from raybatch_addon.core.scene.archive import load_scene

        self._session, self._path, self._folder = session, path, folder
        self._scene, settings = load_scene(path)
        self._settings = settings.replace(**VARIANTS[variant], device="cpu", sample_count=32)
        self.outcome = KillOutcome(path.name, variant)
        session.render(self._scene, self._settings)  # kernels are compiled
        start = time.perf_counter()
        session.render(self._scene, self._settings)
        more = max(1.0, RENDER_SECONDS / (time.perf_counter() - start))
        self._settings = self._settings.replace(sample_count=int(32 * more))
        self._expected = session.render(self._scene, self._settings)
        self._checkpoint = folder / "film.checkpoint"

    def film(self, random: np.random.Generator, kills_most: int) -> None:
        """Render one film, with `kills_most` kills at most; the last render is left alone."""
        outcome, checkpoint = self.outcome, self._checkpoint
        checkpoint.unlink(missing_ok=True)
        kills = 0
        while True:
            seconds = float(random.uniform(0, KILL_SECONDS)) if kills < kills_most else None
            code = self._start(checkpoint, seconds, int(random.integers(2**31)))
            if code != -signal.SIGKILL:
                break
            kills += 1
            outcome.kills += 1
            outcome.kills_of_writers += any(each.name.startswith(".") for each in self._folder.iterdir())
        outcome.films += 1
        if code:
            outcome.faults.append(f"a render ended with exit code {code}")
        elif fault := self._fault(checkpoint):
            outcome.faults.append(fault)

    def _start(self, path: Path, seconds: float | None, seed: int) -> int:
        """The exit code of a process that renders, killed after some `seconds`; None: it is left alone."""
        number = self.outcome.kills + self.outcome.films
        start = self._command if number % COMMAND_EVERY == COMMAND_EVERY - 1 else self._fork
        return start(path, seconds, seed)

    def _fault(self, checkpoint: Path) -> str:
        """Why what is in `checkpoint` is not the film; empty where it is."""
        from raybatch_addon.core.checkpoint.file import load_kept
        from raybatch_addon.core.errors import RayBatchError

        try:
            film = load_kept(checkpoint).film()
        except RayBatchError as error:
            return str(error)
        for mine, theirs in zip(
            (film, *(film.halves or ())), (self._expected, *(self._expected.halves or ())), strict=True
        ):
            if not np.array_equal(mine.counts, theirs.counts):
                return "other samples"
            for name in differing_passes(mine.passes, theirs.passes):
                return f"the pass {name} differs"
        if left := [each.name for each in self._folder.iterdir() if each.name.startswith(".")]:
            return f"{left[0]} was left"
        return ""

    def _schedule(self, seed: int) -> dict[str, Any]:
        """Other tiles, workers, rays and order: what a checkpoint must not depend on."""
        random = np.random.default_rng(seed)
        return {
            "tile_size": int(random.choice([0, 5, 16, 64])),
            "thread_count": int(random.integers(1, 3)),
            "ray_count": int(random.choice([0, 200, 2000])),
            "batching": str(random.choice(["OFF", "OFF", "ON"])),
            "sample_order": str(random.choice(["FRAME_FIRST", "PIXEL_FIRST"])),
        }

    def _fork(self, path: Path, seconds: float | None, seed: int) -> int:
        """The same of a forked process, killed so long after its start."""
        found, pipe = os.pipe()
        child = os.fork()
        if child == 0:
            os._exit(_code_of(lambda: self._render(path, self._settings.replace(**self._schedule(seed)), pipe)))
        os.close(pipe)
        if seconds is not None:
            time.sleep(seconds)
            os.kill(child, signal.SIGKILL)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        self.outcome.goings_on += bool(os.read(found, 1))
        os.close(found)
        return code

    def _render(self, path: Path, settings: Any, pipe: int) -> None:
        from raybatch_addon.core.checkpoint.checkpoint import Checkpoint

        checkpoint = Checkpoint(path, INTERVAL, report=lambda text: "goes on" in text and os.write(pipe, b"+"))
        self._session.render(self._scene, settings, checkpoint=checkpoint)

    def _command(self, path: Path, seconds: float | None, seed: int) -> int:
        """The same of a process of render.py, killed so long after its checkpoint was there or was written anew."""
        settings = {**self._schedule(seed), **VARIANTS[self.outcome.variant], "device": "cpu"}
        settings["sample_count"] = self._settings.sample_count
        command = [sys.executable, str(Path(__file__).resolve().parents[1] / "render.py"), str(self._path)]
        command += ["--checkpoint", str(path), "--checkpoint-interval", str(INTERVAL)]
        command += [word for name, value in settings.items() for word in ("--set", f"{name}={value}")]
        return self._watched(command, path, seconds)[0]

    def _watched(self, command: list[str], path: Path, seconds: float | None) -> tuple[int, str]:
        """The exit code of `command` and what it printed."""
        before = _written_at(path)
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            while seconds is not None and process.poll() is None and _written_at(path) == before:
                time.sleep(0.01)
            if seconds is not None:
                time.sleep(seconds)
                process.kill()
            printed, errors = process.communicate()
        self.outcome.goings_on += "goes on from" in errors
        return process.returncode, printed


class KilledBlender(Killed):
    """Renders of a file of Blender's by processes of its own, killed."""

    def __init__(self, path: Path, variant: str, folder: Path):
        self._path, self._folder, self._variant = path, folder, variant
        self.outcome = KillOutcome(path.name, variant)
        self._sample_count = 32
        self._alone()  # kernels are compiled
        for _ in range(2):  # few samples say little of how long many take
            seconds = self._alone()[1]["render"]
            self._sample_count = max(32, int(self._sample_count * BLENDER_SECONDS / seconds))
        self._expected, _ = self._alone()

    def _alone(self) -> tuple[Any, dict[str, float]]:
        """The film of a render that nobody kills, and the seconds of its parts."""
        from raybatch_addon.core.checkpoint.file import load_kept

        for each in self._folder.iterdir():
            each.unlink()
        code, printed = self._watched(self._process(0), self._folder, None)
        if code:
            raise UsageError(f"{self._path} could not be rendered: the process ended with exit code {code}")
        (self._checkpoint,) = self._folder.iterdir()
        seconds = next(line for line in printed.splitlines() if line.startswith("{"))
        return load_kept(self._checkpoint).film(), json.loads(seconds)

    def _process(self, seed: int) -> list[str]:
        settings = {**self._schedule(seed), **VARIANTS[self._variant], "device": "cpu"}
        settings["sample_count"] = self._sample_count
        arguments = [Path(__file__).resolve().parents[2], self._path, self._folder / "film", json.dumps(settings)]
        return [sys.executable, "-c", BLENDER, *map(str, arguments)]

    def _start(self, path: Path, seconds: float | None, seed: int) -> int:
        return self._watched(self._process(seed), path, seconds)[0]


def _scenes_of_tests(folder: Path) -> list[Path]:
    from raybatch_addon.core.scene.archive import save_scene
    from tests.support import schedule_scenes

    paths = []
    for name, make in schedule_scenes.SCENES.items():
        paths.append(folder / f"{name}.scene.npz")
        save_scene(paths[-1], make(), schedule_scenes.ESTIMATOR)
    return paths


def _written_at(path: Path) -> int:
    return path.stat().st_mtime_ns if path.exists() else 0


def _code_of(work: Callable[[], None]) -> int:
    try:
        work()
    except BaseException as error:  # this process ends with it
        print(f"kill_renders.py: {type(error).__name__}: {error}", file=sys.stderr, flush=True)
        return 1
    return 0


def run(options: argparse.Namespace, folders: OutputFolders, standard_output: IO[str]) -> int:
    """The exit code; raises `RayBatchError`."""
    from raybatch_addon.core.session import Session

    if not hasattr(os, "fork"):
        raise UsageError("this system cannot fork processes")
    if options.json and options.json != "-":
        folders.prepare(Path(options.json).absolute())
    random, start = np.random.default_rng(options.seed), time.perf_counter()
    session = Session("cpu")
    with tempfile.TemporaryDirectory(prefix="raybatch-kills-") as scratch:
        killed, scenes = [], options.scenes or _scenes_of_tests(Path(scratch))
        for number, (path, variant) in enumerate((path, name) for path in scenes for name in options.variants):
            folder = Path(scratch, str(number))
            folder.mkdir()
            killed.append(
                KilledBlender(path.absolute(), variant, folder)
                if path.suffix == ".blend"
                else Killed(session, path, variant, folder)
            )
        while (left := options.kills - sum(each.outcome.kills for each in killed)) > 0:
            least = min(killed, key=lambda each: each.outcome.kills)
            least.film(random, min(left, options.kills_a_film))
            print(f"kill_renders.py: {options.kills - left} of {options.kills} kills", file=sys.stderr, flush=True)
    outcomes = [each.outcome for each in killed]
    report = of_chance(options, start, outcomes=[vars(each) for each in outcomes])
    publish(options, report, table_of(report), MARKS, standard_output)
    return int(any(each.faults for each in outcomes))


def table_of(report: dict[str, Any]) -> str:
    """The report as a table of Markdown."""
    outcomes = report["outcomes"]
    numbers = ("kills", "kills_of_writers", "goings_on", "films")
    rows = [
        "| scene | settings | kills | while a file was written | went on from samples | films | differ |",
        "|---|---|---:|---:|---:|---:|---:|",
    ]
    rows += [
        f"| {each['scene']} | {each['variant']} | {' | '.join(str(each[name]) for name in numbers)} | "
        f"{len(each['faults'])} |"
        for each in outcomes
    ]
    sums = " | ".join(str(sum(each[name] for each in outcomes)) for name in numbers)
    rows.append(f"| all | | {sums} | {sum(len(each['faults']) for each in outcomes)} |")
    faults = [f"- {each['scene']}, {each['variant']}: {fault}" for each in outcomes for fault in each["faults"]]
    return "\n".join([heading(report), "", *rows, *(["", *faults] if faults else [])])


def main(arguments: list[str] | None = None) -> int:
    """The exit code."""
    parser = argparse.ArgumentParser(
        prog="kill_renders.py", description=DESCRIPTION, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", type=Path, metavar="SCENE")
    parser.add_argument("--kills", type=int, default=300, metavar="N", help="default: 300")
    parser.add_argument("--kills-a-film", type=int, default=8, metavar="N", help="at most; default: 8")
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS), metavar="NAME")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of chance; default: 0")
    parser.add_argument("--json", metavar="FILE", help="write the report as JSON too; - is standard output")
    parser.add_argument("--page", type=Path, metavar="FILE.md", help="write the report between its marks in a page")
    options = parser.parse_args(arguments)
    return run_command("kill_renders.py", False, functools.partial(run, options))


if __name__ == "__main__":
    leave(main())
