"""Groups from frame to frame. Where a member goes, its place in the group is left empty, so that the others keep theirs
and the tree that is over them; where it comes back, it gets its place again. What is new is a group behind the others.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .groups import Group, Member

# Groups of what came later are joined to one where they would be more; and all is grouped anew where empty places, or
# what came later, would be more than a share of all triangles
_LATE_MOST = 6
_SHARE_MOST = 0.5


def with_same_members(groups: Sequence[Group], fresh: Sequence[Group]) -> tuple[Group, ...] | None:
    """`groups` of the frame before, of one whose groups by itself are `fresh`, where the same objects are there with
    as many triangles: maybe elsewhere, or of another shape. None where others are there.
    """
    now = {each.instance: (group.visibility, each) for group in fresh for each in group.members}
    before = [(group.visibility, each) for group in groups for each in group.members if each.instance >= 0]
    if len(before) != len(now):
        return None
    for visibility, each in before:
        found = now.get(each.instance)
        if found is None or (visibility, _shape(each)) != (found[0], _shape(found[1])):
            return None
    return tuple(
        replace(group, members=tuple(now[each.instance][1] if each.instance >= 0 else each for each in group.members))
        for group in groups
    )


def _shape(member: Member) -> tuple:
    return member.name, member.vertex_count, member.triangle_count


def followed(groups: Sequence[Group], fresh: Sequence[Group]) -> tuple[Group, ...] | None:
    """The same where others are there: what went leaves its place empty, and what came is in a group behind. None where
    it is better to group all anew. Meshes of `fresh` have keys.
    """
    coming = _Coming(fresh)
    made = [replace(group, members=tuple(coming.take_same(group, each) for each in group.members)) for group in groups]
    made = [replace(group, members=tuple(coming.take_alike(group, each) for each in group.members)) for group in made]
    made = [_with_state(group, before) for group, before in zip(made, groups, strict=True) if any(group.is_there)]
    late = [group for group in made if group.is_late]
    new = coming.left()
    if new and len(late) + len(new) > _LATE_MOST:
        made = [group for group in made if not group.is_late]
        for group in late:
            new[group.visibility] = [m for m in group.members if m.instance >= 0] + new.get(group.visibility, [])
    number = 1 + max((group.number for group in groups), default=-1)
    made += [Group(number + i, seen, tuple(new[seen]), is_late=True) for i, seen in enumerate(new)]
    return tuple(made) if _is_worth_while(made) else None


class _Coming:
    """The members of a frame that are still to be put into groups."""

    def __init__(self, fresh: Sequence[Group]) -> None:
        self._members = {(group.visibility, each.instance): each for group in fresh for each in group.members}
        self._same: defaultdict[tuple, deque[Member]] = defaultdict(deque)
        self._alike: defaultdict[tuple, deque[Member]] = defaultdict(deque)
        for (visibility, _), each in self._members.items():
            self._same[visibility, each.mesh, each.place].append(each)
            self._alike[visibility, *_shape(each)].append(each)

    def take_same(self, group: Group, was: Member) -> Member:
        """The member that is as one of `group` was, and where; or its place, which it left."""
        return self._take(group, was, self._same.get((group.visibility, was.mesh, was.place)) if was.mesh else None)

    def take_alike(self, group: Group, was: Member) -> Member:
        """For a place that is empty still the same object, with as many triangles elsewhere or of another shape."""
        return was if was.instance >= 0 else self._take(group, was, self._alike.get((group.visibility, *_shape(was))))

    def _take(self, group: Group, was: Member, found: deque[Member] | None) -> Member:
        while found:
            each = found.popleft()
            if self._members.pop((group.visibility, each.instance), None) is not None:
                return each
        return replace(was, instance=-1)

    def left(self) -> dict[int, list[Member]]:
        """What was not taken, by visibility."""
        found: dict[int, list[Member]] = {}
        for (visibility, _), each in self._members.items():
            found.setdefault(visibility, []).append(each)
        return found


def needs_refit(group: Group, before: Group) -> bool:
    """Whether boxes of the tree of `before` have to change for `group`, which has as many members with as many
    triangles each: what is there now is elsewhere, or the boxes have no room for it.
    """
    return any(
        now.instance >= 0
        and (
            not now.mesh or (now.mesh, now.place) != (was.mesh, was.place) or (was.instance < 0 and before.is_refitted)
        )
        for now, was in zip(group.members, before.members, strict=True)
    )


def _with_state(group: Group, before: Group) -> Group:
    if needs_refit(group, before):
        return replace(group, is_refitted=not all(group.is_there))
    return group


def _is_worth_while(groups: Sequence[Group]) -> bool:
    total = sum(each.triangle_count for group in groups for each in group.members)
    empty = sum(each.triangle_count for group in groups for each in group.members if each.instance < 0)
    late = sum(each.triangle_count for group in groups if group.is_late for each in group.members)
    return max(empty, late) <= _SHARE_MOST * total


def refitted(groups: Sequence[Group]) -> tuple[Group, ...]:
    """`groups` after their trees were refitted."""
    return tuple(group if all(group.is_there) else replace(group, is_refitted=True) for group in groups)


def placed_at(groups: Sequence[Group], transform: np.ndarray) -> tuple[Group, ...]:
    """`groups` whose instances have moved to `transform`, shape [n, 3, 4]."""
    return tuple(
        replace(
            group,
            members=tuple(
                each
                if each.instance < 0 or each.place == (place := transform[each.instance].tobytes())
                else replace(each, place=place)
                for each in group.members
            ),
        )
        for group in groups
    )
