#!/usr/bin/env python3
"""Compare the films of two checkouts bit for bit. `compare_films.py --help` says how."""

from __future__ import annotations

import argparse
import functools
import hashlib
import importlib
import json
import os
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

DESCRIPTION = """\
Compare the films of two checkouts of RayBatch, before and after a change that must not alter a bit.

digest CHECKOUT --out FILE   render every stability case of CHECKOUT, and each SCENE (.scene.npz, written by render.py
                             --save-scene), and write a digest of each film: its passes and its counts of samples
compare FILE FILE            list the scenes whose films differ, and those that one file lacks; exit code 1 if any do

Digests are of one device model and compiler: make both on the same machine. A file is written as films come, so that
what was interrupted goes on where it stopped.
"""


def digest_of(film: Any) -> str:
    """SHA-256 over the names, shapes and bits of a film's passes, and its counts of samples."""
    digest = hashlib.sha256()
    for name, values in (*sorted(film.passes.items()), ("counts", film.counts)):
        digest.update(f"{name} {values.shape} {values.dtype}".encode())
        digest.update(values.tobytes())
    return digest.hexdigest()


class Recorder:
    """Digests of all films that are rendered while it is installed, by the order in which they come."""

    def __init__(self, session_class: Any) -> None:
        self.digests: list[str] = []
        self._render = session_class.render
        recorder = self

        def render(session, *arguments, **named):
            film = recorder._render(session, *arguments, **named)
            recorder.digests.append(digest_of(film) if film.complete else "incomplete")
            return film

        session_class.render = render

    def take(self) -> list[str]:
        """The digests since the last call."""
        taken, self.digests = self.digests, []
        return taken


def stability_module(name: str) -> Any:
    """A module of the stability cases, wherever this checkout keeps them."""
    try:
        return importlib.import_module(f"tests.stability.{name}")
    except ModuleNotFoundError:
        return importlib.import_module(f"stability.{name}")


def stability_jobs(part: int, part_count: int, device: str) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Names of stability cases with their tracer, and what runs them. What a case finds is compared too: some trace
    rays and render nothing.
    """
    cases, bench = stability_module("cases"), stability_module("bench")
    session = importlib.import_module("raybatch_addon.core.session").Session(device)
    jobs = [(case, tracer) for case in cases.all_cases() for tracer in case.tracers if case.family != "leaks"]
    for case, tracer in jobs[part::part_count]:
        yield f"{case.name} ({tracer})", functools.partial(case.run, bench.Bench(device, tracer, session))


def scene_jobs(paths: list[Path], device: str) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Names of saved scenes with their schedule, and what renders them."""
    archive = importlib.import_module("raybatch_addon.core.scene.archive")
    session = importlib.import_module("raybatch_addon.core.session").Session(device)
    for path in paths:
        scene, settings = archive.load_scene(path)
        for batching in ("OFF", "ON"):
            chosen = settings.replace(device=device, sample_count=4, batching=batching)
            yield f"{path.name} (batching {batching})", functools.partial(rendered, session, scene, chosen)


def rendered(session: Any, scene: Any, settings: Any) -> None:
    """Render `scene`."""
    session.render(scene, settings)


def digest(options: argparse.Namespace) -> int:
    """Render and write; the exit code."""
    root = options.checkout.absolute()
    sys.path[:0] = [str(root), str(root / "tests"), str(root / "scripts")]
    out: dict[str, Any] = {"device": options.device, "films": {}, "seconds": {}}
    if options.out.exists():
        out = json.loads(options.out.read_text(encoding="utf-8"))
    part, part_count = (int(number) for number in options.part.split("/"))
    if options.cores:
        own = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {own[(part * options.cores + i) % len(own)] for i in range(options.cores)})
    wanted = set(json.loads(options.like.read_text(encoding="utf-8"))["films"]) if options.like else set()
    recorder = Recorder(importlib.import_module("raybatch_addon.core.session").Session)
    scenes = options.scene[part - 1 :: part_count]
    jobs = (*scene_jobs(scenes, options.device), *stability_jobs(part - 1, part_count, options.device))
    for name, run in jobs:
        if name in out["films"] or (wanted and name not in wanted):
            continue
        start = time.perf_counter()
        try:
            outcome = run()
            # without the note, which may hold seconds
            found = [] if outcome is None else [f"{outcome.measured!r} of {outcome.expected!r}, {outcome.tolerance!r}"]
        except Exception as error:  # a case that cannot run here: alike in both checkouts
            traceback.print_exc()
            found = [f"{type(error).__name__}: {error}"[:200]]
        out["films"][name] = recorder.take() + found
        out["seconds"][name] = round(time.perf_counter() - start, 2)
        options.out.write_text(json.dumps(out, indent=1), encoding="utf-8")
    return 0


def split_digest(options: argparse.Namespace) -> int:
    """`digest` in several processes, whose files are merged; the exit code."""
    command = [sys.executable, __file__, "digest", str(options.checkout), *map(str, options.scene)]
    command += ["--like", str(options.like)] if options.like else []
    jobs = []
    for part in range(1, options.jobs + 1):
        out = options.out.with_suffix(f".{part}.json")
        device = options.device.replace("*", str((part - 1) % max(1, options.device_count)))
        cores = max(1, (os.cpu_count() or 1) // options.jobs)
        more = ["--device", device, "--cores", str(cores), "--part", f"{part}/{options.jobs}", "--out", str(out)]
        jobs.append((subprocess.Popen([*command, *more]), out))
    codes = [process.wait() for process, _ in jobs]
    whole: dict[str, Any] = {"device": options.device, "films": {}, "seconds": {}}
    for _, out in jobs:
        if out.exists():
            part = json.loads(out.read_text(encoding="utf-8"))
            whole["films"] |= part["films"]
            whole["seconds"] |= part["seconds"]
    options.out.write_text(json.dumps(whole, indent=1), encoding="utf-8")
    return max(codes)


def compare(options: argparse.Namespace) -> int:
    """Print what differs; the exit code."""
    before, after = (json.loads(path.read_text(encoding="utf-8"))["films"] for path in options.files)
    different = [name for name in before if name in after and before[name] != after[name]]
    lacking = sorted(set(before) ^ set(after))
    films = sum(len(before[name]) for name in before if name in after)
    for name in different:
        count = sum(a != b for a, b in zip(before[name], after[name], strict=False))
        print(f"differs: {name}: {count} of {len(before[name])} films")
    for name in lacking:
        print(f"only in one: {name}")
    print(f"{films:,} films of {len(set(before) & set(after))} scenes compared: {len(different)} scenes differ")
    return int(bool(different or lacking))


def main() -> int:
    """The exit code."""
    parser = argparse.ArgumentParser(description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("digest")
    one.add_argument("checkout", type=Path)
    one.add_argument("scene", type=Path, nargs="*", help="saved scenes (.scene.npz)")
    one.add_argument("--out", type=Path, required=True)
    one.add_argument("--device", default="cpu", help="cpu or cuda:N; cuda:* spreads processes over --device-count")
    one.add_argument("--device-count", type=int, default=1)
    one.add_argument("--part", default="1/1", metavar="I/N", help="every Nth case, from the Ith")
    one.add_argument("--like", type=Path, metavar="FILE", help="only the scenes whose films this file has")
    one.add_argument("--cores", type=int, default=0, help="cores that a process keeps to (default: all)")
    one.add_argument("--jobs", type=int, default=1, help="processes")
    both = commands.add_parser("compare")
    both.add_argument("files", type=Path, nargs=2)
    options = parser.parse_args()
    if options.command == "compare":
        return compare(options)
    return split_digest(options) if options.jobs > 1 else digest(options)


if __name__ == "__main__":
    sys.exit(main())
