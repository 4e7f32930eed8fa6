"""What programs read of a scene, kept for the next one: where instances only moved, their maps alone are copied."""

from __future__ import annotations

import numpy as np
import warp as wp

from ...kept_arrays import changed_rows, overwrite_changed
from ...programs.inputs_data import InputData, inverses, upload_inputs
from ...scene.description import Scene
from .unchanged import Last, kept_inputs_key


class KeptInputs:
    """What programs of surfaces read of the last scene."""

    def __init__(self) -> None:
        self._last: Last[InputData] = Last()
        self._transform = np.zeros((0, 3, 4), np.float32)  # where instances are by the inputs

    @property
    def made(self) -> InputData | None:
        """The inputs."""
        return self._last.made

    def clear(self) -> None:
        """Forget them."""
        self._last.clear()

    def get(self, scene: Scene, ops: tuple[str, ...], device: wp.Device) -> InputData:
        """The inputs that programs with `ops` read of `scene`, but for the camera; what was returned before may hold
        them now.
        """
        transform = np.asarray(scene.instances.transform, np.float32)

        def make() -> InputData:
            self._transform = transform.copy()
            return upload_inputs(scene, ops, device)

        inputs = self._last.get(kept_inputs_key(scene, ops, device.alias), make)
        changed = changed_rows(self._transform, transform)
        if len(changed):
            overwrite_changed(inputs.to_world, changed, transform)
            overwrite_changed(inputs.to_object, changed, transform, inverses)
            self._transform = transform.copy()
        return inputs
