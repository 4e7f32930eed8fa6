"""Features run in processes of their own: what ends one of these with Blender in it is reported, and costs no other
feature.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

GROUP_SECONDS = 3600  # a group is given up then
PICTURES_TOGETHER = 6


def groups_of(features: list) -> list[list]:
    """Nodes that share a sheet together, and pictures by a few."""
    from tests.blender.features.runner import sheets

    made = sheets([each for each in features if each.kind == "node"])
    pictures = [each for each in features if each.kind == "picture"]
    return made + [pictures[i : i + PICTURES_TOGETHER] for i in range(0, len(pictures), PICTURES_TOGETHER)]


def run_groups(features: list, script: Path, jobs: int, done: Callable) -> list:
    """Results of `features`, in their order; `done` is called with each as it comes, one at a time."""
    from tests.blender.features.runner import FAILED, Result

    results: dict[str, Result] = {}
    telling = threading.Lock()
    by_name = {each.name: each for each in features}

    def report(result: Result) -> None:
        with telling:
            results[result.feature.name] = result
            done(result)

    def run(group: list) -> None:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "results.npz"
            why = _run_process(script, [each.name for each in group], file)
            found = list(read_results(file, by_name)) if file.exists() else []
        missing = [each for each in group if each.name not in {result.feature.name for result in found}]
        if missing and len(group) > 1:
            for result in found:
                report(result)
            for each in missing:
                run([each])
            return
        for result in found + [Result(each, FAILED, note=why or "no result") for each in missing]:
            report(result)

    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(run, groups_of(features)))
    return [results[each.name] for each in features]


def _run_process(script: Path, names: list[str], file: Path) -> str:
    """Why there may be no result; empty when all went well."""
    command = [
        sys.executable,
        str(script),
        "--worker",
        str(file),
        *(part for name in names for part in ("--exactly", name)),
    ]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=GROUP_SECONDS, env=dict(os.environ)
        )
    except subprocess.TimeoutExpired:
        return f"no result after {GROUP_SECONDS} s"
    if done.returncode:
        sys.stderr.write(done.stderr[-4000:])
        return f"the process ended with {done.returncode}: {(done.stderr.strip().splitlines() or [''])[-1]}"
    return ""


# --- results as a file, written anew with each of them


def write_results(results: list, file: Path) -> None:
    """`results` as an .npz."""
    arrays: dict[str, Any] = {}
    for i, result in enumerate(results):
        arrays[f"{i} name"] = np.array([result.feature.name, result.status, result.note])
        arrays[f"{i} keys"] = np.array(list(result.figures), dtype=str)
        arrays[f"{i} values"] = np.array([*result.figures.values(), result.seconds], float)
        for name in ("ours", "theirs"):
            picture = getattr(result, name)
            if picture is not None:
                arrays[f"{i} {name}"] = picture.astype(np.float32)
    temporary = file.with_name("writing.npz")
    np.savez(temporary, **arrays)
    temporary.replace(file)


def read_results(file: Path, by_name: dict) -> Iterator:
    """What `write_results` wrote."""
    from tests.blender.features.runner import Result

    with np.load(file) as arrays:
        for i in range(sum(name.endswith(" name") for name in arrays.files)):
            name, status, note = map(str, arrays[f"{i} name"])
            *values, seconds = arrays[f"{i} values"].tolist()
            figures = dict(zip(map(str, arrays[f"{i} keys"]), values))
            pictures = {
                key: arrays[f"{i} {key}"].astype(float) for key in ("ours", "theirs") if f"{i} {key}" in arrays.files
            }
            yield Result(by_name[name], status, figures, note, seconds=seconds, **pictures)
