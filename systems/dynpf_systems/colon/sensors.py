"""The capsule's sensors: five ranges in the true map of the time, and the commanded motion."""

import numpy as np
from dynpf_runtime.node import Output, Result, State, Step
from dynpf_services.scenario.context import Context

from dynpf.colon.world import Capsule, read_ranges
from dynpf.maps.raycast import RayCaster
from dynpf.rng import generator
from dynpf_systems.colon.config import CapsuleSensorsConfig
from dynpf_systems.colon.messages import CapsuleReading, CapsuleState
from dynpf_systems.colon.tube import ColonWorld, colon_world

__all__ = ["CapsuleSensors", "build"]


class CapsuleSensors:
    """Simulates a reading for each true state.

    Raises ScenarioError for a map that cannot be made, or that does not contain the route.
    """

    def __init__(self, *, config: CapsuleSensorsConfig, seed: int, world: ColonWorld, name: str = "sensors") -> None:
        self.name = name
        self._seed = seed
        self._capsule = Capsule(sigma_range=config.sigma_range_px, outlier_fraction=config.outlier_fraction)
        self._casters = {name: RayCaster(grid) for name, grid in world.true_grids().items()}
        self._start = np.array(world.route.start)

    def step(self, step: Step) -> Result:
        """Return a reading for each true state."""
        states = [item.message for item in step.inputs if isinstance(item.message, CapsuleState)]
        return Result(tuple(Output("sensors/capsule", self._read(state)) for state in states))

    def _read(self, state: CapsuleState) -> CapsuleReading:
        random = generator(self._seed, self.name, state.reading, "ranges")
        pose = np.array([state.x_px, state.y_px, state.theta])
        ranges = read_ranges(self._casters[state.map], pose, self._capsule, random)
        return CapsuleReading(reading=state.reading, ranges_px=tuple(ranges.tolist()), move=state.move)

    def rehearse(self) -> None:
        """See Rehearsing."""
        for caster in self._casters.values():
            read_ranges(caster, self._start, self._capsule, generator(self._seed, self.name, 0, "rehearsal"))

    def freeze(self) -> State:
        """Return no state: readings depend on the truth only."""
        return {}

    def thaw(self, state: State) -> None:
        """There is no state."""


def build(config: CapsuleSensorsConfig, context: Context) -> CapsuleSensors:
    """Return the sensors of a run."""
    return CapsuleSensors(config=config, seed=context.seed, world=colon_world(context), name=context.name)
