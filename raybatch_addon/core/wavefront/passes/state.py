"""Values that paths keep for passes that are summed beside Combined and Normal, and what these read of the scene."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import warp as wp

from ...film.channels import ChannelLayout
from ...film.mattes import MatteEntry
from ...programs.inputs_data import corner_values
from ...scene.cryptomatte import matte_identity
from ...scene.description import COPY_SET, CameraKind, Scene
from ...scene.features import SceneFeatures
from ...scene.passes import (
    COLOR_PASSES,
    DIRECT_PASSES,
    GUIDE_PASSES,
    INDIRECT_PASSES,
    MATTE_KINDS,
    OCCLUSION_PASS,
    VECTOR,
    VECTOR_WEIGHT,
    VOLUME_PASSES,
    aov_passes,
    channels_of,
    light_group_passes,
    matte_kinds,
    shows_catchers,
    summed_passes,
)
from ...shading.camera import CameraData, camera_axes
from ..catchers.state import caught_bytes_per_path, upload_catchers
from .vectors import VectorInputs, upload_vectors


@wp.struct
class PassInputs:
    """Arrays of the scene that passes read; those that no pass needs are empty."""

    object_index: wp.array(dtype=float)  # of each instance's object
    material_index: wp.array(dtype=float)
    uv_first: wp.array(dtype=int)  # for each instance: its first corner in `uvs`; -1: it has no UV map
    uvs: wp.array(dtype=wp.vec2)  # of triangle corners
    # identities (`scene/cryptomatte.py`): of each instance's object and asset, and of each material
    object_identity: wp.array(dtype=int)
    asset_identity: wp.array(dtype=int)
    material_identity: wp.array(dtype=int)
    is_catcher: wp.array(dtype=int)  # 1, of each instance that is a shadow catcher
    # the light set by which light is chosen where copies of paths see catchers alone; -1: as for others
    copy_receiver: int
    # numbers of kinds of mattes; -1: no pass shows them
    object_matte: int
    material_matte: int
    asset_matte: int
    vector: VectorInputs
    mist_start: float  # [m]
    mist_scale: float  # one over the distance from there to the densest mist [1/m]; 0: there is none
    mist_falloff: float  # exponent
    orthographic: int  # 1: mist counts distances along the view
    alpha_threshold: float  # least alpha of the surface whose data passes show
    occlusion_distance: float  # [m]


@wp.struct
class PathPasses:
    """State of paths for passes, in the device's memory. A channel of -1 belongs to a pass that is not there."""

    # samples to come, a row for each channel of `ChannelLayout.others`; 0 where a path starts; shape [channels, paths]
    values: wp.array2d(dtype=float)
    # how light is divided that comes by the path's extending ray, and by its shadow ray: the share that a diffuse
    # closure scattered where the path scattered first, by color, and 1 where it was reflected, 0 where transmitted, 2
    # where a volume scattered it
    share: wp.array(dtype=wp.vec4)
    shadow_share: wp.array(dtype=wp.vec4)
    life: wp.array(dtype=int)  # `Life` (`catchers/state.py`); where there are shadow catchers
    shadow_group: wp.array(dtype=int)  # number of the light group that the shadow ray is aimed at; -1: none
    settled: wp.array(dtype=int)  # 1: the surface that data passes show has been met; where surfaces may be transparent
    carried: wp.array(dtype=wp.vec3)  # `guides.py`: share that counts of what is met next; 0 when nothing does any more
    to_camera: wp.mat33  # for guides: from world space to the camera's: right, up, and away from it; unit rows
    aov: wp.array(dtype=wp.vec2i)  # of each pass of materials: its first channel, and how many it has
    # first channels
    mist: int
    uv: int
    vector: int
    vector_weight: int
    albedo: int  # of what guides a denoiser, as `normal` and `depth`
    normal: int
    depth: int
    occlusion: int
    emission: int
    environment: int
    group: int  # of light groups, one behind another
    volume: wp.vec2i  # of light that volumes scatter first: direct, indirect
    color: wp.vec3i  # by component: diffuse, glossy, transmission
    direct: wp.vec3i
    indirect: wp.vec3i
    inputs: PassInputs


@wp.func
def is_guided(passes: wp.array(dtype=PathPasses)) -> bool:
    """Whether paths note what guides a denoiser; `passes` are those of `Paths`."""
    if passes.shape[0] > 0:
        return passes[0].carried.shape[0] > 0
    return False


@wp.func
def add_channels(passes: PathPasses, first: int, path: int, value: wp.vec3):
    """Add `value` to three channels of a path, from `first` on; -1: to none."""
    if first >= 0:
        for c in range(3):
            passes.values[first + c, path] = passes.values[first + c, path] + value[c]


def pass_bytes_per_path(features: SceneFeatures) -> int:
    """Memory of `PathPasses` for each path [bytes]."""
    channels = ChannelLayout(False, False, summed_passes(features.passes)).others_count
    settles = features.records_surfaces and features.transparency
    set_aside = MatteEntry.numpy_dtype()["itemsize"] * len(matte_kinds(features.passes))
    set_aside += caught_bytes_per_path(features, channels)
    set_aside += 12 * features.guides + 4 * (features.light_groups and features.shadow_rays)
    return set_aside + 4 * channels + 16 * features.splits_light * (1 + features.shadow_rays) + 4 * settles


def make_path_passes(
    path_count: int,
    features: SceneFeatures,
    layout: ChannelLayout,
    inputs: PassInputs,
    camera: CameraData,
    device: wp.Device,
) -> PathPasses | None:
    """The state of `path_count` paths for the passes of `features`; None where they need none."""
    if not (features.records_surfaces or layout.others or shows_catchers(features.passes)):
        return None

    def first(name: str) -> int:
        return layout.span(name).start - layout.others_first if name in layout.others else -1

    passes = PathPasses()
    split, shadow = features.splits_light, features.splits_light and features.shadow_rays
    settles = features.records_surfaces and features.transparency
    passes.values = wp.zeros((layout.others_count, path_count), dtype=float, device=device)
    passes.share = wp.zeros(path_count if split else 0, dtype=wp.vec4, device=device)
    passes.shadow_share = wp.zeros(path_count if shadow else 0, dtype=wp.vec4, device=device)
    grouped = features.light_groups and features.shadow_rays
    passes.life = wp.zeros(path_count if features.catchers else 0, dtype=int, device=device)
    passes.shadow_group = wp.zeros(path_count if grouped else 0, dtype=int, device=device)
    passes.carried = wp.zeros(path_count if features.guides else 0, dtype=wp.vec3, device=device)
    passes.settled = wp.zeros(path_count if settles else 0, dtype=int, device=device)
    aovs = [(first(name), channels_of(name)) for name in aov_passes(features.passes)]
    passes.aov = wp.array(np.array(aovs, np.int32).reshape(-1, 2), dtype=wp.vec2i, device=device)
    passes.mist, passes.uv, passes.vector = first("Mist"), first("UV"), first(VECTOR)
    passes.vector_weight = first(VECTOR_WEIGHT)
    passes.albedo, passes.normal, passes.depth = map(first, GUIDE_PASSES)
    passes.to_camera = camera_axes(camera)
    passes.occlusion = first(OCCLUSION_PASS)
    passes.emission, passes.environment = first("Emission"), first("Environment")
    groups = light_group_passes(layout.others)
    passes.group = first(groups[0]) if groups else -1
    passes.color = wp.vec3i(*map(first, COLOR_PASSES))
    passes.direct = wp.vec3i(*map(first, DIRECT_PASSES))
    passes.indirect = wp.vec3i(*map(first, INDIRECT_PASSES))
    passes.volume = wp.vec2i(*map(first, VOLUME_PASSES))
    passes.inputs = inputs
    return passes


def upload_pass_inputs(scene: Scene, features: SceneFeatures, device: wp.Device) -> PassInputs:
    """What the passes of `features` read of `scene`."""
    inputs, names = PassInputs(), features.passes
    start, depth, falloff = scene.frame.mist
    inputs.mist_start, inputs.mist_scale, inputs.mist_falloff = start, 1 / depth if depth > 0 else 0.0, falloff
    inputs.orthographic = int(scene.camera.kind == CameraKind.ORTHOGRAPHIC)
    inputs.alpha_threshold = scene.frame.alpha_threshold
    inputs.occlusion_distance = scene.frame.occlusion_distance
    if "Object Index" in names:
        info = scene.instances.info
        values = np.zeros(len(scene.instances), np.float32) if info is None else np.asarray(info, np.float32)[:, 4]
        inputs.object_index = wp.array(np.ascontiguousarray(values), dtype=float, device=device)
    if "Material Index" in names:
        values = np.array([material.index for material in scene.materials], np.float32)
        inputs.material_index = wp.array(values, dtype=float, device=device)
    if "UV" in names:
        maps = {i: mesh.corner_uvs for i, mesh in enumerate(scene.meshes) if mesh.corner_uvs is not None}
        corner_first, uvs = corner_values(scene, maps, 2)
        inputs.uv_first = wp.array(corner_first, dtype=int, device=device)
        inputs.uvs = wp.array(uvs, dtype=wp.vec2, device=device)
    if VECTOR in names:
        inputs.vector = upload_vectors(scene, device)
    kinds = matte_kinds(names)
    numbers = {kind: kinds.index(kind) if kind in kinds else -1 for kind in MATTE_KINDS}
    inputs.is_catcher = upload_catchers(scene, features, device)
    all_shine = all(light.light_sets >> COPY_SET & 1 for light in scene.lights)
    inputs.copy_receiver = -1 if all_shine else COPY_SET
    inputs.object_matte, inputs.material_matte, inputs.asset_matte = numbers.values()

    def identities(of: Iterable[str]) -> np.ndarray:
        return np.array([matte_identity(name) for name in of], np.uint32).view(np.int32)

    placed, objects = scene.instances.object, scene.object_names
    if inputs.object_matte >= 0:
        inputs.object_identity = wp.array(identities(objects)[placed], dtype=int, device=device)
    if inputs.asset_matte >= 0:
        inputs.asset_identity = wp.array(identities(scene.asset_names or objects)[placed], dtype=int, device=device)
    if inputs.material_matte >= 0:
        names_of_materials = (material.name for material in scene.materials)
        inputs.material_identity = wp.array(identities(names_of_materials), dtype=int, device=device)
    return inputs
