"""Notices: what of a scene is not rendered as it was made, with where it is and what to do about it."""

from __future__ import annotations

from collections.abc import Iterable
from enum import IntEnum
from typing import Any

# Names that a message lists
_NAMED_MOST = 8


class Weight(IntEnum):
    """How much a picture differs by what a notice is about."""

    # what no other engine would show: data that is broken and was mended or left out, passes that are empty
    REPAIRED = 0
    SETTING = 1  # a setting of another engine that is passed over: noise, time, and light of late bounces
    REPLACED = 2  # something else stands in for it
    MISSING = 3  # it is not in the picture, or the picture is another one


class Notice(str):
    """A message, and what it is about; the text stands for itself wherever messages are printed."""

    __slots__ = ("material", "nodes", "objects", "option", "remedy", "weight")
    weight: Weight
    objects: tuple[str, ...]
    material: str
    nodes: tuple[str, ...]
    remedy: str
    option: str

    def __new__(
        cls,
        text: str,
        weight: Weight = Weight.REPLACED,
        *,
        objects: Iterable[str] = (),
        material: str = "",
        nodes: Iterable[str] = (),
        remedy: str = "",
        option: str = "",
    ) -> Notice:
        """`objects`, `material` and `nodes` are names in the file, `remedy` is what a user can do, and `option` does it
        on a command line; it is without what options begin with there.
        """
        notice = super().__new__(cls, text)
        notice.weight, notice.objects, notice.material = weight, tuple(objects), material
        notice.nodes, notice.remedy, notice.option = tuple(nodes), remedy, option
        return notice

    def to_do(self, options_begin: str = "--") -> str:
        """What a user can do, for those who see it on a command line."""
        ways = [self.remedy, f"{options_begin}{self.option}" if self.option else ""]
        return ", or ".join(filter(None, ways))

    def __reduce__(self):
        return _again, (str(self), self.weight, self.objects, self.material, self.nodes, self.remedy, self.option)


def _again(text: str, weight: Weight, *about: Any) -> Notice:
    names = ("objects", "material", "nodes", "remedy", "option")
    return Notice(text, weight, **dict(zip(names, about, strict=True)))


def as_notice(message: str) -> Notice:
    """`message` itself, or a notice with its text: what nobody weighed counts as replaced."""
    return message if isinstance(message, Notice) else Notice(message)


def about(message: str, name: str, objects: Iterable[str] = ()) -> Notice:
    """`message` with what it is about, the thing called `name`, before it."""
    notice = as_notice(message)
    text = f"{name}: {notice}"
    return Notice(text, notice.weight, objects=objects, nodes=notice.nodes, remedy=notice.remedy, option=notice.option)


def quoted(names: Iterable[str]) -> str:
    """The first of different `names`, in quotation marks, and how many more there are."""
    different = list(dict.fromkeys(names))
    more = len(different) - _NAMED_MOST
    return ", ".join(f"“{name}”" for name in different[:_NAMED_MOST]) + (f" and {more:,} more" if more > 0 else "")


def by_weight(messages: Iterable[str]) -> list[Notice]:
    """All `messages` as notices, the weightiest first, else in their order."""
    return sorted(map(as_notice, messages), key=lambda notice: -notice.weight)


def as_record(notice: Notice) -> dict[str, Any]:
    """All that a notice says beside its text; what it does not say is left out."""
    every = {
        "weight": notice.weight.name,
        "objects": list(notice.objects),
        "material": notice.material,
        "nodes": list(notice.nodes),
        "remedy": notice.remedy,
        "option": notice.option,
    }
    return {name: value for name, value in every.items() if value}


def from_record(text: str, record: dict[str, Any]) -> Notice:
    """The inverse of `as_record`: the notice with that `text`."""
    rest = {name: record[name] for name in ("objects", "material", "nodes", "remedy", "option") if name in record}
    return Notice(text, Weight[record["weight"]], **rest)


def described(notice: Notice) -> dict[str, Any]:
    """A notice as statistics have it: `what` it says, and the rest."""
    return {"what": str(notice), **as_record(notice)}
