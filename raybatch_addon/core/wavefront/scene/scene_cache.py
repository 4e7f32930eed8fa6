"""A scene's geometry and tree, as far as they are kept for the next frame."""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import warp as wp

from ...bvh.build.scene_tree import BuiltTree, build_scene_tree, refit_scene_tree
from ...bvh.memory import GeometrySize, check_counts, check_memory, explained_memory_errors
from ...bvh.node import Layout
from ...bvh.pages.build import build_paged_scene
from ...bvh.pages.peers.build import build_with_peers
from ...bvh.pages.residency import Residency
from ...bvh.pages.transfer import staging_bytes_of
from ...bvh.traverse.reference import BuiltReference, build_reference
from ...bvh.treelets.cut import CutRule
from ...bvh.treelets.tree import TreeletTree, cut_scene_tree
from ...device.devices import free_memory
from ...displacement.boundaries import MovedBoundaries
from ...displacement.displaced import DisplacedMeshes
from ...displacement.evaluate import Move
from ...kept_arrays import KeptArrays
from ...programs.inputs_data import bytes_of
from ...programs.tiling import images_of_displacement
from ...scene.description import Image, Scene
from ...scene.flatten import FlatGeometry
from ...scene.frozen import Same
from ...scene.geometry import Geometry, holds_corners, update_geometry, upload_geometry
from ...scene.moved import with_motion
from ...shading.images.image_upload import ImageCache, UploadedImages, device_bytes_of
from ...shading.lights.choice_table import ChoiceTable, choice_tree_bytes
from ..plan.plan import Method, TracingPlan, cut_rule
from ..volumes.upload import VolumeCache
from .fingerprint import Fingerprint
from .geometry_request import GeometryRequest, geometry_of, still_of
from .kept_bakes import KeptBakes
from .kept_emitters import KeptEmitters
from .kept_inputs import KeptInputs
from .moved_instances import Placed, follow_moved
from .paged_tree import PagedTree
from .shown_instances import ShownInstances, grouped, show
from .unchanged import LastSmall
from .world_cache import WorldCache

# Share of a device's free memory that images may take: geometry, rays and the film need the rest
IMAGE_SHARE = 0.5

BuiltGeometry = BuiltReference | BuiltTree | PagedTree


@dataclass(kw_only=True)
class Kept:
    """The geometry and tree of a frame."""

    fingerprint: Fingerprint
    geometry: Geometry
    built: BuiltGeometry
    treelets: TreeletTree | None = None  # of `built`, where rays wait at treelets in memory
    cut: CutRule | None = None  # that they were cut by
    same: Same | None = None  # what of the scene it was made of
    shows: ShownInstances | None = None  # which instances, by its trees
    kind: tuple = ()  # `GeometryRequest.kind` that it was made for
    placed: Placed | None = None  # where its parts lie; None where the next frame is to be looked at anyway

    @property
    def device_bytes(self) -> int:
        """Memory of the tree on the device [bytes]; 0 where it is not known."""
        if isinstance(self.built, BuiltTree):
            return int(self.built.statistics.get("bytes", 0)) + (self.treelets.bytes if self.treelets else 0)
        if isinstance(self.built, PagedTree):
            scene, pool = self.built.scene, self.built.residency
            return (
                scene.resident_bytes
                + pool.slot_count * pool.slot_bytes
                + staging_bytes_of(scene, pool.slot_count, pool.device)
            )
        return 0


class SceneCache:
    """The geometry and tree of the last frame, for the next one: kept where it shows the same, refitted where things
    only moved.
    """

    def __init__(self, beside: Callable[[], int] = lambda: 0):
        """`beside`: memory on the device that is kept of the last frame, and given up for another one, beside what is
        here [bytes].
        """
        self._beside = beside
        self.boundaries = MovedBoundaries()
        self.images = ImageCache()
        self.world = WorldCache()
        self.volumes = VolumeCache()
        self.arrays = KeptArrays()  # of programs and materials
        self.inputs = KeptInputs()  # what programs of surfaces read of the scene
        self.emissive = KeptEmitters()
        self.emissive_arrays: LastSmall[list[wp.array]] = LastSmall(_bytes_of_arrays)  # the same on the device
        self.light_tree: LastSmall[ChoiceTable] = LastSmall(choice_tree_bytes)
        self._displaced = DisplacedMeshes()
        self._bakes = KeptBakes()
        self._last: Kept | None = None
        self._lock = threading.Lock()  # the build of a cancelled render may still be going on

    def clear(self) -> None:
        """Forget it."""
        self.boundaries.clear()
        self.images.clear()
        self.world.clear()
        self.volumes.clear()
        self.arrays.clear()
        self.inputs.clear()
        self.emissive.clear()
        self.emissive_arrays.clear()
        self.light_tree.clear()
        self._displaced.clear()
        self._bakes.clear()
        self._last = None

    @property
    def device_bytes(self) -> int:
        """Memory that the last frame's trees, its programs' inputs and its volumes hold on the device, and the next
        one's may have [bytes].
        """
        last, inputs = self._last, self.inputs.made
        kept = (
            last.device_bytes if last else 0,
            bytes_of(inputs) if inputs else 0,
            self.arrays.bytes,
            self.emissive_arrays.bytes,
            self.light_tree.bytes,
            self.volumes.device_bytes,
        )
        return sum(kept)

    def image_budget(self, device: wp.Device) -> int | None:
        """What images may take of the memory of `device` [bytes]; None: they lie where they are.

        It does not depend on what is kept of the last frame, or images would be made smaller in one frame and not in
        the next.
        """
        if not device.is_cuda:
            return None
        return int(IMAGE_SHARE * (self._free(device) + self.images.device_bytes))

    def free_for_geometry(self, images: Sequence[Image], device: wp.Device, asked: int = 0) -> int:
        """Memory that the geometry of a frame with `images` may have on `device` [bytes]. `asked`: what these may take
        by the setting `texture_budget`; 0: `image_budget`.
        """
        budget = asked or self.image_budget(device)
        images_need = 0 if budget is None else min(device_bytes_of(images), budget) - self.images.device_bytes
        return self._free(device) - images_need

    def _free(self, device: wp.Device) -> int:
        """Free memory of `device` without all that is kept of the last frame but its images [bytes]."""
        return free_memory(device) + self.device_bytes + self.world.device_bytes + self._beside()

    def displaced(self, scene: Scene, device: wp.Device, move: Move, asked: int = 0) -> Scene:
        """`scene` with the vertices where its materials move them, whose programs `move` runs. `asked`: as for
        `free_for_geometry`.
        """

        @functools.cache
        def images() -> UploadedImages:  # held until all is displaced: the table has addresses alone
            budget = self.image_budget(device)
            return self.images.upload(images_of_displacement(scene, asked or budget), device, None if asked else budget)

        return self._displaced.displaced(scene, lambda: images().table, device, move)

    def get(self, scene: Scene, request: GeometryRequest, device: wp.Device) -> Kept:
        """Geometry and tree of `scene`; those of the last call cannot be used any more.

        Raises `SceneError` for too large a scene, `OutOfMemoryError` for one that does not fit, before or where memory
        is asked for; `BuildCancelledError`.
        """
        kept = self._unchanged(scene, request) or self._moved(scene, request, device)
        if kept is not None:
            return kept
        size = GeometrySize.of(scene)
        whole = request.plan.method is not Method.PAGED
        check_counts(size, paged=not whole, corners=device.is_cuda and not whole)
        asked = size, request.layout, device
        budget = None if whole else request.plan.geometry_budget
        check_memory(*asked, all_of_it=True, budget=budget)
        with explained_memory_errors(*asked, budget=budget):
            before = self._last
            follows = _may_show(before, request, device)
            made = dict(bakes=self._bakes, keyed=device.is_cpu, room=request.room(device))
            shows, flat = grouped(scene, _shown_before(before), follows=follows, **made)
            fingerprint = Fingerprint.of(flat, scene, request.kind())
            with self._lock:
                # nothing is kept until the new one is whole: not what an error left half done, nor two of them
                last, self._last = self._last, None
                if last is not None and fingerprint.triangles != last.fingerprint.triangles:
                    self.inputs.clear()  # of triangles that are there no more
                if (
                    last is None
                    or last is not before
                    or not _serves(last.built, request.plan)
                    or not _follow(last, fingerprint, shows, flat, scene, request, device)
                ):
                    del last, before
                    self.inputs.clear()
                    check_memory(*asked, all_of_it=False, budget=budget)
                    if shows.is_follower:
                        shows, flat = grouped(scene, **made)
                        fingerprint = Fingerprint.of(flat, scene, request.kind())
                    last = _build(fingerprint, flat, scene, request, device)
                    last.shows, last.kind = shows, request.kind()
                own = isinstance(last.built, BuiltTree)
                self._keep(last, own and Placed.of(flat, scene, *still_of(scene, request)), scene, request, device)
                return last

    def _keep(
        self, kept: Kept, placed: Placed | None, scene: Scene, request: GeometryRequest, device: wp.Device
    ) -> None:
        """`kept` shows `scene`, whose parts lie where `placed` says."""
        _cut(kept, request, device)
        kept.same, kept.placed = Same(*geometry_of(scene, request)), placed or None
        self._last = kept

    def _moved(self, scene: Scene, request: GeometryRequest, device: wp.Device) -> Kept | None:
        """What is kept, where instances of the same frozen meshes moved and nothing else changed."""
        with self._lock:
            last = self._last
            if last is None or last.placed is None or not _serves(last.built, request.plan):
                return None
            if not last.placed.serves(scene, *still_of(scene, request)):
                return None
            self._last = None  # until it is whole
            placed, trees = follow_moved(last.placed, scene, last.built, last.geometry, device)
            if trees and last.shows:
                last.shows = last.shows.refitted()
            digests = tuple(b"" if i in trees else each for i, each in enumerate(last.fingerprint.positions))
            last.fingerprint = replace(last.fingerprint, positions=digests, transforms=b"")
            last.treelets = last.cut = None  # copies of what is changed now
            if placed is None:
                self._last, last.same, last.placed = last, None, None
                return None
            self._keep(last, placed, scene, request, device)
            return last

    def _unchanged(self, scene: Scene, request: GeometryRequest) -> Kept | None:
        """What is kept, where `scene` has the same frozen arrays: then there is nothing to look at."""
        start = time.perf_counter()
        with self._lock:
            last = self._last
            if last is None or last.same is None or not last.same.holds(*geometry_of(scene, request)):
                return None
            if not _serves(last.built, request.plan):
                return None
            if isinstance(last.built, BuiltTree):
                last.built.note(0, 0, start)
            return last


def _bytes_of_arrays(arrays: list[wp.array]) -> int:
    return sum(int(each.capacity) for each in arrays)


def _serves(built: BuiltGeometry, plan: TracingPlan) -> bool:
    """Whether a tree is as good as one that is built for `plan`. One that was built with splits serves short renders
    too, and long ones also where its vertices moved and it follows them without.
    """
    if isinstance(built, PagedTree):
        return not built.residency.has_failed  # its file is no good; a new one may be
    if not isinstance(built, BuiltTree):
        return True
    # what waits at treelets has no ranges of time within meshes (`build_scene_tree`)
    deforms = any(mesh.step_units for mesh in built.meshes)
    ranges_fit = not deforms or built.mesh_ranges == (plan.method is not Method.BATCHED)
    return ranges_fit and (built.splits_planned or not plan.splits)


def _shown_before(last: Kept | None) -> ShownInstances | None:
    """What the frame `last` shows, where it is."""
    if last is None or last.shows is None or last.placed is None:
        return None
    return last.shows.at(last.placed.transform)


def _may_show(last: Kept | None, request: GeometryRequest, device: wp.Device) -> bool:
    """Whether trees of `last` may follow a frame that shows other things: where rays are too few to be worth trees as
    good as they can be, and processors build them, which takes long.
    """
    own = last is not None and isinstance(last.built, BuiltTree)
    return own and device.is_cpu and not request.plan.splits and last.kind == request.kind()


def _follow(
    last: Kept,
    fingerprint: Fingerprint,
    shows: ShownInstances,
    flat: FlatGeometry,
    scene: Scene,
    request: GeometryRequest,
    device: wp.Device,
) -> bool:
    """Make `last` show the frame; False where it cannot."""
    start = time.perf_counter()
    before, last.fingerprint = last.fingerprint, fingerprint
    shown, last.shows = _shown_before(last), shows
    own = isinstance(last.built, BuiltTree)
    if fingerprint != before:
        if not own:
            return False
        if fingerprint.topology != before.topology:
            if shown is None or not _may_show(last, request, device):
                return False
            geometry = show(shown, shows, last.built, last.geometry, flat, scene, device)
            if geometry is None:
                return False
            last.geometry, last.treelets, last.cut = geometry, None, None
            return True
        remade = fingerprint.remade_since(before, last.geometry, flat)
        update_geometry(last.geometry, with_motion(flat), scene, fingerprint.triangles != before.triangles)
        was = zip(before.triangles, before.positions, strict=True)
        now = zip(fingerprint.triangles, fingerprint.positions, strict=True)
        moved = [i for i, (old, new) in enumerate(zip(was, now, strict=True)) if old != new]
        if moved or fingerprint.transforms != before.transforms:
            last.shows = shows.refitted() if moved else shows
            last.treelets = last.cut = None  # copies of what is changed now
            refit_scene_tree(last.built, flat, last.geometry, scene.instances.visibility, moved, device, remade)
            return True
    if own:
        last.built.note(0, 0, start)
    return True


def _build(
    fingerprint: Fingerprint, flat: FlatGeometry, scene: Scene, request: GeometryRequest, device: wp.Device
) -> Kept:
    plan, settings, layout, visibility = request.plan, request.settings, request.layout, scene.instances.visibility
    paged = plan.method is Method.PAGED
    on_host = paged and device.is_cuda
    # of what is kept in pages nothing follows another frame in place
    together = on_host and holds_corners(flat)
    geometry = upload_geometry(with_motion(flat, corners=together), scene, device, on_host, in_place=paged)
    if paged:
        asked: dict[str, Any] = dict(
            budget=plan.geometry_budget,
            rule=cut_rule(request.plan, request.settings),
            spatial_splits=settings.is_on("spatial_splits"),
            corners=geometry.positions if together else None,
            cancelled=request.cancelled,
            encoded=encodes(layout),
        )
        if plan.geometry_store == "PEERS":
            pages = build_with_peers(request.common.pages, flat, visibility, layout, device, **asked)
        else:
            store, folder = plan.geometry_store, request.page_folder
            pages = build_paged_scene(flat, visibility, layout, device, store=store, folder=folder, **asked)
        return Kept(
            fingerprint=fingerprint,
            geometry=geometry,
            built=PagedTree(pages, Residency(pages, plan.geometry_budget, device)),
        )
    if plan.method is Method.REFERENCE:
        reference = build_reference(flat, visibility, request.instancing, device)
        return Kept(fingerprint=fingerprint, geometry=geometry, built=reference)
    built = build_scene_tree(
        flat,
        geometry,
        visibility,
        request.instancing,
        device,
        layout,
        spatial_splits=plan.splits,
        splits_moving=settings.is_on("spatial_splits"),
        mesh_ranges=plan.method is not Method.BATCHED,
        in_common=request.common.trees,
    )
    return Kept(fingerprint=fingerprint, geometry=geometry, built=built)


def encodes(layout: Layout) -> bool:
    """Whether pages are packed on their way: where the device expands them faster than the bus brings them."""
    return layout is Layout.QUANTISED


def _cut(kept: Kept, request: GeometryRequest, device: wp.Device) -> None:
    """Treelets of the tree, where rays wait at them; else none are kept."""
    if request.plan.method is not Method.BATCHED:
        kept.treelets = kept.cut = None
        return
    rule = cut_rule(request.plan, request.settings)
    if kept.treelets is None or kept.cut != rule:
        kept.treelets, kept.cut = None, rule
        kept.treelets = cut_scene_tree(kept.built, rule, device)
