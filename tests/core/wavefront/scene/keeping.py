"""For tests of what is kept from render to render: scenes that nobody can change, and counts of what is made."""

from collections.abc import Callable

from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.scene.frozen import freeze


def frozen_meshes(scene: Scene) -> Scene:
    """`scene` with meshes whose arrays nobody can change."""
    for mesh in scene.meshes:
        for array in (mesh.positions, mesh.triangles, mesh.triangle_slot, mesh.corner_normals, mesh.corner_uvs):
            if array is not None:
                freeze(array)
    return scene


def counted_calls(monkeypatch) -> tuple[list[str], Callable[[object, str], None]]:
    """Names of functions that were called, in order, and what has the calls of one counted: (owner, name), of a module
    or a class.
    """
    calls: list[str] = []

    def count(owner, name):
        real = getattr(owner, name)

        def counted(*args, **kwargs):
            calls.append(name)
            return real(*args, **kwargs)

        monkeypatch.setattr(owner, name, staticmethod(counted) if isinstance(owner, type) else counted)

    return calls, count
