"""A scene on a device, ready to render."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import warp as wp

from ...bvh.build.scene_tree import BuiltTree
from ...bvh.traverse.reference import ReferenceTree
from ...bvh.tree import Tree
from ...bvh.treelets.tree import TreeletTree
from ...device.devices import worker_count
from ...native.structs import Upload, arrays_in
from ...programs.inputs_data import upload_camera_inputs, with_camera
from ...programs.op import NodeData
from ...programs.parts import transparent_parts
from ...programs.table import store_programs, upload_programs
from ...programs.tiling import fetch_part, tiles_at_once
from ...scene.description import ClosureKind, Scene
from ...scene.features import SceneFeatures
from ...scene.program import Program
from ...settings.settings import RenderSettings
from ...shading.bsdf.bsdf import ClosureFeatures, upload_materials
from ...shading.bsdf.materials import material_bins
from ...shading.camera import CameraData, upload_camera
from ...shading.images.image_upload import UploadedImages
from ...shading.images.textures import ImageTable
from ...shading.lights.choice_table import choice_tree
from ...shading.lights.emissive.arrays import triangle_arrays
from ...shading.lights.emitters import emits_light, find_emissive_triangles
from ...shading.lights.lamp_program import upload_lamp_programs
from ...shading.lights.table import UploadedLights, upload_lights
from ...shading.lights.world import WorldLight
from ..estimates.launch import brightness_of_lamps, emission_of_triangles, sun_brightness, world_texels
from ..order.hit_order import HitKey, sorts_materials
from ..passes.state import PassInputs, upload_pass_inputs
from ..plan.plan import Choice, TracingPlan
from ..plan.tracing import Tracing
from ..textures.pool import refuse_few_slots
from ..volumes.upload import UploadedVolumes, upload_volumes
from .geometry_request import GeometryRequest
from .paged_tree import PagedTree
from .scene_cache import BuiltGeometry, SceneCache
from .shading_data import SceneData, with_images, with_surface_images
from .world_cache import WorldCache


@dataclass(kw_only=True)
class DeviceScene:
    """A scene ready to render; shared by all workers, which only read it."""

    device: wp.Device
    features: SceneFeatures
    shading: SceneFeatures  # what kernels that shade are specialised on: `features`, or those of all scenes
    data: SceneData
    camera: CameraData
    tree: Tree | ReferenceTree | None  # None: there is nothing to hit
    tracing: Tracing
    treelets: TreeletTree | None  # where rays wait at treelets in memory
    box: np.ndarray | None  # two corners that hold all surfaces [m], float64, shape [2, 3]
    transparent_shadows: bool  # some surface lets shadow rays through
    lights: UploadedLights  # keeps the tree of the lights alive
    shadow_rays: bool  # there is an emitter to aim at, not only code for it
    built: BuiltGeometry | None
    images: UploadedImages  # keeps them alive
    stored: list[wp.array]  # the programs in memory, for kernels that read them there
    pass_inputs: PassInputs  # what passes read
    hit_bins: int  # numbers that `MaterialRecord.bin` has
    volumes: UploadedVolumes | None = None  # None: there are none
    splits: Choice | None = None  # whether the tree splits triangles, where that is not as planned
    fetches: NodeData | None = None  # programs that ask for tiles of images; None: all images are whole
    image_budget: int = 0  # for all images, where some are in tiles [bytes]
    tiles_least: int = 0  # that one path may need at once

    @staticmethod
    def build(
        scene: Scene,
        features: SceneFeatures,
        request: GeometryRequest,
        device: wp.Device,
        cache: SceneCache,
        shading: SceneFeatures | None = None,
        on_stage: Callable[[str], None] = lambda stage: None,
    ) -> DeviceScene:
        """Upload `scene` and build its tree.

        `shading`: what kernels are specialised on (default: `features`). `on_stage` gets what begins: `images`,
        `tree`, `materials`, `volumes`, `lights`.
        """
        shading = shading or features

        def keep(of: str) -> Upload:
            return lambda name, *given: cache.arrays.upload(f"{of}: {name}", *given)

        on_stage("images")
        data = SceneData()
        built = treelets = None
        passing: list[Program | None] = []
        # what has to be whole is never made smaller for a budget that was asked for: that would change the picture
        budget = None if request.settings.texture_budget else cache.image_budget(device)
        images = cache.images.upload(scene.images, device, budget)
        fetches, fetching = None, [each.program and each.program.fetches for each in scene.materials]
        if features.surfaces:
            on_stage("tree")
            kept = cache.get(scene, request, device)
            on_stage("materials")
            data.geometry, built, treelets = kept.geometry, kept.built, kept.treelets
            data.materials = upload_materials(
                scene.materials, ClosureFeatures(features.closures), device, keep("materials")
            )
            programs = [material.program for material in scene.materials]
            if features.transparency:
                passing = transparent_parts([None if each.shadow_opaque else each.program for each in scene.materials])
            if features.requests:
                programs += [program.requests if program else None for program in programs]
            programs += passing  # last, behind those of requests, if any
            inputs = None
            if not features.programs:
                cache.inputs.clear()
            else:
                inputs = with_camera(cache.inputs.get(scene, features.programs.ops, device), scene)
            uploaded = functools.partial(
                upload_programs, scene=scene, geometry=data.geometry, images=images.table, device=device, inputs=inputs
            )
            data.nodes = uploaded(programs, features.programs, upload=keep("surfaces"))
            if needs := features.fetch_program:
                fetching += [each and fetch_part(each, needs.register_count) for each in passing]
                fetches = uploaded(fetching, needs, upload=keep("fetches"))
                if images.tiled:
                    workers = worker_count(device, request.settings.thread_count)
                    workers = min(workers, request.settings.ray_count or workers)
                    given = request.settings.texture_budget or budget or 0
                    refuse_few_slots(images.tiled, given, images.bytes, workers, tiles_at_once(fetching))
        data.world_nodes = upload_programs(
            [scene.world.program],
            features.world_program,
            scene,
            data.geometry,
            images.table,
            device,
            inputs=upload_camera_inputs(scene, device),
            upload=keep("world"),
        )
        data.lamp_nodes = upload_lamp_programs(
            scene, features.lamp_program, data.geometry, images.table, device, keep("lamps")
        )
        stored = []
        if shading.programs.apart:
            stored = store_programs(data.nodes, data.world_nodes, data.lamp_nodes, device=device, upload=keep("stored"))
        volumes = None
        if features.volumes:
            on_stage("volumes")
            volumes = upload_volumes(scene, features, shading, data.geometry, images.table, device, cache.volumes)
        else:
            cache.volumes.clear()
        on_stage("lights")
        emitted, world, lamps = _program_light(data, scene, features, shading, device, cache.world)
        emits = [emits_light(material, emitted is not None) for material in scene.materials]
        triangles = cache.emissive.get(scene, emits, device.alias, lambda: find_emissive_triangles(scene, emitted))
        lights = upload_lights(
            scene,
            device,
            triangles=triangles,
            world=world,
            lamps=lamps,
            geometry=data.geometry,
            cells=volumes.cells if volumes else None,
            keep=cache.light_tree.get,
            keep_triangles=cache.emissive_arrays.get,
        )
        data.lights = lights.table
        data.world = wp.vec3(*scene.world.radiance)
        data.world_visibility = scene.world.visibility
        matrix = np.asarray(scene.camera.transform, np.float64)
        data.view_origin = wp.vec3(*matrix[:, 3].tolist())
        if not scene.camera.kind.is_panorama:
            data.view_axis = wp.vec3(*(-matrix[:, 2] / np.linalg.norm(matrix[:, 2])).tolist())
        lets_through = any(
            closure.kind == ClosureKind.TRANSPARENT and any(closure.weight)
            for material in scene.materials
            if not material.shadow_opaque
            for closure in material.closures
        ) or any(passing)
        return DeviceScene(
            device=device,
            features=features,
            shading=shading,
            data=data,
            camera=upload_camera(scene.camera, scene.frame.width, scene.frame.height, device),
            tree=built.tree if built else None,
            tracing=Tracing.of(request.plan, request.layout, features),
            treelets=treelets,
            box=built.box if built else None,
            transparent_shadows=lets_through or features.volumes,
            lights=lights,
            shadow_rays=features.shadow_rays and lights.emitter_count > 0,
            built=built,
            images=images,
            stored=stored,
            pass_inputs=upload_pass_inputs(scene, features, device),
            volumes=volumes,
            hit_bins=max(material_bins(scene.materials), default=0) + 1,
            splits=_splits_of(built, request.plan) if isinstance(built, BuiltTree) else None,
            fetches=fetches,
            image_budget=request.settings.texture_budget or budget or 0,
            tiles_least=tiles_at_once(fetching),
        )

    def data_with(self, images: ImageTable) -> SceneData:
        """`data` whose surfaces look up `images`."""
        return with_surface_images(self.data, images)

    def fetches_with(self, images: ImageTable) -> NodeData:
        """`fetches` that look at `images`."""
        assert self.fetches is not None
        return with_images(self.fetches, images)

    @property
    def warnings(self) -> list[str]:
        """What the user should know of it."""
        found = [*self.images.warnings, *(self.volumes.warnings if self.volumes else ())]
        if self.paged:
            made = self.paged.statistics
            found += [made[name] for name in ("page_file_warning", "store_warning") if name in made]
        return found

    @property
    def paged(self) -> PagedTree | None:
        """The tree, where it lies beyond memory."""
        return self.built if isinstance(self.built, PagedTree) else None

    @functools.cached_property
    def own_bytes(self) -> int:
        """Memory on the device of what a `SceneCache` does not keep for the next scene [bytes]."""
        data, volumes = self.data, self.volumes
        lights, images = self.lights, self.images
        whole = [data, self.camera, self.pass_inputs, self.stored, images.table, lights.choice]
        kept = [data.geometry, data.nodes.inputs, data.lights.world, choice_tree(lights.choice), images.keep]
        kept += [triangle_arrays(data.lights), data.materials, self.stored]
        for nodes in (data.nodes, data.world_nodes, data.lamp_nodes):
            kept += [nodes.code, nodes.constants, nodes.program_first, nodes.albedo]
        if volumes:
            whole += [volumes.data, volumes.stored, volumes.surfaces]
            kept += [volumes.data.grids, volumes.data.bounds]
        own = arrays_in(whole)
        return sum(own[address] for address in own.keys() - arrays_in(kept))

    @property
    def geometry_on_host(self) -> bool:
        """Whether a CUDA device reads what shading needs of triangles through the bus."""
        return self.paged is not None and self.device.is_cuda

    def hits_sorted_by(self, settings: RenderSettings) -> HitKey | None:
        """By what hits are sorted before they are shaded; None: not at all."""
        if settings.schedule == "STREAMING":
            return None
        if self.geometry_on_host:
            return HitKey.TRIANGLE
        return HitKey.MATERIAL if self.hit_bins > 1 and sorts_materials(settings.hit_sort, self.device) else None


def _splits_of(built: BuiltTree, plan: TracingPlan) -> Choice | None:
    """Whether a tree that an earlier render left splits triangles; None where it does as `plan` says."""
    whole, trees = built.whole_count, len(built.meshes)
    if not plan.splits:
        return None if whole == trees else Choice("ON", "the tree of an earlier render has them")
    if not whole:
        return None
    return Choice(
        "OFF" if whole == trees else "ON", f"{whole} of {trees} trees follow vertices that moved, which split nothing"
    )


def _program_light(
    data: SceneData,
    scene: Scene,
    features: SceneFeatures,
    shading: SceneFeatures,
    device: wp.Device,
    worlds: WorldCache,
):
    """Functions that compute the emission of triangles by programs and the brightness of lamps, and between them the
    sampled world; None for each that the scene does not have. Their kernels are specialised on `shading`.
    """
    emitted = world = lamps = None
    if features.mesh_programs:
        emitted = functools.partial(emission_of_triangles, data, shading, device)
    if not features.world_light:
        worlds.clear()
    else:
        size = scene.world.sampling_size
        # along a ray through a volume light is looked for wherever it may scatter, and mostly it does not
        beside_rays = features.mis and not features.volumes

        def light() -> WorldLight:
            sun = scene.world.sun
            within = 0.0 if sun is None else sun_brightness(data, shading, sun, device)
            return WorldLight(world_texels(data, shading, size, device), sun, within)

        world = worlds.get(scene, device, light, beside_rays)
    if features.lamp_program:
        lamps = functools.partial(brightness_of_lamps, scene, data, shading, device)
    return emitted, world, lamps
