"""Who is who among discs that look alike: a belief over all ways to give the names to the discs.

Tracks follow discs by where they are; names are robot and parts. Each pair of a name and a track has an evidence, a
log-likelihood: of the radii and colours seen, a start that the task gives, where one that was lost was last seen, and
of the motion: the robot's disc moves as commanded, a part's rests unless it is held. A hypothesis is an assignment of
names to tracks, its log-likelihood the sum of its pairs; none is ever dropped. The probability of a pair is that of the
best hypothesis with it, relative to the best with each other track.
"""

import math
from typing import NamedTuple

import numpy as np
from dynpf_runtime.node import State
from numpy.typing import NDArray

from dynpf.assignment import assign, cheapest_exchanges
from dynpf.portable import exp, log
from dynpf.types import FloatArray
from dynpf_systems.parts.config import IdentityConfig, RearrangementConfig
from dynpf_systems.parts.robot_filters import Seen
from dynpf_systems.parts.task import Noise, RearrangementTask

__all__ = ["Look", "WhoIsWho", "alike", "hypotheses"]

ROBOT = 0  # the first of the names; part i is name i + 1
IMPOSSIBLE = 60.0  # nats: what keeps apart names that do not look alike, and the most that motion tells
LEVELS = 256.0  # of a colour
UNKNOWN = 1e3  # m^2, variance of a position of which nothing is known
MOST_AT_ONCE = 8.0  # nats, that a single frame tells by motion: a disc may be a false one


class Look(NamedTuple):
    """What is seen of each track in a tick, (k,): whether anything, centre (k, 2), radius, colour (k, 3) or NaN."""

    seen: NDArray[np.bool_]
    centres: FloatArray
    radii: FloatArray
    colours: FloatArray


class _Bank(NamedTuple):
    """A Kalman filter for each track under one model of motion: means (k, 2), variances of a coordinate (k,)."""

    means: FloatArray
    variances: FloatArray

    def step(self, look: Look, shift: FloatArray, process: float, measurement: float) -> tuple["_Bank", FloatArray]:
        """Return the bank after a tick, and the log-likelihoods of what was seen, (k,)."""
        means, variances = self.means + shift, self.variances + process
        innovation, total = look.centres - means, variances + measurement
        squared = innovation[:, 0] * innovation[:, 0] + innovation[:, 1] * innovation[:, 1]
        likelihood = np.where(look.seen, -0.5 * squared / total - log(total), 0.0)
        gain = np.where(look.seen, variances / total, 0.0)
        return _Bank(means + gain[:, None] * innovation, variances * (1.0 - gain)), likelihood


def alike(task: RearrangementTask, config: RearrangementConfig) -> NDArray[np.bool_]:
    """Return which names may be taken for each other by their looks, (p + 1, p + 1): radius, and grey where known."""
    radii = np.array([task.robot_radius, *(part.radius for part in task.parts)])
    similar = np.abs(radii[:, None] - radii) < config.radius_gate
    if config.robot_grey is not None and config.part_grey is not None:
        apart = abs(config.robot_grey - config.part_grey) >= config.identity.grey_sigmas * config.grey_sigma
        similar[ROBOT, 1:] &= not apart
        similar[1:, ROBOT] &= not apart
    return np.asarray(similar)


def hypotheses(evidence: FloatArray) -> FloatArray:
    """Return the probability of each pair of a name and a track, (k, k), by the ``evidence`` of pairs, (k, k).

    That is the likelihood of the best hypothesis with the pair, as a share of those of all pairs of the name.
    """
    order = assign(-evidence)
    shares = exp(-cheapest_exchanges(-evidence[:, order]))
    probabilities = np.empty_like(shares)
    probabilities[:, order] = shares / np.sum(shares, axis=1, keepdims=True)
    return probabilities


class WhoIsWho:
    """The evidence of each pair of name and track. Tracks are numbered by the names that they are given at the time."""

    def __init__(self, task: RearrangementTask, config: RearrangementConfig, noise: Noise) -> None:
        self._config: IdentityConfig = config.identity
        self._radii = np.array([task.robot_radius, *(part.radius for part in task.parts)])
        self._kinds = np.append(-1, task.kinds)
        self._alike = alike(task, config)
        self._noise, self._process = noise, config.part_process_variance
        self._radius_variance = config.radius_sigma * config.radius_sigma
        self._colours = np.array([colour or (np.nan,) * 3 for colour in task.colours])
        self._starts = [task.robot_start, *(part.start for part in task.parts)]
        self._density = 1.0 / (task.width * task.height)
        count = len(self._radii)
        self._seen = np.zeros(count, dtype=np.int64)  # radii so far of each track ...
        self._radius_sum = np.zeros(count)  # ... and their sum
        self._coloured = np.zeros(count, dtype=np.int64)  # colours so far of each track ...
        self._colour_sum = np.zeros((count, 3))  # ... and their sum
        self._places = np.zeros((count, count))  # evidence of starts, and of where lost ones turned up
        self._motion = np.zeros(count)  # how much more likely each track's motion is for the robot than for a part
        self._moving = _Bank(np.zeros((count, 2)), np.full(count, UNKNOWN))
        self._resting = _Bank(np.zeros((count, 2)), np.full(count, UNKNOWN))
        self._lost = np.ones(count, dtype=bool)  # tracks without a disc
        self._last = np.array([start or (np.nan, np.nan) for start in self._starts])  # of names, before they were lost
        self._gone = np.ones(count, dtype=bool)  # names lost since all tracks had discs, or never seen
        self._settled = np.zeros(count, dtype=bool)  # tracks that were sure of their names once
        self._resolve()

    @property
    def needed(self) -> bool:
        """Whether any two names that are not interchangeable look alike."""
        return bool(np.any(self._alike & (self._kinds[:, None] != self._kinds)))

    @property
    def certainties(self) -> FloatArray:
        """The probability that each track is what it is taken for, or one interchangeable with that, (k,)."""
        same = self._kinds[:, None] == self._kinds
        total: FloatArray = np.minimum(np.sum(np.where(same, self._probabilities, 0.0), axis=1), 1.0)
        return total

    @property
    def robot_among(self) -> tuple[int, ...]:
        """The parts whose track may be the robot's."""
        likely = self._probabilities[ROBOT, 1:] > 1.0 - self._config.sure
        return tuple(np.flatnonzero(likely).tolist())

    def predictions(self, shift: FloatArray, process: float) -> list[tuple[NDArray[np.bool_], FloatArray, FloatArray]]:
        """Return where tracks that may be the robot's may be, under both models: which, (k,), means, variances."""
        open_ = self._probabilities[ROBOT] > 1.0 - self._config.sure
        if np.sum(open_) < 2:
            return []
        return [
            (open_, self._moving.means + shift, self._moving.variances + process),
            (open_, self._resting.means, self._resting.variances + self._process),
        ]

    def robot_position(self) -> Seen:
        """Return where the robot's track is, moved as the robot is."""
        return Seen(self._moving.means[ROBOT].copy(), float(self._moving.variances[ROBOT]))

    def part_positions(self) -> tuple[FloatArray, FloatArray]:
        """Return where the tracks of the parts are, at rest: means (p, 2) and variances (p,)."""
        return self._resting.means[1:].copy(), np.where(self._lost, UNKNOWN, self._resting.variances)[1:]

    def update(self, look: Look, lost: NDArray[np.bool_], held: int, shift: FloatArray, process: float) -> None:
        """Take in what is seen of each track in a tick; ``lost`` are the tracks whose disc is not known (any more)."""
        found = look.seen & self._lost
        self._lose(lost & ~look.seen & ~self._lost)
        for track in np.flatnonzero(found).tolist():
            self._begin(track, look)
        measurement = self._noise.measurement
        self._moving, moved = self._moving.step(look, shift, process, measurement)
        self._resting, rested = self._resting.step(look, np.zeros(2), self._process, measurement)
        known = look.seen & ~found
        if held >= 0:  # it moves with the robot, and is none
            known[held + 1] = False
            if look.seen[held + 1]:
                for bank in (self._moving, self._resting):
                    bank.means[held + 1], bank.variances[held + 1] = look.centres[held + 1], measurement
        told = np.minimum(np.maximum(moved - rested, -MOST_AT_ONCE), MOST_AT_ONCE)
        self._motion = np.where(known, np.clip(self._motion + told, -IMPOSSIBLE, IMPOSSIBLE), self._motion)
        self._seen = self._seen + look.seen
        self._radius_sum = self._radius_sum + np.where(look.seen, look.radii, 0.0)
        coloured = look.seen & ~np.isnan(look.colours[:, 0])
        self._coloured = self._coloured + coloured
        self._colour_sum = self._colour_sum + np.where(coloured[:, None], look.colours, 0.0)
        if not self._lost.any():
            self._gone[:] = False
        self._resolve()

    def better(self) -> NDArray[np.intp] | None:
        """Return for each name the track that shall have it, (k,), where another hypothesis is clearly better.

        Who was sure of its name keeps it while its disc is in view: what speaks against it later makes it doubtful.
        """
        evidence = self._evidence()
        stays = np.where(self._settled, 100.0 * IMPOSSIBLE, self._config.relabel / 2.0)
        order = assign(-(evidence + np.diag(stays)))
        return order if np.any(order != np.arange(len(order))) else None

    def rename(self, order: NDArray[np.intp]) -> None:
        """Give name i to track ``order[i]``."""
        self._seen, self._radius_sum = self._seen[order], self._radius_sum[order]
        self._coloured, self._colour_sum = self._coloured[order], self._colour_sum[order]
        self._places, self._motion = self._places[:, order], self._motion[order]
        self._moving = _Bank(self._moving.means[order], self._moving.variances[order])
        self._resting = _Bank(self._resting.means[order], self._resting.variances[order])
        self._lost, self._settled = self._lost[order], self._settled[order]
        self._resolve()

    def freeze(self) -> State:
        """Return the evidence."""
        return {
            "seen": self._seen.copy(),
            "radius_sum": self._radius_sum.copy(),
            "coloured": self._coloured.copy(),
            "colour_sum": self._colour_sum.copy(),
            "places": self._places.copy(),
            "motion": self._motion.copy(),
            "moving": [array.copy() for array in self._moving],
            "resting": [array.copy() for array in self._resting],
            "lost": self._lost.copy(),
            "last": self._last.copy(),
            "gone": self._gone.copy(),
            "settled": self._settled.copy(),
        }

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""
        self._seen, self._radius_sum = state["seen"].copy(), state["radius_sum"].copy()
        self._coloured, self._colour_sum = state["coloured"].copy(), state["colour_sum"].copy()
        self._places, self._motion = state["places"].copy(), state["motion"].copy()
        self._moving = _Bank(*(array.copy() for array in state["moving"]))
        self._resting = _Bank(*(array.copy() for array in state["resting"]))
        for name in ("lost", "last", "gone", "settled"):
            setattr(self, f"_{name}", state[name].copy())
        self._resolve()

    # --- evidence ------------------------------------------------------------------------------------------------

    def _resolve(self) -> None:
        self._probabilities = hypotheses(self._evidence())
        self._settled = (self._settled | (self.certainties >= self._config.sure)) & ~self._lost

    def _evidence(self) -> FloatArray:
        """Return the evidence of each name for each track, (k, k)."""
        count = np.maximum(self._seen, 1)
        bias = self._config.radius_bias
        variance = self._radius_variance / count + bias * bias
        error = self._radius_sum / count - self._radii[:, None]
        evidence = np.where(self._seen > 0, -0.5 * error * error / variance, 0.0) + self._places
        evidence[ROBOT] += self._motion
        evidence += self._of_colours()
        evidence[~self._alike] -= 10.0 * IMPOSSIBLE
        result: FloatArray = evidence
        return result

    def _of_colours(self) -> FloatArray:
        """Return what the tracks' mean colours say for each name, (k, k); a name without a colour may have any."""
        variance = self._config.colour_sigma * self._config.colour_sigma
        mean = self._colour_sum / np.maximum(self._coloured, 1)[:, None]
        apart = self._colours[:, None] - mean
        squared = apart[:, :, 0] * apart[:, :, 0] + apart[:, :, 1] * apart[:, :, 1] + apart[:, :, 2] * apart[:, :, 2]
        density = np.maximum(-0.5 * squared / variance, -IMPOSSIBLE)
        anything = 1.5 * log(math.tau * variance) - 3.0 * log(LEVELS)
        told: FloatArray = np.where(np.isnan(squared), anything, density)
        return np.where(self._coloured > 0, told, 0.0)

    def _lose(self, tracks: NDArray[np.bool_]) -> None:
        """The discs of these tracks are gone: remember where their names were."""
        self._last[tracks] = self._resting.means[tracks]
        self._lost, self._gone = self._lost | tracks, self._gone | tracks

    def _begin(self, track: int, look: Look) -> None:
        """A track has a disc: it is one of the names that were lost, most likely one that was lost here."""
        self._lost[track] = self._settled[track] = False
        self._seen[track], self._radius_sum[track], self._motion[track] = 0, 0.0, 0.0
        self._coloured[track], self._colour_sum[track] = 0, 0.0
        for bank in (self._moving, self._resting):
            bank.means[track], bank.variances[track] = look.centres[track], UNKNOWN
        offset = look.centres[track] - self._last
        spread = self._config.start_sigma * self._config.start_sigma + self._noise.measurement
        squared = offset[:, 0] * offset[:, 0] + offset[:, 1] * offset[:, 1]
        near = exp(np.maximum(-0.5 * squared / spread, -IMPOSSIBLE)) / (math.tau * spread)
        moved = self._config.moved
        density = np.where(np.isnan(squared), self._density, moved * self._density + (1.0 - moved) * near)
        self._places[:, track] = np.where(self._gone, log(density), -IMPOSSIBLE)
