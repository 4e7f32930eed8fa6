"""The state of a path that has met a shadow catcher, kept while it goes on from there again and again."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
import warp as wp

from ...film.channels import ChannelLayout
from ...scene.description import Scene
from ...scene.features import SceneFeatures
from ...scene.linking import catchers
from ...scene.passes import (
    CATCHER_ALPHA,
    CATCHER_LIGHT,
    CAUGHT_LIGHT,
    CAUGHT_WORLD,
    DIRECT_PASSES,
    INDIRECT_PASSES,
    LIGHT_GROUP,
    VOLUME_PASSES,
    channels_of,
)


class Life(IntEnum):
    """The purpose that a path is traced for, one after another in its slot."""

    NONE = 0  # it has met no catcher before it scattered
    MAIN = 1  # it has
    WORLD = 2  # its ray once more, with nothing in its way
    COPY = 3  # once more, where it sees catchers alone
    NEW_COPY = 4  # the same, before its ray has met the catcher again


@wp.struct
class CaughtPaths:
    """The last ray of each path before a catcher that it met, and what it brought; one entry a path. Channels are those
    of `PathPasses.values`; -1: there is none.
    """

    origin: wp.array(dtype=wp.vec3)
    direction: wp.array(dtype=wp.vec3)
    t_max: wp.array(dtype=float)
    throughput: wp.array(dtype=wp.vec3)
    passed: wp.array(dtype=int)  # where surfaces may be transparent, like `passed_t`
    passed_t: wp.array(dtype=float)
    radiance: wp.array(dtype=wp.vec3)  # before the catcher; of the whole path once that is at its end
    alpha: wp.array(dtype=float)  # if nothing of the catcher covered the film; of the whole path in the end
    values: wp.array2d(dtype=float)  # rows of `PathPasses.values` as they will be in the end
    # 1: passes of light, to which a path adds nothing behind a catcher; of each channel, int32
    of_light: wp.array(dtype=int)
    is_catcher: wp.array(dtype=int)  # 1, of each instance
    caught: int  # first channel of the light of the path behind the catcher
    copied: int  # of that of its copy
    coverage: int  # of the alpha of catchers
    behind: int  # of the world behind catchers
    environment: int  # of the pass Environment
    shows_world: int  # 1: the world behind catchers is looked at


# Arrays of one entry a path: of all scenes with catchers, and of those where surfaces may be transparent
_OF_PATHS = ("origin", "direction", "t_max", "throughput", "radiance", "alpha")
_OF_TRANSPARENCY = ("passed", "passed_t")


def caught_bytes_per_path(features: SceneFeatures, channel_count: int) -> int:
    """Memory of `CaughtPaths` and `PathPasses.life` for each path [bytes]."""
    if not features.catchers:
        return 0
    arrays = (*_OF_PATHS, *(_OF_TRANSPARENCY if features.transparency else ()))
    sizes = (wp.types.type_size_in_bytes(CaughtPaths.vars[name].type.dtype) for name in arrays)
    return sum(sizes) + 4 * channel_count + 4


def allocate_caught(
    path_count: int, layout: ChannelLayout, features: SceneFeatures, is_catcher: wp.array, device: wp.Device
) -> CaughtPaths:
    """For `path_count` paths of a film with `layout`; `is_catcher`: see `CaughtPaths`."""

    def first(name: str) -> int:
        return layout.span(name).start - layout.others_first if name in layout.others else -1

    caught, of_light = CaughtPaths(), np.zeros(layout.others_count, np.int32)
    for name in layout.others:
        if name in (*DIRECT_PASSES, *INDIRECT_PASSES, *VOLUME_PASSES) or name.startswith(LIGHT_GROUP):
            of_light[first(name) : first(name) + channels_of(name)] = 1
    for name in (*_OF_PATHS, *_OF_TRANSPARENCY):
        count = path_count if features.transparency or name in _OF_PATHS else 0
        setattr(caught, name, wp.zeros(count, dtype=CaughtPaths.vars[name].type.dtype, device=device))
    caught.values = wp.zeros((layout.others_count, path_count), dtype=float, device=device)
    caught.of_light = wp.array(of_light, dtype=int, device=device)
    caught.is_catcher = is_catcher
    caught.caught, caught.copied, caught.coverage = map(first, (CAUGHT_LIGHT, CATCHER_LIGHT, CATCHER_ALPHA))
    caught.behind, caught.environment = first(CAUGHT_WORLD), first("Environment")
    caught.shows_world = int(not layout.transparent and (caught.behind >= 0 or caught.environment >= 0))
    return caught


def upload_catchers(scene: Scene, features: SceneFeatures, device: wp.Device) -> wp.array:
    """`CaughtPaths.is_catcher` of `scene`; empty where it has none."""
    flags = catchers(scene).astype(np.int32) if features.catchers else np.zeros(0, np.int32)
    return wp.array(flags, dtype=int, device=device)
