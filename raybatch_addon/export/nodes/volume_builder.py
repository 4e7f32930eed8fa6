"""Programs of volumes: inputs of surfaces are 0 there, and closures of surfaces none."""

from __future__ import annotations

from typing import Any

from ...core.programs.builder import ProgramBuilder, Value
from ...core.programs.op import VOLUME_PREFIX

_ZERO, _NONE = Value.of((0.0, 0.0, 0.0)), Value.of(0.0)
# Ops that read a triangle, and what they give where there is none
_OF_TRIANGLES = {
    "bump": _ZERO,
    "curve_tangent_normal": _ZERO,
    "normal_map": _ZERO,
    "parametric": _ZERO,
    "radial_tangent": _ZERO,
    "uv": _ZERO,
    "uv_tangent": _ZERO,
    "wireframe": _NONE,
}
# Coordinates that are those of the world in its own volume, where ops of surfaces know a direction alone
_OF_OBJECTS = ("generated", "object_coordinates", "position")


class VolumeBuilder(ProgramBuilder):
    """Steps of the program of a volume."""

    def __init__(self, of_world: bool, has_grids: bool, smooth: bool = False) -> None:
        """A program without steps.

        `of_world`: of the volume that fills the world, which is no object; `has_grids`: there are objects with grids;
        `smooth`: these are read by splines.
        """
        super().__init__()
        self._reads_grids = "volume_attribute_cubic" if smooth else "volume_attribute"
        self._of_world, self._has_grids = of_world, has_grids and not of_world

    def value(self, name: str, *operands) -> Value | tuple[Value, ...]:
        """Result of the op `name`, as it is in a volume."""
        if name == "attribute":
            return self.value("volume_attribute", operands[0], 0.0)
        if name == "volume_attribute" and not self._has_grids:
            missing = Value.of(operands[1]).number()
            return Value.of((missing,) * 3), Value.of(missing), _NONE
        if name == "volume_attribute":
            return super().value(self._reads_grids, *operands)
        if name in _OF_TRIANGLES:
            return _OF_TRIANGLES[name]
        if self._of_world and name in _OF_OBJECTS:
            return super().value("volume_position", *operands)
        return super().value(name, *operands)

    def closure(self, name: str, *operands) -> None:
        """Add a closure, if volumes have such."""
        if name == "emission" or name.startswith(VOLUME_PREFIX):
            super().closure(name, *operands)


def reads_smoothly(material: Any) -> bool:
    """Whether a material says that grids are read by splines, or None, which does not."""
    # the setting belongs to Cycles, and is there as long as that add-on is enabled; a change of it updates no copy that
    # was evaluated
    own = getattr(getattr(material, "original", None), "cycles", None)
    return getattr(own, "volume_interpolation", "LINEAR") == "CUBIC"


def is_in_volume(graph: Any) -> bool:
    """Whether `graph` describes a volume: nodes of volumes give nothing elsewhere."""
    return isinstance(graph.builder, VolumeBuilder)
