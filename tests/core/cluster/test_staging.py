"""Parts of a scene on their way to machines of which some cannot keep them, and what a render says befell it."""

from types import SimpleNamespace

import numpy as np
import pytest

from raybatch_addon.core.cluster import staging as staging_module
from raybatch_addon.core.cluster.connection import ClusterError, Worker
from raybatch_addon.core.cluster.parts import SceneParts
from raybatch_addon.core.cluster.report import events as events_module
from raybatch_addon.core.cluster.report.events import ClusterEvents
from raybatch_addon.core.cluster.staging import LEFT_OUT_SECONDS, RETURN_SECONDS, LeftOut, Staging

WORKERS = [Worker(f"tcp://{host}:1", host, 1) for host in ("a", "b")]
PARTS = SceneParts("{}", {"one": np.zeros(3), "two": np.ones(4)})


class Cluster:
    """A connection to workers that answer at once; those of `full` machines cannot keep a part."""

    def __init__(self, *full):
        self.full, self.asked, self.known, self.slow = set(full), [], set(), set()
        self.busy = []  # hosts that do not answer in time, as often as they are here

    def submit(self, name, *_arguments, workers, priority):
        host = workers[0].removeprefix("tcp://").removesuffix(":1")
        self.asked.append((name, host))
        found = ["one", "two"] if name == "lacks" else 2
        done = lambda: name == "lacks" or host not in self.slow  # noqa: E731
        if name == "put" and host in self.busy:
            self.busy.remove(host)
            return SimpleNamespace(done=done, status="finished", result=lambda timeout: late())
        if name == "put" and host in self.full:
            found = {"error": "StoreError", "text": "No space left on device"}
        return SimpleNamespace(done=done, status="finished", result=lambda timeout: found)

    def known_hosts(self, seconds):
        assert seconds == RETURN_SECONDS
        return self.known

    def send(self, arrays, _worker):
        return arrays


def late():
    raise TimeoutError


@pytest.fixture
def clock(monkeypatch):
    now = SimpleNamespace(seconds=0.0)
    monkeypatch.setattr(staging_module.time, "monotonic", lambda: now.seconds)
    return now


def steps(staging, workers=WORKERS, count=12):
    for _ in range(count):
        staging.step(workers)


def test_a_machine_that_cannot_keep_parts_is_left_out_for_a_while(clock):
    cluster, events = Cluster("b"), ClusterEvents()
    left_out = LeftOut(events)
    staging = Staging(cluster, PARTS, left_out)
    steps(staging)
    assert staging.ready == {"a"} and "b" in left_out
    assert cluster.asked.count(("put", "b")) == 3
    (event,) = events.all
    assert (event["kind"], event["who"]) == ("MACHINE_LEFT_OUT", "b") and "No space left" in event["text"]
    cluster.full.clear()
    steps(staging)
    assert staging.ready == {"a"}
    clock.seconds = LEFT_OUT_SECONDS
    steps(staging)
    assert staging.ready == {"a", "b"} and not left_out.hosts


def test_it_is_left_out_in_the_next_round_too(clock):
    cluster, left_out = Cluster("b"), LeftOut(ClusterEvents())
    steps(Staging(cluster, PARTS, left_out))
    cluster.asked.clear()
    steps(Staging(cluster, PARTS, left_out))
    assert {host for _, host in cluster.asked} == {"a"}


def test_failures_before_a_machine_had_the_scene_do_not_count(clock):
    cluster, left_out = Cluster("a"), LeftOut(ClusterEvents())
    for _ in range(4):
        staging = Staging(cluster, PARTS, left_out)
        cluster.full = {"a"}
        steps(staging, count=1)
        cluster.full = set()
        steps(staging)
        assert staging.ready == {"a", "b"}


def test_a_machine_that_does_not_answer_in_time_is_asked_again(clock):
    cluster, left_out = Cluster(), LeftOut(ClusterEvents())
    cluster.busy = ["b"] * 7
    staging = Staging(cluster, PARTS, left_out)
    steps(staging)
    assert staging.ready == {"a", "b"} and not left_out.hosts and not cluster.busy


def test_a_machine_that_is_left_out_while_parts_come_is_asked_again(clock):
    cluster, left_out = Cluster(), LeftOut(ClusterEvents())
    staging, cluster.slow = Staging(cluster, PARTS, left_out), {"b"}
    steps(staging, count=3)
    left_out.count("b", "b cannot merge", is_certain=True)
    cluster.slow = set()
    steps(staging, count=3)
    assert staging.ready == {"a"}
    clock.seconds = LEFT_OUT_SECONDS
    steps(staging)
    assert staging.ready == {"a", "b"}


def test_machines_that_fail_again_and_again_end_the_render(clock):
    """One after another, so that they are never left out at the same time."""
    left_out = LeftOut(ClusterEvents())
    for host in ("a", "b", "a"):
        left_out.count(host, f"{host} has no room", is_certain=True)
        clock.seconds += LEFT_OUT_SECONDS
        left_out.see({"a", "b"}, set())
    left_out.note_work()
    for host in ("b", "a", "b"):
        left_out.count(host, f"{host} has no room", is_certain=True)
        clock.seconds += LEFT_OUT_SECONDS
        left_out.see({"a", "b"}, set())
    left_out.count("a", "a has no room", is_certain=True)
    with pytest.raises(ClusterError, match="a has no room"):
        left_out.see({"a", "b"}, set())


def test_parts_that_are_missing_do_not_forgive_what_failed_otherwise(clock):
    cluster, left_out = Cluster(), LeftOut(ClusterEvents())
    staging = Staging(cluster, PARTS, left_out)
    for _ in range(3):
        steps(staging)
        staging.again()
        left_out.count("b", "b cannot render")
    assert left_out.hosts == {"b"}


def test_no_machine_that_can_keep_parts_is_an_error(clock):
    for workers in (WORKERS, WORKERS[1:]):
        staging = Staging(Cluster("a", "b"), PARTS, LeftOut(ClusterEvents()))
        with pytest.raises(ClusterError, match="b cannot keep the scene: No space left on device"):
            steps(staging, workers)


def test_a_machine_that_went_may_come_back(clock):
    """It went before it had the scene, and the one that is left cannot keep it: the render waits, but not for ever."""
    cluster = Cluster("b")
    staging = Staging(cluster, PARTS, LeftOut(ClusterEvents()))
    cluster.known = {"a", "b"}
    steps(staging, WORKERS[1:])
    assert not staging.ready
    cluster.known = {"b"}
    with pytest.raises(ClusterError, match="b cannot keep the scene"):
        steps(staging, WORKERS[1:])
    steps(staging, WORKERS[:1])
    assert staging.ready == {"a"}


def test_work_goes_to_machines_that_are_not_left_out(clock):
    left_out = LeftOut(ClusterEvents())
    for _ in range(3):
        assert left_out.others(["a", "b"]) is None  # any may have it
        left_out.count("b", "b cannot do its part")
    assert left_out.others(["a", "b"]) == {"a"} and left_out.others(["b"]) is None
    assert left_out.why == "b cannot do its part"
    left_out.count("a", "a has no room for kernels", is_certain=True)
    assert left_out.hosts == {"a", "b"}


def test_workers_that_go_and_come_are_noted():
    events = ClusterEvents()
    for addresses, silent in ((["a", "b"], []), (["a"], []), (["a", "c"], []), (["c"], ["a"]), (["c"], ["a"])):
        events.see_workers(addresses, silent)
    assert [(each["kind"], each["who"]) for each in events.all] == [
        ("WORKER_GONE", "b"),
        ("WORKER_CAME", "c"),
        ("WORKER_SILENT", "a"),
    ]


def test_a_report_has_the_first_events_and_the_number_of_others(monkeypatch):
    monkeypatch.setattr(events_module, "EVENTS_MOST", 3)
    events = ClusterEvents()
    for number in range(5):
        events.note("TASK_LOST", str(number), "its worker ended")
    assert [each["who"] for each in events.all] == ["0", "1", "2"] and events.left_out == 2
