"""Where a render stands, in one line: the same in Blender and by `scripts/render.py`. It needs no Blender."""

from __future__ import annotations

from ...core.observers import Progress


def status_text(progress: Progress) -> str:
    """One line on where a render stands; that of samples begins as Cycles' does, for programs that read it."""
    memory = []
    if progress.memory_bytes:
        used, peak = (each / 2**20 for each in (progress.memory_bytes, progress.memory_peak))
        memory = [f"Mem: {used:.0f}M, Peak: {max(used, peak):.0f}M"]
    if progress.stage != "render":
        return " | ".join([progress.message, *memory])
    parts = [
        f"Sample {progress.samples_done:.0f}/{progress.samples_total}",
        f"{progress.rays_per_second / 1e6:.2f} Mrays/s",
    ]
    if progress.seconds_left is not None:
        parts.append(f"{_clock(progress.seconds_left)} left")
    parts += memory
    if progress.kernels:
        beside = ", compiling specialised ones" if progress.compiles else ""
        parts.append(f"{progress.kernels} kernels{beside}")
    return " | ".join(parts)


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"
