"""The estimator of a capsule in a tube whose walls change: its pose, and the map that holds."""

import math
from typing import Any

import numpy as np
from dynpf_protocol import frames
from dynpf_protocol.messages import Color, HostEvent, Log, LogLevel, PoseInFrame, PosesInFrame, SceneUpdate, timestamp
from dynpf_runtime.every import Every
from dynpf_runtime.node import Output, Result, State, Step
from dynpf_services.estimates import gap_warning, particles_picture, robot_transform
from dynpf_services.scenario.context import Context
from dynpf_services.scenario.schema import key_of

from dynpf.colon.hypotheses import UNLISTED
from dynpf.colon.world import BEAMS
from dynpf.filters.resampling import systematic
from dynpf.motion.capsule import CapsuleMotion
from dynpf.rng import Stream
from dynpf_systems.colon.config import CapsuleEstimatorConfig
from dynpf_systems.colon.filters import Located, capsule_filter
from dynpf_systems.colon.messages import CapsuleEstimate, CapsuleMove, CapsuleReading, MapProbability, MovedWall
from dynpf_systems.colon.scene import M_PER_PX, arrow_entity, drawn_pose, tube_entity, walls_entity
from dynpf_systems.colon.tube import ColonWorld, colon_world

__all__ = ["CapsuleEstimator", "build"]

SHOWN_PARTICLES = 200
SHOWN = Every(0.2)
SCENE = Every(1.0)
CAPSULE_COLOR = Color(r=0.8, g=0.15, b=0.25)
WALL_COLOR = Color(r=0.55, g=0.3, b=0.65)
MOVED_COLOR = Color(r=0.9, g=0.6, b=0.1)


class CapsuleEstimator:
    """Processes the capsule's readings, each with the motion before it, in the order of their numbers.

    Raises ScenarioError where filter, maps and schedule do not fit each other.
    """

    def __init__(
        self,
        *,
        config: CapsuleEstimatorConfig,
        seed: int,
        world: ColonWorld,
        name: str = "estimator",
    ) -> None:
        self.name = name
        self._seed = seed
        self._known = config.start == "known"
        self._filter = capsule_filter(config, world, key_of(name))
        self._belief: Any = self._filter.start(self._known, Stream.of(seed, self.name, 0, "start"))
        self._reading = -1
        self._map: str | None = None
        self._shown_ns: int | None = None
        self._scene_ns: int | None = None

    def step(self, step: Step) -> Result:
        """Process the readings; return the estimate after the last of them, if there was any."""
        logs: list[Output] = []
        readings: list[CapsuleReading] = []
        for received in step.inputs:
            match received.message:
                case HostEvent() as gap:
                    logs.append(gap_warning(gap, step.stamp_ns, self.name))
                case CapsuleReading() as reading if reading.reading > self._reading:
                    readings.append(reading)
        located: Located | None = None
        stream = Stream.of(self._seed, self.name, step.number, "update")
        for reading in sorted(readings, key=lambda reading: reading.reading):
            numbers = (max(self._reading, 0), reading.reading)
            ranges = np.array(reading.ranges_px)
            self._belief, located = self._filter.update(
                self._belief, _motion(reading), ranges, stream.part(reading.reading), numbers
            )
            self._reading = reading.reading
        if located is None:
            return Result(tuple(logs))
        return Result((*self._report(located, step.stamp_ns), *self._map_change(located, step.stamp_ns), *logs))

    def rehearse(self) -> None:
        """See Rehearsing."""
        stream = Stream.of(self._seed, self.name, 0, "rehearsal")
        for known in (True,) if self._known else (True, False):
            belief = self._filter.start(known, stream.part("start"))
            for reading, motion in enumerate((None, CapsuleMotion(1.0, 0.0))):
                ranges = np.full(len(BEAMS), 60.0)
                belief, _ = self._filter.update(belief, motion, ranges, stream.part(reading), (0, 0))

    def freeze(self) -> State:
        """Return the belief, the last reading and map, and when pictures were last published."""
        return {
            "belief": self._filter.freeze(self._belief),
            "reading": self._reading,
            "map": self._map,
            "shown_ns": self._shown_ns,
            "scene_ns": self._scene_ns,
        }

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""
        self._belief = self._filter.thaw(state["belief"])
        self._reading = state["reading"]
        self._map = state["map"]
        self._shown_ns = state["shown_ns"]
        self._scene_ns = state["scene_ns"]

    def _report(self, located: Located, stamp_ns: int) -> list[Output]:
        pose = PoseInFrame(timestamp=timestamp(stamp_ns), frame_id=frames.MAP, pose=drawn_pose(*located.pose.tolist()))
        outputs = [Output("estimator/capsule", self._estimate(located)), Output("estimator/pose", pose)]
        if SHOWN.due(stamp_ns, self._shown_ns):
            self._shown_ns = stamp_ns
            outputs.append(Output("estimator/particles", self._particles(stamp_ns)))
            placed = pose.pose.position
            transform = robot_transform(placed.x, placed.y, float(located.pose[2]), pose.timestamp)
            outputs.append(Output("estimator/transforms", transform))
        if SCENE.due(stamp_ns, self._scene_ns):
            self._scene_ns = stamp_ns
            outputs.append(Output("estimator/scene", self._scene(located, stamp_ns)))
        return outputs

    def _estimate(self, located: Located) -> CapsuleEstimate:
        x, y, theta = located.pose.tolist()
        known: dict[str, Any] = {}
        if located.changed_at is not None:
            known["changed_at"] = located.changed_at
        if (moved := located.moved) is not None:
            known["reference"] = moved.reference
            walls = zip(*moved.points.tolist(), moved.distances.tolist(), strict=True)
            known["walls"] = tuple(MovedWall(x_px=a, y_px=b, moved_px=distance) for a, b, distance in walls)
        if located.radius is not None:
            known["end_radius_px"], known["end_radius_sigma_px"] = located.radius
        return CapsuleEstimate(
            reading=self._reading,
            x_px=x,
            y_px=y,
            theta=math.remainder(theta, math.tau),
            covariance=tuple(located.covariance.ravel().tolist()),
            n_eff=self._filter.cloud(self._belief).n_eff,
            map=located.map,
            maps=tuple(MapProbability(map=name, probability=min(p, 1.0)) for name, p in located.maps.items()),
            **known,
        )

    def _particles(self, stamp_ns: int) -> PosesInFrame:
        cloud = self._filter.cloud(self._belief)
        # Chosen by weight, not by index, so that the sample represents the posterior.
        chosen = systematic(cloud.weights, 0.5, min(SHOWN_PARTICLES, cloud.weights.size))
        x_px, y_px, theta = np.asarray(cloud.particles[:3, chosen], dtype=np.float64)
        return particles_picture(np.stack((M_PER_PX * x_px, M_PER_PX * y_px, theta)), timestamp(stamp_ns))

    def _scene(self, located: Located, stamp_ns: int) -> SceneUpdate:
        now, moved = timestamp(stamp_ns), located.moved
        name = located.map if moved is None else moved.reference
        label = f"map {name}" if moved is None else f"{UNLISTED}; {name}'s walls have moved"
        ends = np.zeros((2, 2, 0))
        if moved is not None:
            ends = np.stack((moved.points, moved.points + moved.distances * moved.outwards))
        return SceneUpdate(
            entities=(
                tube_entity(self._filter.grids[name], label, now, "believed tube", WALL_COLOR, above=False),
                walls_entity(ends, now, "moved walls", MOVED_COLOR),
                arrow_entity(located.pose, now, "estimated capsule", CAPSULE_COLOR),
            )
        )

    def _map_change(self, located: Located, stamp_ns: int) -> list[Output]:
        """Return a log message if the likeliest map has changed."""
        before, self._map = self._map, located.map
        if not located.maps or before in (None, located.map):
            return []
        text = f"the map is no longer {before}: {located.map} since about reading {located.changed_at:.0f}"
        return [Output("log", Log(timestamp=timestamp(stamp_ns), level=LogLevel.INFO, message=text, name=self.name))]


def _motion(reading: CapsuleReading) -> CapsuleMotion | None:
    move = reading.move
    return CapsuleMotion(move.rho_px, move.turn) if isinstance(move, CapsuleMove) else None


def build(config: CapsuleEstimatorConfig, context: Context) -> CapsuleEstimator:
    """Return the estimator of a run."""
    return CapsuleEstimator(config=config, seed=context.seed, world=colon_world(context), name=context.name)
