"""The capsule simulator: a capsule driven along its route through a tube whose walls change during the run."""

import math

import numpy as np
from dynpf_protocol.messages import Color, HoldMap, Message, Place, SceneUpdate, timestamp
from dynpf_runtime.every import Every
from dynpf_runtime.node import Output, Result, State, Step
from dynpf_services.scenario.context import Context

from dynpf.colon.world import Capsule, blown, is_free, steered
from dynpf.motion.capsule import CapsuleMotion
from dynpf.rng import generator
from dynpf_systems.colon.config import CapsuleConfig
from dynpf_systems.colon.messages import CapsuleMove, CapsuleState
from dynpf_systems.colon.scene import arrow_entity, tube_entity
from dynpf_systems.colon.tube import ColonWorld, colon_world

__all__ = ["CapsuleSimulator", "build"]

SCENE = Every(0.2)
WALL_COLOR = Color(r=0.35, g=0.35, b=0.35)
CAPSULE_COLOR = Color(r=0.15, g=0.4, b=0.8)


class CapsuleSimulator:
    """True world of a capsule in its tube; the source of its run, which ends with the route.

    Each step is one tick and one reading: the first at the start, each other after a motion. Raises ScenarioError for a
    map that cannot be made, or that does not contain the route.
    """

    def __init__(self, *, config: CapsuleConfig, seed: int, world: ColonWorld, name: str = "simulator") -> None:
        self.name = name
        self._seed = seed
        self._capsule = Capsule(sigma=config.sigma_px, sigma_theta=config.sigma_theta)
        self._route, self._true, self._grids = world.route, world.true, world.true_grids()
        self._goals = world.route.poses()
        self._reading = -1
        self._pose = np.array(world.route.start)
        self._scene_ns: int | None = None
        self._held = ""  # the map that a person has hold

    def step(self, step: Step) -> Result:
        """Make the next motion, except at the first step; return the true state and pictures."""
        self._reading += 1
        for received in step.inputs:
            if isinstance(received.message, HoldMap):
                self._held = received.message.map
        motion = self._move(step.number) if self._reading > 0 else None
        for received in step.inputs:
            if isinstance(received.message, Place):
                self._pose = np.array([received.message.x, received.message.y, received.message.theta])
        x, y, theta = self._pose.tolist()
        state = CapsuleState(
            reading=self._reading,
            x_px=x,
            y_px=y,
            theta=math.remainder(theta, math.tau),
            map=self._map,
            **({} if motion is None else {"move": CapsuleMove(rho_px=motion.rho, turn=motion.turn)}),
        )
        outputs = [Output("truth/capsule", state)]
        if SCENE.due(step.stamp_ns, self._scene_ns):
            self._scene_ns = step.stamp_ns
            outputs.append(Output("truth/scene", self._scene(step.stamp_ns)))
        return Result(tuple(outputs), finished=self._reading >= len(self._route.motions))

    def refuses(self, act: Message) -> str:
        """Return why the capsule cannot be put there, or a map cannot hold."""
        match act:
            case Place(x=x, y=y) if not is_free(self._grids[self._map], np.array([x, y])):
                return f"({x:.1f}, {y:.1f}) px is not inside the tube of map {self._map}"
            case HoldMap(map=name) if name and name not in self._grids:
                return f"map {name!r} is never true in this run; there are {', '.join(self._grids)}"
        return ""

    @property
    def _map(self) -> str:
        """The name of the map that holds."""
        return self._held or self._true.at(max(self._reading, 0))

    def _move(self, number: int) -> CapsuleMotion:
        """Make the next motion, in the map that holds at its end, and return the commanded motion."""
        noisy = self._capsule.sigma > 0.0 or self._capsule.sigma_theta > 0.0
        goal = self._goals[:, self._reading]
        motion = steered(self._pose, goal) if noisy else self._route.motions[self._reading - 1]
        grid = self._grids[self._map]
        self._pose = blown(self._pose, motion, self._capsule, grid, generator(self._seed, self.name, number, "motion"))
        return motion

    def _scene(self, stamp_ns: int) -> SceneUpdate:
        now, held = timestamp(stamp_ns), self._map
        tube = tube_entity(self._grids[held], f"true map: {held}", now, "tube", WALL_COLOR, above=True)
        return SceneUpdate(entities=(tube, arrow_entity(self._pose, now, "capsule", CAPSULE_COLOR)))

    def freeze(self) -> State:
        """Return the number of the reading, the pose, and the map that a person has hold."""
        held = {} if not self._held else {"held": self._held}
        return {"reading": self._reading, "pose": self._pose.copy(), "scene_ns": self._scene_ns, **held}

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""
        self._reading = state["reading"]
        self._pose = np.array(state["pose"])
        self._scene_ns = state["scene_ns"]
        self._held = state.get("held", "")


def build(config: CapsuleConfig, context: Context) -> CapsuleSimulator:
    """Return the simulator of a run."""
    return CapsuleSimulator(config=config, seed=context.seed, world=colon_world(context), name=context.name)
