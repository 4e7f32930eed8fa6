"""The quick cases of the suite; scripts/stability.py runs all of them."""

import math

import pytest

from tests.stability.bench import Bench
from tests.stability.case import CASES, Case, Outcome, Skipped, Sweep, case
from tests.stability.cases import UnknownCase, all_cases, chosen_cases, run_case

# Each third one by one tracer in turn; all by all in a thorough run, and by scripts/stability.py
QUICK = [
    pytest.param(
        each,
        tracer,
        id=f"{each.name} {tracer}",
        marks=() if number % 3 == 0 and (number // 3 + i) % len(each.tracers) == 0 else pytest.mark.thorough,
    )
    for number, each in enumerate(chosen_cases(quick=True))
    for i, tracer in enumerate(each.tracers)
]


@pytest.mark.usefixtures("general_kernels")  # scripts/stability.py renders by specialised ones
@pytest.mark.parametrize("each, tracer", QUICK)
def test_answers_are_right(each, tracer, session, device):
    result = run_case(each, Bench(device, tracer, session))
    if result.skipped:
        pytest.skip(result.skipped)
    assert result.error is None, result.error
    assert result.invalid_samples == 0
    assert result.passed, f"{each.about}: {result.outcome}; {each.bound}"


def test_every_case_says_what_it_does_and_why_its_bound_holds():
    for each in all_cases():
        assert each.name == each.name.strip() and len(each.about) > 20 and len(each.bound) > 20, each.name


def test_an_answer_that_may_be_wrong_does_not_pass():
    assert Outcome(1.0, 1.1, 0.11).passed and Outcome(math.inf, math.inf, 0.0).passed
    assert not any(
        outcome.passed
        for outcome in (
            Outcome(math.nan, 1, 1),
            Outcome(1, math.nan, 1),
            Outcome(1, 1.1, math.nan),
            Outcome(1, 1.2, 0.1),
        )
    )


def test_a_sweep_returns_its_worst_value():
    sweep = Sweep()
    sweep.add(1.0, 1.0, 0.0)
    sweep.add(2.0, 2.1, 0.2, "half")
    sweep.add(30.0, 31.0, 10.0, "a tenth")
    assert sweep.outcome().note == "half" and sweep.count == 3
    for numbers in ((math.nan, 0.0, 1.0), (1.0, math.nan, 1.0), (1.0, 2.0, math.nan), (math.inf, 0.0, math.inf)):
        spoiled = Sweep(sweep.worst, sweep.count)
        spoiled.add(*numbers, "no number")
        assert spoiled.outcome().note == "no number" and not spoiled.outcome().passed


class _Untouched:
    """Stands for a bench that is not used."""

    tracer = "-"


def _made(run) -> Case:
    return Case("made", "made", "", "", run, False, False)


def test_invalid_samples_errors_and_skips_are_distinct():
    def spoils(bench):
        bench.invalid_samples += 1
        return Outcome(0, 0, 0)

    def skips(bench):
        raise Skipped("a file is missing")

    assert run_case(_made(lambda bench: Outcome(0, 0, 0)), _Untouched()).passed
    assert run_case(_made(spoils), _Untouched()).failed
    assert run_case(_made(lambda bench: 1 / 0), _Untouched()).error.startswith("ZeroDivisionError")
    skipped = run_case(_made(skips), _Untouched())
    assert skipped.skipped == "a file is missing" and not skipped.failed and not skipped.passed


def test_names_are_unique_and_found():
    name = next(iter(CASES))
    with pytest.raises(ValueError, match="two cases"):
        case(name, "made", "", "")(lambda bench: None)
    assert [c.name for c in chosen_cases([name])] == [name]
    family = CASES[name].family
    assert {c.family for c in chosen_cases([family])} == {family}
    with pytest.raises(UnknownCase, match="no case is called"):
        chosen_cases(["no such case"])
