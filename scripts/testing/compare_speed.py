#!/usr/bin/env python3
"""Compare the speed of two checkouts, in turns. `compare_speed.py --help` says how."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

DESCRIPTION = """\
Compare the speed of two checkouts of RayBatch, before and after a change that must not cost time: processes of either
take turns, each runs benchmark.py as the checkout has it, and what counts is the ratio of the two of a turn.

  compare_speed.py BEFORE AFTER --turns 15 -- traversal --scene dragon.npz --threads 1 --no-counters
  compare_speed.py BEFORE AFTER --turns 15 -- render sponza.scene.npz --samples 4
  compare_speed.py BEFORE AFTER --turns 3 --compile -- scene.scene.npz

--compile: the processor time of rendering one sample of 16 x 16 pixels (render.py) from an empty kernel cache.
A table gives the median ratio of times, after over before, and the 95 % interval of that median (bootstrap over turns).
On a CPU pin it: taskset -c 1 compare_speed.py ...
"""


def benchmark_times(checkout: Path, arguments: list[str], environment: dict[str, str]) -> dict[str, float]:
    """Seconds by what was measured; of traversal for a million rays."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [sys.executable, str(checkout / "scripts/benchmark.py"), *arguments, "--json", str(report)]
        subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        found = json.loads(report.read_text(encoding="utf-8"))
    if "results" in found:
        return {f"{r['tracer']} {r['rays']} {r['order']}": 1 / r["mrays_per_s"] for r in found["results"]}
    own = found["raybatch"]
    return {"render": own["render"]["seconds"], "tree": own["build"]["seconds"]}


def compile_times(checkout: Path, arguments: list[str], environment: dict[str, str]) -> dict[str, float]:
    """Processor seconds of a first render, all threads and children together."""
    with tempfile.TemporaryDirectory() as folder:
        environment = environment | {"RAYBATCH_KERNEL_CACHE": folder, "WARP_CACHE_PATH": folder}
        out = ["-o", str(Path(folder) / "picture.png"), "--set", "sample_count=1", "--set", "resolution=16x16"]
        command = [sys.executable, str(checkout / "scripts/render.py"), *arguments, *out]
        process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        _, status, usage = os.wait4(process.pid, 0)
        if status:
            raise subprocess.CalledProcessError(status, command)
    return {"first render, processor": usage.ru_utime + usage.ru_stime}


def interval_of_median(ratios: np.ndarray) -> tuple[float, float]:
    """The 95 % interval of the median of `ratios`, by 10,000 resamples."""
    chosen = np.random.default_rng(0).integers(len(ratios), size=(10_000, len(ratios)))
    low, high = np.quantile(np.median(ratios[chosen], 1), (0.025, 0.975))
    return float(low), float(high)


def table_of(kept: list[dict[str, list[float]]]) -> dict[str, dict]:
    """What was measured so far: times before and after [s], the median of their ratios, and its interval."""
    table = {}
    for name, before in kept[0].items():
        ratios = np.array(kept[1][name]) / np.array(before)
        row = {"before": before, "after": kept[1][name], "ratio": float(np.median(ratios))}
        table[name] = row | {"interval": list(interval_of_median(ratios))}
    return table


def main() -> int:
    """The exit code: 1 where an interval lies above 1.03."""
    parser = argparse.ArgumentParser(description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkout", type=Path, nargs=2)
    parser.add_argument("--turns", type=int, default=15)
    parser.add_argument("--compile", action="store_true")
    parser.add_argument("--json", type=Path)
    split = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    options, arguments = parser.parse_args(sys.argv[1:split]), sys.argv[split + 1 :]
    measure = compile_times if options.compile else benchmark_times
    kept: list[dict[str, list[float]]] = [{}, {}]
    table: dict[str, dict] = {}
    for turn in range(-1, options.turns):
        for which in (0, 1) if turn % 2 else (1, 0):
            checkout = options.checkout[which].absolute()
            environment = os.environ | {
                "PYTHONPATH": os.pathsep.join([str(checkout), os.environ.get("PYTHONPATH", "")])
            }
            times = measure(checkout, arguments, environment)
            if turn < 0 and not options.compile:
                continue  # the first compiles
            for name, seconds in times.items():
                kept[which].setdefault(name, []).append(seconds)
        if turn >= 0:
            table = table_of(kept)
            if options.json:
                options.json.write_text(json.dumps(table, indent=1), encoding="utf-8")
    for name, row in table.items():
        low, high = row["interval"]
        before = np.median(row["before"])
        print(f"{name:40s} {before:9.4f} s  x {row['ratio']:.3f}  [{low:.3f}, {high:.3f}]")
    return int(any(row["interval"][0] > 1.03 for row in table.values()))


if __name__ == "__main__":
    sys.exit(main())
