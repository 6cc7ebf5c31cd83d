"""What moves in a room besides the robot: people who walk about, and doors that open and close."""

import math
from collections.abc import Sequence

import numpy as np
from dynpf_protocol.errors import ScenarioError
from dynpf_runtime.node import State

from dynpf.maps.occupancy import OccupancyGrid
from dynpf.portable import dist, norm, whole
from dynpf.rng import Draws, generator
from dynpf.se2 import FloatArray
from dynpf_systems.rooms.clearance import Clearance, from_segments
from dynpf_systems.rooms.config import Door, PeopleParams

__all__ = ["People", "closed_doors"]

Point = tuple[float, float]
Segments = FloatArray

DRAWS = 30  # of a goal, until one is in view
STEP_M = 0.1  # between the places of a way that are looked at
PATIENCE_S = 2.0  # before a closed door or the robot; then there is another goal
ROOM_FOR_ROBOT_M = 0.15  # that people leave between it and themselves


def closed_doors(doors: Sequence[Door], time_s: float, robot: Point) -> Segments:
    """Return the doors (D, 4) that are closed at a time, the robot being where it is."""
    shut = [door.segment for door in doors if not _is_open(door, time_s, robot)]
    return np.array(shut, dtype=np.float64).reshape(-1, 4)


def _is_open(door: Door, time_s: float, robot: Point) -> bool:
    if door.opens_within > 0.0 and from_segments(np.array([door.segment]))(*robot) <= door.opens_within:
        return True
    return (time_s - door.phase) % door.period < door.open_for


class People:
    """Walks from one goal that is in view to the next, straight, at a steady pace.

    Goals are drawn anywhere in the free space of the map. Before a closed door or the robot a person waits, and after
    a while goes elsewhere. ``places`` (P, 2) in metres.
    """

    def __init__(
        self, params: PeopleParams, seed: int, clearance: Clearance, grid: OccupancyGrid, robot: Point
    ) -> None:
        """Draw where people are at first, 1 m or more from the robot; raises ScenarioError where nobody finds room."""
        self.params, self._seed, self._clearance, self._grid = params, seed, clearance, grid
        rng = generator(seed, "simulator", 0, "people")
        self.places = np.array([self._anywhere(rng, robot) for _ in range(params.number)]).reshape(-1, 2)
        self.goals = self.places.copy()
        self.waited_s = np.zeros(params.number)

    def walk(self, number: int, tick_s: float, robot: Point, doors: Segments) -> None:
        """Go on for one tick, whose number it is."""
        rng = generator(self._seed, "simulator", number, "people")
        shut = from_segments(doors)
        for person in range(len(self.places)):
            way = self.goals[person] - self.places[person]
            left = norm(way)
            stride = self.params.speed * tick_s
            if left <= stride or self.waited_s[person] > PATIENCE_S:
                self.goals[person] = self._goal(rng, self.places[person])
                self.waited_s[person] = 0.0
                continue
            there = self.places[person] + way * (stride / left)
            if self._stopped(self.places[person], there, robot) or shut(*there) < self.params.radius:
                self.waited_s[person] += tick_s
            else:
                self.places[person] = there
                self.waited_s[person] = 0.0

    def freeze(self) -> State:
        return {"people": self.places.copy(), "goals": self.goals.copy(), "waited_s": self.waited_s.copy()}

    def thaw(self, state: State) -> None:
        self.places, self.goals = np.array(state["people"]), np.array(state["goals"])
        self.waited_s = np.array(state["waited_s"])

    def _stopped(self, here: FloatArray, there: FloatArray, robot: Point) -> bool:
        """Return whether the robot is in the way: near, and nearer after the next stride."""
        gap = dist(there, robot)
        return gap < self.params.radius + 2 * ROOM_FOR_ROBOT_M and gap < dist(here, robot)

    def _anywhere(self, rng: Draws, robot: Point) -> FloatArray:
        for place in self._drawn(rng, 1000):
            if self._clearance(*place) >= self.params.radius and dist(place, robot) >= 1.0:
                return place
        raise ScenarioError("simulator.people: no room for them in the map")

    def _goal(self, rng: Draws, here: FloatArray) -> FloatArray:
        """Return a goal to which the way is free of walls, or the place itself."""
        for goal in self._drawn(rng, DRAWS):
            steps = max(1, math.ceil(dist(here, goal) / STEP_M))
            way = here + np.linspace(0.0, 1.0, steps + 1)[1:, None] * (goal - here)
            if all(self._clearance(x, y) >= self.params.radius for x, y in way.tolist()):
                return goal
        return here.copy()

    def _drawn(self, rng: Draws, count: int) -> list[FloatArray]:
        """Return those of so many places (2,) in the map's box that are free."""
        rows, columns = self._grid.cells.shape
        column, row = rng.uniform((0.0, 0.0), (columns, rows), (count, 2)).T
        free = self._grid.free[whole(row, 0, rows - 1), whole(column, 0, columns - 1)]
        return list(np.stack(self._grid.to_map(column[free], row[free]), axis=1))
