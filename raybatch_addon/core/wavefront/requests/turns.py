"""Requests of one worker: the state of its paths, and the launches of their stages."""

from __future__ import annotations

from collections.abc import Callable

import warp as wp

from ...rays import RayList
from ..path_lists import PathLists
from .state import allocate_requests


class RequestTurns:
    """Lets programs ask for rays, before anything else is done with paths whose rays are back."""

    def __init__(self, path_count: int, device: wp.Device):
        self.state = allocate_requests(path_count, device)

    def turn(
        self,
        launch_over: Callable,
        kernels: tuple[wp.Kernel | None, ...],
        inputs: tuple,
        lists: PathLists,
        back: tuple[RayList, RayList],
    ) -> tuple[RayList, RayList]:
        """The lists `back` of paths that left the scene and that met a surface, without those that wait for answers
        now. `inputs` of the kernels: scene, work, limits, paths and rays.
        """
        scene, *others = inputs
        for kernel in kernels:
            for slots in back if kernel else ():
                launch_over(kernel, slots, scene, self.state, *others)
        return lists.back(inputs[3].status, back[0].bound)

    def give_up(self) -> None:
        """Forget what is under way."""
        self.state.phase.zero_()
