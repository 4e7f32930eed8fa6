"""Stage: new paths start at the camera, in free slots. Next: `trace`."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import warp as wp

from ...device.kernel import KERNEL_OPTIONS
from ...rays import Rays
from ...scene.description import CameraKind, Visibility
from ...scene.features import narrow
from ...shading.camera import CameraData, CameraFeatures, make_camera_ray
from ...shading.camera_motion import camera_at, shutter_time
from ...shading.sampling import sample_filter
from ...shading.sequences.keys import FILTER, LENS, TIME
from ...shading.sequences.sampler import make_sampler
from ..passes.state import is_guided
from ..rays import VISIBILITY_SHIFT, Paths, Status, bounce_of
from .limits import PathLimits
from .work import TileWork

# Paths that are numbered from one `TileWork.item_base`, by 32 bits
ITEMS_NUMBERED = 1 << 32
CAMERA_RAY = int(Visibility.CAMERA)
NEW_PATH = int(Status.ALIVE | Status.RAY_OUT) | CAMERA_RAY << VISIBILITY_SHIFT


@dataclass(frozen=True, kw_only=True)
class GenerateFeatures:
    """Features that the stage is specialised on."""

    camera: CameraKind | None  # None: any
    depth_of_field: bool
    sample_sequence: str
    transparency: bool
    film_transparent: bool
    normal_pass: bool
    path_history: bool = False
    guides: bool = False
    spherical_stereo: bool = False
    camera_motion: bool = False
    motion: bool = False


@wp.func
def pixel_in_blocks(number: int, width: int, height: int) -> wp.vec2i:
    """Column and row of pixel `number` of a tile that is walked in blocks of 8 x 8, so that rays beside each other are
    alike.
    """
    strip = number / (8 * width)
    rows = wp.min(8, height - 8 * strip)
    rest = number - 8 * width * strip
    block = rest / 64
    if rows < 8:
        block = rest / (8 * rows)
    columns = wp.min(8, width - 8 * block)
    rest -= 8 * rows * block
    row = rest / 8
    if columns < 8:
        row = rest / columns
    return wp.vec2i(8 * block + rest - row * columns, 8 * strip + row)


@wp.struct
class PixelSample:
    """The sample of a pixel that an item stands for."""

    x: int  # column and row in the frame
    y: int
    index: int  # of the pixel within the tile, row by row from its bottom left
    sample: wp.uint32  # index of the pixel's sample


@wp.func
def pixel_sample(work: TileWork, number: wp.uint32) -> PixelSample:
    """Pixel and sample of the path with this number."""
    item = work.item_base + wp.int64(number)
    fast_count = wp.int64(work.width) * wp.int64(work.height)  # how far the index that changes faster goes
    if work.pixel_first != 0:
        fast_count = work.sample_count
    slow = wp.int64(0)
    if item < wp.static(wp.int64(1 << 32)) and fast_count < wp.static(wp.int64(1 << 32)):
        slow = wp.int64(wp.uint32(item) / wp.uint32(fast_count))  # much faster, and nearly always enough
    else:
        slow = item / fast_count
    fast = item - slow * fast_count
    pixel = int(fast)
    sample = slow
    if work.pixel_first != 0:
        pixel = int(slow)
        sample = fast
    place = pixel_in_blocks(pixel, work.width, work.height)
    result = PixelSample()
    result.x = work.x + place[0]
    result.y = work.y + place[1]
    result.index = place[1] * work.width + place[0]
    result.sample = wp.uint32(work.sample_first + sample)
    return result


@wp.kernel(**KERNEL_OPTIONS)
def counted_kernel(work: TileWork, paths: Paths, bounce: wp.array(dtype=int), pixel: wp.array(dtype=int)):
    """What counters ask for: the bounce and the pixel of every path. A free slot's number may be of another tile, where
    this one has no pixel.
    """
    path = wp.tid()
    if paths.status[path] == 0:
        return
    bounce[path] = bounce_of(paths.status[path])
    pixel[path] = pixel_sample(work, paths.item[path]).index


@wp.func
def active_number(work: TileWork, active: wp.array(dtype=int), item: wp.int64) -> wp.uint32:
    """Number of the path that is item `item` of those of the pixels `active` alone, in the same order.

    `active` holds their places in the order in which all pixels are walked. Numbers stay those of a tile that gets
    samples of every pixel (`item_base` is 0), so that no other stage knows the difference.
    """
    if work.pixel_first != 0:
        place = item / work.sample_count
        return wp.uint32(wp.int64(active[int(place)]) * work.sample_count + item - place * work.sample_count)
    count = wp.int64(active.shape[0])
    sample = item / count
    place = item - sample * count
    return wp.uint32(sample * wp.int64(work.width) * wp.int64(work.height) + wp.int64(active[int(place)]))


@functools.cache
def make_begin_path(features: GenerateFeatures) -> wp.Function:
    """Function (work, limits, camera, paths, rays, path, number): the path with this number starts in slot `path`."""
    sampler = make_sampler(features.sample_sequence)
    pixel_key = sampler.pixel_key
    sampler_1d = sampler.sample_1d
    sample_2d = sampler.sample_2d
    camera_ray = make_camera_ray(narrow(features, CameraFeatures))

    @wp.func
    def begin_path(
        work: TileWork, limits: PathLimits, camera: CameraData, paths: Paths, rays: Rays, path: int, number: wp.uint32
    ):
        pixel = pixel_sample(work, number)
        x = pixel.x
        y = pixel.y
        key = pixel_key(limits.seed, wp.uint32(x), wp.uint32(y), wp.uint32(work.frame_width))
        index = pixel.sample
        offset = sample_filter(work.filter_table, sample_2d(key, index, wp.uint32(FILTER)))
        lens = wp.vec2(0.5, 0.5)
        if wp.static(features.depth_of_field):
            if camera.lens_radius > 0.0:
                lens = sample_2d(key, index, wp.uint32(LENS))
        seen = camera
        if wp.static(features.motion):
            if rays.time.shape[0] > 0:
                time = shutter_time(camera, float(y) + 0.5, sampler_1d(key, index, wp.uint32(TIME)))
                rays.time[path] = time
                if wp.static(features.camera_motion):
                    seen = camera_at(camera, time)
        origin, direction, t_max = camera_ray(seen, float(x) + 0.5 + offset[0], float(y) + 0.5 + offset[1], lens)

        rays.origin[path] = origin
        rays.direction[path] = direction
        rays.t_max[path] = t_max
        if rays.visibility.shape[0] > 0:
            rays.visibility[path] = wp.static(CAMERA_RAY)
        paths.item[path] = number
        paths.throughput[path] = wp.vec3(1.0, 1.0, 1.0)
        if wp.static(features.camera is None or features.camera.is_panorama):
            if t_max == 0.0:  # the camera sees nothing there
                paths.throughput[path] = wp.vec3(0.0, 0.0, 0.0)
        paths.radiance[path] = wp.vec3(0.0, 0.0, 0.0)
        paths.pdf[path] = 0.0
        if wp.static(features.transparency):
            paths.passed[path] = 0
            paths.passed_t[path] = 0.0
        if wp.static(features.path_history):
            paths.history[path] = 0
        if wp.static(features.film_transparent):
            if paths.alpha.shape[0] > 0:
                paths.alpha[path] = 1.0
        if wp.static(features.normal_pass):
            if paths.normal.shape[0] > 0:
                paths.normal[path] = wp.vec3(0.0, 0.0, 0.0)
        if wp.static(features.guides):
            if is_guided(paths.passes):
                paths.passes[0].carried[path] = wp.vec3(1.0)
        paths.status[path] = wp.static(NEW_PATH)

    return begin_path


@functools.cache
def generate_kernel(features: GenerateFeatures) -> wp.Kernel:
    """Kernel (work, limits, camera, paths, rays, slots, count): item `item_first + i` starts in free slot `slots[i]`;
    `count` is known.
    """
    begin_path = make_begin_path(features)

    @wp.kernel(**KERNEL_OPTIONS)
    def generate(
        work: TileWork,
        limits: PathLimits,
        camera: CameraData,
        paths: Paths,
        rays: Rays,
        slots: wp.array(dtype=int),
        count: wp.array(dtype=int),
    ):
        i = wp.tid()
        if i == 0:
            count[0] = work.item_count
        number = wp.uint32(work.item_first - work.item_base) + wp.uint32(i)
        begin_path(work, limits, camera, paths, rays, slots[i], number)

    return generate


@functools.cache
def generate_active_kernel(features: GenerateFeatures) -> wp.Kernel:
    """Kernel (work, limits, camera, paths, rays, slots, count, active): the same where pixels of the list `active`
    alone get samples, and items are theirs.
    """
    begin_path = make_begin_path(features)

    @wp.kernel(**KERNEL_OPTIONS)
    def generate_active(
        work: TileWork,
        limits: PathLimits,
        camera: CameraData,
        paths: Paths,
        rays: Rays,
        slots: wp.array(dtype=int),
        count: wp.array(dtype=int),
        active: wp.array(dtype=int),
    ):
        i = wp.tid()
        if i == 0:
            count[0] = work.item_count
        number = active_number(work, active, work.item_first + wp.int64(i))
        begin_path(work, limits, camera, paths, rays, slots[i], number)

    return generate_active
