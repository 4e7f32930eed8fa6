"""What is simulated: clusters of 8, 64 and 512 GPUs, stills and an animation; and what was measured before, by which
the simulation is judged.
"""

from __future__ import annotations

from dataclasses import replace

from studies.many_workers.devices import Shared
from studies.many_workers.model import Job, Site

GPUS = (8, 64, 512)
BANDWIDTHS = (10, 25, 100)  # of a machine [Gbit/s]
SCENE_BYTES = 1e9  # assumed: a large scene
KERNEL_SECONDS = 3.0  # assumed: a worker loads kernels that were compiled before
BUILD_SECONDS = 1.0  # assumed: trees, images and tables, by each worker for each frame
FRAMES = 48

# By name: a still in 3840 x 2160 of so many seconds on one GPU
STILLS = {"still, 60 s": 60.0, "still, 10 min": 600.0, "still, 5 h": 18_000.0}
ANIMATION = f"animation, {FRAMES} frames of 60 s"

# Speedups of rendering that were measured on two H200s of one host, and seconds of one of them (docs/devices.md)
MEASURED = (
    Shared("demo", 1024, 39.9, 0.2, 135, 2, 1.983),
    Shared("BMW", 1024, 51.1, 0.34, 135, 2, 1.985),
    Shared("demo", 256, 10.05, 0.2, 40, 2, 1.941),
    Shared("BMW", 256, 12.54, 0.34, 40, 2, 1.922),
)
# What was not measured, and is predicted
PREDICTED = tuple(replace(case, gpus=gpus, speedup=0.0) for case in MEASURED[:2] for gpus in (4, 8))
# Two workers on two cores beside one process with two threads, seconds of this and of them: a sample takes a worker
# 1.16 times as long, and the workers start for six seconds
LOCAL = ((32.0, 42.0), (95.0, 127.0))
LOCAL_SAMPLE, LOCAL_START = 1.16, 6.0


def site(gpus: int, gigabits: float = 25.0) -> Site:
    """A cluster of machines of eight GPUs, each a worker's."""
    return Site(gpus=gpus, gpus_machine=8, bandwidth=gigabits * 1e9 / 8)


def still(seconds: float, is_cold: bool) -> Job:
    """One picture; a cluster that is cold has nothing of the scene, and no kernels are loaded."""
    cold = Job(seconds=seconds, scene_bytes=SCENE_BYTES, kernel_seconds=KERNEL_SECONDS, build_seconds=BUILD_SECONDS)
    return cold if is_cold else replace(cold, scene_bytes=0.0, kernel_seconds=0.0)


def animation(is_cold: bool = True) -> Job:
    """Frames of which machines get what changed."""
    return replace(still(60.0, is_cold), frames=FRAMES)


def local_job(seconds: float) -> tuple[Site, Job]:
    """Two workers on two cores, and a picture of 640 x 360 pixels that takes one process with both `seconds`: a worker
    has one core, and takes `LOCAL_SAMPLE` times as long for a sample as the process would with it.
    """
    job = Job(seconds=2 * seconds * LOCAL_SAMPLE, samples=256, width=640, height=360, kernel_seconds=0.0)
    return Site(gpus=2, gpus_machine=2, spread=0.0), job
