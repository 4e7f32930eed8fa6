"""Rivals as the command line names them: `NAME`, or `NAME:parameter=value,...`."""

from __future__ import annotations

from dataclasses import dataclass

from lib.command import UsageError


@dataclass(frozen=True)
class Parameter:
    """One parameter of a rival: a whole number, or a word of `choices`."""

    default: int | str
    meaning: str
    least: int = 1
    most: int = 1
    choices: tuple[str, ...] = ()

    def parse(self, text: str, where: str) -> int | str:
        """The value that `text` says; raises `UsageError`, which begins with `where`."""
        if self.choices:
            if text not in self.choices:
                raise UsageError(f"{where}={text} is not known: choose of {', '.join(self.choices)}")
            return text
        if not text.isdecimal() or not self.least <= int(text) <= self.most:
            raise UsageError(f"{where}={text} is not valid: give a whole number from {self.least:,} to {self.most:,}")
        return int(text)

    @property
    def range(self) -> str:
        """What it may be, in words."""
        return "|".join(self.choices) if self.choices else f"{self.least}..{self.most}"


@dataclass(frozen=True)
class RivalRequest:
    """A rival that was asked for."""

    name: str
    label: str  # as reports name it: with what was given, in the order in which it was
    values: dict[str, int | str]  # every parameter


def parse_rival(text: str, known: dict[str, dict[str, Parameter]]) -> RivalRequest:
    """What `text` asks for, of the rivals `known` with their parameters; raises `UsageError`."""
    name, _, assignments = text.partition(":")
    name = name.strip()
    if name not in known:
        raise UsageError(f"--rival {name!r} is not known: choose of {', '.join(known)}")
    parameters, given = known[name], {}
    for assignment in assignments.split(",") if assignments.strip() else []:
        key, equals, value = (part.strip() for part in assignment.partition("="))
        where = f"--rival {name}:{key}"
        if key not in parameters:
            raise UsageError(f"{where} is not known: {name} has {', '.join(parameters)}")
        if not equals or not value:
            raise UsageError(f"{where} has no value: write {key}=VALUE")
        if key in given:
            raise UsageError(f"{where} is given twice: give it once")
        given[key] = parameters[key].parse(value, where)
    label = name + (":" if given else "") + ",".join(f"{key}={value}" for key, value in given.items())
    return RivalRequest(name, label, {key: each.default for key, each in parameters.items()} | given)
