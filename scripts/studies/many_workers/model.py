"""What a simulation is of: costs, a cluster, and a job."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Costs:
    """What things take, but the samples themselves."""

    client_task: float  # of the process that hands out, for a task of Dask's [s]
    scheduler_task: float  # of Dask's scheduler, for the same [s]
    film_bytes: float  # of a pixel
    film_made: float  # a worker, for a film that it rendered [s/pixel]
    film_merged: float  # a worker, for two films that become one [s/pixel]
    film_received: float  # at home [s/pixel]
    film_joined: float  # of the bands to a frame, and its picture, at home [s/pixel]
    relay: float  # the scheduler, for what goes through it [s/byte]
    scene_cut: float  # at home, for a scene in parts with digests [s/byte]
    scene_kept: float  # a machine, for parts that come [s/byte]
    scene_read: float  # a worker, for a scene of parts [s/byte]
    latency: float = 2e-4  # of a message [s]


FREE = Costs(
    client_task=0.0,
    scheduler_task=0.0,
    film_bytes=0.0,
    film_made=0.0,
    film_merged=0.0,
    film_received=0.0,
    film_joined=0.0,
    relay=0.0,
    scene_cut=0.0,
    scene_kept=0.0,
    scene_read=0.0,
    latency=0.0,
)


@dataclass(frozen=True, kw_only=True)
class Site:
    """A cluster: workers of one GPU each, or of several (`gpus_worker`), on machines."""

    gpus: int
    gpus_machine: int = 8
    gpus_worker: int = 1
    bandwidth: float = 25e9 / 8  # of a machine, each way [bytes/s]
    spread: float = 0.02  # of the rates of workers (standard deviation of their logarithm)
    slow_share: float = 0.0  # of the workers, which take twice as long
    shared_loss: float = 0.0  # what each further GPU of a worker takes off all of them (Amdahl's serial share)
    poll: float = 0.05  # how often who hands out looks what came [s]
    ahead: int = 0  # tasks that a worker has beside the one that it renders

    @property
    def workers(self) -> int:
        """How many there are."""
        return -(-self.gpus // self.gpus_worker)

    @property
    def worker_rate(self) -> float:
        """Of a worker's, beside one GPU."""
        return self.gpus_worker / (1.0 + self.shared_loss * (self.gpus_worker - 1))


@dataclass(frozen=True, kw_only=True)
class Job:
    """A still, or an animation."""

    seconds: float  # that one GPU takes for the samples of a frame
    samples: int = 1024
    width: int = 3840  # pixels
    height: int = 2160
    frames: int = 1
    under_way: int = 2  # frames at most
    scene_bytes: float = 0.0  # that machines lack; of later frames the share `changed`
    changed: float = 0.05
    kernel_seconds: float = 0.0  # that each worker takes before its first samples
    build_seconds: float = 0.0  # that each worker takes before its first samples of each frame: trees, uploads


@dataclass(kw_only=True)
class Losses:
    """GPU-seconds that were no samples of the picture, by cause."""

    scene: float = 0.0  # before the scene was there
    kernels: float = 0.0  # loading kernels and building trees
    films: float = 0.0  # making films of tasks
    waits: float = 0.0  # between tasks
    end: float = 0.0  # from a worker's last task to the last one of all
    twice: float = 0.0  # rendering what another one rendered too
    home: float = 0.0  # merging what was left, and bringing it home
    shared: float = 0.0  # several GPUs of a worker, and workers slower than the mean


@dataclass(frozen=True)
class Outcome:
    """What came of a simulated job."""

    seconds: float
    useful: float  # GPU-seconds of samples, by one GPU
    gpus: int
    losses: Losses
    tasks: int
    scheduler_busy: float  # share of the time
    client_busy: float

    @property
    def speedup(self) -> float:
        """Over one GPU, for which nothing but the samples counts."""
        return self.useful / self.seconds

    @property
    def efficiency(self) -> float:
        """The same for each GPU."""
        return self.speedup / self.gpus
