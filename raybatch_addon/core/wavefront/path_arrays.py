"""The arrays of a worker's paths: their rays, and what features of the scene keep beside them."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from ..film.channels import ChannelLayout
from ..native.structs import upload_struct
from ..rays import Rays
from ..settings.settings import RenderSettings
from .catchers.state import CaughtPaths, allocate_caught
from .passes.state import PathPasses, make_path_passes
from .plan.plan import Method
from .rays import Paths, RayNeeds, allocate_paths, allocate_rays
from .requests.state import Requests, allocate_requests
from .scene.device_scene import DeviceScene
from .tier import array_features
from .volumes.table import VolumeData
from .volumes.volumes import with_state


@dataclass(frozen=True, kw_only=True)
class PathArrays:
    """State of so many paths; None for what the scene does not have."""

    paths: Paths
    rays: Rays
    passes: PathPasses | None
    catchers: CaughtPaths | None
    volumes: VolumeData | None
    requests: Requests | None

    @staticmethod
    def allocate(scene: DeviceScene, layout: ChannelLayout, settings: RenderSettings, count: int) -> PathArrays:
        """For `count` paths in `scene`, whose film has `layout`; all are free."""
        features, device = scene.features, scene.device
        paths = allocate_paths(count, array_features(features, scene.shading), device)
        passes = make_path_passes(count, features, layout, scene.pass_inputs, scene.camera, device)
        if passes:
            paths.passes = upload_struct(passes, device)
        requests = allocate_requests(count, features, device)
        if requests:
            paths.requests = upload_struct(requests, device)
        needs = RayNeeds.of(features, scene.tracing.method is Method.REFERENCE)
        return PathArrays(
            paths=paths,
            rays=allocate_rays(count, device, dataclasses.replace(needs, shadow_rays=scene.shadow_rays)),
            passes=passes,
            catchers=allocate_caught(count, layout, features, scene.pass_inputs.is_catcher, device)
            if features.catchers
            else None,
            volumes=with_state(scene.volumes.data, count, settings.volume_bounce_max, device)
            if scene.volumes
            else None,
            requests=requests,
        )

    def free_all(self) -> None:
        """Give up all paths."""
        self.paths.status.zero_()
        if self.passes:
            self.passes.values.zero_()
            self.passes.life.zero_()
        if self.requests:
            self.requests.phase.zero_()
