"""Another library on the landmark problem, in its own process: `python -I peer_worker.py NAME`.

Runs in the peers' environment (`make peers`) and imports nothing of dynpf. Reads requests from stdin and answers each
on stdout, with a JSON document on each line:

    {"command": "prepare", "problem": {...}, "n": N, "seed": S}  ->  {"version": "..."}
    {"command": "run", "updates": K}  ->  {"seconds": for K updates, "estimate": [x, y, heading], "step": last}
    {"command": "release"}  ->  {}

or with {"error": "..."}. The problem (lab/dynpf_lab/bench/problems.py) is a robot that drives a circle, one lap in T
steps, and sees all landmarks at each: step k is row k modulo T of "ranges" and "bearings", both T by L. Every library
does the same work in each step, as its own documentation shows, vectorized as far as it allows: it samples the motion,
weights by range and bearing, normalizes, computes the weighted mean, and resamples systematically. The docstring of a
peer tells where it does more or less.
"""

import json
import os
import sys
import time
import traceback
from collections.abc import Callable
from datetime import datetime, timedelta
from importlib.metadata import version
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Problem:
    """The common model: N poses at a time, their coordinates as arrays (N,), in float64 as in the libraries."""

    def __init__(self, request: dict[str, Any]) -> None:
        self.start, self.start_sigma = np.array(request["start"]), np.array(request["start_sigma"])
        self.turn_before, self.way, self.turn_after = request["control"]
        self.control_sigma = np.array(request["control_sigma"])
        self.landmarks = np.array(request["landmarks"])
        self.ranges, self.bearings = np.array(request["ranges"]), np.array(request["bearings"])
        self.sigma_range, self.sigma_bearing = request["sigma_range"], request["sigma_bearing"]

    def drawn_start(self, n: int) -> Array:
        """Return poses drawn from the prior, shape (n, 3)."""
        return self.start + self.start_sigma * np.random.standard_normal((n, 3))  # noqa: NPY002 - as the libraries do

    def moved(self, x: Array, y: Array, heading: Array) -> tuple[Array, Array, Array]:
        """Return draws from the odometry motion model: turn, go straight, turn, each with noise of its own."""
        noise = np.random.standard_normal((3, len(x))) * self.control_sigma[:, None]  # noqa: NPY002
        direction = heading + (self.turn_before + noise[0])
        way = self.way + noise[1]
        return x + way * np.cos(direction), y + way * np.sin(direction), direction + (self.turn_after + noise[2])

    def expected(self, x: Array, y: Array, heading: Array) -> tuple[Array, Array]:
        """Return the ranges and bearings of all landmarks from each pose, each (N, L)."""
        east = self.landmarks[:, 0] - x[:, None]
        north = self.landmarks[:, 1] - y[:, None]
        return np.sqrt(east * east + north * north), np.arctan2(north, east) - heading[:, None]

    def log_likelihood(self, ranges: Array, bearings: Array, step: int) -> Array:
        """Return the log-density of a step's reading up to a constant, shape (N,)."""
        return self.compared(ranges, bearings, self.ranges[step], self.bearings[step])

    def compared(self, ranges: Array, bearings: Array, seen_ranges: Array, seen_bearings: Array) -> Array:
        """Return the log-density of seen ranges and bearings given expected ones, shape (N,)."""
        across = (seen_ranges - ranges) / self.sigma_range
        turned = wrapped(seen_bearings - bearings) / self.sigma_bearing
        squares: Array = np.einsum("ij,ij->i", across, across) + np.einsum("ij,ij->i", turned, turned)
        return -0.5 * squares

    @property
    def steps(self) -> int:
        """The number of steps of a lap."""
        return len(self.ranges)


def wrapped(angle: Array) -> Array:
    """Return angles wrapped to [-pi, pi]."""
    return angle - 2.0 * np.pi * np.rint(angle / (2.0 * np.pi))


class Peer(Protocol):
    """A filter that tracks the robot."""

    def update(self, step: int) -> None:
        """Update the filter by the control and the readings of a step."""
        ...

    def estimate(self) -> Array:
        """Return the weighted mean pose, (3,)."""
        ...


def particles_peer(problem: Problem, n: int) -> Peer:
    """`particles`: its SMC class on the bootstrap filter of a state-space model.

    Its step begins with the resampling of the step before, so each call still does each part once. ``ESSrmin=1`` makes
    it resample at every step; ``Moments`` is its own collector of weighted means and variances.
    """
    import particles
    from particles import distributions, state_space_models
    from particles.collectors import Moments

    class Moved(distributions.ProbDist):
        dim = 3

        def __init__(self, poses: Array) -> None:
            self.poses = poses

        def rvs(self, size: int | None = None) -> Array:  # noqa: ARG002 - one draw for each pose
            return np.stack(problem.moved(*self.poses.T), axis=1)

    class Seen(distributions.ProbDist):
        dim = 2 * len(problem.landmarks)

        def __init__(self, poses: Array) -> None:
            self.poses = poses

        def logpdf(self, x: int) -> Array:
            return problem.log_likelihood(*problem.expected(*self.poses.T), x)

    class Robot(state_space_models.StateSpaceModel):
        def PX0(self) -> Any:  # noqa: N802 - the library's names
            pairs = zip(problem.start, problem.start_sigma, strict=True)
            return distributions.IndepProd(*(distributions.Normal(loc=mean, scale=sigma) for mean, sigma in pairs))

        def PX(self, t: int, xp: Array) -> Any:  # noqa: N802, ARG002
            return Moved(xp)

        def PY(self, t: int, xp: Array, x: Array) -> Any:  # noqa: N802, ARG002
            return Seen(x)

    class Particles:
        def __init__(self) -> None:
            # A reading is given by its row, so that the data repeat for as many steps as needed.
            rows = [step % problem.steps for step in range(1_000_000)]
            model = state_space_models.Bootstrap(ssm=Robot(), data=rows)
            self.smc = particles.SMC(fk=model, N=n, resampling="systematic", ESSrmin=1.0, collect=[Moments()])

        def update(self, step: int) -> None:  # noqa: ARG002 - it counts for itself
            next(self.smc)

        def estimate(self) -> Array:
            return np.asarray(self.smc.summaries.moments[-1]["mean"])

    return Particles()


def pfilter_peer(problem: Problem, n: int) -> Peer:
    """pfilter: its ParticleFilter with functions of whole arrays and its own systematic resampling.

    Its update always computes the covariance, the mean observation, the entropy and the best particle, too. Its
    resampling is a loop in Python.
    """
    from pfilter import ParticleFilter, systematic_resample

    def dynamics(poses: Array) -> Array:
        return np.stack(problem.moved(*poses.T), axis=1)

    def observe(poses: Array) -> Array:
        return np.concatenate(problem.expected(*poses.T), axis=1)

    def weight(expected: Array, seen: Array) -> Array:
        halves = np.split(expected, 2, axis=1), np.split(seen, 2, axis=1)
        score = problem.compared(*halves[0], *halves[1])
        return np.asarray(np.exp(score - score.max()))

    class PFilter:
        def __init__(self) -> None:
            np.seterr(divide="ignore", invalid="ignore")  # its entropy takes the logarithm of weights of zero
            self.filter = ParticleFilter(
                prior_fn=problem.drawn_start,
                observe_fn=observe,
                resample_fn=systematic_resample,
                n_particles=n,
                dynamics_fn=dynamics,
                weight_fn=weight,
            )
            self.seen = np.concatenate((problem.ranges, problem.bearings), axis=1)

        def update(self, step: int) -> None:
            self.filter.update(self.seen[step])

        def estimate(self) -> Array:
            return np.asarray(self.filter.mean_state)

    return PFilter()


def stonesoup_peer(problem: Problem, n: int) -> Peer:
    """Stone Soup: its ParticlePredictor, ParticleUpdater and SystematicResampler, all landmarks as one detection.

    Its own bearing-range models have no heading in the state, so the model here is a subclass, as its documentation
    recommends, with its own density instead of the multivariate normal of its base class, which does not wrap angles
    and multiplies by a matrix of 30 x 30. The mean is computed after resampling, as its updater returns it; there is no
    N_eff.
    """
    from stonesoup.predictor.particle import ParticlePredictor
    from stonesoup.resampler.particle import SystematicResampler
    from stonesoup.types.array import StateVector, StateVectors
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import ParticleState
    from stonesoup.updater.particle import ParticleUpdater

    motion, landmarks = _stonesoup_models(problem)

    class StoneSoup:
        def __init__(self) -> None:
            variances = np.repeat((problem.sigma_range**2, problem.sigma_bearing**2), len(problem.landmarks))
            model = landmarks(ndim_state=3, mapping=(0, 1, 2), noise_covar=np.diag(variances))
            self.now = datetime(2000, 1, 1)
            self.detections = [
                Detection(StateVector(np.concatenate(seen)), timestamp=self.now, measurement_model=model)
                for seen in zip(problem.ranges, problem.bearings, strict=True)
            ]
            self.predictor = ParticlePredictor(motion)
            self.updater = ParticleUpdater(None, resampler=SystematicResampler())
            start = StateVectors(problem.drawn_start(n).T)
            self.state = ParticleState(start, weight=np.full(n, 1.0 / n), timestamp=self.now)

        def update(self, step: int) -> None:
            self.now += timedelta(seconds=1)
            prediction = self.predictor.predict(self.state, timestamp=self.now)
            self.state = self.updater.update(SingleHypothesis(prediction, self.detections[step]))
            self.mean = self.state.mean

        def estimate(self) -> Array:
            return np.asarray(self.mean, dtype=np.float64).ravel()

    return StoneSoup()


def _stonesoup_models(problem: Problem) -> tuple[Any, Any]:
    """Return the motion model, and the class of the measurement model, as subclasses of Stone Soup's."""
    from stonesoup.base import Property
    from stonesoup.models.measurement.nonlinear import NonLinearGaussianMeasurement
    from stonesoup.models.transition.base import TransitionModel
    from stonesoup.types.array import StateVectors

    class Odometry(TransitionModel):
        ndim_state: int = Property(default=3)

        def function(self, state: Any, noise: Any = False, **kwargs: Any) -> Any:  # noqa: ARG002
            return StateVectors(np.stack(problem.moved(*np.asarray(state.state_vector))))

        def rvs(self, num_samples: int = 1, **kwargs: Any) -> Any:
            raise NotImplementedError

        def pdf(self, state1: Any, state2: Any, **kwargs: Any) -> Any:
            raise NotImplementedError

    class Landmarks(NonLinearGaussianMeasurement):
        ndim_meas: int = Property(default=2 * len(problem.landmarks))

        def function(self, state: Any, noise: Any = False, **kwargs: Any) -> Any:  # noqa: ARG002
            return StateVectors(np.concatenate(problem.expected(*np.asarray(state.state_vector)), axis=1).T)

        def logpdf(self, state1: Any, state2: Any, **kwargs: Any) -> Array:  # noqa: ARG002
            seen = np.split(np.asarray(state1.state_vector, dtype=np.float64)[:, 0], 2)
            return problem.compared(*problem.expected(*np.asarray(state2.state_vector)), *seen)

    return Odometry(), Landmarks


def filterpy_peer(problem: Problem, n: int) -> Peer:
    """filterpy: it has no particle filter, only resampling; the rest is NumPy as in its book.

    Its resampling is a loop in Python.
    """
    from filterpy.monte_carlo import systematic_resample

    class FilterPy:
        def __init__(self) -> None:
            self.poses = problem.drawn_start(n).T

        def update(self, step: int) -> None:
            moved = np.stack(problem.moved(*self.poses))
            score = problem.log_likelihood(*problem.expected(*moved), step)
            weights = np.exp(score - score.max())
            weights /= weights.sum()
            self.mean = np.average(moved, weights=weights, axis=1)
            self.n_eff = 1.0 / np.sum(weights**2)
            self.poses = moved[:, systematic_resample(weights)]

        def estimate(self) -> Array:
            return self.mean

    return FilterPy()


PEERS: dict[str, Callable[[Problem, int], Peer]] = {
    "particles": particles_peer,
    "pfilter": pfilter_peer,
    "stonesoup": stonesoup_peer,
    "filterpy": filterpy_peer,
}


class Worker:
    """Answers requests for one library."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.peer: Peer | None = None
        self.step = 0
        self.steps = 1

    def prepare(self, problem: dict[str, Any], n: int, seed: int) -> dict[str, Any]:
        """Make a filter of ``n`` particles for the problem."""
        np.random.seed(seed)  # noqa: NPY002 - the generator that all libraries use
        self.release()
        model = Problem(problem)
        self.peer, self.step, self.steps = PEERS[self.name](model, n), 0, model.steps
        return {"version": version(self.name)}

    def run(self, updates: int) -> dict[str, Any]:
        """Execute updates; return their seconds and the estimate."""
        assert self.peer is not None
        began = time.perf_counter()
        for _ in range(updates):
            self.peer.update(self.step % self.steps)
            self.step += 1
        seconds = time.perf_counter() - began
        estimate = [float(value) for value in self.peer.estimate()]
        return {"seconds": seconds, "estimate": estimate, "step": (self.step - 1) % self.steps}

    def release(self) -> dict[str, Any]:
        """Release the filter."""
        self.peer = None
        return {}


def serve(name: str) -> None:
    """Answer requests until stdin ends. Output of a library goes to stderr."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    worker = Worker(name)
    for line in sys.stdin:
        request = json.loads(line)
        try:
            answer = getattr(worker, request.pop("command"))(**request)
        except Exception:
            answer = {"error": traceback.format_exc()}
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    serve(sys.argv[1])
