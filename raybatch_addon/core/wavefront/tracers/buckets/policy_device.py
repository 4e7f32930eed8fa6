"""Which queue is served next, as renders choose it on any device: by the rules of `policy.py`, in kernels.

Every thread looks at some buckets, and the largest key wins.
"""

from __future__ import annotations

import warp as wp

from ....device.kernel import KERNEL_OPTIONS
from ....native.structs import to_numpy
from .blocks import OVERFLOW, STEP, WAITING, Blocks
from .policy import Selection, Step

# Entries of `PolicyState.choice`: a `Step`, the queue it serves and its rays, the bucket that was served last, and rays
# that are done; whether the device goes on by itself, and for how many steps it still may (-1: the host leads); with so
# many rays done nothing is chosen
STEP_KIND, QUEUE, AMOUNT, LAST, FINISHED_RAYS, GO, BUDGET, TARGET, CHOICE_SIZE = range(9)
# Sizes of launches that a device chooses from, as shares of the largest batch
SIZES = (1024, 64, 8, 1)
# Threads at most
_THREADS = 4096

# Selections with a rule here: in `bucket_key`, but for ALL, which serves every bucket, in `decide`
RULES = (Selection.MOST_FULL, Selection.NEXT, Selection.RANDOM, Selection.ALL)
_MOST_FULL, _NEXT, _RANDOM, _ALL = (wp.constant(int(each)) for each in RULES)
_NOTHING, _TOP, _TREELET = (wp.constant(int(each)) for each in (Step.NOTHING, Step.TOP, Step.TREELET))
_SWEEP, _UNBATCHED = (wp.constant(int(each)) for each in (Step.SWEEP, Step.UNBATCHED))


@wp.struct
class PolicyState:
    """Rules, and what was chosen."""

    selection: int
    wait_max: int
    seed: int
    bucket_count: int
    rays_few: int
    # keys and what they belong to in one number, so that the largest is found by its bits
    best: wp.array(dtype=wp.int64)  # fullest bucket, chosen bucket, queue that waits longest, shape [3]
    choice: wp.array(dtype=int)  # shape [CHOICE_SIZE]
    sizes: wp.array(dtype=int)  # of launches, ascending
    branches: wp.array(
        dtype=int
    )  # 1 for the size and the step that is next, shape [sizes, 2]: exit queues, entry queues


@wp.func
def random_word(key: wp.uint32, word: int) -> wp.uint32:
    """A round of `random_key` in `policy.py`."""
    mixed = (key ^ wp.uint32(word)) * wp.uint32(0x85EBCA6B)
    mixed = mixed ^ (mixed >> wp.uint32(13))
    mixed = mixed * wp.uint32(0xC2B2AE35)
    return mixed ^ (mixed >> wp.uint32(16))


@wp.func
def bucket_key(policy: PolicyState, selection: int, bucket: int, load: int, step: int) -> int:
    """The bucket with the largest is served."""
    if selection == _MOST_FULL:
        return load
    if selection == _NEXT:
        distance = policy.choice[LAST] - bucket
        return wp.where(distance < 0, distance + policy.bucket_count + 1, distance)
    if selection == _RANDOM:
        key = random_word(random_word(random_word(wp.uint32(0x9E3779B9), policy.seed), step), bucket)
        return int(key >> wp.uint32(1))
    return 0


@wp.func
def with_number(key: int, number: int) -> wp.int64:
    """Key and number in one word, so that a maximum picks the largest key and, among equals, the smallest number."""
    return (wp.int64(key) << wp.int64(32)) | wp.int64(0x7FFFFFFF - number)


@wp.func
def number_of(best: wp.int64) -> int:
    """Inverse of `with_number`: the queue or bucket."""
    return 0x7FFFFFFF - int(best & wp.int64(0x7FFFFFFF))


@wp.func
def bucket_load(blocks: Blocks, policy: PolicyState, bucket: int) -> int:
    """Rays of a bucket that are not done."""
    load = blocks.counts[2 * bucket + 1]
    if bucket < policy.bucket_count:
        load += blocks.counts[2 * bucket]
    return load


@wp.func
def look_at_buckets(blocks: Blocks, policy: PolicyState, first: int, stride: int):
    """Merge every `stride`-th bucket from `first` on into `policy.best`."""
    step = blocks.state[STEP]
    selection = policy.selection
    if blocks.state[OVERFLOW] > 0:
        selection = _MOST_FULL
    fullest = wp.int64(0)
    chosen = wp.int64(0)
    oldest = wp.int64(0)
    for bucket in range(first, policy.bucket_count + 1, stride):
        load = bucket_load(blocks, policy, bucket)
        if load > 0:
            fullest = wp.max(fullest, with_number(load, bucket))
            if selection != _MOST_FULL:
                chosen = wp.max(chosen, with_number(bucket_key(policy, selection, bucket, load, step), bucket))
            if policy.wait_max > 0:
                for side in range(2):
                    queue = 2 * bucket + side
                    if blocks.counts[queue] > 0 and queue != 2 * policy.bucket_count:
                        oldest = wp.max(oldest, with_number(step - blocks.since[queue], queue))
    if selection == _MOST_FULL:
        chosen = fullest
    if fullest > wp.int64(0):
        wp.atomic_max(policy.best, 0, fullest)
        wp.atomic_max(policy.best, 1, chosen)
        wp.atomic_max(policy.best, 2, oldest)


@wp.func
def decide(blocks: Blocks, policy: PolicyState):
    """Choose by `policy.best`, and forget it."""
    fullest = policy.best[0]
    chosen = policy.best[1]
    oldest = policy.best[2]
    finished = blocks.counts[2 * policy.bucket_count]
    waiting = blocks.state[WAITING] - finished
    few = int(fullest >> wp.int64(32))
    if policy.selection == _ALL:
        few = waiting
    kind = int(_NOTHING)
    queue = int(-1)
    amount = int(waiting)
    if waiting > 0 and finished < policy.choice[TARGET] and policy.choice[BUDGET] != 0:
        if few < policy.rays_few:
            kind = _UNBATCHED
        elif policy.selection == _ALL:
            kind = _SWEEP
        else:
            if policy.wait_max > 0 and int(oldest >> wp.int64(32)) >= policy.wait_max:
                queue = number_of(oldest)
            else:
                bucket = number_of(chosen)
                queue = 2 * bucket
                entry = int(-1)
                if bucket < policy.bucket_count:
                    entry = blocks.counts[queue]
                if entry < blocks.counts[queue + 1]:
                    queue += 1
            kind = wp.where(queue % 2 == 1, _TOP, _TREELET)
            amount = blocks.counts[queue]
            policy.choice[LAST] = queue // 2
        blocks.state[STEP] = blocks.state[STEP] + 1
    policy.choice[STEP_KIND] = kind
    policy.choice[QUEUE] = queue
    policy.choice[AMOUNT] = amount
    policy.choice[FINISHED_RAYS] = finished
    budget = policy.choice[BUDGET]
    go = int(0)
    if queue >= 0 and budget > 0:
        go = 1
    policy.choice[GO] = go
    policy.choice[BUDGET] = budget - go
    below = int(0)
    for i in range(policy.sizes.shape[0]):
        size = policy.sizes[i]
        taken = int(0)
        if go == 1 and amount > below and (amount <= size or i == policy.sizes.shape[0] - 1):
            taken = 1
        policy.branches[2 * i] = taken * (queue % 2)
        policy.branches[2 * i + 1] = taken * (1 - queue % 2)
        below = size
    for i in range(3):
        policy.best[i] = wp.int64(0)


@wp.kernel(**KERNEL_OPTIONS)
def look_kernel(blocks: Blocks, policy: PolicyState, stride: int):
    """`stride` threads."""
    look_at_buckets(blocks, policy, wp.tid(), stride)


@wp.kernel(**KERNEL_OPTIONS)
def decide_kernel(blocks: Blocks, policy: PolicyState):
    """One thread, behind `look_kernel`."""
    decide(blocks, policy)


@wp.kernel(**KERNEL_OPTIONS)
def host_choose_kernel(blocks: Blocks, policy: PolicyState):
    """One thread does both, for the CPU."""
    look_at_buckets(blocks, policy, 0, 1)
    decide(blocks, policy)


@wp.kernel(**KERNEL_OPTIONS)
def begin_kernel(policy: PolicyState, target: int, budget: int):
    """One thread."""
    policy.choice[TARGET] = target
    policy.choice[BUDGET] = budget


class DevicePolicy:
    """Launches the choice; what is chosen lies in `state.choice`."""

    def __init__(
        self,
        selection: Selection,
        wait_max: int,
        seed: int,
        bucket_count: int,
        rays_few: int,
        blocks: Blocks,
        parallel: bool | None = None,
        capacity: int = 1,
    ):
        """Rules as for `BucketPolicy`, for the queues in `blocks`. `capacity`: rays of a batch at most. Raises
        `ValueError` for a selection without a rule.
        """
        if selection not in RULES:
            raise ValueError(f"there is no rule for the selection {selection!r}: add one here and in `policy.py`")
        self.device = device = blocks.counts.device
        self.blocks, self.state = blocks, PolicyState()
        self._parallel = device.is_cuda if parallel is None else parallel
        self._threads = min(_THREADS, bucket_count + 1)
        state = self.state
        state.selection, state.wait_max, state.bucket_count, state.rays_few = (
            int(selection),
            wait_max,
            bucket_count,
            rays_few,
        )
        state.seed = (seed & 0xFFFFFFFF) - ((seed & 0x80000000) << 1)
        state.best = wp.zeros(3, dtype=wp.int64, device=device)
        start = [0] * CHOICE_SIZE
        start[QUEUE], start[LAST], start[BUDGET], start[TARGET] = -1, -1, -1, 2**31 - 1
        state.choice = wp.array(start, dtype=int, device=device)
        self.sizes = sorted({-(-capacity // share) for share in SIZES})
        state.sizes = wp.array(self.sizes, dtype=int, device=device)
        state.branches = wp.zeros(2 * len(self.sizes), dtype=int, device=device)
        # a CPU's memory is the host's
        self._on_host = to_numpy(state.choice) if device.is_cpu else None

    def begin(self, target: int, budget: int = -1) -> None:
        """Nothing is chosen any more when `target` rays are done, or the device has taken `budget` steps by itself (-1:
        the host leads).
        """
        wp.launch(begin_kernel, 1, [self.state, target, budget], device=self.device)

    def fetch(self) -> list[int]:
        """`PolicyState.choice`."""
        return (self._on_host if self._on_host is not None else to_numpy(self.state.choice)).tolist()

    def launch(self) -> None:
        """Choose for the step that is written in the queues' state."""
        if self._parallel:
            wp.launch(look_kernel, self._threads, [self.blocks, self.state, self._threads], device=self.device)
            wp.launch(decide_kernel, 1, [self.blocks, self.state], device=self.device)
        else:
            wp.launch(host_choose_kernel, 1, [self.blocks, self.state], device=self.device)


def policy_kernels(device: wp.Device) -> tuple[wp.Kernel, ...]:
    """The kernels that a `DevicePolicy` launches on `device`."""
    return (begin_kernel, look_kernel, decide_kernel) if device.is_cuda else (begin_kernel, host_choose_kernel)
