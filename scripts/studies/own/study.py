"""A study of one's own as the runner takes it: its cases, what is measured of one, and the run of all of it."""

from __future__ import annotations

import functools
import hashlib
import json
from pathlib import Path
from typing import Any

from lib.command import UsageError

from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.settings.settings import SETTINGS, RenderSettings
from studies import runner
from studies.bench import Bench
from studies.own.definition import Definition, definition_of, read_definition
from studies.own.page import asked_for, page_fragment
from studies.own.plots import draw_axes
from studies.study import Case, Options, Row, Study


def own_study(definition: Definition, plots: bool = True) -> Study:
    """The study that is defined; its page shows `plots`, which are drawn apart."""
    return Study(
        definition.name,
        definition.about or definition.title,
        functools.partial(cases_of, definition),
        _Measurement(definition).measure,
        functools.partial(page_fragment, definition, plots),
        functools.partial(draw_axes, definition),
        turns=(definition.turns, definition.turns),
        title=definition.title,
        definition=definition.digest,
    )


def cases_of(definition: Definition, options: Options) -> list[Case]:
    """All cases of a scene take turns."""
    return [
        Case(
            f"{scene.key}: {case.key}",
            scene.key,
            {"scene": scene.name, "variant": case.label, "settings": case.settings},
        )
        for scene in definition.scenes
        for case in definition.cases
    ]


class _Measurement:
    """Renders cases. The settings of the scene at hand are those of its file."""

    def __init__(self, definition: Definition):
        self._definition = definition
        self._scenes = {scene.name: scene for scene in definition.scenes}
        self._settings: dict[str, RenderSettings] = {}

    def measure(self, case: Case, turn: int, bench: Bench) -> Row:
        """One render; where errors are measured with a seed of its own in each turn."""
        defined, source = self._definition, self._scenes[case.what["scene"]]

        def opened() -> Any:
            try:
                scene, self._settings[source.name] = source.open(bench.options)
            except RayBatchError as error:  # not a figure of a case
                raise UsageError(f"the scene {source.name} cannot be opened: {error}") from None
            return scene

        scene = bench.scene(source.key, opened)
        base = self._settings[source.name].replace(**defined.common)
        settings = base.replace(**case.what["settings"])
        warm = (source.key, case.key)
        frame = {"width": scene.frame.width, "height": scene.frame.height}
        if not defined.measures_errors:
            return {**frame, "estimator": estimator_digest(settings), **bench.timed(scene, settings, warm)}
        settings = settings.replace(seed=settings.seed + turn)
        wanted = base.replace(**defined.reference)
        kept = bench.reference(source.key, scene, wanted, defined.reference_samples)
        return {**frame, "estimator": estimator_digest(settings), **bench.curve(scene, settings, kept, warm)}


def estimator_digest(settings: RenderSettings) -> str:
    """A digest of the settings that decide the film: where it is equal films are, bit for bit, however rays are
    scheduled. Warp's own tree (REFERENCE) meets other hits, so it counts too.
    """
    decides = {name: getattr(settings, name) for name, info in SETTINGS.items() if info.effect == "estimator"}
    decides["reference_tree"] = settings.batching == "REFERENCE"
    return hashlib.blake2b(json.dumps(decides, sort_keys=True).encode(), digest_size=8).hexdigest()


def run_study(
    definition: dict[str, Any] | Path, out: Path, *, name: str = "study", plots: bool = True
) -> tuple[Path, list[Row]]:
    """Measure a study, a TOML file or a dictionary of the same form, called `name`, as `study.py FILE --out OUT` does;
    returns its page and its rows. What was measured before is not measured again. Raises `RayBatchError`.
    """
    defined = definition_of(definition, name) if isinstance(definition, dict) else read_definition(Path(definition))
    study, rows = own_study(defined, plots), []
    for device in defined.devices:
        runner.device_of(device)  # before time is spent on another
    for device in defined.devices:
        run = runner.run_of(study, device, out)
        run.path.parent.mkdir(parents=True, exist_ok=True)
        run.measured()
        report = runner.read_report(runner.publish(study, [run.path], out))
        rows += asked_for(defined, report)["rows"]
    return runner.write_page(study, out, plots), rows
