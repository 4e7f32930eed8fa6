"""The protocol of queues under thousands of drawn orders of accesses: no token is lost, none is in two places, no entry
is read before it was published, all warps come to an end, and no queue is left waiting.
"""

import random

import pytest

from raybatch_addon.core.wavefront.streaming.queues import FAIR_TURNS, Queue
from tests.core.wavefront.streaming.protocol import ROUNDS, Shared, warp

DRAWS = 4500  # in a thorough run
STEPS_MOST = 60_000  # of all warps together; a run takes some thousands


def run(seed: int, fault: str = "", **sizes) -> Shared:
    """A launch in which chance decides who takes the next step: all warps alike, or some far more often."""
    numbers = random.Random(seed)
    drawn = {
        "path_count": numbers.randint(1, 9),
        "treelet_count": numbers.choice((0, 0, 1, 3)),
        "treelet_places": numbers.choice((2, 4)),
        "batch": numbers.randint(1, 4),
        "full": numbers.randint(1, 3),
        "limit": numbers.randint(0, 12),
    }
    shared = Shared(**(drawn | sizes), fault=fault)
    warps = [warp(number, shared, numbers) for number in range(numbers.randint(1, 5))]
    weights = [numbers.choice((1.0, 1.0, 0.01)) for _ in warps]
    for _ in range(STEPS_MOST):
        if not warps:
            break
        chosen = numbers.choices(range(len(warps)), weights)[0]
        try:
            next(warps[chosen])
        except StopIteration:
            del warps[chosen], weights[chosen]
    assert not warps, "a launch does not come to its end"
    return shared


def check(shared: Shared) -> None:
    """Nothing is lost or left behind."""
    assert sorted(shared.items) == list(range(shared.limit)) and shared.ended == shared.limit
    assert shared.alive == 0 and set(shared.holder) == {None}
    assert [shared.tail[q] - shared.head[q] for q in range(len(shared.size))] == shared.size
    assert shared.size[Queue.GENERATE] == shared.path_count == sum(shared.size)
    assert shared.room == [shared.treelet_places] * shared.treelet_count
    for ring, head, tail in zip(shared.ring, shared.head, shared.tail, strict=True):
        turns = [ring[ticket % len(ring)][0] for ticket in range(head, head + len(ring))]
        assert turns == [ticket + (ticket < tail) for ticket in range(head, head + len(ring))]
    ring, first = shared.ring[Queue.GENERATE], shared.head[Queue.GENERATE]
    tokens = [ring[(first + i) % len(ring)][1] for i in range(shared.path_count)]
    assert sorted(tokens) == list(range(shared.path_count))


def test_any_order_of_accesses_ends_with_every_token_in_its_place(examples):
    for seed in range(examples(DRAWS)):
        check(run(seed))


@pytest.mark.parametrize(
    ("fault", "items"),
    [
        ("look and take apart", 12),
        ("too much is not given back", 12),
        ("room is not given back", 12),
        ("read before it is published", 12),
        ("room is not looked at", 12),
        ("overwrites", 12),
        ("any turn", 40),
        ("begun before alive", 2),
    ],
)
def test_a_fault_of_the_protocol_is_found(fault, items):
    def fails(seed: int, fault: str) -> bool:
        try:
            check(run(seed, fault, path_count=8, treelet_count=1, treelet_places=2, limit=items))
        except AssertionError:
            return True
        return False

    found = next(seed for seed in range(200) if fails(seed, fault))
    assert not fails(found, "")


def test_a_queue_with_one_token_is_served_while_others_are_full():
    """Fairness: the next queue in turn that is not empty is served every so many choices of a warp."""
    shared = Shared(path_count=64, batch=2, full=2, limit=10_000)
    lonely = warp(0, shared, random.Random(0))
    # one path waits for the film, the latest stage but never a full batch; the others keep earlier stages full
    shared.ring[Queue.GENERATE][63], shared.size[Queue.GENERATE], shared.tail[Queue.GENERATE] = (63, 0), 63, 63
    shared.ring[Queue.BACKGROUND][0], shared.size[Queue.BACKGROUND], shared.tail[Queue.BACKGROUND] = (1, 63), 1, 1
    shared.alive, shared.left[63] = 1, ROUNDS
    shared.target = lambda token, queue, numbers: (
        Queue.SURFACE if queue == Queue.TRACE else Queue.TRACE if queue == Queue.SURFACE else Queue.BACKGROUND
    )
    queues = len(shared.size)
    while Queue.BACKGROUND not in shared.chosen and len(shared.chosen) < 1000:
        next(lonely)
    assert shared.chosen.index(Queue.BACKGROUND) < FAIR_TURNS * queues
