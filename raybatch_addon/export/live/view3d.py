"""The view of a region of the 3D view, as plain values, and the core's camera and frame for it.

Blender's own projection of the region is taken: zoom, shift, the camera's frame within the region and walking through
the scene are in it already.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...core.errors import SceneError
from ...core.scene.cameras import Camera, CameraKind
from ...core.scene.description import Frame
from ..camera import depth_of_field, frame_window, kind_of
from ..panorama import export_panorama

# Parts of a region: x0, y0, x1, y1
Box = tuple[int, int, int, int]
Edges = tuple[float, float, float, float]


@dataclass(frozen=True, kw_only=True)
class RegionView:
    """A region and where it looks from."""

    width: int  # [pixels]
    height: int
    to_view: tuple[float, ...]  # world to view, 16 numbers row by row
    projection: tuple[float, ...]  # view to clip space, 16 numbers row by row
    is_perspective: bool
    clip: tuple[float, float]  # near and far [m], of a view without camera
    through_camera: bool
    border: tuple[float, float, float, float] | None = None  # x0, y0, x1, y1 in shares of the camera's frame or region

    @property
    def window(self) -> tuple[float, float, float, float]:
        """Left, right, bottom, top edges, as `Camera.window` has them."""
        matrix = self.projection
        if self.is_perspective:
            x, y, cx, cy = matrix[0], matrix[5], matrix[2], matrix[6]
            return (cx - 1) / x, (cx + 1) / x, (cy - 1) / y, (cy + 1) / y
        x, y, cx, cy = matrix[0], matrix[5], matrix[3], matrix[7]
        return (-1 - cx) / x, (1 - cx) / x, (-1 - cy) / y, (1 - cy) / y

    @property
    def transform(self) -> np.ndarray:
        """View to world, float64, shape [4, 4]."""
        return np.linalg.inv(np.array(self.to_view, float).reshape(4, 4))


def region_view(region: bpy.types.Region, space: bpy.types.SpaceView3D, scene: bpy.types.Scene) -> RegionView:
    """What `region` of the 3D view `space` shows of `scene`."""
    data = space.region_3d if getattr(region, "data", None) is None else region.data
    camera = camera_of(space, scene)
    through = data.view_perspective == "CAMERA" and camera is not None and camera.type == "CAMERA"
    border = None
    if through and scene.render.use_border:
        render = scene.render
        border = (render.border_min_x, render.border_min_y, render.border_max_x, render.border_max_y)
    elif not through and space.use_render_border:
        border = (
            space.render_border_min_x,
            space.render_border_min_y,
            space.render_border_max_x,
            space.render_border_max_y,
        )
    return RegionView(
        width=region.width,
        height=region.height,
        to_view=tuple(float(each) for row in data.view_matrix for each in row),
        projection=tuple(float(each) for row in data.window_matrix for each in row),
        is_perspective=bool(data.is_perspective),
        clip=(space.clip_start, space.clip_end),
        through_camera=through,
        border=border,
    )


def camera_of(space: bpy.types.SpaceView3D, scene: bpy.types.Scene) -> bpy.types.Object | None:
    """The camera that the view would look through."""
    return space.camera if space.use_local_camera and space.camera is not None else scene.camera


def live_camera(
    view: RegionView, camera: bpy.types.Object | None, depsgraph: bpy.types.Depsgraph, frame: Frame
) -> tuple[Camera, Frame | None]:
    """The core's camera for `view`, through `camera` if the view is; and `frame` with the region's size and the part
    that is to be rendered, or None where nothing of that is in the region.

    Raises `SceneError` for a view that is not finite, as after a stroke of a brush on an object that is scaled to 0.
    """
    if not np.isfinite([*view.to_view, *view.projection]).all():
        if view.through_camera and camera is not None:
            what = "its lens" if np.isfinite(view.to_view).all() else "its matrix"
            raise SceneError(
                f"camera “{camera.name}”: {what} is not finite; reset its location, rotation, scale and lens"
            )
        raise SceneError("the view's matrix is not finite; choose View > Frame All, then View > Viewpoint > Top")
    window, transform = view.window, view.transform[:3]
    box: Box | None = None
    if view.through_camera and camera is not None:
        evaluated, scene = camera.evaluated_get(depsgraph), depsgraph.scene
        made, frame_edges = _through(evaluated, scene, depsgraph, transform, window)
        box = None if view.border is None else _box_in(view, view.border, frame_edges)
    else:
        made = _free(view, transform, window)
        box = None if view.border is None else _box_in(view, view.border, window)
    frame = replace(frame, width=view.width, height=view.height, border=box)
    if box is not None and (box[0] >= box[2] or box[1] >= box[3]):
        return made, None
    return made, frame


def _free(view: RegionView, transform: np.ndarray, window: tuple[float, float, float, float]) -> Camera:
    near, far = view.clip
    if view.is_perspective:
        return Camera(CameraKind.PERSPECTIVE, transform.astype(np.float32), window, clip_start=near, clip_end=far)
    # such a view looks both ways from where it is: it begins as far behind as it sees before it
    behind = np.array(transform)
    behind[:, 3] += behind[:, 2] * far
    kind = CameraKind.ORTHOGRAPHIC
    return Camera(kind, behind.astype(np.float32), window, clip_start=0.0, clip_end=2 * far)


def _through(
    camera: bpy.types.Object,
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    transform: np.ndarray,
    window: tuple[float, float, float, float],
) -> tuple[Camera, tuple[float, float, float, float]]:
    """The camera that the region looks through, and the edges of its own frame on the plane of `window`."""
    data, ignored = camera.data, list[str]()
    kind = kind_of(data, camera.name, ignored)
    render = scene.render
    size = (
        render.resolution_x * render.resolution_percentage / 100,
        render.resolution_y * render.resolution_percentage / 100,
    )
    size = max(1, int(size[0])), max(1, int(size[1]))
    shift = (data.shift_x, data.shift_y)
    flat = CameraKind.PERSPECTIVE if kind.is_panorama else kind
    edges = frame_window(data, flat, shift, render, *size)
    panorama = None
    if kind.is_panorama:
        span = np.array([size[0] * render.pixel_aspect_x, size[1] * render.pixel_aspect_y])
        panorama = export_panorama(data, span)
        left, bottom = _share(window[0], edges[:2]), _share(window[2], edges[2:])
        right, top = _share(window[1], edges[:2]), _share(window[3], edges[2:])
        window = shift[0] + left, shift[0] + right, shift[1] + bottom, shift[1] + top
    near, far = float(data.clip_start), float(data.clip_end)
    made = Camera(
        kind,
        transform.astype(np.float32),
        window,
        clip_start=near,
        clip_end=far if far > near else np.inf,
        **depth_of_field(camera, kind, transform, depsgraph, camera.name, ignored),
        panorama=panorama,
    )
    return made, edges


def _box_in(view: RegionView, border: Edges, edges: Edges) -> Box:
    """The `border` of `view`, in shares of what has these `edges`, in pixels of the region and cut by it."""
    window, (x0, y0, x1, y1) = view.window, border

    def pixel(share: float, low: float, high: float, along: tuple[float, float], pixels: int) -> int:
        return min(max(round(_share(low + share * (high - low), along) * pixels), 0), pixels)

    return (
        pixel(x0, *edges[:2], window[:2], view.width),
        pixel(y0, *edges[2:], window[2:], view.height),
        pixel(x1, *edges[:2], window[:2], view.width),
        pixel(y1, *edges[2:], window[2:], view.height),
    )


def _share(at: float, edges: tuple[float, ...]) -> float:
    """Where `at` is between two edges: 0 at the first, 1 at the second."""
    return (at - edges[0]) / (edges[1] - edges[0])
