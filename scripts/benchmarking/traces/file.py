"""The file of a trace, docs/ray-traces.md: rays in the order in which a render handed them to its tracer, and what they
hit.

Others write such files too: all that is read is checked, and what is wrong with it is said by name.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lib.command import UsageError
from lib.output import write_whole

from benchmarking.rays import CapturedRays, RayPlaces, RayType
from benchmarking.scenes import BenchmarkScene
from benchmarking.tracers.interface import Hits
from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.scene.features import derive_features

FORMAT = "raybatch-rays"
VERSION = 1
CLOSEST, ANY_HIT = 0, 1  # values of the array `kind`
BOUNCE_MAX = 99
LENGTH_ERROR_MAX = 1e-5  # of directions, which are rounded to float32


@dataclass(frozen=True)
class ArrayInfo:
    """One array of the file, an entry a ray."""

    dtype: str
    parts: tuple[int, ...]  # shape behind the number of rays
    about: str
    required: bool = False


RAY_ARRAYS = {
    "origin": ArrayInfo("float32", (3,), "where the ray begins, in world space [m]", True),
    "direction": ArrayInfo("float32", (3,), "unit length, in world space", True),
    "t_max": ArrayInfo("float32", (), "only hits nearer than this count [m]; above 0, may be infinite", True),
    "kind": ArrayInfo("uint8", (), "0: the closest hit is wanted, 1: any hit (shadow rays)", True),
    "bounce": ArrayInfo(
        "uint8",
        (),
        "how often the path scattered before the ray, 0 from the camera; of a shadow ray the number of the hit that it "
        "leaves, from 1",
        True,
    ),
    "visibility": ArrayInfo("int32", (), "one bit: the ray passes objects that do not have it", True),
    "pixel": ArrayInfo("int32", (2,), "column and row in the frame, from its bottom left"),
    "sample": ArrayInfo("int32", (), "sample of the pixel, from 0"),
    "wave": ArrayInfo("int32", (), "number of the call that handed the ray to the tracer, from 0"),
    "sequence": ArrayInfo(
        "int64", (), "number of the ray among all that were handed over, also those that are not in the file; rises"
    ),
}
HIT_ARRAYS = {
    "hit": ArrayInfo("bool", (), "whether anything was hit", True),
    "t": ArrayInfo("float32", (), "distance of the closest hit [m]; infinite where there is none or any was asked for"),
    "instance": ArrayInfo("int32", (), "of the scene; -1 where `t` is infinite"),
    "primitive": ArrayInfo("int32", (), "triangle of the instance's mesh; -1 where `t` is infinite"),
    "u": ArrayInfo("float32", (), "weight of the triangle's second corner; 0 where `t` is infinite"),
    "v": ArrayInfo("float32", (), "weight of the triangle's third corner; 0 where `t` is infinite"),
}
PLACES = ("pixel", "sample", "wave", "sequence")


@dataclass(frozen=True)
class RayTrace:
    """Rays of a file, checked."""

    name: str
    header: dict[str, Any]
    arrays: dict[str, np.ndarray]  # those of `RAY_ARRAYS` and `HIT_ARRAYS` that are there

    def __len__(self) -> int:
        return len(self.arrays["t_max"])

    def types(self) -> list[RayType]:
        """The types of rays that are there: closest hits by bounce, then any hits."""
        pairs = np.unique(self.arrays["kind"].astype(int) * 256 + self.arrays["bounce"])
        return [_type_of(*divmod(pair, 256)) for pair in pairs.tolist()]

    def where(self, ray_type: RayType, count: int | None = None) -> np.ndarray:
        """Indices of the first `count` rays of a type, or of all, in the order of the file."""
        mine = (self.arrays["kind"] == int(ray_type.shadow)) & (self.arrays["bounce"] == ray_type.bounce)
        return np.flatnonzero(mine)[:count]

    def captured(self, types: Sequence[RayType], count: int | None = None) -> list[CapturedRays]:
        """The first `count` rays of each type, or all; raises `UsageError` for a type that is not there."""
        there = self.types()
        found = []
        for each in types:
            if each not in there:
                raise UsageError(
                    f"{self.name} has no rays {each.name}; it has {', '.join(kind.name for kind in there)}: leave the "
                    "others out of --rays"
                )
            where = self.where(each, count)
            columns = [self.arrays[name][where] for name in ("origin", "direction", "t_max", "visibility")]
            places = RayPlaces(*(self.arrays[n][where] for n in PLACES)) if self.arrays.keys() >= set(PLACES) else None
            found.append(CapturedRays(each, *columns, places))
        return found

    def hits(self, ray_type: RayType, count: int | None = None) -> Hits:
        """What the file says that rays of a type hit, as `captured` has them; raises `UsageError`."""
        if "hit" not in self.arrays or ("t" not in self.arrays and not ray_type.shadow):
            raise UsageError(
                f"{self.name} has no hits of {ray_type.name}: give them with --hits, or record them with --hits-of"
            )
        where = self.where(ray_type, count)
        found = {name: self.arrays[name][where] for name in HIT_ARRAYS if name in self.arrays}
        if ray_type.shadow:
            return Hits(found["hit"], None)
        return Hits(found["hit"], found["t"], found.get("instance"), found.get("primitive"))


def _type_of(kind: int, bounce: int) -> RayType:
    name = f"shadow{bounce}" if kind == ANY_HIT else f"bounce{bounce}" if bounce else "primary"
    return RayType(name, kind == ANY_HIT, bounce)


def geometry_digest(scene: Scene) -> str:
    """A digest of all that rays can hit: meshes, where instances place them, and which rays see them; 32 hexadecimal
    digits. Numbers of instances and triangles are those of the scene of this digest.
    """
    digest = hashlib.blake2b(digest_size=16)
    instances = scene.instances
    for array in (instances.mesh, instances.transform, instances.visibility):
        _feed(digest, array)
    for mesh in scene.meshes:
        _feed(digest, mesh.positions)
        _feed(digest, mesh.triangles)
    return digest.hexdigest()


def _feed(digest: Any, array: np.ndarray) -> None:
    array = np.ascontiguousarray(array)
    digest.update(f"{array.dtype.str}{array.shape}".encode())
    digest.update(array.tobytes())


def write_trace(path: Path, header: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
    """Write a trace to `path`, whole or not at all; raises `OutputError`."""
    text = json.dumps({"format": FORMAT, "version": VERSION, **header}, ensure_ascii=False)

    def write(temporary: Path) -> None:
        with open(temporary, "wb") as file:
            np.savez(file, header=np.frombuffer(text.encode(), np.uint8), **arrays)

    write_whole(path, write)


def read_trace(path: Path) -> RayTrace:
    """The trace in a file, all of it checked; raises `UsageError` that names the file, the array and what to do."""
    header, arrays = _read(path)
    kept = _checked(path, arrays, RAY_ARRAYS, None)
    count = len(kept["t_max"])
    if count == 0:
        raise UsageError(f"{path} has no rays")
    _check_rays(path, kept)
    if "hit" in arrays:
        kept |= checked_hits(path, arrays, kept)
    return RayTrace(path.name, header, kept)


def with_hits(trace: RayTrace, path: Path) -> RayTrace:
    """`trace` with the hits of another file, an entry for each of its rays; raises `UsageError`."""
    header, arrays = _read(path)
    rays = {name: each for name, each in trace.arrays.items() if name in RAY_ARRAYS}
    return RayTrace(path.name, {**trace.header, "hits": header.get("hits")}, rays | checked_hits(path, arrays, rays))


def _read(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    try:
        loaded = np.load(path, allow_pickle=False)
        if not isinstance(loaded, np.lib.npyio.NpzFile):
            raise UsageError(f"{path} is a single array; a trace is an archive (.npz) with the array header and others")
        with loaded as archive:
            arrays = {name: archive[name] for name in archive.files}
    except FileNotFoundError:
        raise UsageError(f"there is no file {path}") from None
    except (OSError, EOFError, ValueError, KeyError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        raise UsageError(f"{path} cannot be read as a NumPy archive; is it damaged or cut short? ({error})") from None
    if "header" not in arrays:
        raise UsageError(f"{path} is no trace of rays: it has no array header (docs/ray-traces.md says what it holds)")
    try:
        header = json.loads(arrays.pop("header").tobytes().decode())
        known = header["format"] == FORMAT
    except (ValueError, KeyError, TypeError):
        raise UsageError(f"{path}: the array header is no JSON with the entry format, as UTF-8 in uint8") from None
    if not known:
        raise UsageError(f"{path} is no trace of rays: its header says format {header['format']!r}, not {FORMAT!r}")
    if header.get("version") != VERSION:
        raise UsageError(
            f"{path} is a trace of version {header.get('version')!r}, and this RayBatch reads version {VERSION}: "
            "record it again"
        )
    return header, arrays


def _checked(
    path: Path, arrays: dict[str, np.ndarray], schema: dict[str, ArrayInfo], count: int | None
) -> dict[str, np.ndarray]:
    """Those of `arrays` that `schema` names, each with `count` entries (None: all alike)."""
    found = {}
    for name, info in schema.items():
        if name not in arrays:
            if info.required:
                raise UsageError(f"{path} has no array {name}: {info.about}")
            continue
        array = arrays[name]
        if array.dtype != info.dtype:
            raise UsageError(f"{path}: array {name} is {array.dtype}; it must be {info.dtype}: {info.about}")
        count = len(array) if count is None and array.ndim else count
        if array.shape != (count, *info.parts):
            wanted = ", ".join(map(str, (count, *info.parts)))
            raise UsageError(f"{path}: array {name} has the shape {list(array.shape)}, and it must be [{wanted}]")
        found[name] = np.ascontiguousarray(array)
    return found


def _refuse(path: Path, name: str, bad: np.ndarray, what: str) -> None:
    """Raise `UsageError` where any of `bad`, an entry a ray, is set."""
    if bad.any():
        raise UsageError(
            f"{path}: array {name} {what} in {int(bad.sum()):,} of {len(bad):,} rays (the first is "
            f"{int(np.argmax(bad)):,})"
        )


def _check_rays(path: Path, rays: dict[str, np.ndarray]) -> None:
    for name in ("origin", "direction"):
        _refuse(path, name, ~np.isfinite(rays[name]).all(1), "is not finite")
    length = np.linalg.norm(rays["direction"].astype(np.float64), axis=1)
    _refuse(path, "direction", np.abs(length - 1) > LENGTH_ERROR_MAX, "has not unit length")
    _refuse(path, "t_max", ~(rays["t_max"] > 0), "is not above 0")
    _refuse(path, "kind", rays["kind"] > ANY_HIT, "is neither 0 (closest hit) nor 1 (any hit)")
    _refuse(path, "bounce", rays["bounce"] > BOUNCE_MAX, f"is above {BOUNCE_MAX}")
    _refuse(path, "bounce", (rays["kind"] == ANY_HIT) & (rays["bounce"] == 0), "is 0, and shadow rays leave a hit,")
    bits = rays["visibility"]
    _refuse(path, "visibility", (bits <= 0) | (bits & (bits - 1) != 0), "is not one bit")
    if "sequence" in rays:
        _refuse(path, "sequence", np.diff(rays["sequence"], prepend=-1) <= 0, "does not rise")


def checked_hits(path: Path, arrays: dict[str, np.ndarray], rays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The hits among `arrays`, of `rays`; raises `UsageError`."""
    hits = _checked(path, arrays, HIT_ARRAYS, len(rays["t_max"]))
    told = hits["hit"] & (rays["kind"] == CLOSEST)
    if "t" in hits:
        t = hits["t"]
        _refuse(path, "t", told & ~(np.isfinite(t) & (t >= 0)), "is not finite and 0 or more where hit is true")
        _refuse(path, "t", told & (t > rays["t_max"]), "is beyond t_max where hit is true")
    for name in ("instance", "primitive"):
        if name in hits:
            _refuse(path, name, told & (hits[name] < 0), "is below 0 where hit is true")
    for name in ("u", "v"):
        if name in hits:
            _refuse(path, name, told & ~(np.abs(hits[name]) < 2), "is no weight of a corner")
    return hits


def refuse_unfit(scene: BenchmarkScene) -> None:
    """Raise `UsageError` for a scene whose rays are more than a trace holds."""
    features = derive_features(scene.scene, scene.settings)
    what = "things move while the shutter is open, and rays have a time" if features.motion else ""
    if scene.flat.curves:
        what = "curves are no triangles"
    if what:
        raise UsageError(
            f"{scene.name} has rays that traces do not hold: {what}; save it without them (render.py --save-scene)"
        )


def check_scene(trace: RayTrace, scene: BenchmarkScene) -> None:
    """Raise `UsageError` where the rays of `trace` are of other geometry than `scene`, or its hits name what is not
    there; or where `scene` is none that traces are of. A trace that names no geometry is taken as it is.
    """
    refuse_unfit(scene)
    wanted = (trace.header.get("scene") or {}).get("geometry")
    if wanted and wanted != geometry_digest(scene.scene):
        raise UsageError(
            f"{trace.name} holds rays of {trace.header['scene'].get('name')}, whose geometry is not that of "
            f"{scene.name}: give the scene that it was recorded from, with the same --grid and --up"
        )
    if {"instance", "primitive"} <= trace.arrays.keys():
        instances, meshes = scene.scene.instances.mesh, scene.scene.meshes
        told = trace.arrays["hit"] & (trace.arrays["kind"] == CLOSEST)
        instance, primitive = (np.where(told, trace.arrays[name], 0) for name in ("instance", "primitive"))
        path = Path(trace.name)
        _refuse(
            path,
            "instance",
            instance >= len(instances),
            f"names no instance of {scene.name}, which has {len(instances):,},",
        )
        sizes = np.array([len(mesh.triangles) for mesh in meshes])[instances]
        _refuse(path, "primitive", told & (primitive >= sizes[instance]), "names no triangle of its instance's mesh")
