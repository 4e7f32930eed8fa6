#!/usr/bin/env python3
"""What long shader programs cost: a plane whose colour comes out of a chain of nodes, beside the same folded by hand
into one node.

    python scripts/benchmarking/program_cost.py [--nodes N] [--device D] [--samples N] [--repeats N]

Each node of the chain multiplies by a factor and adds a term; by hand that is one factor and one term. Both are
rendered in turns, and beside them a plane of a constant colour, which has no program; the smallest times count. Also
reported: by how much the pictures differ.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

import numpy as np
from lib.command import UsageError, exit_code


def argument_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="program_cost.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--nodes", type=int, default=500, metavar="N", help="nodes of the chain")
    parser.add_argument("--device", default="AUTO", help="AUTO, cpu or cuda:N")
    parser.add_argument("--samples", type=int, default=64, metavar="N", help="samples a pixel")
    parser.add_argument("--repeats", type=int, default=3, metavar="N", help="renders of each kind; the fastest counts")
    return parser


def chain(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Factors and terms of `count` nodes, whose product stays near 1 and whose sum stays near 0: float64, shape [count]
    each.
    """
    rng = np.random.default_rng(1)
    factors = np.exp(rng.uniform(-0.1, 0.1, count))
    factors[1::2] = 1 / factors[: 2 * (count // 2) : 2]
    return factors, rng.uniform(-1, 1, count) / count


def scenes_of(count: int):
    """The plane with the chain, folded by hand, and of one colour."""
    from raybatch_addon.core.programs import ops  # noqa: F401  its files register ops
    from raybatch_addon.core.programs.builder import ProgramBuilder
    from raybatch_addon.core.programs.ops.values.math import MathOperation
    from raybatch_addon.core.scene.description import ClosureKind, Frame, Material
    from tests.support import scenes

    factors, terms = chain(count)
    whole, sum_of_terms = 1.0, 0.0
    for factor, term in zip(factors, terms):
        whole, sum_of_terms = whole * factor, sum_of_terms * factor + term

    def by(steps) -> Material:
        builder = ProgramBuilder()
        value = builder.value("average", builder.value("generated", 0))
        for factor, term in steps:
            value = builder.value("math", MathOperation.MULTIPLY_ADD, 0, value, factor, term)
        builder.closure("emission", builder.value("splat", value))
        return Material("chain", kinds=(ClosureKind.EMISSION,), program=builder.finish())

    plane = dataclasses.replace(scenes.plane(), texture_space=((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)))
    view = scenes.camera(eye=(0, -1e-3, 3), half_width=0.3)
    materials = by(zip(factors, terms)), by([(whole, sum_of_terms)]), scenes.emitter(0.5)
    return [
        scenes.scene([(plane, scenes.IDENTITY, material)], view=view, frame=Frame(256, 256)) for material in materials
    ]


def run(given: argparse.Namespace) -> int:
    """The exit code; raises `RayBatchError`."""
    from raybatch_addon.core.session import Session
    from raybatch_addon.core.settings.settings import RenderSettings

    if min(given.nodes, given.samples, given.repeats) < 1:
        raise UsageError("--nodes, --samples and --repeats must be at least 1")
    settings = RenderSettings(sample_count=given.samples, bounce_max=0, nee="OFF")
    names, times, pictures = ("chain", "folded by hand", "constant"), ([], [], []), []
    with contextlib.closing(Session(given.device)) as session:
        scenes = scenes_of(given.nodes)
        pictures = [session.render(scene, settings).passes["Combined"] for scene in scenes]
        for _ in range(given.repeats):
            for scene, mine in zip(scenes, times):
                start = time.perf_counter()
                session.render(scene, settings)
                mine.append(time.perf_counter() - start)
    best = [min(mine) for mine in times]
    points = 256 * 256 * given.samples
    for name, seconds in zip(names, best):
        print(f"{name:16}{seconds:8.3f} s  {seconds / best[1]:6.2f} x")
    print(f"a node of the chain: {(best[0] - best[1]) / points / max(given.nodes - 1, 1) * 1e9:.3g} ns a sample")
    print(f"largest difference of the pictures: {np.abs(pictures[0] - pictures[1]).max():.3g}")
    return 0


def main(arguments: list[str] | None = None) -> int:
    """The exit code."""
    given = argument_parser().parse_args(arguments)
    return exit_code("program_cost.py", lambda: run(given))


if __name__ == "__main__":
    sys.exit(main())
