"""Renders that need no Blender: saved scenes and NumPy geometry."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import IO

from lib.command import RefusedError, UsageError
from lib.geometry_files import load_geometry, parse_view
from lib.output import (
    OutputFolders,
    described,
    film_arrays,
    print_notes,
    print_saved,
    print_warnings,
    write_film,
    write_json,
)

from raybatch_addon.blender.denoise_library import library_for
from raybatch_addon.blender.denoising import denoise_film, with_guides
from raybatch_addon.blender.kernel_cache import kernel_cache_folder
from raybatch_addon.core.checkpoint.checkpoint import Checkpoint
from raybatch_addon.core.cluster.session import ClusterSession
from raybatch_addon.core.film import Film
from raybatch_addon.core.measure.parts import Parts
from raybatch_addon.core.scene.archive import load_scene, save_scene
from raybatch_addon.core.scene.description import Camera, Scene
from raybatch_addon.core.scene.notice import Weight, by_weight
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from rendering.pictures import picture_path, write_heat_map, write_picture
from rendering.progress import ProgressBar
from rendering.request import ARCHIVE, RESOLUTION_DEFAULT, Request, not_layered
from rendering.stops import StopRequests


def render_standalone(
    request: Request,
    folders: OutputFolders,
    bar: ProgressBar,
    standard_output,
    opened: Callable[[RenderSettings], ClusterSession] | None = None,
) -> None:
    """Render `request.source`, by the session that `opened` returns for its settings, if it is given, and write what
    was asked for; raises `RayBatchError`.
    """
    if request.settings_from:
        raise UsageError(f"{request.source} holds no settings of other engines; --settings-from is for .blend files")
    if request.frames is not None or request.view_layers:
        raise UsageError(f"{request.source} holds one picture; --frame, --frames and --view-layer are for .blend files")
    out = picture_path(Path(request.out).absolute()) if request.out else None
    if request.multilayer and out is not None and out.suffix.lower() != ".exr":  # which has every pass
        raise not_layered(request.out or "")
    film_path = Path(request.film).absolute() if request.film else None
    heat_maps = [(name, Path(path).absolute()) for name, path in request.heat_maps]
    checkpoint = None
    if request.checkpoint:
        checkpoint = Checkpoint(
            request.checkpoint, request.checkpoint_interval, report=lambda text: print_notes([text])
        )
    for path in (out, film_path, None if checkpoint is None else checkpoint.path, *(path for _, path in heat_maps)):
        if path is not None:
            folders.prepare(path)
    parts = Parts("export")
    scene, settings = _scene_and_settings(request)
    passes = dict.fromkeys((*scene.frame.passes, *request.passes))
    scene = dataclasses.replace(scene, frame=dataclasses.replace(scene.frame, passes=tuple(passes)))
    settings = settings.replace(**request.settings)
    if request.save_scene:
        path = Path(request.save_scene).absolute()
        save_scene(path, scene, settings)
        print_saved(path, "the scene")
    print_warnings(scene.warnings)
    if not request.renders:
        return
    _refuse(request, scene)
    denoiser = library_for(settings)
    scene = with_guides(scene, settings)
    parts.enter("start")
    renderer = opened(settings) if opened else Session(settings.device, settings, kernel_cache_folder())
    try:
        with StopRequests() as stops:
            film = renderer.render(
                scene,
                settings,
                on_progress=bar.show,
                cancelled=stops.asked,
                sample_first=request.sample_first,
                parts=parts,
                checkpoint=checkpoint,
            )
    finally:
        renderer.close()
        bar.close()
    if stops.asked() and not film.complete:
        _report(request, film, scene, standard_output)
        raise KeyboardInterrupt
    if denoiser is not None:
        parts.enter("denoise")
        denoise_film(film, settings, denoiser)
    film.statistics["seconds"] = parts.record()
    if out is not None:
        write_picture(out, film, scene)
        print_saved(out)
    if film_path is not None:
        write_film(film_path, film_arrays([("", film)]))
        print_saved(film_path, "the film")
    for name, path in heat_maps:
        write_heat_map(path, film.passes[name][..., 0], name)
    _report(request, film, scene, standard_output)


def _report(request: Request, film: Film, scene: Scene, standard_output: IO[str]) -> None:
    print_warnings(text for text in film.statistics["warnings"] if text not in scene.warnings)
    if request.json:
        write_json(request.json, [described(film, None, None)], standard_output)


def _refuse(request: Request, scene: Scene) -> None:
    """Raise `RefusedError` if the scene was exported without what `--strict` asks for."""
    heavy = [each for each in by_weight(scene.warnings) if request.strict and each.weight >= Weight[request.strict]]
    if heavy:
        raise RefusedError(f"not rendered, as nothing may be missing: {heavy[0]}")


def _scene_and_settings(request: Request) -> tuple[Scene, RenderSettings]:
    if request.kind == ARCHIVE:
        if request.camera or request.up:
            raise UsageError(f"{request.source} has a camera of its own; --camera and --up are for geometry files")
        scene, settings = load_scene(request.source)
        # the device and its threads were those of the machine that saved the scene
        settings = settings.replace(device="AUTO", thread_count=0)
        return (resized(scene, *request.resolution) if request.resolution else scene), settings
    width, height = request.resolution or RESOLUTION_DEFAULT
    view = parse_view(request.camera) if request.camera else None
    return load_geometry(request.source, width=width, height=height, view=view, up=request.up or "z"), RenderSettings()


def resized(scene: Scene, width: int, height: int) -> Scene:
    """`scene` at another resolution: the longer side shows what it showed, the shorter one more or less of it; a border
    scales along.
    """
    frame, camera = scene.frame, scene.camera
    border = None
    if frame.border is not None:
        x0, y0, x1, y1 = frame.border
        across, down = width / frame.width, height / frame.height
        left, bottom = min(round(x0 * across), width - 1), min(round(y0 * down), height - 1)
        border = (left, bottom, max(left + 1, round(x1 * across)), max(bottom + 1, round(y1 * down)))
    frame = dataclasses.replace(frame, width=width, height=height, border=border)
    return dataclasses.replace(
        scene, frame=frame, camera=_refitted(camera, scene.frame.width, scene.frame.height, width, height)
    )


def _refitted(camera: Camera, old_width: int, old_height: int, width: int, height: int) -> Camera:
    """`camera` for a frame of another shape, square pixels assumed to stay as square as they were."""
    left, right, bottom, top = camera.window
    # size of a pixel in the window, where the longer side keeps its extent
    scale = max(old_width, old_height) / max(width, height)
    half_x = (right - left) / 2 * scale * width / old_width
    half_y = (top - bottom) / 2 * scale * height / old_height
    x, y = (left + right) / 2, (bottom + top) / 2
    return dataclasses.replace(camera, window=(x - half_x, x + half_x, y - half_y, y + half_y))
