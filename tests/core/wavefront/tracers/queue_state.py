"""The state of queues of waiting rays, read and set."""

from raybatch_addon.core.wavefront.tracers.buckets.blocks import FREE, STEP
from raybatch_addon.core.wavefront.tracers.buckets.queues import BucketQueues


def set_step(queues: BucketQueues, step: int) -> None:
    """Let transactions from now on belong to `step`; how long rays wait is counted in steps."""
    queues.blocks.state[STEP : STEP + 1].fill_(step)


def free_block_count(queues: BucketQueues) -> int:
    """Number of blocks that no queue has."""
    return int(queues.fetch_state()[FREE])
