"""A row: one property, or several of one sense, that rendering passes over."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ...core.scene.notice import Notice, Weight

if TYPE_CHECKING:
    import bpy


@dataclass(frozen=True)
class Row:
    """Something that can be set. `found` looks for it and says what it is, or gives nothing where it is not set."""

    text: str  # of the message, with `{found}` where that is reported
    found: Callable[..., Any]
    weight: Weight
    remedy: str = ""


def notices(rows: Iterable[Row], *where: Any) -> Iterator[Notice]:
    """What `rows` find in `where`, the arguments of their functions."""
    for row in rows:
        found = row.found(*where)
        if found:
            yield Notice(row.text.format(found=found), row.weight, remedy=row.remedy)


def object_notices(rows: Iterable[Row], objects: Iterable[bpy.types.Object]) -> Iterator[Notice]:
    """What `rows` find at each of `objects`: a notice a row that names all of them."""
    rows = tuple(rows)
    names: list[list[str]] = [[] for _ in rows]
    for each in objects:
        for row, of_row in zip(rows, names, strict=True):
            if row.found(each):
                of_row.append(each.name)
    for row, of_row in zip(rows, names, strict=True):
        if of_row:
            listed = ", ".join(f"“{name}”" for name in of_row)
            yield Notice(row.text.format(found=listed), row.weight, objects=of_row, remedy=row.remedy)


def unlike_new(owner: Any, *names: str) -> str:
    """Labels and values of those properties `names` of `owner` that are not as in a new scene.

    `owner` is None where an add-on that defines it is not enabled.
    """
    values = []
    for name in names:
        prop = owner.bl_rna.properties.get(name) if owner is not None else None
        if prop is None or getattr(owner, name) == prop.default:
            continue
        values.append(f"{prop.name} {shown(getattr(owner, name))}")
    return ", ".join(values)


def shown(value: Any) -> str:
    """A value of a property as messages have it."""
    if isinstance(value, bool):
        return "on" if value else "off"
    return f"{value:g}" if isinstance(value, float) else str(value).replace("_", " ").lower() if value else "none"
