"""Features that the kernels of volumes are specialised on."""

from __future__ import annotations

from dataclasses import dataclass

from ...scene.program import ProgramFeatures
from ..stages.surface.features import SurfaceFeatures


@dataclass(frozen=True)
class VolumeFeatures(SurfaceFeatures):
    """The part of `SceneFeatures` that volumes depend on; fields have the same names."""

    volume_program: ProgramFeatures = ProgramFeatures()
    lamp_program: ProgramFeatures = ProgramFeatures()
    light_hits: bool = False
