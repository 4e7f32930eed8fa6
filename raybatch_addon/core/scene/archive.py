"""A `Scene` and its `RenderSettings` in one file, so that a scene exported in one place renders the same in another.

The file is a NumPy archive (`.npz`, no pickled objects): member `header` is UTF-8 JSON that describes the tree of
dataclasses; arrays are members of their own, named in it. Arrays come back bit for bit, and numbers too, because
JSON writes the shortest text that reads back as the same float64.
"""

from __future__ import annotations

import dataclasses
import enum
import json
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import SceneError
from ..files import whole_file
from ..settings.settings import RenderSettings
from . import description
from .frozen import freeze
from .motion import instance_maps
from .notice import Notice, as_record, from_record

FORMAT = "raybatch-scene"
VERSION = 2

_CLASSES: dict[str, type] = {
    name: value
    for name, value in vars(description).items()
    if isinstance(value, type) and (dataclasses.is_dataclass(value) or issubclass(value, enum.Enum))
} | {"RenderSettings": RenderSettings}


def save_scene(path: str | Path, scene: description.Scene, settings: RenderSettings) -> None:
    """Write `scene` and `settings` to `path`, whole or not at all; raises `SceneError` if it cannot be written."""
    path = Path(path)
    tree, arrays = record_of_scene(scene, settings)
    members: dict[str, Any] = dict(arrays)
    header = json.dumps({"format": FORMAT, "version": VERSION, **tree}, ensure_ascii=False)
    try:
        with whole_file(path) as temporary, temporary.open("wb") as file:
            np.savez(file, header=np.frombuffer(header.encode(), np.uint8), **members)
    except OSError as error:
        raise SceneError(f"the scene cannot be written to {path}: {error.strerror or error}") from error


def record_of_scene(scene: description.Scene, settings: RenderSettings) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """`scene` and `settings` as JSON has them, and the arrays that this names."""
    arrays: dict[str, np.ndarray] = {}
    members: dict[int, str] = {}  # member by id of an array, so that one used twice is written once
    return {"scene": _encode(scene, arrays, members), "settings": _encode(settings, arrays, members)}, arrays


def scene_of_record(record: dict[str, Any], arrays: dict[str, np.ndarray]) -> tuple[description.Scene, RenderSettings]:
    """The inverse of `record_of_scene`; raises `KeyError`, `TypeError`, `ValueError` or `AttributeError` for what is
    none.
    """
    scene, settings = _decode(record["scene"], arrays), _decode(record["settings"], arrays)
    if not isinstance(scene, description.Scene) or not isinstance(settings, RenderSettings):
        raise ValueError("it does not hold a scene and its settings")
    return scene, settings


def load_scene(path: str | Path) -> tuple[description.Scene, RenderSettings]:
    """The scene, its arrays frozen, and the settings of a file by `save_scene`.

    Raises `SceneError` for any other or a damaged file.
    """
    path = Path(path)
    try:
        loaded = np.load(path, allow_pickle=False)
        if not isinstance(loaded, np.lib.npyio.NpzFile):
            raise SceneError(f"{path} is not a saved scene (it is a single array)")
        with loaded as archive:
            if "header" not in archive:
                raise SceneError(f"{path} is not a saved scene (its header is missing)")
            header = json.loads(archive["header"].tobytes().decode())
            if not isinstance(header, dict) or header.get("format") != FORMAT:
                raise SceneError(f"{path} is not a saved scene (its header is of another kind)")
            if header.get("version") != VERSION:
                raise SceneError(
                    f"{path} is a saved scene of format version {header.get('version')}, and this RayBatch reads "
                    f"version {VERSION}: save the scene again with this RayBatch"
                )
            arrays = {name: freeze(archive[name]) for name in archive.files if name != "header"}
        return scene_of_record(header, arrays)
    except FileNotFoundError:
        raise SceneError(f"there is no file {path}") from None
    except (
        OSError,
        EOFError,
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        if isinstance(error, SceneError):
            raise
        raise SceneError(f"{path} cannot be read as a saved scene; is it damaged or cut short? ({error})") from error


def _encode(value: Any, arrays: dict[str, np.ndarray], members: dict[int, str]) -> Any:
    """`value` in a form that JSON can hold; arrays go to `arrays`. A list in JSON stands for a tuple."""
    if isinstance(value, (np.ndarray, np.generic)):
        if id(value) not in members:
            array = np.asarray(value)
            if array.dtype.hasobject:
                raise TypeError("an array of Python objects cannot be part of a saved scene")
            members[id(value)] = name = f"array{len(arrays)}"
            arrays[name] = array
        return {"scalar" if isinstance(value, np.generic) else "array": members[id(value)]}
    if isinstance(value, Notice):
        return {"notice": str(value), **as_record(value)}
    if isinstance(value, enum.Enum):
        return {"enum": type(value).__name__, "value": value.value}
    if dataclasses.is_dataclass(value):
        fields = {
            description.stored_name(field): _encode(getattr(value, field.name), arrays, members)
            for field in dataclasses.fields(value)
        }
        return {"class": type(value).__name__, "fields": fields}
    if isinstance(value, (tuple, list)):
        return [_encode(item, arrays, members) for item in value]
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise TypeError(f"a {type(value).__name__} cannot be part of a saved scene")


def _decode(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    """The inverse of `_encode`; a field that the file lacks gets its default, an unknown one is an error."""
    if isinstance(value, list):
        return tuple(_decode(item, arrays) for item in value)
    if not isinstance(value, dict):
        return value
    if "notice" in value:
        return from_record(value["notice"], value)
    if "array" in value:
        return arrays[value["array"]]
    if "scalar" in value:
        return arrays[value["scalar"]][()]
    if "enum" in value:
        return _CLASSES[value["enum"]](value["value"])
    kind = _CLASSES[value["class"]]
    names = {description.stored_name(field): field.name for field in dataclasses.fields(kind)}
    found = {names.get(name, name): _decode(item, arrays) for name, item in value["fields"].items()}
    if kind is description.Instances:  # earlier files hold maps of all instances
        dense = {name: maps for name in ("motion", "frames") if isinstance(maps := found.get(name), np.ndarray)}
        found |= {name: instance_maps(maps) for name, maps in dense.items()}
    return kind(**found)
