"""Displacement by the kernels that are there: general ones, or ones that are specialised on its programs."""

from __future__ import annotations

import warp as wp

from ...device.devices import is_compiled, load_module
from ...displacement.evaluate import Move, VertexWork, move_vertices
from ...programs.op import NodeData
from ...programs.table import store_programs
from ...scene.program import ProgramFeatures
from ..scene.shading_data import SceneData
from ..tier import asked_tier, general_features, lack_of
from .kernels import estimate_kernel
from .work import Estimate, EstimateWork


def mover(setting: str) -> Move:
    """What runs programs of displacement where the setting `kernel_tier` is `setting`. AUTO takes general kernels that
    are compiled: vertices are few beside rays.
    """
    asked = asked_tier(setting)

    def move(data: NodeData, programs: ProgramFeatures, work: VertexWork, count: int, device: wp.Device) -> None:
        general = general_features(device)
        kernel = estimate_kernel(general, Estimate.DISPLACEMENT)
        can = asked != "SPECIALISED" and not lack_of(programs, general.programs)
        if not (can and (asked == "GENERAL" or is_compiled(kernel, device))):
            move_vertices(data, programs, work, count, device)
            return
        load_module(kernel, device)
        stored = store_programs(data, device=device)
        scene, todo = SceneData(), EstimateWork()
        scene.nodes, todo.vertices, todo.estimate = data, work, int(Estimate.DISPLACEMENT)
        wp.launch(kernel, count, [scene, todo], device=device)
        wp.synchronize_device(device)  # what is stored is read until then
        del stored

    return move
