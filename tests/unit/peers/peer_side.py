"""What other libraries make of the same numbers: `python -I peer_side.py`, in the peers' environment.

Reads one JSON document from stdin, {question: {...}}, and prints {question: answer}; a function here is named as the
question that it answers. Models that the libraries ask for are written here once more, from the textbook, so that
nothing of dynpf takes part.
"""

import json
import os
import sys
from datetime import datetime, timedelta

import numpy as np


def kalman_filterpy(problem):
    """Return mean and covariance after every update of filterpy's KalmanFilter."""
    from filterpy.kalman import KalmanFilter

    kf = KalmanFilter(dim_x=len(problem["mean"]), dim_z=len(problem["H"]))
    kf.x, kf.P = np.array(problem["mean"])[:, None], np.array(problem["P"])
    kf.F, kf.H = np.array(problem["F"]), np.array(problem["H"])
    kf.Q, kf.R = np.array(problem["Q"]), np.array(problem["R"])
    beliefs = []
    for z in problem["readings"]:
        kf.predict()
        kf.update(np.array(z)[:, None])
        beliefs.append((kf.x[:, 0].tolist(), kf.P.tolist()))
    return beliefs


def kalman_stonesoup(problem):
    """Return mean and covariance after every update of Stone Soup's KalmanPredictor and KalmanUpdater."""
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel
    from stonesoup.predictor.kalman import KalmanPredictor
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import GaussianState
    from stonesoup.updater.kalman import KalmanUpdater

    observation = np.array(problem["H"])
    transition = LinearGaussianTimeInvariantTransitionModel(
        transition_matrix=np.array(problem["F"]), covariance_matrix=np.array(problem["Q"])
    )
    mapping = [int(np.flatnonzero(row)[0]) for row in observation]  # its H picks rows of the state
    assert np.array_equal(observation, np.eye(observation.shape[1])[mapping])
    measurement = LinearGaussian(len(problem["mean"]), mapping, np.array(problem["R"]))
    now = datetime(2000, 1, 1)
    state = GaussianState(np.array(problem["mean"])[:, None], np.array(problem["P"]), timestamp=now)
    predictor, updater = KalmanPredictor(transition), KalmanUpdater(measurement)
    beliefs = []
    for z in problem["readings"]:
        now += timedelta(seconds=1)
        detection = Detection(np.array(z)[:, None], timestamp=now, measurement_model=measurement)
        state = updater.update(SingleHypothesis(predictor.predict(state, timestamp=now), detection))
        mean = np.asarray(state.state_vector, dtype=float).ravel()
        beliefs.append((mean.tolist(), np.asarray(state.covar, dtype=float).tolist()))
    return beliefs


def bootstrap_particles(problem):
    """Return the weighted means after every update of a bootstrap filter by `particles`."""
    import particles
    from particles import distributions, state_space_models
    from particles.collectors import Moments

    transition, observation = np.array(problem["F"]), np.array(problem["H"])

    class Linear(state_space_models.StateSpaceModel):
        def PX0(self):  # noqa: N802
            mean = transition @ np.array(problem["mean"])
            spread = transition @ np.array(problem["P"]) @ transition.T + np.array(problem["Q"])
            return distributions.MvNormal(loc=mean, cov=spread)

        def PX(self, t, xp):  # noqa: N802
            return distributions.MvNormal(loc=xp @ transition.T, cov=np.array(problem["Q"]))

        def PY(self, t, xp, x):  # noqa: N802
            return distributions.MvNormal(loc=x @ observation.T, cov=np.array(problem["R"]))

    np.random.seed(problem["seed"])  # noqa: NPY002
    data = [np.array(z) for z in problem["readings"]]
    fk = state_space_models.Bootstrap(ssm=Linear(), data=data)
    smc = particles.SMC(fk=fk, N=problem["n"], resampling="systematic", ESSrmin=0.5, collect=[Moments()])
    smc.run()
    return [moments["mean"].tolist() for moments in smc.summaries.moments]


def resampling_particles(problem):
    """Return the survivors of `particles`' systematic and stratified schemes for the given uniform numbers, and ESS."""
    from particles import resampling

    weights, uniforms = np.array(problem["weights"]), np.array(problem["uniforms"])
    resampling.random.rand = lambda count: uniforms[:count]
    ess = resampling.Weights(lw=np.log(weights)).ESS
    chosen = {scheme: resampling.resampling(scheme, weights).tolist() for scheme in ("systematic", "stratified")}
    return {**chosen, "n_eff": float(ess)}


def _odometry(problem, mean):
    """Return f, its Jacobian and its noise's covariance for rotation, way, rotation (Thrun et al., 2005, table 5.6)."""
    first, way, second = problem["control"]
    direction = mean[2] + first
    moved = mean + np.array([way * np.cos(direction), way * np.sin(direction), first + second])
    jacobian = np.eye(3)
    jacobian[:2, 2] = -way * np.sin(direction), way * np.cos(direction)
    by_noise = np.array([[jacobian[0, 2], np.cos(direction), 0], [jacobian[1, 2], np.sin(direction), 0], [1, 0, 1]])
    return moved, jacobian, by_noise @ np.diag(np.square(problem["control_sigma"])) @ by_noise.T


def _seen(problem, mean):
    """Return the ranges of all landmarks, then their bearings."""
    east, north = (np.array(problem["landmarks"]) - mean[:2]).T
    return np.concatenate((np.hypot(east, north), np.arctan2(north, east) - mean[2]))


def _seen_jacobian(problem, mean):
    east, north = (np.array(problem["landmarks"]) - mean[:2]).T
    square = east**2 + north**2
    distance, zero = np.sqrt(square), np.zeros_like(east)
    ranges = np.stack((-east / distance, -north / distance, zero), axis=1)
    bearings = np.stack((north / square, -east / square, zero - 1.0), axis=1)
    return np.concatenate((ranges, bearings))


def _wrapped(problem, angles_from):
    def residual(a, b):
        difference = a - b
        difference[angles_from:] = (difference[angles_from:] + np.pi) % (2 * np.pi) - np.pi
        return difference

    return residual


def _noise(problem):
    count = len(problem["landmarks"])
    return np.diag(np.repeat(np.square((problem["sigma_range"], problem["sigma_bearing"])), count))


def extended_filterpy(problem):
    """Return mean and covariance after every update of filterpy's ExtendedKalmanFilter among landmarks."""
    from filterpy.kalman import ExtendedKalmanFilter

    count = len(problem["landmarks"])

    class Robot(ExtendedKalmanFilter):
        x: np.ndarray

        def predict_x(self, u=0):
            self.x, self.F, self.Q = _odometry(problem, self.x)

    kf = Robot(dim_x=3, dim_z=2 * count)
    kf.x, kf.P, kf.R = np.array(problem["mean"]), np.array(problem["P"]), _noise(problem)
    beliefs = []
    for z in problem["readings"]:
        kf.predict()
        kf.update(
            np.array(z),
            lambda mean: _seen_jacobian(problem, mean),
            lambda mean: _seen(problem, mean),
            residual=_wrapped(problem, count),
        )
        beliefs.append((kf.x.tolist(), kf.P.tolist()))
    return beliefs


def unscented_filterpy(problem):
    """Return mean and covariance after every update of filterpy's UKF with the scaled points of van der Merwe."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    count = len(problem["landmarks"])
    residual = _wrapped(problem, count)

    def mean_seen(seen, weights):  # bearings may lie on both sides of pi
        return seen[0] + weights @ np.array([residual(z, seen[0]) for z in seen])

    points = MerweScaledSigmaPoints(3, alpha=problem["alpha"], beta=problem["beta"], kappa=problem["kappa"])
    kf = UnscentedKalmanFilter(
        3,
        2 * count,
        1.0,
        hx=lambda mean: _seen(problem, mean),
        fx=lambda mean, dt: _odometry(problem, mean)[0],
        points=points,
        z_mean_fn=mean_seen,
        residual_z=residual,
    )
    kf.x, kf.P, kf.R = np.array(problem["mean"]), np.array(problem["P"]), _noise(problem)
    beliefs = []
    for z in problem["readings"]:
        kf.Q = _odometry(problem, kf.x)[2]
        kf.predict()
        kf.update(np.array(z))
        beliefs.append((kf.x.tolist(), kf.P.tolist()))
    return beliefs


if __name__ == "__main__":
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a library prints
    questions = json.load(sys.stdin)
    print(json.dumps({name: globals()[name](problem) for name, problem in questions.items()}), file=answers)
