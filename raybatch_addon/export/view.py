"""The view that is rendered: of stereoscopy one eye, otherwise the camera itself."""

from __future__ import annotations

from dataclasses import dataclass, replace

import bpy
import numpy as np


@dataclass(frozen=True)
class View:
    """A view of a render by `engine`, which knows where its eye is; without an engine the camera as it stands."""

    engine: bpy.types.RenderEngine | None = None
    name: str = ""  # as the render result calls it
    is_look: bool = False  # nothing is rendered: what a render would lack is looked for
    held: bpy.types.Object | None = None  # the camera at all times, whatever markers of the timeline change

    def camera(self, scene: bpy.types.Scene) -> bpy.types.Object | None:
        """The object that is looked through."""
        if self.held is not None:
            return self.held
        found = self.engine.camera_override if self.engine else None
        return found or scene.camera

    def holding(self, scene: bpy.types.Scene) -> View:
        """This view through the camera that it has now."""
        return replace(self, held=self.camera(scene))

    def is_spherical(self, camera: bpy.types.Object) -> bool:
        """Whether the eye moves with the rays' directions."""
        return bool(self.engine and self.name and self.engine.use_spherical_stereo(camera))

    def matrix(self, camera: bpy.types.Object, is_spherical: bool) -> np.ndarray:
        """Camera to world, shape [4, 4]."""
        if not self.engine or not self.name:
            return np.array(camera.matrix_world, float)
        flat = self.engine.camera_model_matrix(camera, use_spherical_stereo=is_spherical)
        return np.array(flat, float).reshape(4, 4).T if len(flat) == 16 else np.array(flat, float)

    def shift(self, camera: bpy.types.Object, is_spherical: bool) -> tuple[float, float]:
        """Shift of the frame, in units of the sensor."""
        if not self.engine or not self.name:
            return camera.data.shift_x, camera.data.shift_y
        return self.engine.camera_shift_x(camera, use_spherical_stereo=is_spherical), camera.data.shift_y
