"""Trees over time: what things that move far cost the rays of a tree, and what each way to bound them saves."""

from __future__ import annotations

import statistics
import time
from pathlib import Path

import numpy as np

from raybatch_addon.core.bvh.build.scene_tree import BuiltTree
from raybatch_addon.core.bvh.node import VECTOR_BYTES, Layout, decode_children
from raybatch_addon.core.bvh.treelets.links import ranges
from raybatch_addon.core.device.devices import find_device
from raybatch_addon.core.scene.motion import KEY_FLOATS, maps_at
from studies.bench import Bench
from studies.motion.moving import SCENES, AimedRays, aimed_rays, part_of_time, still_at
from studies.motion.traced import Traced, built_tree, trace
from studies.motion.twin import Nodes, entry_boxes, linear_nodes, mesh_nodes, split_in_time, walk
from studies.pages import device_title, machine, table
from studies.study import Case, Options, Report, Row, Study

RANGES = (1, 2, 4, 8)
PARTS = 8
WAYS = {
    "still": "still, at mid-shutter",
    **{
        f"ranges {count}": f"{count} ranges" if count > 1 else "1 range: boxes around all of the time"
        for count in RANGES
    },
    "chosen": "as many ranges as pay",
    "apart": f"{PARTS} trees, each built for its part of the time",
    "one, walked": "walked: 1 range",
    "two boxes, walked": "walked: two boxes a child, mixed by the ray's time",
    "split, walked": "walked: things split in time within one top level",
}


def cases(options: Options) -> list[Case]:
    """Ways take turns; what was not built is walked on a CPU alone."""
    return [
        Case(f"{name}, {way}", name, {"scene": name, "way": way})
        for name in SCENES
        for way in WAYS
        if not (options.is_cuda and way.endswith("walked"))
        if not (name == "grass that sways" and way == "split, walked")
    ]


def measure(case: Case, turn: int, bench: Bench) -> Row:
    """Rays through the trees of one way, the first of which say what is hit."""
    options, device = bench.options, find_device(bench.options.device)
    name, way = case.what["scene"], case.what["way"]
    scene = bench.scene(name, lambda: SCENES[name](options.quick))
    count = options.pick(2000, 1_000_000 if options.is_cuda else 20_000)
    whole = built_tree(scene, device, 1)
    assert whole.box is not None, "the box of a tree"
    rays = aimed_rays(whole.box, count)
    if way.endswith("walked"):
        return _walked(way, whole, rays, trace(whole, rays, device, runs=0))
    if way == "apart":
        found = []
        for k in range(PARTS):
            some = np.flatnonzero((rays.time * PARTS).astype(int) == k)
            aimed = rays.at(some)._replace(time=(rays.time[some] * PARTS - k).astype(np.float32))
            part = built_tree(part_of_time(scene, k / PARTS, (k + 1) / PARTS), device, 1)
            found.append(trace(part, aimed, device))
        return _row(found, count)
    start = time.perf_counter()
    if way == "still":
        built = built_tree(still_at(scene, 0.5), device, 1)
    else:
        built = built_tree(scene, device, None if way == "chosen" else int(way.split()[1]))
    seconds = time.perf_counter() - start
    size = built.tree.nodes.size + built.tree.triangles.size - built.top_room
    size += built.top_first[-1] * built.layout.node_words // 4
    return {
        **_row([trace(built, rays, device)], count),
        "ranges": built.tree.top_ranges,
        "bytes": VECTOR_BYTES * size,
        "build": seconds,
    }


def _row(found: list[Traced], count: int) -> Row:
    return {
        "nodes": sum(each.nodes for each in found) / count,
        "triangles": sum(each.triangles for each in found) / count,
        "ns": 1e9 * sum(each.seconds for each in found) / count,
    }


def _walked(way: str, built: BuiltTree, rays: AimedRays, met: Traced) -> Row:
    """What rays would visit: in the top level, and in the mesh that deforms, or the trees of what is entered."""
    top, runs, order = _top_nodes(way, built)
    visits, ray, leaf = walk(top, rays, met.t.astype(np.float64))
    first, several = runs[leaf].T
    ray, entry = np.repeat(ray, several), order[ranges(first, several)]
    nodes, triangles = visits, 0
    moved, turned = _maps_of(built, rays, ray, entry)
    assert built.entry_mesh is not None, "the meshes of entries"
    for mesh in range(len(built.meshes)):
        some = np.flatnonzero(built.entry_mesh[entry] == mesh)
        made, held = mesh_nodes(built, mesh)
        if not way.startswith("two boxes"):
            made.box = _over_all(made.box)
        own = AimedRays(moved[some], turned[some], rays.time[ray[some]])
        visits, _, leaf = walk(made, own, met.t[ray[some]].astype(np.float64))
        nodes += visits
        triangles += int(held[leaf].sum())
    return {"nodes": nodes / len(rays.time), "triangles": triangles / len(rays.time)}


def _top_nodes(way: str, built: BuiltTree) -> tuple[Nodes, np.ndarray, np.ndarray]:
    """The top level, and what its leaves list: first and count of each in an array, then that."""
    if way.startswith("split"):
        entries = np.arange(built.tree.entry_count)
        return split_in_time(built), np.stack([entries, np.ones_like(entries)], 1), entries
    width, first = Layout.BOXES.node_words, built.tree.top_node
    words = built.tree.nodes.numpy().ravel()[width * first : width * (first + built.top_first[-1])].reshape(-1, width)
    boxes = entry_boxes(built) if way.startswith("two boxes") else entry_boxes(built, 0.0)
    order, children = built.tree.top_entry.numpy(), decode_children(Layout.BOXES, words)
    is_leaf = children.count > 0
    runs = np.stack([children.first[is_leaf], children.count[is_leaf]], 1)
    ends = np.stack([runs[:, 0], runs.sum(1)], 1).ravel()
    listed = np.concatenate([boxes[:, order], boxes[:, order[-1:]]], 1)
    around = [way.reduceat(listed[:, :, k], ends, 1)[:, ::2] for k, way in enumerate((np.minimum, np.maximum))]
    return linear_nodes(words, np.stack(around, 2)), runs, order


def _over_all(box: np.ndarray) -> np.ndarray:
    return np.stack([box[..., 0, :].min(0), box[..., 1, :].max(0)], -2)[None]


def _maps_of(built: BuiltTree, rays: AimedRays, ray: np.ndarray, entry: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rays in the spaces of entries, at their times."""
    from_world = built.tree.entry_from_world.numpy().astype(np.float64)[entry]
    row = built.tree.entry_motion.numpy()[entry]
    keys = built.tree.motion_keys.numpy().reshape(-1, built.tree.motion_steps, KEY_FLOATS)
    for each in np.unique(row[row >= 0]):
        some = np.flatnonzero(row == each)
        maps = maps_at(keys[each][None], rays.time[ray[some]])[0]
        linear = np.linalg.inv(maps[:, :, :3])
        from_world[some, :, :3] = linear
        from_world[some, :, 3] = -np.einsum("nij,nj->ni", linear, maps[:, :, 3])
    origin, direction = rays.origin[ray].astype(np.float64), rays.direction[ray].astype(np.float64)
    moved = np.einsum("nij,nj->ni", from_world[:, :, :3], origin) + from_world[:, :, 3]
    return moved, np.einsum("nij,nj->ni", from_world[:, :, :3], direction)


def fragment(reports: dict[str, Report]) -> str:
    """A table of every device."""
    lines = [*(f"- {machine(report)}" for report in reports.values()), ""]
    rows = []
    for report in reports.values():
        for name in SCENES:
            found = {way: [r for r in report["rows"] if (r["scene"], r["way"]) == (name, way)] for way in WAYS}
            for way, what in WAYS.items():
                if found[way]:
                    rows.append([device_title(report), name, what, *_figures(found[way], found)])
    head = ["device", "scene", "trees", "nodes a ray", "triangles a ray", "ns a ray", "MB", "build s", "nodes over"]
    return "\n".join([*lines, table(head, rows)])


def _figures(own: list[Row], all_ways: dict[str, list[Row]]) -> list[str]:
    def median(rows: list[Row], key: str) -> float | None:
        values = [row[key] for row in rows if row.get(key) is not None]
        return statistics.median(values) if values else None

    walked = own[0]["way"].endswith("walked")
    one = median(all_ways["one, walked" if walked else "ranges 1"], "nodes")
    nodes, ns, size, build = (median(own, key) for key in ("nodes", "ns", "bytes", "build"))
    return [
        f"{nodes:.2f}" + (f" ({own[0]['ranges']})" if own[0]["way"] == "chosen" else ""),
        f"{median(own, 'triangles'):.1f}",
        f"{ns:.0f}" if ns else "",
        f"{size / 1e6:.2f}" if size else "",
        f"{build:.2f}" if build else "",
        f"{one / nodes:.2f}" if one and nodes else "",
    ]


def draw(reports: dict[str, Report], folder: Path) -> None:
    """Draws nothing: a table says it all."""


ABOUT = "things that move far while the shutter is open: nodes and time a ray, by how trees bound them"
STUDY = Study("trees-over-time", ABOUT, cases, measure, fragment, draw, turns=(1, 3))
