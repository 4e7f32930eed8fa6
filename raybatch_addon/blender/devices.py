"""The devices that a render may choose among, by name and memory; found in the background, as that starts Warp."""

from __future__ import annotations

import functools
import platform
import re
from dataclasses import dataclass

from . import warm_up

# What makers write into names of processors and says nothing
_NOISE = re.compile(r"\((R|TM)\)|\bCPU\b|\bProcessor\b|@.*|\b\d+-Core\b|with .* Graphics", re.IGNORECASE)


@dataclass(frozen=True)
class DeviceChoice:
    """A value of the setting `device`."""

    name: str
    label: str
    description: str


def device_choices() -> tuple[DeviceChoice, ...] | None:
    """AUTO, the CPU and each CUDA device; None as long as they are looked for."""
    if not warm_up.is_over(_nothing):
        return None
    try:
        return _found()
    except Exception as error:  # Warp is missing, or does not fit: renders say so too
        return (DeviceChoice("AUTO", "No device", f"RayBatch cannot start: {type(error).__name__}: {error}"),)


def _nothing() -> None:
    pass


@functools.cache
def _found() -> tuple[DeviceChoice, ...]:
    import warp as wp

    from ..core.device.devices import find_device, start_warp, total_memory, worker_count

    start_warp()
    cpu = wp.get_device("cpu")
    threads = worker_count(cpu, 0)
    found = [
        DeviceChoice("cpu", f"CPU, {cpu_name()}, {_size(total_memory(cpu))}", f"The processor, by {threads} threads"),
        *(
            DeviceChoice(device.alias, f"{device.name}, {_size(total_memory(device))}", f"CUDA device {device.alias}")
            for device in wp.get_cuda_devices()
        ),
    ]
    chosen = next(each for each in found if each.name == find_device("AUTO").alias)
    about = f"The first CUDA device, else the CPU: {chosen.label}"
    return (DeviceChoice("AUTO", f"Auto ({chosen.label.rpartition(',')[0]})", about), *found)


def cpu_name() -> str:
    """What the processor is called."""
    name = ""
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
            name = next((line.partition(":")[2] for line in file if line.startswith("model name")), "")
    except OSError:
        name = platform.processor()
    return " ".join(_NOISE.sub(" ", name).split()) or platform.machine()


def _size(number: int) -> str:
    return f"{number / 2**30:.0f} GiB"
