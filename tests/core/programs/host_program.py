"""Programs run on the host, by the Python bodies of their ops."""

from __future__ import annotations

import functools
from types import SimpleNamespace

import numpy as np
import warp as wp

from raybatch_addon.core.programs.builder import _Closures
from raybatch_addon.core.programs.op import as_python, op_named
from raybatch_addon.core.scene.description import Closure
from raybatch_addon.core.scene.program import Program
from raybatch_addon.core.shading.bsdf.albedo import AlbedoTables, load_table
from raybatch_addon.core.shading.bsdf.materials import constant_closure


class _Table:
    """An array as Python bodies of Warp functions read it: plain numbers, and rows."""

    def __init__(self, values: np.ndarray):
        self._values = values
        self.shape = values.shape

    def __getitem__(self, index):
        found = self._values[index]
        return _Table(found) if np.ndim(found) else float(found)


def albedo_arrays() -> dict[str, np.ndarray]:
    """All arrays of `AlbedoTables` by name, float32."""
    return {name: load_table(name) for name in AlbedoTables.vars}


@functools.cache
def host_tables() -> SimpleNamespace:
    """`AlbedoTables` that Python bodies can read."""
    return SimpleNamespace(**{name: _Table(values.astype(np.float64)) for name, values in albedo_arrays().items()})


def closures_seen_at(program: Program, cosine: float, azimuth: float = 0.4) -> tuple[Closure, ...]:
    """The closures that `program` makes on a surface that faces +Z.

    It is seen from `closure_probe.toward(cosine, azimuth)`.
    """
    sine = np.sqrt(1 - cosine**2)
    up = wp.vec3(0.0, 0.0, 1.0)
    incoming = wp.vec3(sine * np.cos(azimuth), sine * np.sin(azimuth), cosine)
    point = SimpleNamespace(normal=up, geometric_normal=up, incoming=incoming, backfacing=0, instance=0)
    stack, constants = [0.0] * program.register_count, [float(c) for c in program.constants]
    closures, count = _Closures([None] * program.closure_count), 0
    for step in program.instructions:
        op = op_named(step.op)
        data = SimpleNamespace(code=[0, *step.words], constants=constants, albedo=host_tables())
        if op.makes_closures:
            count = as_python(op.function)(data, stack, 0, point, closures, count)
        else:
            as_python(op.function)(data, stack, 0, point)
    return tuple(constant_closure(record) for record in closures[:count])
