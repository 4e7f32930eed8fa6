"""Law 2 over all settings at once: whatever the schedule, the film is the same, bit for bit."""

import collections
import json
import random

import check_schedules
import pytest
from checking.films import FilmComparer
from checking.schedules import NOT_CHOSEN, NOT_DRAWN, DrawnSizes, SeededDraws, drawn_schedule, part_to_render

from raybatch_addon.core.scene.archive import save_scene
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import SETTINGS
from tests.support import schedule_scenes
from tests.support.schedule_scenes import ESTIMATOR
from tests.support.under_test import DEVICE

# For the plain film, and where `kernel_tier` is AUTO; tracers are as ever
pytestmark = pytest.mark.usefixtures("general_kernels_of_module")
SIZES = DrawnSizes(triangles=5000, tree_bytes=400_000, paths=3000, image_bytes=200_000)
EXAMPLES = 60  # of each scene, in a thorough run
TURNS = 16


@pytest.fixture(scope="module")
def session(device, tmp_path_factory):
    """A session whose files of pages are its own."""
    opened = Session(device, page_folder=tmp_path_factory.mktemp("pages"))
    yield opened
    opened.close()


@pytest.fixture(scope="module")
def comparers(session, pytestconfig):
    turns = TURNS if pytestconfig.option.thorough else TURNS // 2  # of few rays alive: of the rest of the frame
    return {name: FilmComparer(session, make(), ESTIMATOR, turns) for name, make in schedule_scenes.SCENES.items()}


@pytest.mark.parametrize("name", schedule_scenes.SCENES)
def test_the_plain_film_shows_something(comparers, name):
    picture = comparers[name].plain.passes["Combined"]
    assert picture[..., :3].std() > 0.05 and picture[..., :3].min() >= 0
    assert comparers[name].plain.statistics["batching"] is None
    assert comparers[name].plain.statistics["rays"]["shadow"] > 100


@pytest.mark.parametrize("name", schedule_scenes.SCENES)
def test_any_schedule_gives_the_same_film(comparers, name, examples, pytestconfig):
    """Also: every ray that was taken in is finished once, and no sample is invalid."""
    comparer, methods, count = comparers[name], collections.Counter(), examples(EXAMPLES)
    fixed = schedule_scenes.not_drawn(name, pytestconfig.option.thorough)
    wanted = ["unbatched", "batched"]
    # on CUDA the smallest scene is smaller than a page and what stays beside it: no budget makes it wait
    if schedule_scenes.least_budget(DEVICE, name) < comparer.sizes.tree_bytes:
        wanted.append("paged")
    assert DEVICE != "cpu" or "paged" in wanted

    def is_enough() -> bool:
        return methods.total() >= count and min(methods[each] for each in wanted) > count // 8

    numbers = random.Random(name)  # of schedules that have nothing in common
    while not is_enough() and methods.total() < 2 * count:  # a method that chance left out is drawn in the end
        number = numbers.getrandbits(32)
        found = comparer.compare_drawn(SeededDraws(number), fixed)
        methods[found.method] += 1
        if found.differs:
            pytest.fail(
                f"schedule {number}: {found.differs}, region {found.region}, {comparer.simplest(found)} of "
                f"{found.settings}; not drawn: {fixed}"
            )
    assert is_enough(), methods


def test_the_settings_that_make_a_film_wrong_are_found(comparers, monkeypatch):
    comparer = comparers["open"]
    faults, wrong = comparer.faults, {"batching": "ON", "ray_storage": "DIRECT", "queue_size": 7}

    def faulty(film):
        drawn = film.statistics["settings"]
        return faults(film) + ["wrong"] * (drawn["ray_storage"] == "DIRECT" and drawn["queue_size"] == 7)

    monkeypatch.setattr(comparer, "faults", faulty)
    drawn = {**drawn_schedule(SeededDraws(9), comparer.sizes), **schedule_scenes.FIXED["open"], **wrong}
    found = comparer.compare(drawn)
    assert found.differs == ["wrong"] and comparer.simplest(found) == {"ray_storage": "DIRECT", "queue_size": 7}


# --- what is drawn


def test_every_schedule_setting_is_drawn():
    schedule = {name for name, info in SETTINGS.items() if info.effect == "schedule"}
    assert set(drawn_schedule(SeededDraws(0), SIZES)) == schedule - NOT_DRAWN


def test_what_is_drawn_is_legal_and_goes_everywhere():
    seen = collections.defaultdict(set)
    for seed in range(1500):
        drawn = drawn_schedule(SeededDraws(seed), SIZES)
        ESTIMATOR.replace(**drawn)  # raises for what is not legal
        for name, value in drawn.items():
            seen[name].add(value)
    for name, info in SETTINGS.items():
        if name in NOT_DRAWN or info.effect != "schedule":
            continue
        if info.choices:
            assert seen[name] == {each for each, _, _ in info.choices} - set(NOT_CHOSEN.get(name, ())), name
        else:
            assert info.default in seen[name] or name in ("ray_low_water", "ray_high_water", "treelet_size_min"), name
            assert len(seen[name]) > 1, name
    for name in ("ray_count", "queue_size", "queue_count", "treelet_size", "warp_count", "bucket_wait_max"):
        assert 1 in seen[name] and max(seen[name]) > 100, name
    budgets = seen["geometry_budget"] - {0}
    assert min(budgets) < SIZES.tree_bytes // 30 and max(budgets) > SIZES.tree_bytes


def test_a_seed_repeats_what_it_drew():
    assert (
        drawn_schedule(SeededDraws(3, 4), SIZES)
        == drawn_schedule(SeededDraws(3, 4), SIZES)
        != drawn_schedule(SeededDraws(3, 5), SIZES)
    )


@pytest.mark.parametrize(
    "change", [dict(ray_count=1), dict(tile_size=1), dict(ray_high_water=0.0, ray_low_water=0.0), {}], ids=str
)
def test_with_few_rays_alive_a_part_is_rendered(change):
    frame = schedule_scenes.frame(100, 60)
    part = part_to_render(SeededDraws(1), frame, ESTIMATOR.replace(**change), 24)
    x0, y0, x1, y1 = part.region
    assert 0 <= x0 < x1 <= 100 and 0 <= y0 < y1 <= 60
    assert (part == frame) == (not change) and (
        not change or (x1 - x0) * (y1 - y0) * ESTIMATOR.sample_count <= 24 * ESTIMATOR.sample_count
    )


# --- the script, which draws what other kernels are not compiled for

NOT_DRAWN_OF_CLOSED = [
    word for name, value in schedule_scenes.FIXED["closed"].items() for word in ("--set", f"{name}={value}")
]


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    path = tmp_path_factory.mktemp("scenes") / "closed.scene.npz"
    save_scene(path, schedule_scenes.closed_scene(), ESTIMATOR)
    return path


def run(capfd, *arguments):
    code = check_schedules.main([*map(str, arguments), "--json"])
    captured = capfd.readouterr()
    return code, json.loads(captured.out) if captured.out else {}, captured.err


@pytest.mark.usefixtures("cpu_compiler")
def test_the_script_finds_nothing_where_all_is_well(saved, device, capfd):
    code, report, reported = run(
        capfd,
        "--scene",
        saved,
        saved,
        "--device",
        device,
        "--count",
        4,
        "--size",
        12,
        "--samples",
        1,
        "--seed",
        5,
        *NOT_DRAWN_OF_CLOSED,
    )
    assert code == 0 and report["faults"] == 0 and report["compared"] == 8 and report["seed"] == 5
    assert [scene["frame"] for scene in report["scenes"]] == [[12, 9]] * 2
    assert (
        report["scenes"][0]["methods"] == report["scenes"][1]["methods"]
        and sum(report["scenes"][0]["methods"].values()) == 4
    )
    assert "closed.scene.npz: the plain film" in reported


def test_the_script_reports_what_differs(saved, device, capfd, monkeypatch):
    """A film that is wrong in its last bit alone, and a render that fails."""
    render = Session.render

    def wrong(self, scene, drawn=None, **more):
        film = render(self, scene, drawn, **more)
        if drawn.batching == "ON":
            film.sums.window[0, 0] += 1
        return film

    monkeypatch.setattr(Session, "render", wrong)
    options = (
        "--scene",
        saved,
        "--device",
        device,
        "--count",
        3,
        "--size",
        8,
        "--samples",
        1,
        "--set",
        "batching=ON",
        "--set",
        "geometry_budget=0",
        *NOT_DRAWN_OF_CLOSED,
    )
    code, report, reported = run(capfd, *options)
    assert code == 1 and report["faults"] == 3 and report["scenes"][0]["faults"][0]["simplest"] == {"batching": "ON"}
    first = report["scenes"][0]["faults"][0]
    assert (
        first["differs"][-1] == "exact sums differ"
        and first["settings"]["batching"] == "ON"
        and '"queue_size"' in reported
    )

    def fails(self, scene, drawn=None, **more):
        if drawn.batching == "ON":
            raise AssertionError("a ray is in two places")
        return render(self, scene, drawn, **more)

    monkeypatch.setattr(Session, "render", fails)
    code, report, reported = run(capfd, *options)
    assert code == 1 and report["scenes"][0]["faults"][0]["differs"] == ["AssertionError: a ray is in two places"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--count", 0), "--count 0 is not valid"),
        (("--set", "seed=3"), "seed is not drawn"),
        (("--set", "device=cpu"), "device is not drawn"),
        (("--set", "colour=red"), "no setting is called"),
    ],
)
def test_the_script_says_what_is_wrong_with_its_options(saved, capfd, options, words):
    code, _, reported = run(capfd, "--scene", saved, *options)
    assert code == 1 and words in reported


def test_the_script_wants_saved_scenes(tmp_path, capfd):
    code, _, reported = run(capfd, "--scene", tmp_path / "a.blend")
    assert code == 1 and "render.py --save-scene" in reported
