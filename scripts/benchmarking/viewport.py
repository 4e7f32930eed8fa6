"""How soon a viewport shows an edit: edits of a scene, replayed through what renders viewports, without a window."""

from __future__ import annotations

import statistics
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarking.progress import Steps
from benchmarking.whole_render import RenderRequest, open_scene
from raybatch_addon.blender.kernel_cache import kernel_cache_folder
from raybatch_addon.core.device.devices import find_device
from raybatch_addon.core.errors import DeviceError
from raybatch_addon.core.live.picture import LivePicture, LiveRequest
from raybatch_addon.core.live.render import LiveRender
from raybatch_addon.core.scene.description import Instances, Material, Scene
from raybatch_addon.core.scene.frozen import freeze
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings

# The picture refines so long before the next edit [s]: edits come while rays are under way
PAUSE_SECONDS = 0.2
WAIT_SECONDS = 600.0  # for a first picture at most


def turned_camera(scene: Scene, step: int) -> Scene:
    """The camera turned a little about the vertical, around the origin."""
    angle = 0.02 * step
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    return replace(scene, camera=replace(scene.camera, transform=(turn @ scene.camera.transform).astype(np.float32)))


def moved_instance(scene: Scene, step: int) -> Scene:
    """An instance somewhere else."""
    transform = scene.instances.transform.copy()
    transform[len(transform) // 2, :, 3] += 0.01 * step * (1 + np.abs(transform[len(transform) // 2, :, 3]))
    return replace(scene, instances=replace(scene.instances, transform=transform))


def changed_value(scene: Scene, step: int) -> Scene:
    """A slider of a material moved."""
    materials = list(scene.materials)
    used = int(scene.slot_materials[0])
    materials[used] = _darker(materials[used], 1 - 0.005 * step)
    return replace(scene, materials=tuple(materials))


def _darker(material: Material, factor: float) -> Material:
    """Closures of `material` are darker, or a constant of its program is another."""
    if material.program is None:
        closures = tuple(replace(each, weight=tuple(factor * c for c in each.weight)) for each in material.closures)
        return replace(material, closures=closures)
    constants = np.array(material.program.constants)
    set_ones = np.flatnonzero(constants)  # to change what is 0 changes nothing
    constants[set_ones[: max(1, len(constants) // 4)]] *= factor
    return replace(material, program=replace(material.program, constants=constants))


def changed_graph(scene: Scene, step: int) -> Scene:
    """A material has another graph: that of one of the others, whose kernels are there."""
    materials = list(scene.materials)
    used = int(scene.slot_materials[0])
    other = (used + 1 + step % max(1, len(materials) - 1)) % len(materials)
    materials[used] = replace(_darker(materials[other], 1 - 0.005 * step), name=materials[used].name)
    return replace(scene, materials=tuple(materials))


def reshaped_mesh(scene: Scene, step: int) -> Scene:
    """A mesh of another shape, with the triangles that it had."""
    meshes = list(scene.meshes)
    place = int(scene.instances.mesh[len(scene.instances) // 2])
    wave = 1 + 0.01 * np.sin(step + 10 * meshes[place].positions[:, :1])
    meshes[place] = replace(meshes[place], positions=freeze((meshes[place].positions * wave).astype(np.float32)))
    return replace(scene, meshes=tuple(meshes))


def dimmed_world(scene: Scene, step: int) -> Scene:
    """Other light from the world, where it is of one color."""
    return replace(scene, world=replace(scene.world, radiance=(0.5, 0.4 + 0.01 * step, 0.6)))


def dimmed_light(scene: Scene, step: int) -> Scene:
    """The first lamp gives less light."""
    lights = list(scene.lights)
    lights[0] = replace(lights[0], emission=tuple((1 - 0.01 * step) * c for c in lights[0].emission))
    return replace(scene, lights=tuple(lights))


def hidden_instance(scene: Scene, step: int) -> Scene:
    """Without one of the instances, another each time."""
    kept = np.arange(len(scene.instances)) != step % len(scene.instances)

    def part(array: np.ndarray | None) -> np.ndarray | None:
        return None if array is None else array[kept]

    old = scene.instances
    new = Instances(
        *(part(each) for each in (old.mesh, old.transform, old.slot_first, old.visibility, old.object)),
        info=part(old.info),
        attributes=part(old.attributes),
        links=part(old.links),
        light_group=part(old.light_group),
    )
    return replace(scene, instances=new)


EDITS: dict[str, Callable[[Scene, int], Scene]] = {
    "camera": turned_camera,
    "place": moved_instance,
    "value": changed_value,
    "graph": changed_graph,
    "mesh": reshaped_mesh,
    "world": dimmed_world,
    "light": dimmed_light,
    "visibility": hidden_instance,
}


class OwnSession:
    """Lends one session that nobody else wants."""

    def __init__(self, session: Session) -> None:
        self._session = session

    @contextmanager
    def session(self, _request: LiveRequest, _given_up: Callable[[], bool]) -> Iterator[Session]:
        """See `SessionSource.session`."""
        yield self._session

    def is_wanted(self, _has_shown: bool) -> bool:
        """See `SessionSource.is_wanted`."""
        return False


class Watch:
    """A live render, and when its first picture of a request came."""

    def __init__(self, session: Session, settings: RenderSettings) -> None:
        self._settings, self._number = settings, 0
        self._came = threading.Condition()
        self._first: dict[int, tuple[float, LivePicture]] = {}
        self.render = LiveRender(OwnSession(session), self._note)

    def _note(self) -> None:
        picture, now = self.render.picture, time.perf_counter()
        with self._came:
            if picture is not None:
                self._first.setdefault(picture.request.number, (now, picture))
            self._came.notify_all()

    def show(self, scene: Scene) -> tuple[float, LivePicture]:
        """Seconds until the first picture of `scene`, and that picture; raises `DeviceError`."""
        self._number += 1
        start, number = time.perf_counter(), self._number
        self.render.show(LiveRequest(number, scene, self._settings))
        with self._came:
            self._came.wait_for(lambda: number in self._first or self.render.state.error, WAIT_SECONDS)
            if number not in self._first:
                raise DeviceError(self.render.state.error or f"no picture came in {WAIT_SECONDS:g} s")
            came, picture = self._first.pop(number)
        return came - start, picture


def measure_viewport(request: RenderRequest) -> dict[str, Any]:
    """The report of `benchmark.py viewport`; raises `RayBatchError`."""
    opened = open_scene(request)
    settings = opened.settings.replace(
        sample_count=request.samples, bounce_max=request.bounces, thread_count=request.threads
    )
    settings = settings.replace(**request.settings).replace(
        error_target=0.0, time_limit=0.0, error_estimate="OFF", adaptive_sampling="OFF"
    )
    for mesh in opened.scene.meshes:
        for array in (mesh.positions, mesh.triangles, mesh.triangle_slot, mesh.corner_normals, mesh.corner_uvs):
            if array is not None:
                freeze(array)
    device = find_device(request.device)
    session = Session(device.alias, settings, kernel_cache_folder())
    watch = Watch(session, settings)
    kinds = [name for name in EDITS if _applies(name, opened.scene)]
    steps, rows = Steps(1 + len(kinds)), []
    try:
        steps.begin("first picture")
        first, _ = watch.show(opened.scene)
        steps.end()
        for kind in kinds:
            steps.begin(f"edits: {kind}")
            rows.append({"edit": kind, **_measure(watch, opened.scene, EDITS[kind], request.runs)})
            steps.end()
    finally:
        watch.render.close()
        watch.render.join(WAIT_SECONDS)
        session.close()
    frame = opened.scene.frame
    return {
        "scene": opened.name,
        "device": {"alias": device.alias, "name": device.name},
        "triangles": sum(len(opened.scene.meshes[i].triangles) for i in opened.scene.instances.mesh),
        "instances": len(opened.scene.instances),
        "frame": {"width": frame.width, "height": frame.height},
        "edits_of_each_kind": request.runs,
        "first_picture_seconds": round(first, 4),
        "edits": rows,
    }


def _applies(kind: str, scene: Scene) -> bool:
    if kind == "world":
        return scene.world.program is None
    if kind == "light":
        return bool(scene.lights)
    return kind == "camera" or len(scene.instances) > (kind == "visibility")


def _measure(watch: Watch, scene: Scene, edit: Callable[[Scene, int], Scene], count: int) -> dict[str, Any]:
    """Edits of one kind, after one that is not counted: what it needs for the first time is loaded then."""
    seconds, sides = [], []
    for step in range(count + 1):
        edited = edit(scene, step + 1)
        time.sleep(PAUSE_SECONDS)
        took, picture = watch.show(edited)
        seconds.append(took)
        sides.append(picture.side)
    before, counted = seconds[0], sorted(seconds[1:])
    return {
        "median": round(statistics.median(counted), 4),
        "p95": round(counted[min(len(counted) - 1, int(0.95 * len(counted)))], 4),
        "most": round(counted[-1], 4),
        "first": round(before, 4),
        "pixel_side": statistics.median(sides[1:]),
    }
