"""The identity of a film: scene, settings, frame, device and versions, by which another render may go on with it."""

from __future__ import annotations

import dataclasses
import platform
from dataclasses import dataclass
from typing import Any

import warp as wp

from ..convergence.reference import NOT_SHOWN, digest_of_value
from ..film.channels import layout_of
from ..measure.statistics import versions
from ..scene.description import Frame, Scene
from ..scene.passes import matte_kinds
from ..settings.settings import RenderSettings
from ..wavefront.render.resume import estimator_settings
from .samples import FilmPart

# Whose code makes the film's bits
_VERSIONS = ("raybatch", "warp")


@dataclass(frozen=True, kw_only=True)
class FilmIdentity:
    """Values that must be the same where a film is gone on with, or merged with another. All of them can be written as
    JSON.
    """

    versions: dict[str, str]
    device: str  # of one kind and model alone the bits are the same
    scene: dict[str, str]  # digest and name of each part
    width: int  # of the full frame [pixels]
    height: int
    region: tuple[int, int, int, int]
    passes: tuple[str, ...]
    transparent: bool
    settings: dict[str, Any]  # those that the film's sums depend on

    @staticmethod
    def of(scene: Scene, settings: RenderSettings, device: wp.Device) -> FilmIdentity:
        """The identity of the film of a render that is asked for."""
        return FilmIdentity.of_device(
            scene, settings, f"CUDA, {device.name}" if device.is_cuda else f"CPU, {platform.machine()}"
        )

    @staticmethod
    def of_device(scene: Scene, settings: RenderSettings, device: str) -> FilmIdentity:
        """The same, of a device by what is said of it in `device`."""
        frame, record = scene.frame, versions()
        x0, y0, x1, y1 = map(int, frame.region)
        return FilmIdentity(
            versions={name: record[name] for name in _VERSIONS},
            device=device,
            scene=_scene_parts(scene),
            width=frame.width,
            height=frame.height,
            region=(x0, y0, x1, y1),
            passes=tuple(frame.passes),
            transparent=bool(frame.transparent),
            settings=estimator_settings(settings) | {"batching": _tree(settings)},
        )

    @staticmethod
    def of_record(record: dict[str, Any]) -> FilmIdentity:
        """The inverse of `record`; raises `TypeError` or `ValueError` for what is none."""
        values = {**record, "region": tuple(map(int, record["region"])), "passes": tuple(map(str, record["passes"]))}
        found = FilmIdentity(**values)
        x0, y0, x1, y1 = found.region
        if not (0 <= x0 < x1 <= found.width and 0 <= y0 < y1 <= found.height) or not found.settings["sample_count"] > 0:
            raise ValueError("its frame or its samples are none")
        return found

    def record(self) -> dict[str, Any]:
        """The values as JSON has them."""
        return dataclasses.asdict(self)

    @property
    def part(self) -> FilmPart:
        """Whose samples the film has."""
        return FilmPart(self.region, self.passes, layout_of(self.passes, self.transparent))

    @property
    def frame(self) -> Frame:
        """The frame, as far as films know it."""
        return Frame(self.width, self.height, border=self.region, transparent=self.transparent, passes=self.passes)

    def why_not(self, film: FilmIdentity) -> str:
        """Why `film` is not one of this; empty where it is, with any number of samples."""
        for name, own in self.versions.items():
            if (theirs := film.versions.get(name)) != own:
                return f"it was rendered by {_ENGINES[name]} {theirs}, and this is {own}, whose bits may differ"
        if film.device != self.device:
            return f"it was rendered on another device ({film.device}; this is {self.device}), whose bits differ"
        if (film.width, film.height) != (self.width, self.height):
            return f"its frame has {film.width} x {film.height} pixels, and this one {self.width} x {self.height}"
        if film.region != self.region:
            return f"its border is {list(film.region)}, and this one {list(self.region)}"
        if film.passes != self.passes or film.transparent != self.transparent:
            return f"its passes are {_passes(film)}, and those of this film {_passes(self)}"
        if unknown := sorted(film.settings.keys() ^ self.settings.keys()):
            where = "it lacks" if unknown[0] in self.settings else "this RayBatch lacks"
            return f"it was begun by another version: {where} the setting {unknown[0]}"
        for name, own in self.settings.items():
            if name != "sample_count" and film.settings[name] != own:
                return f"it was begun with {name} = {film.settings[name]}, and this film has {own}"
        return _change(film.scene, self.scene)


_MESH = "mesh "
# Parts of a scene that are looked at one by one, and what one of them is called
_LISTED = {"meshes": "mesh", "materials": "material", "lights": "light"}
_ENGINES = {"raybatch": "RayBatch", "warp": "Warp"}


def _tree(settings: RenderSettings) -> str:
    """The choice of the one schedule setting that changes hits: Warp's own tree."""
    return "REFERENCE" if settings.batching == "REFERENCE" else "another"


def _passes(film: FilmIdentity) -> str:
    return ", ".join(film.passes) + (" on a transparent film" if film.transparent else "")


def _scene_parts(scene: Scene) -> dict[str, str]:
    """Digests of all that decides what the scene looks like, each with the name of what it is of; where mattes show
    names, of these too.
    """
    parts: dict[str, str] = {}
    for field in dataclasses.fields(scene):
        if field.name in NOT_SHOWN or field.name == "asset_names":
            continue
        value = getattr(scene, field.name)
        if field.name in _LISTED:
            for number, each in enumerate(value, 1):
                parts[f"{_LISTED[field.name]} {number}"] = (
                    f"{digest_of_value(each)} {getattr(each, 'name', '')}".strip()
                )
        else:
            parts[field.name] = digest_of_value(value)
    if matte_kinds(scene.frame.passes):
        names = (scene.object_names, tuple(each.name for each in scene.materials), scene.asset_names)
        parts["names that mattes show"] = digest_of_value(names)
    if "UV" in scene.frame.passes:  # elsewhere UV maps count where programs read them
        parts["UV maps"] = digest_of_value(tuple(mesh.corner_uvs for mesh in scene.meshes))
    return parts


def _change(before: dict[str, str], now: dict[str, str]) -> str:
    """What of the scene is not as it was, in words."""
    then, here = ({part: value.split(" ", 1)[0] for part, value in each.items()} for each in (before, now))
    changed = [part for part in dict.fromkeys((*then, *here)) if then.get(part) != here.get(part)]
    if not changed:
        return ""
    name = (now.get(changed[0]) or before[changed[0]]).partition(" ")[2]
    more = f", and {len(changed) - 1} more" if len(changed) > 1 else ""
    text = f"its scene is another one ({changed[0]}{f', {name}' if name else ''}{more})"
    if all(part.startswith(_MESH) and part in then and part in here for part in changed):
        text += (
            "; if nobody changed it, Blender did not make it to the same bits again, as with some modifiers: "
            "render.py --save-scene keeps a scene as it is"
        )
    return text
