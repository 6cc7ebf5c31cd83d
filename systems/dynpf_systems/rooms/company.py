"""Dynamic obstacles of a room: people who walk about, and doors that open and close."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from dynpf_protocol.errors import ScenarioError
from dynpf_runtime.node import State

from dynpf.maps.occupancy import OccupancyGrid
from dynpf.portable import dist, norm, whole
from dynpf.rng import Draws, generator
from dynpf.types import FloatArray
from dynpf_systems.rooms.clearance import Clearance, from_segments
from dynpf_systems.rooms.config import Door, PeopleParams

__all__ = ["People", "closed_doors"]

Point = tuple[float, float]
Segments = FloatArray

DRAWS = 30  # attempts to draw a goal that is in view
STEP_M = 0.1  # between the points of a path whose clearance is checked
PATIENCE_S = 2.0  # a person waits so long before a closed door or the robot, then takes another goal
ROOM_FOR_ROBOT_M = 0.15  # that people leave between it and themselves


def closed_doors(doors: Sequence[Door], time_s: float, robot: Point, by_hand: Mapping[int, bool] = {}) -> Segments:
    """Return the doors (D, 4) that are closed at a time, with the robot at a position.

    ``by_hand`` says of the doors that a person holds, by their numbers, whether they are closed.
    """
    closed = [by_hand.get(number, not _is_open(door, time_s, robot)) for number, door in enumerate(doors)]
    shut = [door.segment for door, is_closed in zip(doors, closed, strict=True) if is_closed]
    return np.array(shut, dtype=np.float64).reshape(-1, 4)


def _is_open(door: Door, time_s: float, robot: Point) -> bool:
    if door.opens_within > 0.0 and from_segments(np.array([door.segment]))(*robot) <= door.opens_within:
        return True
    return (time_s - door.phase) % door.period < door.open_for


class People:
    """People who walk straight from goal to goal in view, at constant speed.

    Goals are drawn uniformly in the free space of the map. A person waits before a closed door or the robot, and after
    ``PATIENCE_S`` takes another goal. ``positions`` (P, 2) in metres.
    """

    def __init__(
        self, params: PeopleParams, seed: int, clearance: Clearance, grid: OccupancyGrid, robot: Point
    ) -> None:
        """Draw the first positions, 1 m or more from the robot; raises ScenarioError where there is no room."""
        self.params, self._seed, self._clearance, self._grid = params, seed, clearance, grid
        rng = generator(seed, "simulator", 0, "people")
        self.positions = np.array([self._anywhere(rng, robot) for _ in range(params.number)]).reshape(-1, 2)
        self.goals = self.positions.copy()
        self.waited_s = np.zeros(params.number)

    def walk(self, number: int, tick_s: float, robot: Point, doors: Segments) -> None:
        """Advance by the tick of this number."""
        rng = generator(self._seed, "simulator", number, "people")
        shut = from_segments(doors)
        for person in range(len(self.positions)):
            way = self.goals[person] - self.positions[person]
            left = norm(way)
            stride = self.params.speed * tick_s
            if left <= stride or self.waited_s[person] > PATIENCE_S:
                self.goals[person] = self._goal(rng, self.positions[person])
                self.waited_s[person] = 0.0
                continue
            there = self.positions[person] + way * (stride / left)
            if self._stopped(self.positions[person], there, robot) or shut(*there) < self.params.radius:
                self.waited_s[person] += tick_s
            else:
                self.positions[person] = there
                self.waited_s[person] = 0.0

    def freeze(self) -> State:
        """Return positions, goals and waiting times."""
        return {"people": self.positions.copy(), "goals": self.goals.copy(), "waited_s": self.waited_s.copy()}

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""
        self.positions, self.goals = np.array(state["people"]), np.array(state["goals"])
        self.waited_s = np.array(state["waited_s"])

    def _stopped(self, here: FloatArray, there: FloatArray, robot: Point) -> bool:
        """Return whether the robot stops a person: it is near, and nearer after the next stride."""
        gap = dist(there, robot)
        return gap < self.params.radius + 2 * ROOM_FOR_ROBOT_M and gap < dist(here, robot)

    def _anywhere(self, rng: Draws, robot: Point) -> FloatArray:
        for position in self._drawn(rng, 1000):
            if self._clearance(*position) >= self.params.radius and dist(position, robot) >= 1.0:
                return position
        raise ScenarioError("simulator.people: no room for them in the map")

    def _goal(self, rng: Draws, here: FloatArray) -> FloatArray:
        """Return a goal in view, with a path free of walls, or else the position itself."""
        for goal in self._drawn(rng, DRAWS):
            steps = max(1, math.ceil(dist(here, goal) / STEP_M))
            way = here + np.linspace(0.0, 1.0, steps + 1)[1:, None] * (goal - here)
            if all(self._clearance(x, y) >= self.params.radius for x, y in way.tolist()):
                return goal
        return here.copy()

    def _drawn(self, rng: Draws, count: int) -> list[FloatArray]:
        """Draw ``count`` positions (2,) in the map's bounding box and return those that are free."""
        rows, columns = self._grid.cells.shape
        column, row = rng.uniform((0.0, 0.0), (columns, rows), (count, 2)).T
        free = self._grid.free[whole(row, 0, rows - 1), whole(column, 0, columns - 1)]
        return list(np.stack(self._grid.to_map(column[free], row[free]), axis=1))
