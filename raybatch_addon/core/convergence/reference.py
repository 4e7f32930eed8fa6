"""References: pictures that errors are measured against, with their own uncertainty, and the files they are kept in."""

from __future__ import annotations

import dataclasses
import enum
import hashlib
import json
import math
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import RayBatchError
from ..files import whole_file
from ..scene.description import Scene, stored_name
from ..settings.settings import SETTINGS, RenderSettings
from .errors import relative_to, squared_error_of_halves

FORMAT = "raybatch-reference"
VERSION = 1
# Estimator settings that say which picture is asked for. The others say how it is estimated: they may differ from the
# reference's, and clamping too, since what it takes away is an error.
PICTURE_SETTINGS = ("bounce_max", "transparent_bounce_max", "pixel_filter", "filter_width")
# What of a scene does not change its picture: names, notes, the other passes, parts of programs that fetch images, and
# UV maps while no shader reads them (Blender subdivides on many threads, and does not make them to the same bits twice)
NOT_SHOWN = {"name", "object_names", "warnings", "passes", "kinds", "corner_uvs", "fetches"}


@dataclass(frozen=True)
class Reference:
    """The picture that a render should come to. Raises `RayBatchError` where it is no picture, or has values that are
    not finite.
    """

    picture: np.ndarray  # linear RGB, float64, shape [height, width, 3], bottom row first
    # of each value of `picture`, float64, the same shape; 0 for a closed form; None: not known
    variance: np.ndarray | None = None
    name: str = "reference"  # where it is from
    samples: int = 0  # of each pixel; 0 where it has none, or nobody knows

    def __post_init__(self):
        picture = np.asarray(self.picture, np.float64)
        if picture.ndim != 3 or picture.shape[2] != 3 or not picture.size:
            raise RayBatchError(
                f"{self.name} is no picture: its shape is {list(picture.shape)}, and [height, width, 3] is needed"
            )
        _require_finite(picture, f"{self.name} has")
        object.__setattr__(self, "picture", picture)
        if self.variance is None:
            return
        variance = np.asarray(self.variance, np.float64)
        if variance.shape != picture.shape:
            shapes = f"{list(variance.shape)}, its picture {list(picture.shape)}"
            raise RayBatchError(f"the variance of {self.name} has shape {shapes}: make it again")
        _require_finite(variance, f"the variance of {self.name} has")
        if (variance < 0).any():
            raise RayBatchError(f"the variance of {self.name} is below 0 somewhere: make it again")
        object.__setattr__(self, "variance", variance)

    @staticmethod
    def of_halves(a: np.ndarray, b: np.ndarray, name: str, samples: int) -> Reference:
        """The mean of two independent pictures with `samples` samples together, and its variance from their
        difference.
        """
        variance = squared_error_of_halves(a, b)
        return Reference((np.asarray(a, np.float64) + np.asarray(b, np.float64)) / 2, variance, name, samples)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [pixels]."""
        return self.picture.shape[1], self.picture.shape[0]


def noise_floor(reference: Reference) -> tuple[float, float]:
    """The RMSE and relMSE that the reference's own noise has: what a perfect picture would be said to be off; NaN where
    it is not known.

    Noise of reference and picture are independent, so their squares add: error^2 = (true error)^2 + floor^2 in the
    mean.
    """
    if reference.variance is None:
        return math.nan, math.nan
    return math.sqrt(reference.variance.mean()), float((reference.variance / relative_to(reference.picture)).mean())


# --- files


def scene_hash(scene: Scene) -> str:
    """A digest of all that decides how the scene looks: camera, size, geometry, materials, lights and world; 32
    hexadecimal digits.
    """
    return digest_of_value(scene)


def digest_of_value(value: Any) -> str:
    """A digest of a scene or of a part of it, but for what does not show; 32 hexadecimal digits."""
    digest = hashlib.blake2b(digest_size=16)
    _feed(digest, value)
    return digest.hexdigest()


def save_reference(
    path: str | Path,
    reference: Reference,
    scene: str = "",
    settings: RenderSettings | None = None,
    facts: dict[str, Any] | None = None,
) -> None:
    """Write `reference` to `path` (.npz), whole or not at all; raises `RayBatchError` if it cannot be written.

    `scene` is its `scene_hash`, `settings` are those it was made with; both are checked when it is read. `facts` (JSON
    values) are kept for whoever reads the file.
    """
    path = Path(path)
    estimator = (
        {n: getattr(settings, n) for n, info in SETTINGS.items() if info.effect == "estimator"} if settings else {}
    )
    header = {
        "format": FORMAT,
        "version": VERSION,
        "name": reference.name,
        "samples": int(reference.samples),
        "size": list(reference.size),
        "scene": scene,
        "settings": estimator,
        "facts": facts or {},
    }
    arrays: dict[str, Any] = {"picture": reference.picture}
    if reference.variance is not None:
        arrays["variance"] = reference.variance
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, header=np.frombuffer(json.dumps(header).encode(), np.uint8), **arrays)
    except OSError as error:
        raise RayBatchError(
            f"the reference cannot be written to {path}: {error.strerror or error}; choose another place"
        ) from error


def load_reference(
    path: str | Path, size: tuple[int, int] | None = None, scene: str = "", settings: RenderSettings | None = None
) -> Reference:
    """The reference in a file by `save_reference`, or a saved film (`Film.save_npz`), whose error, scene and settings
    nobody knows.

    Raises `RayBatchError`, with what to do, for a file that is not there, is of another kind or damaged, or has values
    that are not finite; and for a picture of another `size` (width, height), of another `scene` (a `scene_hash`) or
    with other `settings` (those of `PICTURE_SETTINGS`). What is not given, or not in the file, is not compared.
    """
    path = Path(path)
    try:
        loaded = np.load(path, allow_pickle=False)
        if not isinstance(loaded, np.lib.npyio.NpzFile):
            raise RayBatchError(f"{path} is no reference (it is a single array); save a film or a reference as .npz")
        with loaded as archive:
            arrays = {
                name: archive[name] for name in archive.files if name in ("header", "picture", "variance", "Combined")
            }
        if not all(isinstance(array, np.ndarray) for array in arrays.values()):
            raise ValueError("not all of it is arrays")
    except FileNotFoundError:
        raise RayBatchError(f"there is no file {path}") from None
    except (OSError, EOFError, ValueError, KeyError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        # RuntimeError: flipped bits may say that it is encrypted, or compressed as nobody does
        raise RayBatchError(
            f"{path} cannot be read as a reference; is it damaged or cut short? Make it again ({error})"
        ) from error
    header = _header(path, arrays)
    picture, variance = arrays.get("picture"), arrays.get("variance")
    if picture is None:
        picture = arrays["Combined"]
        picture = picture[..., :3] if picture.ndim == 3 else picture
    for array in (picture, variance):
        if array is not None and not np.issubdtype(array.dtype, np.floating):
            raise RayBatchError(f"{path} is no reference: its values are {array.dtype}, not floating-point numbers")
    samples = header.get("samples", 0)
    reference = Reference(
        picture, variance, str(header.get("name", path.name)), samples if isinstance(samples, int) else 0
    )
    _require_same(path, reference, header, size, scene, settings)
    return reference


def _header(path: Path, arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    """What the file says of its picture; nothing for a film. Raises `RayBatchError` for what is neither."""
    if "header" not in arrays:
        if "Combined" in arrays:
            return {}
        raise RayBatchError(f"{path} is no reference: it has neither a reference's header nor a film's pass Combined")
    try:
        header = json.loads(arrays["header"].tobytes().decode())
    except (ValueError, RecursionError) as error:
        raise RayBatchError(f"{path} cannot be read as a reference; is it damaged? Make it again ({error})") from error
    if not isinstance(header, dict) or header.get("format") != FORMAT or "picture" not in arrays:
        raise RayBatchError(f"{path} is no reference: it is a file of another kind")
    if header.get("version") != VERSION:
        raise RayBatchError(
            f"{path} is a reference of format version {header.get('version')}, and {VERSION} is read here: make it "
            "again"
        )
    return header


def _require_same(
    path: Path, reference: Reference, header: dict[str, Any], size, scene: str, settings: RenderSettings | None
) -> None:
    if size is not None and tuple(size) != reference.size:
        raise RayBatchError(
            f"{path} is {reference.size[0]} x {reference.size[1]} pixels and the render {size[0]} x {size[1]}: "
            "render in the reference's size, or give a reference of this one"
        )
    if scene and header.get("scene") and scene != header["scene"]:
        raise RayBatchError(
            f"{path} shows another scene, or this one as it was before it changed (camera, geometry, materials, lights "
            "or world differ): "
            "make the reference again, or give the one of this scene"
        )
    estimator = header.get("settings") or {}
    if not isinstance(estimator, dict):
        raise RayBatchError(
            f"{path} cannot be read as a reference: its settings are no settings; is it damaged? Make it again"
        )
    for name in PICTURE_SETTINGS if settings is not None else ():
        saved, own = estimator.get(name), getattr(settings, name)
        if saved is not None and saved != own:
            remedy = f"set {name} to {saved}, or make the reference again"
            raise RayBatchError(f"{path} was made with {name} = {saved}, and the render has {own}: {remedy}")


def _require_finite(values: np.ndarray, whose: str) -> None:
    bad = int(values.size - np.isfinite(values).sum())
    if bad:
        raise RayBatchError(f"{whose} {bad:,} values that are not finite: it cannot be compared with; make it again")


def _feed(digest: hashlib.blake2b, value: Any) -> None:
    """Every value with its kind and length in front, so that no two scenes are written alike."""
    if dataclasses.is_dataclass(value):
        digest.update(f"<{type(value).__name__}>".encode())
        for field in dataclasses.fields(value):
            if field.name not in NOT_SHOWN:
                digest.update(f"{stored_name(field)}:".encode())
                _feed(digest, getattr(value, field.name))
    elif isinstance(value, (np.ndarray, np.generic)):
        array = np.ascontiguousarray(value)
        digest.update(f"[{array.dtype.str}{array.shape}]".encode())
        digest.update(array.data)
    elif isinstance(value, (tuple, list)):
        digest.update(f"({len(value)})".encode())
        for item in value:
            _feed(digest, item)
    elif isinstance(value, enum.Enum):
        digest.update(f"{int(value.value)};".encode())
    else:
        digest.update(f"{value!r};".encode())
