"""Cycles as a peer: the same .blend, in the same process, made unbiased."""

from __future__ import annotations

import os
import tempfile
import time

import numpy as np
import warp as wp

from lib.command import UsageError
from raybatch_addon.core.settings.settings import RenderSettings

GPU_KINDS = ("OPTIX", "CUDA")  # in this order


class CyclesPeer:
    """Renders the open .blend with Cycles."""

    def __init__(self, scene, device: wp.Device, settings: RenderSettings, thread_count: int, kind: str | None = None):
        """`scene` is Blender's; samples, bounces and filter are those of `settings`, and `kind` one of `kinds_offered`
        (None: the first of them). Raises `UsageError`.
        """
        self._scene, self._samples, self._device = scene, settings.sample_count, device
        make_unbiased(scene, settings)
        if thread_count:
            scene.render.threads_mode, scene.render.threads = "FIXED", thread_count
        else:
            scene.render.threads_mode = "AUTO"
        self.device = use_device(scene, device, kind)  # as Cycles calls it

    def render(self) -> float:
        """Seconds of one render, with the samples and the seed that it had last."""
        import bpy

        use_device(self._scene, self._device, self.device)  # another peer of the scene may have chosen its own
        self._scene.render.engine = "CYCLES"
        start = time.perf_counter()
        bpy.ops.render.render()
        return time.perf_counter() - start

    def picture(self, seed: int) -> np.ndarray:
        """The linear picture rendered with `seed`, float64, shape [height, width, 3], bottom row first."""
        return self.timed_picture(seed, self._samples)[1]

    def timed_picture(self, seed: int, samples: int) -> tuple[float, np.ndarray]:
        """Seconds of a render with `seed` and `samples`, and its picture as in `picture`."""
        self._scene.cycles.seed, self._scene.cycles.samples = seed, samples
        return self.render(), self._rendered()

    def _rendered(self) -> np.ndarray:
        """The picture of the last render, as in `picture`."""
        import bpy

        scene = self._scene
        image = scene.render.image_settings
        if hasattr(image, "media_type"):
            image.media_type = "IMAGE"
        image.file_format, image.color_mode, image.color_depth, image.exr_codec = "OPEN_EXR", "RGB", "32", "ZIP"
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "picture.exr")
            bpy.data.images["Render Result"].save_render(path, scene=scene)
            loaded = bpy.data.images.load(path)
            loaded.colorspace_settings.name = "Non-Color"
            pixels = np.empty(len(loaded.pixels), np.float32)
            loaded.pixels.foreach_get(pixels)
            width, height = loaded.size
            bpy.data.images.remove(loaded)
        return pixels.reshape(height, width, -1)[..., :3].astype(np.float64)


def leave_as_rendered(scene) -> None:
    """Show the view layer that RayBatch renders, as it is: without compositing, and with the scene's samples."""
    import bpy

    render = scene.render
    render.use_compositing = render.use_sequencer = render.use_freestyle = False
    for layer in scene.view_layers:
        layer.use = layer == bpy.context.view_layer
        layer.samples = 0  # of its own: none


def make_unbiased(scene, settings: RenderSettings) -> None:
    """Leave Cycles without shortcuts in `scene`: what is left is noise. It renders the view layer that RayBatch does,
    with the samples, bounces and filter of `settings`, and shows it as it is.
    """
    import bpy

    leave_as_rendered(scene)
    cycles = scene.cycles
    if hasattr(cycles, "use_sample_subset"):
        cycles.use_sample_subset = False
    cycles.film_exposure = 1
    cycles.samples = settings.sample_count
    cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_guiding = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0
    cycles.blur_glossy = cycles.light_sampling_threshold = 0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    cycles.use_fast_gi = False
    # shadow caustics take the place of paths through casters, and show a part of their light
    for each in (*bpy.data.lights, *bpy.data.worlds):
        each.cycles.is_caustics_light = False
    cycles.texture_limit_render = "OFF"
    cycles.time_limit = 0
    cycles.pixel_filter_type, cycles.filter_width = settings.pixel_filter, settings.filter_width
    cycles.min_light_bounces = cycles.min_transparent_bounces = 0
    for name in ("max_bounces", "diffuse_bounces", "glossy_bounces", "transmission_bounces", "volume_bounces"):
        setattr(cycles, name, settings.bounce_max)
    cycles.volume_bounces = min(settings.bounce_max, settings.volume_bounce_max)
    cycles.transparent_max_bounces = settings.transparent_bounce_max


def kinds_offered(device: wp.Device) -> tuple[str, ...]:
    """The kinds of devices on which Cycles can render where RayBatch does; raises `UsageError` where there is none."""
    if not device.is_cuda:
        return ("CPU",)
    found = tuple(kind for kind in GPU_KINDS if _devices_of(kind))
    if not found:
        raise UsageError(
            f"Cycles finds no GPU here, and RayBatch renders on {device.alias}: use --device cpu, or leave --against "
            "out"
        )
    return found


def use_device(scene, device: wp.Device, kind: str | None = None) -> str:
    """Let Cycles render where RayBatch does, by `kind` of `kinds_offered` (None: the first); returns it. Raises
    `UsageError` where it cannot.
    """
    kind = kind or kinds_offered(device)[0]
    if kind == "CPU":
        scene.cycles.device = "CPU"
        return kind
    usable = _devices_of(kind)
    if not usable:
        raise UsageError(f"Cycles finds no device of the kind {kind} here")
    import bpy

    chosen = usable[device.ordinal % len(usable)]
    for each in bpy.context.preferences.addons["cycles"].preferences.devices:
        each.use = each == chosen
    scene.cycles.device = "GPU"
    return kind


def _devices_of(kind: str) -> list:
    """Cycles' devices of `kind`, which becomes the kind that its preferences show."""
    import bpy

    preferences = bpy.context.preferences.addons["cycles"].preferences
    try:
        preferences.compute_device_type = kind
    except TypeError:  # this Blender was built without it
        return []
    preferences.get_devices()
    return [each for each in preferences.devices if each.type == kind]
