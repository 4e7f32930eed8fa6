"""Meshes of earlier exports, found again by digests of what Blender stores of a mesh.

Blender evaluates a scene anew for every render, so that meshes have other addresses each time. Their numbers show
whether they are the same. Attributes as Blender stores them are copied a hundred times as fast as triangles, normals
and what else it derives from them. The arrays of a kept mesh are frozen: what the core made of them may be kept too.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import bpy
import numpy as np

from ...core.host_memory import host_memory_free
from ...core.scene.description import Attribute, Mesh
from ...core.scene.frozen import freeze
from .attributes import ATTRIBUTE_TYPES, mesh_attributes
from .mesh_arrays import MeshArrays
from .meshes import export_mesh

# A mesh that this many exports have not used is dropped
_EXPORTS_KEPT = 2
# Share of the host's free memory that kept meshes may take
_MEMORY_SHARE = 0.25
# What counts as free at most, as where the system does not say [bytes]
_FREE_MOST = 64 << 30

# Modifiers that run on several threads round what they interpolate differently each time, by a few units in the last
# place: relative
_ROUNDING = 2.0**-21

# Attributes that triangles, normals and materials follow from, wherever a mesh has them
_OF_SHAPE = frozenset(
    {
        "position",
        ".edge_verts",
        ".corner_vert",
        ".corner_edge",
        "sharp_face",
        "sharp_edge",
        "custom_normal",
        "material_index",
    }
)
# By Blender's type of an attribute, also of those that normals and topology are made of
_STORED = ATTRIBUTE_TYPES | {"INT32_2D": ("value", np.int32, 2), "INT16_2D": ("value", np.int16, 2)}


class _Kept:
    """A mesh, and what more of it the last two exports asked for.

    UV coordinates are apart from the mesh: modifiers round them differently from one evaluation to the next.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = replace(mesh, corner_uvs=None)  # without attributes
        self._mesh_bytes = sum(array.nbytes for array in mesh_arrays(self.mesh))
        self.used = self.made = _export_count  # numbers of the exports that last used it and that made it
        self._now: dict[tuple, Attribute] = {}
        self._before: dict[tuple, Attribute] = {}

    @property
    def bytes(self) -> int:
        """Memory that it takes on the host [bytes]."""
        more = {id(each): each.values.nbytes for each in (*self._now.values(), *self._before.values())}
        return self._mesh_bytes + sum(more.values())

    def use(self) -> None:
        """The present export uses it."""
        if self.used != _export_count:
            self.used, self._before, self._now = _export_count, self._now, {}

    def use_all(self) -> None:
        """The present export uses it, and what more the last one used of it."""
        self.used = _export_count

    def part(self, key: tuple) -> Attribute | None:
        """What was kept by `key`."""
        found = self._now.get(key) or self._before.get(key)
        if found is not None:
            self._now[key] = found
        return found

    def keep(self, key: tuple, part: Attribute) -> Attribute:
        """Keep `part`, whose values nobody may change any more; what is kept is that of an earlier export where they
        are rounded in another way alone.
        """
        for other, known in (*self._now.items(), *self._before.items()):
            if other[1:] == key[1:] and _is_alike(known.values, part.values):
                part = known
                break
        else:
            freeze(part.values)
        self._now[key] = part
        return part


def _is_alike(values: np.ndarray, others: np.ndarray) -> bool:
    """Whether `others` are `values` as far as evaluating them again shows."""
    if values.shape != others.shape or values.dtype != others.dtype:
        return False
    if values.dtype.kind != "f":
        return np.array_equal(values, others)
    with np.errstate(invalid="ignore"):
        near = np.isfinite(values) & (np.abs(values - others) <= _ROUNDING * np.abs(values))
    return bool((near | (values == others)).all())


_kept: dict[bytes, _Kept] = {}  # by digest of the shape
# The digest that each mesh had last, by names and counts
_last: dict[tuple, bytes] = {}
_export_count = 0
_is_aside = False


def mesh_arrays(mesh: Mesh) -> list[np.ndarray]:
    """All arrays of `mesh`."""
    own = (mesh.positions, mesh.triangles, mesh.triangle_slot, mesh.corner_normals, mesh.corner_uvs, mesh.radii)
    return [each for each in own if each is not None] + [each.values for each in mesh.attributes]


def forget_meshes() -> None:
    """Drop all meshes that are kept."""
    _kept.clear()
    _last.clear()


@contextmanager
def aside() -> Iterator[None]:
    """Exports meanwhile are of another scene than the user's, and no meshes of that are dropped for them."""
    global _is_aside
    _is_aside = True
    try:
        yield
    finally:
        _is_aside = False


def end_export() -> None:
    """An export has ended: drop meshes that are not used any more, and the longest unused where they take too much."""
    global _export_count
    if _is_aside:
        return
    for digest in [digest for digest, each in _kept.items() if each.used <= _export_count - _EXPORTS_KEPT]:
        del _kept[digest]
    sizes = {digest: each.bytes for digest, each in _kept.items()}
    taken = sum(sizes.values())
    room = _MEMORY_SHARE * (min(host_memory_free(), _FREE_MOST) + taken)
    for digest in sorted(sizes, key=lambda each: _kept[each].used):
        if taken <= room:
            break
        taken -= sizes[digest]
        del _kept[digest]
    for place in [place for place, digest in _last.items() if digest not in _kept]:
        del _last[place]
    _export_count += 1


def _make_room(place: tuple, digest: bytes) -> None:
    """`digest` is the one of the mesh at `place` from now on: what one export alone had there is dropped before there
    are two of it, as meshes that deform are others in each frame.
    """
    before = _kept.get(_last.get(place, b""))
    if before is not None and before.made == before.used != _export_count:
        del _kept[_last[place]]
    _last[place] = digest


def use_again(shape: bytes) -> None:
    """The present export uses the mesh of that digest as the last one did, if it is kept."""
    if (kept := _kept.get(shape)) is not None:
        kept.use_all()


def kept_mesh(digest: bytes, place: tuple, make: Callable[[], Mesh]) -> Mesh:
    """The mesh of that digest, without UV map and attributes, as an earlier export made it, else as `make` does.
    `place` is what stays the same where the mesh changes.
    """
    kept = _kept.get(digest)
    if kept is None:
        _make_room(place, digest)
        kept = _frozen(digest, make())
    kept.use()
    return kept.mesh


def _frozen(digest: bytes, mesh: Mesh) -> _Kept:
    for array in mesh_arrays(mesh):
        freeze(array)
    kept = _kept[digest] = _Kept(mesh)
    return kept


def kept_uvs(digest: bytes, key: bytes, make: Callable[[], np.ndarray]) -> np.ndarray:
    """The UV map by `key` of the kept mesh of that digest, as an earlier export made it, else as `make` does."""
    kept = _kept[digest]
    part = kept.part((key,))
    if part is None:
        part = kept.keep((key,), Attribute("UV", "", make()))
    return part.values


class MeshSource:
    """A mesh of Blender's, evaluated, as often as the export asks for it or for more of its attributes."""

    def __init__(self, mesh: bpy.types.Mesh, user: str, warnings: list[str]) -> None:
        """Messages call the mesh by its object `user`; `warnings` gets them."""
        self._mesh, self._user, self._warnings = mesh, user, warnings
        mesh.calc_loop_triangles()
        self._layer = next((layer for layer in mesh.uv_layers if layer.active_render and len(layer.uv)), None)
        self._shape = _digest(mesh, self._layer, _OF_SHAPE)
        self._counts = len(mesh.vertices), len(mesh.polygons)
        self._all: bytes | None = None

    @property
    def shape(self) -> bytes:
        """The digest that it is kept by."""
        return self._shape

    def exported(self) -> Mesh | None:
        """The mesh without attributes; None if it has no triangles."""
        kept = _kept.get(self._shape)
        if kept is None:
            _make_room((self._user, self._mesh.name, *self._counts), self._shape)
            before = len(self._warnings)
            mesh = export_mesh(self._mesh, self._user, self._warnings)
            if mesh is None or len(self._warnings) > before:  # messages are those of this object
                return mesh
            kept = _frozen(self._shape, mesh)
            if mesh.corner_uvs is not None:
                kept.keep((self._uv_digest(),), Attribute("UV", "", mesh.corner_uvs))
        kept.use()
        return replace(kept.mesh, corner_uvs=self._uvs() if self._layer is not None else None)

    def _uvs(self) -> np.ndarray:
        return kept_uvs(self._shape, self._uv_digest(), lambda: MeshArrays(self._mesh).uvs(self._layer))

    def _uv_digest(self) -> bytes:
        assert self._layer is not None, "the mesh has no UV map"
        digest = hashlib.sha1(usedforsecurity=False)
        _add(digest, self._layer.uv, "vector", np.float32, 2)
        return digest.digest()

    def attributes(self, asked: Iterable[tuple[str, str]]) -> list[Attribute]:
        """Attributes of kind and name `asked`, as far as the mesh has them."""
        asked, found = list(asked), []
        kept = _kept.get(self._shape)
        if asked and kept is not None and self._all is None:
            self._all = _digest(self._mesh, self._layer)
        for key in [(self._all, *each) for each in asked]:
            part = kept and kept.part(key)
            if part:
                found.append(part)
                continue
            before = len(self._warnings)
            read = mesh_attributes(self._mesh, [key[1:]], self._user, self._warnings)
            if kept is not None and len(self._warnings) == before:
                read = [kept.keep(key, each) for each in read]
            found += read
        return found


def _digest(mesh: bpy.types.Mesh, layer, wanted: Collection[str] | None = None) -> bytes:
    """Equal for equal meshes only, as far as the attributes with `wanted` names go; None: all. `layer`: the UV map of
    renders.
    """
    digest = hashlib.sha1(usedforsecurity=False)
    colors = mesh.color_attributes
    render_color, has_custom = colors.render_color_index, mesh.has_custom_normals
    names = (
        mesh.name,
        len(mesh.materials),
        tuple(mesh.texspace_location),
        tuple(mesh.texspace_size),
        mesh.normals_domain,
        has_custom,
        None if layer is None else layer.name,
        colors[render_color].name if 0 <= render_color < len(colors) else None,
    )
    digest.update(repr(names).encode())
    # how many corners each face has shows in its triangles
    _add(digest, mesh.loop_triangle_polygons, "value", np.int32, 1)
    stored = False
    for attribute in mesh.attributes:
        name = attribute.name
        if wanted is not None and name not in wanted:
            continue
        data_type = attribute.data_type
        digest.update(f"{name!r} {attribute.domain} {data_type}".encode())
        if data_type in _STORED:
            _add(digest, attribute.data, *_STORED[data_type])
            stored |= name == "custom_normal"
    if has_custom and not stored:  # Blender keeps them elsewhere
        _add(digest, mesh.corner_normals, "vector", np.float32, 3)
    return digest.digest()


def _add(digest, collection, attribute: str, dtype, width: int) -> None:
    count = len(collection)
    values = np.empty(count * width, dtype)
    collection.foreach_get(attribute, values)
    digest.update(b"%d %d" % (count, width))
    digest.update(values)
