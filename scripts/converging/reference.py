"""The reference that errors are measured against: a file, Cycles, or this engine with another seed and many more
samples; what was made is kept.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import os
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from benchmarking.whole_render import OpenedScene
from lib.command import UsageError

import raybatch_addon.core
from converging.request import CYCLES, RAYBATCH, REFERENCE_FACTOR, ConvergenceRequest, Variant
from raybatch_addon.blender.kernel_cache import user_cache_folder
from raybatch_addon.core.convergence.points import (
    PICTURE_SETTINGS,
    Reference,
    load_reference,
    noise_floor,
    relmse,
    rmse,
    save_reference,
    scene_hash,
)
from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.measure.snapshot import Snapshot
from raybatch_addon.core.measure.statistics import versions
from raybatch_addon.core.observers import RenderObserver
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import SETTINGS, RenderSettings
from raybatch_addon.core.wavefront.stages.limits import half_seed

VARIABLE = "RAYBATCH_REFERENCES"  # environment variable with another folder for references that were made
SEED = 1_812_433_253  # of references; runs have small ones
CYCLES_SEEDS = (SEED, SEED + 1)
TAKEN_SEEDS = (SEED, half_seed(SEED, 1), *CYCLES_SEEDS)


@dataclass(frozen=True)
class UsedReference:
    """A reference and where it is from."""

    kind: str  # "file", "halves" (there is none), or the engine that made it in small letters
    reference: Reference | None
    settings: RenderSettings | None = None  # it was made with
    path: Path | None = None
    from_cache: bool = False
    seconds: float | None = None  # that it took, if it was made just now

    @property
    def floor(self) -> tuple[float | None, float | None]:
        """RMSE and relMSE of its own noise; None where it is not known."""
        if self.reference is None:
            return None, None
        of_rmse, of_relmse = (None if np.isnan(value) else value for value in noise_floor(self.reference))
        return of_rmse, of_relmse


class LastHalves(RenderObserver):
    """An observer that keeps the two halves of a render at its end."""

    def __init__(self) -> None:
        self.snapshot: Snapshot | None = None

    def snapshot_samples(self, _sample_count: int) -> list[int]:
        """No snapshots on the way."""
        return []

    def on_snapshot(self, snapshot: Snapshot) -> None:
        """Takes the snapshot at the end."""
        self.snapshot = snapshot


class References:
    """Gives each variant what its picture is to be measured against. Pictures with different bounces or filters have
    different ones.
    """

    def __init__(
        self,
        request: ConvergenceRequest,
        opened: OpenedScene,
        session: Session,
        on_make: Callable[[str], None] = lambda _: None,
    ):
        """`on_make` is called before one is rendered."""
        self._request, self._opened, self._session, self._on_make = request, opened, session, on_make
        self._found: dict[tuple, UsedReference] = {}
        self._hash = scene_hash(opened.scene)

    @property
    def used(self) -> list[UsedReference]:
        """All so far, each once."""
        return list({id(each): each for each in self._found.values()}.values())

    def of(self, variant: Variant, samples: int) -> UsedReference:
        """The reference for renders of `variant` with about `samples` samples; one that is made has more. Raises
        `RayBatchError`.
        """
        key = self._key(variant)
        if key not in self._found:
            self._found[key] = self._get(key[0], variant.settings, samples)
            self._require_reachable(self._found[key])
        return self._found[key]

    def apart(self) -> dict[str, float | None] | None:
        """How far the limits of two engines are apart, with the noise that either reference adds; None where there is
        one.
        """
        by_kind = {each.kind: each for each in self.used if each.reference is not None}
        if len(by_kind) < 2 or len(self.used) > 2:
            return None
        ours, theirs = by_kind["raybatch"], by_kind["cycles"]
        assert ours.reference is not None and theirs.reference is not None
        a, b = ours.reference.picture, theirs.reference.picture
        our_noise, their_noise = noise_floor(ours.reference), noise_floor(theirs.reference)
        return {
            "rmse": rmse(b, a),
            "relmse": relmse(b, a),
            "mean_ratio": float(a.mean() / b.mean()) if b.mean() else None,
            "noise_rmse": float(np.hypot(our_noise[0], their_noise[0])),
            "noise_relmse": our_noise[1] + their_noise[1],
        }

    def require_one(self, variants: Iterable[Variant]) -> None:
        """Raise `UsageError` where the reference is to be written, and `variants` have more than one."""
        if self._request.save_reference and len({self._key(variant) for variant in variants}) > 1:
            raise UsageError(
                "--save-reference holds one picture, and this comparison has several references: leave it out"
            )

    # --- where it is from

    def _key(self, variant: Variant) -> tuple:
        """Who makes the reference of `variant`, and what it shows: equal for those that have one together."""
        wanted = self._request.reference_from
        return {"own": variant.engine, "cycles": CYCLES, "raybatch": RAYBATCH}.get(wanted, wanted), *picture_key(
            variant.settings
        )

    def _get(self, engine: str, settings: RenderSettings, samples: int) -> UsedReference:
        request = self._request
        if engine == "halves":
            return UsedReference(engine, None)
        x0, y0, x1, y1 = self._opened.scene.frame.region
        size = (x1 - x0, y1 - y0)
        if engine == "file":
            assert request.reference is not None  # it names a file
            path = Path(request.reference)
            reference = load_reference(path, size, self._hash, settings)  # raises where it is not for these settings
            same = next((other for other in self.used if other.reference is not None), None)
            return same or UsedReference(engine, reference, path=path)
        settings = reference_settings(settings, request.reference_samples or REFERENCE_FACTOR * samples)
        path = reference_folder() / f"{self._name(engine, settings)}.npz"
        # when time decides how many samples a run has, they are never quite the same
        enough = (
            settings.sample_count
            if request.reference_samples or request.seconds is None
            else settings.sample_count // 2
        )
        if not request.new_reference and (cached := self._cached(path, size, settings, enough)):
            return UsedReference(engine.lower(), cached, settings.replace(sample_count=cached.samples), path, True)
        self._on_make(f"reference by {engine}, {settings.sample_count:,} samples")
        start = time.perf_counter()
        reference = self._from_cycles(settings, size) if engine == CYCLES else self._from_raybatch(settings)
        seconds, kept = time.perf_counter() - start, True
        facts = {"versions": versions(), "scene": self._opened.name, "seconds": round(seconds, 3)}
        try:
            save_reference(path, reference, self._hash, settings, facts)
        except RayBatchError as error:
            print(f"convergence.py: warning: {error}", file=sys.stderr)
            kept = False
        return UsedReference(engine.lower(), reference, settings, path if kept else None, False, seconds)

    def _cached(self, path: Path, size: tuple[int, int], settings: RenderSettings, samples: int) -> Reference | None:
        if not path.is_file():
            return None
        try:
            found = load_reference(path, size, self._hash, settings)
        except RayBatchError as error:
            print(f"convergence.py: warning: a kept reference is made anew: {error}", file=sys.stderr)
            return None
        return found if found.samples >= samples else None

    def _name(self, engine: str, settings: RenderSettings) -> str:
        """Name of a kept reference's file: all that decides the picture, and how it was estimated, except its
        samples.
        """
        estimator = {
            name: getattr(settings, name)
            for name, info in SETTINGS.items()
            if info.effect == "estimator" and name != "sample_count"
        }
        maker = core_digest() if engine == RAYBATCH else versions().get("blender", "")
        text = json.dumps([self._hash, engine, maker, estimator], sort_keys=True)
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()

    def _from_raybatch(self, settings: RenderSettings) -> Reference:
        """Two halves with scrambles of their own: their difference shows the reference's noise."""
        halves = LastHalves()
        self._session.render(self._opened.scene, settings, observers=[halves])
        assert halves.snapshot is not None and halves.snapshot.halves is not None  # of a render with an error estimate
        first, second = halves.snapshot.halves
        return Reference.of_halves(first, second, "RayBatch with another seed", settings.sample_count)

    def _from_cycles(self, settings: RenderSettings, size: tuple[int, int]) -> Reference:
        from converging.cycles import open_peer, require_size

        half = settings.replace(sample_count=settings.sample_count // 2)
        peer = open_peer(self._opened, self._session.device, half)
        first, second = (peer.picture(seed) for seed in CYCLES_SEEDS)
        require_size(first, size)
        return Reference.of_halves(first, second, "Cycles", settings.sample_count)

    def _require_reachable(self, used: UsedReference) -> None:
        floor, target = used.floor[1], self._request.target
        if target is None or floor is None or target > floor:
            return
        least = float(f"{floor * 1.05:.2g}")  # two digits, above the floor
        remedy = "a reference with less noise" if used.kind == "file" else "more --reference-samples"
        raise UsageError(
            f"--target {target:g} cannot be told: the reference's own noise is a relMSE of {floor:.3g}. "
            f"The least that it allows is {least:g}; give that or more, or {remedy}"
        )


def picture_key(settings: RenderSettings) -> tuple:
    """Equal for settings that aim at the same picture."""
    return tuple(getattr(settings, name) for name in PICTURE_SETTINGS)


def reference_settings(settings: RenderSettings, samples: int) -> RenderSettings:
    """Settings of an unbiased reference for renders with `settings`: two halves, with a seed that runs do not have."""
    estimating = [
        name for name, info in SETTINGS.items() if info.effect == "estimator" and name not in PICTURE_SETTINGS
    ]
    plain = {name: SETTINGS[name].default for name in (*estimating, "counters", "debug_checks")}
    plain |= {"sample_count": samples + samples % 2, "seed": SEED, "error_estimate": "ON"}
    return settings.replace(**plain)


def reference_folder() -> Path:
    """Where references are kept; it need not exist yet."""
    override = os.environ.get(VARIABLE)
    return Path(override).expanduser().absolute() if override else user_cache_folder() / "raybatch" / "references"


# Folders of the core that measure renders and do not change them
_REPORTS = ("measure", "convergence")


@functools.cache
def core_digest() -> str:
    """Digest of all files of the core but its reports: a reference by another state of it is another reference."""
    folder = Path(raybatch_addon.core.__file__).parent
    digest = hashlib.blake2b(digest_size=16)
    for path in sorted(path for path in folder.rglob("*") if path.suffix in (".py", ".h", ".npz")):
        if any(path.is_relative_to(folder / name) for name in _REPORTS):
            continue
        digest.update(str(path.relative_to(folder).as_posix()).encode() + path.read_bytes())
    return digest.hexdigest()


def write_reference(path: Path, opened: OpenedScene, used: UsedReference) -> None:
    """Write a reference that was made for other runs, whole or not at all; raises `RayBatchError`."""
    assert used.reference is not None  # it was made
    save_reference(path, used.reference, scene_hash(opened.scene), used.settings)


def picture_alone(opened: OpenedScene) -> OpenedScene:
    """`opened` without other passes: they cost time and show nothing here."""
    scene = dataclasses.replace(opened.scene, frame=dataclasses.replace(opened.scene.frame, passes=("Combined",)))
    return dataclasses.replace(opened, scene=scene)
