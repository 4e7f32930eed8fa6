"""Measure RayBatch.

python scripts/benchmark.py render SCENE [--samples N] [--bounces N] [--size WxH] [--runs R] [--device D] [--against cycles] [--json [FILE]] [--picture PNG]

SCENE is a .blend (needs bpy) or a .scene.npz (does not). Runs of RayBatch and of Cycles alternate; medians are reported, with the
spread (largest less smallest, over the median). RayBatch's first run, with compilation, is reported apart. Cycles renders with the
same samples and bounces, without adaptive sampling, denoising, clamping or any other bias, and on the CPU. Its time is that of
the whole render call; RayBatch's is given likewise, and for its stages.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.scene.archive import load_scene
from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings import RenderSettings


def summary(seconds: list[float]) -> dict[str, Any]:
    """Median and spread of several runs."""
    middle = statistics.median(seconds)
    return {"seconds": round(middle, 4), "spread": round((max(seconds) - min(seconds)) / middle, 3), "runs": len(seconds)}


def make_cycles_unbiased(scene, samples: int, bounces: int) -> None:
    """Cycles without shortcuts: what is left is noise."""
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.samples = samples
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0
    cycles.blur_glossy = cycles.light_sampling_threshold = 0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    for name in ("max_bounces", "diffuse_bounces", "glossy_bounces", "transmission_bounces"):
        setattr(cycles, name, bounces)


class BlendFile:
    """A .blend, exported once; Cycles renders it as it is."""

    def __init__(self, path: Path, given: argparse.Namespace):
        import bpy

        import raybatch_addon
        from raybatch_addon.export.scene import export_scene
        from raybatch_addon.export.settings import settings_from

        raybatch_addon.register()
        bpy.ops.wm.open_mainfile(filepath=str(path.resolve()))
        self._bpy, self._scene = bpy, bpy.context.scene
        if given.size:
            self._scene.render.resolution_x, self._scene.render.resolution_y = given.size
            self._scene.render.resolution_percentage = 100
        self._scene.render.engine = "RAYBATCH"
        depsgraph = bpy.context.evaluated_depsgraph_get()
        start = time.perf_counter()
        self.scene = export_scene(depsgraph)
        self.export_seconds = time.perf_counter() - start
        self.settings = settings_from(self._scene)

    def cycles(self, samples: int, bounces: int) -> float:
        """Seconds of one render by Cycles."""
        make_cycles_unbiased(self._scene, samples, bounces)
        self._scene.render.engine = "CYCLES"
        start = time.perf_counter()
        self._bpy.ops.render.render()
        return time.perf_counter() - start


def measure_render(given: argparse.Namespace) -> dict[str, Any]:
    """The report of `benchmark.py render`."""
    blend = None
    if given.scene.suffix == ".blend":
        blend = BlendFile(given.scene, given)
        scene, settings = blend.scene, blend.settings
    else:
        scene, settings = load_scene(given.scene)
    settings = settings.replace(sample_count=given.samples, bounce_max=given.bounces)
    if given.against and blend is None:
        raise RayBatchError("--against cycles needs a .blend")
    session = Session(given.device, settings)
    cold = timed_render(session, scene, settings)
    runs, cycles = [], []
    for _ in range(given.runs):
        runs.append(timed_render(session, scene, settings))
        if given.against:
            cycles.append(blend.cycles(given.samples, given.bounces))
    if given.picture:
        save_picture(cold["film"], given.picture)
    statistics_of = runs[-1]["film"].statistics
    report = {
        "scene": given.scene.name,
        "device": statistics_of["device"],
        "versions": statistics_of["versions"],
        "frame": statistics_of["frame"],
        "triangles": statistics_of["triangles"],
        "samples_per_pixel": given.samples,
        "bounces": given.bounces,
        "rays": statistics_of["rays"],
        "invalid_samples": statistics_of["invalid_samples"],
        "export_s": round(blend.export_seconds, 4) if blend else None,
        "cold": {"seconds": round(cold["seconds"], 3), "stages": cold["film"].statistics["seconds"]},
        "raybatch": summary([run["seconds"] for run in runs])
        | {stage: summary([run["film"].statistics["seconds"][stage] for run in runs]) for stage in ("build", "render")},
    }
    if cycles:
        report["cycles"] = summary(cycles)
        ratios = [run["seconds"] / other for run, other in zip(runs, cycles)]
        report["raybatch_over_cycles"] = round(statistics.median(ratios), 3)
    return report


def timed_render(session: Session, scene: Scene, settings: RenderSettings) -> dict[str, Any]:
    """One whole render, tree included: caches of geometry are given back first."""
    session.close()
    start = time.perf_counter()
    film = session.render(scene, settings)
    return {"seconds": time.perf_counter() - start, "film": film}


def save_picture(film, path: Path) -> None:
    """The combined pass as an 8-bit sRGB picture."""
    import numpy as np
    from PIL import Image

    linear = np.clip(np.flipud(film.passes["Combined"][..., :3]), 0, 1)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    Image.fromarray(np.round(srgb * 255).astype(np.uint8)).save(path)


def size(text: str) -> tuple[int, int]:
    """WxH in pixels."""
    width, _, height = text.partition("x")
    return int(width), int(height)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    render = commands.add_parser("render", help="whole renders, beside Cycles when asked")
    render.add_argument("scene", type=Path)
    render.add_argument("--samples", type=int, default=16)
    render.add_argument("--bounces", type=int, default=7)
    render.add_argument("--size", type=size, help="WxH; default: the file's")
    render.add_argument("--runs", type=int, default=3)
    render.add_argument("--device", default="AUTO")
    render.add_argument("--against", choices=("cycles",))
    render.add_argument("--json", nargs="?", const="-", help="write the report as JSON; without FILE to standard output, and nothing else there")
    render.add_argument("--picture", type=Path, help="save the picture as PNG")
    given = parser.parse_args()
    try:
        report = measure_render(given)
    except RayBatchError as error:
        print(f"benchmark.py: {error}", file=sys.stderr)
        return 1
    text = json.dumps(report, indent=1)
    if given.json and given.json != "-":
        Path(given.json).write_text(text + "\n", encoding="utf-8")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
