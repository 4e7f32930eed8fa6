"""Everything that a render writes is documented: in memory, batched, and beyond memory."""

import re
from pathlib import Path

import pytest

from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import schedule_scenes

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")
# of pages, where something is wrong, or where several devices hold them
NOT_ALWAYS = {"large_treelets", "page_file_warning", "store_warning", "peer_count", "peer_bytes", "host_bytes"}
TEXT = (Path(__file__).resolve().parents[3] / "docs/statistics.md").read_text(encoding="utf-8")
RENDERS = {
    "unbatched": dict(batching="OFF", ray_sort="ON", counters="ON"),
    "batched": dict(batching="ON", treelet_size=2, counters="ON"),
    "host": dict(geometry_store="HOST"),
    "disk": dict(geometry_store="DISK", counters="ON"),
}
# Objects whose keys are explained elsewhere, or are names of what is counted
OPEN = {"settings", "auto", "versions"}


def section(title: str) -> str:
    """From the heading `title` to the next one."""
    start = TEXT.index(f"# {title}\n")
    end = re.compile(r"^#", re.MULTILINE).search(TEXT, start + 2)
    return TEXT[start : end.start() if end else len(TEXT)]


def assert_documented(names, text: str) -> None:
    for name in names:
        assert f"`{name}`" in text, name


@pytest.mark.parametrize("kind", RENDERS)
def test_everything_is_documented_where_it_belongs(device, tmp_path, kind):
    paged = kind in ("host", "disk")
    settings = RenderSettings(sample_count=1, bounce_max=2, **RENDERS[kind])
    if paged:
        settings = settings.replace(batching="ON", geometry_budget=schedule_scenes.least_budget(device) + 500)
    session = Session(device, page_folder=tmp_path)
    reported = session.render(schedule_scenes.mixed_scene(), settings).statistics
    session.close()
    tree = reported["tree"]
    assert ("pages" in tree, "cut" in tree, reported["batching"] is None) == (
        paged,
        kind == "batched",
        kind == "unbatched",
    )
    assert (reported["ray_sort"] is None) == (kind != "unbatched")
    assert_documented(reported, TEXT)
    for name, value in reported.items():
        if isinstance(value, dict) and name not in OPEN | {"tree", "counters", "ray_sort"}:
            assert_documented(value, TEXT)
    text = section("Tree") + (section("Pages") if paged else section("Treelets in memory"))
    assert_documented(tree, text)
    assert_documented(tree.get("cut", {}), section("Treelets in memory"))


def test_what_is_documented_of_pages_and_treelets_is_there(device, tmp_path):
    """But for warnings, where nothing is wrong, and what several devices have (`test_pages_of_peers.py`)."""
    session = Session(device, page_folder=tmp_path)
    budget = schedule_scenes.least_budget(device) + 500
    found = {}
    for title, change in (("Pages", dict(geometry_budget=budget, geometry_store="DISK")), ("Treelets in memory", {})):
        tree = session.render(
            schedule_scenes.mixed_scene(), RenderSettings(sample_count=1, batching="ON", **change)
        ).statistics["tree"]
        found[title] = tree.get("cut", tree)
    session.close()
    for title, written in found.items():
        rows = [line.split("|")[1] for line in section(title).splitlines() if line.startswith("| `")]
        names = set(re.findall(r"`(\w+)`", " ".join(rows)))
        assert names - NOT_ALWAYS <= set(written), title


def test_bytes_of_a_paged_tree_are_what_was_built(device):
    session = Session(device)
    budget = schedule_scenes.least_budget(device) + 500
    reported = session.render(
        schedule_scenes.mixed_scene(),
        RenderSettings(sample_count=1, batching="ON", geometry_budget=budget, geometry_store="HOST"),
    ).statistics
    session.close()
    tree = reported["tree"]
    assert tree["pages"] > 1 and tree["bytes"] >= tree["node_bytes"] + tree["triangle_bytes"]
    assert tree["page_bytes"] <= budget and reported["resident_peak"] <= budget
    assert reported["schedule"]["bytes_per_path"] > 0
