"""What a study of one's own can measure: the columns of its table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from studies.study import Row


@dataclass(frozen=True)
class Measure:
    """A figure of a row."""

    title: str  # the column's head
    about: str
    value: Callable[[Row], float | None]
    is_error: bool = False  # needs a reference


def _entry(name: str, scale: float = 1.0) -> Callable[[Row], float | None]:
    return lambda row: None if row.get(name) is None else row[name] / scale


def _share(name: str) -> Callable[[Row], float | None]:
    return lambda row: row[name] / row["rays"] if row.get(name) is not None and row.get("rays") else None


def _last(name: str) -> Callable[[Row], float | None]:
    return lambda row: row["points"][-1][name] if row.get("points") else None


def _rate(row: Row) -> float | None:
    return row["rays"] / row["seconds"] / 1e6 if row.get("seconds") and row.get("rays") else None


MEASURES: dict[str, Measure] = {
    "seconds": Measure("seconds", "seconds of rendering, trees and compilation not counted", _entry("seconds")),
    "build": Measure("build [s]", "seconds that trees and uploads took; 0 where they were kept", _entry("build")),
    "rays": Measure("rays", "rays that were traced", _entry("rays")),
    "mrays_per_second": Measure("Mrays/s", "millions of rays a second of rendering", _rate),
    "rays_alive": Measure("rays alive", "rays that could be alive at once", _entry("rays_alive")),
    "tree_bytes": Measure("tree [MB]", "nodes and triangles of the tree [MB]", _entry("tree_bytes", 1e6)),
    "treelets": Measure("treelets", "treelets that the tree was cut into", _entry("treelets")),
    "treelet_nodes": Measure("nodes a treelet", "mean nodes of a treelet", _entry("treelet_nodes")),
    "steps": Measure("steps", "turns of the scheduler", _entry("steps")),
    "rays_queued_per_ray": Measure(
        "queued a ray", "how often a ray was put into a queue", _entry("rays_queued_per_ray")
    ),
    "treelet_visits_per_ray": Measure(
        "treelets a ray", "treelets that a ray visited", _entry("treelet_visits_per_ray")
    ),
    "blocks_short": Measure("queues short", "how often the pool of queue blocks ran out", _entry("blocks_short")),
    "bytes_copied": Measure("copied [MB]", "geometry brought to the device [MB]", _entry("bytes_copied", 1e6)),
    "bytes_copied_per_ray": Measure(
        "bytes copied a ray", "geometry brought to the device, over rays [bytes]", _share("bytes_copied")
    ),
    "pages_loaded": Measure("pages", "pages of geometry brought to the device", _entry("pages_loaded")),
    "resident_peak": Measure(
        "held at most [MB]", "most geometry on the device at once, of budgets [MB]", _entry("resident_peak", 1e6)
    ),
    "relmse": Measure("relMSE", "relative mean squared error of the finished picture", _last("relmse"), True),
    "rmse": Measure("RMSE", "root of the mean squared error of the finished picture", _last("rmse"), True),
    "efficiency": Measure(
        "efficiency", "1 / (relMSE x seconds), over the course of the render", _entry("efficiency"), True
    ),
}
