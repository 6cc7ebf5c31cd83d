"""The construction of PARTS: products of distances, gamma^k / beta (eq. 2.1 to 2.7). It has no state."""

import numpy as np
from dynpf_runtime.node import State
from numpy.typing import NDArray

from dynpf.fields.laws import Pace, mate_step, move_step
from dynpf.fields.layout import Layout
from dynpf.fields.placing import blocked_goals, free_place
from dynpf.fields.potentials import log_mate_part, log_move_part, steepest_part
from dynpf_systems.parts.beliefs import Motion, Scene, Subtask, margins_of
from dynpf_systems.parts.controller_config import RearrangementControllerConfig

__all__ = ["ProductConstruction"]


class ProductConstruction:
    """Potentials gamma^k / beta for the choice of a part and its motion."""

    progress = 0.05  # in the logarithm of the potential

    def __init__(self, config: RearrangementControllerConfig, layout: Layout, pace: Pace) -> None:
        self._config, self._layout, self._pace = config, layout, pace

    def choose(
        self, scene: Scene, away: NDArray[np.intp], stalls: NDArray[np.int64], *, make_way: bool
    ) -> Subtask | None:
        """Choose the part of steepest descent among those with the fewest stalls and a free goal."""
        blocked, blockers = blocked_goals(scene.parts, self._layout, self._config.goal_gap)
        able = away[~blocked[away]]
        if able.size:
            fewest = able[stalls[able] == stalls[able].min()].tolist()
            part = steepest_part(scene.parts, fewest, self._layout, self._config.next_exponent)
            return Subtask(part, self._layout.goals[part])
        if not make_way:
            return None
        makes_room = int(next(part for part in away if blockers[part])) if blockers[away].any() else int(away[0])
        spot = free_place(scene.parts, makes_room, self._layout, 2.0 * self._layout.robot_radius)
        return None if spot is None else Subtask(makes_room, spot, parked=True)

    def mate(self, scene: Scene, subtask: Subtask) -> Motion:
        """See Construction."""
        margins = margins_of(scene, self._config)
        margins.parts[subtask.part] = self._layout.reach
        given = (scene.pose[:2], scene.parts, subtask.part, self._layout)
        exponent = self._config.mate_exponent
        step = mate_step(*given, margins=margins, exponent=exponent, pace=self._pace)
        return Motion(np.append(step, 0.0), log_mate_part(*given, exponent))

    def move(self, scene: Scene, subtask: Subtask) -> Motion:
        """See Construction."""
        goals = self._layout.goals.copy()
        goals[subtask.part] = subtask.goal
        given = (scene.pose, scene.parts, subtask.part, self._layout._replace(goals=goals))
        exponent = self._config.move_exponent
        step = move_step(*given, margins=margins_of(scene, self._config), exponent=exponent, pace=self._pace)
        return Motion(step, log_move_part(*given, exponent))

    def freeze(self) -> State:
        """Return no state."""
        return {}

    def thaw(self, state: State) -> None:
        """There is no state."""
        pass
