"""Kernels of rays that wait at several treelets: copies are made of a ray, and what they met is put together again.

Every ray slot s has `width` places, s * width and those behind it, each of which holds a *copy* of the ray: all that a
traversal needs of it. Queues hold numbers of places. The first copy goes through the top level; where it comes to a
treelet and waits, the next one goes on from there, as far as there are places. Copies that are back from their treelets
wait for the others: the last one finds the closest hit of all, and the first goes on behind the treelet that was last.
"""

from __future__ import annotations

import warp as wp

from .....bvh.traverse.counts import TraceCounts
from .....bvh.traverse.identify import name_of
from .....bvh.tree import DONE, TopProgress, Tree
from .....device.kernel import KERNEL_OPTIONS
from .....rays import DeviceRayList, Rays
from ..storage import copy_progress, copy_ray

PARKED = -3
"""In place of a treelet: the copy waits for others of its ray, in no queue."""


@wp.struct
class Copies:
    """What copies of a ray know of each other, by ray slot; `at` by place."""

    width: int  # places of a ray
    any_first: int  # places from here on ask for any hit
    waiting: wp.array(dtype=int)  # copies at treelets that were not served yet; 1 where there is one copy; 0: no ray
    used: wp.array(dtype=int)  # copies that were sent to treelets together
    ended: wp.array(dtype=int)  # 1: there is no treelet behind theirs, and the copy behind them is done
    # distance of the closest hit of all copies, or `t_max` [m]; of a ray that asks for any hit -1 once there is one
    best: wp.array(dtype=float)
    last: wp.array(dtype=int)  # where in the batch the last of its copies is
    at: wp.array(dtype=int)  # treelet


@wp.func
def comes_before(a: wp.vec2i, b: wp.vec2i) -> bool:
    """Which of two hits at one distance counts: the lower instance, then the lower primitive."""
    return a[0] < b[0] or (a[0] == b[0] and a[1] < b[1])


@wp.func
def entry_of(progress: TopProgress, rays: Rays, place: int) -> int:
    """The entry of a copy's hit while it is under way."""
    if progress.entry.shape[0] > 0:
        return rays.hit_instance[place]
    return 0


@wp.kernel(**KERNEL_OPTIONS)
def begin_copies_kernel(home: Rays, copies: Copies, rays: Rays, batch: DeviceRayList, places: wp.array(dtype=int)):
    """By new ray of the batch: what does not change goes to all of its places; `places` gets the first."""
    i = wp.tid()
    if i >= batch.count[0]:
        return
    slot = batch.slots[i]
    first = slot * copies.width
    for place in range(first, first + copies.width):
        copy_ray(home, slot, rays, place)
    places[i] = first
    copies.waiting[slot] = 1


@wp.kernel(**KERNEL_OPTIONS)
def spread_copies_kernel(
    copies: Copies,
    rays: Rays,
    progress: TopProgress,
    batch: DeviceRayList,
    places: wp.array(dtype=int),
    locations: wp.array(dtype=int),
):
    """By copy of the batch: where it came to a treelet, the next copy goes on from there; it is `DONE` otherwise."""
    i = wp.tid()
    if i >= batch.count[0]:
        return
    place = batch.slots[i]
    location = batch.locations[i]
    places[i] = place + 1
    if location >= 0:
        rays.t_max[place + 1] = rays.t_max[place]  # `hit_t` too
        copy_progress(rays, progress, place, rays, progress, place + 1)
        locations[i] = location
    else:
        locations[i] = DONE


@wp.kernel(**KERNEL_OPTIONS)
def send_copies_kernel(
    home: Rays, copies: Copies, rays: Rays, batch: DeviceRayList, locations: wp.array2d(dtype=int), passes: int
):
    """By ray of the batch, whose first copy and `passes` others went through the top level, these to `locations`: how
    many wait at treelets, and which rays are done.
    """
    i = wp.tid()
    if i >= batch.count[0]:
        return
    first = batch.slots[i]
    slot = first // copies.width
    asks_any = first >= copies.any_first
    used = int(0)
    location = batch.locations[i]
    ended = int(0)
    while location >= 0:
        copies.at[first + used] = location
        used += 1
        location = -1
        if used <= passes:
            location = locations[used - 1, i]
            ended = wp.where(location < 0, 1, 0)
    if used > 0 and ended == 1 and asks_any:
        if rays.hit_instance[first + used] >= 0:  # above treelets, and all others need not go
            rays.hit_instance[first] = rays.hit_instance[first + used]
            used = 0
            batch.locations[i] = DONE
            for k in range(passes):
                locations[k, i] = DONE
    if used == 0:
        home.hit_instance[slot] = rays.hit_instance[first]
        if not asks_any:
            home.hit_t[slot] = rays.hit_t[first]
            home.hit_primitive[slot] = rays.hit_primitive[first]
            home.hit_uv[slot] = rays.hit_uv[first]
        return
    copies.waiting[slot] = used
    copies.used[slot] = used
    copies.ended[slot] = ended
    best = float(0.0)
    if not asks_any:
        best = rays.hit_t[first + used - 1 + ended]
    copies.best[slot] = best


@wp.kernel(**KERNEL_OPTIONS)
def enter_copies_kernel(copies: Copies, rays: Rays, batch: DeviceRayList):
    """By copy of the batch, before it visits its treelet: what others met in the meantime counts for it. Where they met
    something nearer, its own hit is forgotten, and only a hit that is no farther than theirs is looked for.
    """
    i = wp.tid()
    if i >= batch.count[0]:
        return
    place = batch.slots[i]
    slot = place // copies.width
    best = copies.best[slot]
    copies.last[slot] = -1  # each copy of the batch says the same
    if place >= copies.any_first:
        if best < 0.0:
            batch.locations[i] = DONE
    elif best < rays.hit_t[place]:
        # beyond it, if little, so that hits at the same distance are found
        rays.hit_t[place] = best + wp.max(best * wp.static(2.0**-23), wp.static(2.0**-120))
        rays.hit_primitive[place] = -1
        rays.hit_instance[place] = -1


@wp.kernel(**KERNEL_OPTIONS)
def leave_copies_kernel(copies: Copies, rays: Rays, batch: DeviceRayList):
    """By copy of the batch, behind its visit: it is back, and what it met is known to the others."""
    i = wp.tid()
    if i >= batch.count[0]:
        return
    place = batch.slots[i]
    slot = place // copies.width
    if place >= copies.any_first:
        if batch.locations[i] == DONE:
            wp.atomic_min(copies.best, slot, -1.0)
    elif rays.hit_primitive[place] >= 0:
        wp.atomic_min(copies.best, slot, rays.hit_t[place])
    wp.atomic_sub(copies.waiting, slot, 1)
    wp.atomic_max(copies.last, slot, i)


@wp.func
def closest_copy(tree: Tree, copies: Copies, rays: Rays, progress: TopProgress, first: int, used: int) -> int:
    """The place with the closest hit of `used` copies that are under way; -1: nothing was met."""
    best = int(-1)
    for place in range(first, first + used):
        face = rays.hit_primitive[place]
        if face >= 0:
            nearer = bool(best < 0)
            if not nearer:
                t, best_t = rays.hit_t[place], rays.hit_t[best]
                nearer = t < best_t
                if t == best_t:
                    entry, best_entry = entry_of(progress, rays, place), entry_of(progress, rays, best)
                    best_face = rays.hit_primitive[best]
                    if entry == best_entry:
                        nearer = face < best_face
                    else:
                        nearer = comes_before(name_of(tree, entry, face), name_of(tree, best_entry, best_face))
            if nearer:
                best = place
    return best


@wp.kernel(**KERNEL_OPTIONS)
def gather_copies_kernel(
    home: Rays, tree: Tree, copies: Copies, rays: Rays, progress: TopProgress, batch: DeviceRayList
):
    """By copy of the batch: the last one that came back puts together what all of them met. The ray is done, or its
    first copy goes on behind the treelet that was last. Of copies that come back in one step the one that is last in
    the batch does it, so that nothing depends on the order in which they are looked at.
    """
    i = wp.tid()
    if i >= batch.count[0]:
        return
    slot = batch.slots[i] // copies.width
    first = slot * copies.width
    if copies.waiting[slot] != 0 or copies.last[slot] != i:
        batch.locations[i] = PARKED
        return
    used = copies.used[slot]
    ended = copies.ended[slot] == 1
    copies.waiting[slot] = 1
    batch.slots[i] = first
    last = first + used - 1
    if first >= copies.any_first:
        if copies.best[slot] < 0.0 or ended:
            home.hit_instance[slot] = wp.where(copies.best[slot] < 0.0, 0, -1)
            batch.locations[i] = DONE
            return
    else:
        best = closest_copy(tree, copies, rays, progress, first, used)
        if ended:
            # the copy behind has its hit as hits are reported
            name = wp.vec2i(-1, -1)
            t = rays.hit_t[first]
            uv = wp.vec2(0.0, 0.0)
            if best >= 0:
                name = name_of(tree, entry_of(progress, rays, best), rays.hit_primitive[best])
                t = rays.hit_t[best]
                uv = rays.hit_uv[best]
            end = last + 1
            if rays.hit_instance[end] >= 0:
                theirs = wp.vec2i(rays.hit_instance[end], rays.hit_primitive[end])
                if best < 0 or rays.hit_t[end] < t or (rays.hit_t[end] == t and comes_before(theirs, name)):
                    name = theirs
                    t = rays.hit_t[end]
                    uv = rays.hit_uv[end]
            home.hit_t[slot] = t
            home.hit_instance[slot] = name[0]
            home.hit_primitive[slot] = name[1]
            home.hit_uv[slot] = uv
            batch.locations[i] = DONE
            return
        if best > first:
            rays.hit_t[first] = rays.hit_t[best]
            rays.hit_instance[first] = rays.hit_instance[best]
            rays.hit_primitive[first] = rays.hit_primitive[best]
            rays.hit_uv[first] = rays.hit_uv[best]
    for word in range(progress.trail.shape[0]):
        progress.trail[word, first] = progress.trail[word, last]
    if progress.entry.shape[0] > 0:
        progress.entry[first] = progress.entry[last]
    batch.locations[i] = copies.at[last]


@wp.kernel(**KERNEL_OPTIONS)
def hand_back_kernel(copies: Copies, places: wp.array(dtype=int), count: wp.array(dtype=int)):
    """By ray that is done: `places` becomes the list of slots."""
    i = wp.tid()
    if i < count[0]:
        slot = places[i] // copies.width
        places[i] = slot
        copies.waiting[slot] = 0


@wp.kernel(**KERNEL_OPTIONS)
def reset_copy_counts_kernel(counts: TraceCounts, width: int, slots: wp.array(dtype=int), count: wp.array(dtype=int)):
    """By new ray: nothing was counted of any copy."""
    i = wp.tid()
    if i < count[0]:
        for place in range(slots[i] * width, (slots[i] + 1) * width):
            counts.node_steps[place] = 0
            counts.box_tests[place] = 0
            counts.triangle_tests[place] = 0
            counts.treelet_visits[place] = 0
            counts.queued[place] = 0


@wp.kernel(**KERNEL_OPTIONS)
def add_copy_counts_kernel(counts: TraceCounts, width: int, batch: DeviceRayList, total: TraceCounts):
    """By ray of the batch: if it is done, what was counted of all of its copies goes to its slot."""
    i = wp.tid()
    if i >= batch.count[0]:
        return
    if batch.locations[i] == DONE:
        slot = batch.slots[i] // width
        nodes = int(0)
        boxes = int(0)
        triangles = int(0)
        visits = int(0)
        queued = int(0)
        for place in range(slot * width, (slot + 1) * width):
            nodes += counts.node_steps[place]
            boxes += counts.box_tests[place]
            triangles += counts.triangle_tests[place]
            visits += counts.treelet_visits[place]
            queued += counts.queued[place]
        total.node_steps[slot] = nodes
        total.box_tests[slot] = boxes
        total.triangle_tests[slot] = triangles
        total.treelet_visits[slot] = visits
        total.queued[slot] = queued


COPY_KERNELS = (
    begin_copies_kernel,
    spread_copies_kernel,
    send_copies_kernel,
    enter_copies_kernel,
    leave_copies_kernel,
    gather_copies_kernel,
    hand_back_kernel,
    reset_copy_counts_kernel,
    add_copy_counts_kernel,
)
