"""Models that Kalman filters are tested with: linear ones, and a robot that sees landmarks by range and bearing."""

from typing import NamedTuple

import numpy as np

from dynpf.se2 import wrap_angle


class Linear:
    """x' = F x + u + noise of covariance Q."""

    def __init__(self, transition, process):
        self.transition, self.process = np.asarray(transition), np.asarray(process)

    def particles(self, poses, _stream):
        return poses

    def propagate(self, particles, control, stream):
        raise NotImplementedError

    def expected(self, states, control):
        return self.transition @ states + np.asarray(control)[:, None]

    def jacobian(self, states, _control):
        return np.repeat(self.transition[:, :, None], states.shape[1], axis=2)

    def covariance(self, states, _control):
        return np.repeat(self.process[:, :, None], states.shape[1], axis=2)


class Numbers(NamedTuple):
    values: np.ndarray


class LinearReading:
    """z = H x + noise of covariance R; whatever is in the reading is believed, NaN included."""

    def __init__(self, observation, noise):
        self.observation, self.covariance = np.asarray(observation), np.asarray(noise)

    def admit(self, _particles, _weights, reading):
        return reading

    def log_likelihood(self, particles, reading):
        raise NotImplementedError

    def innovation(self, states, reading):
        return reading.values[:, None] - self.observation @ states

    def jacobian(self, states, _reading):
        return np.repeat(self.observation[:, :, None], states.shape[1], axis=2)

    def noise(self, _reading):
        return self.covariance

    def angular(self, reading):
        return np.zeros(len(self.noise(reading)), dtype=bool)


class Unicycle:
    """Drives u[0] metres along its heading, then turns by u[1]; noise of variances q on x, y and theta.

    The heading comes back in [-pi, pi].
    """

    def __init__(self, process=(1e-3, 1e-3, 1e-3)):
        self.process = np.diag(process)

    def particles(self, poses, _stream):
        return poses

    def propagate(self, particles, control, stream):
        raise NotImplementedError

    def expected(self, states, control):
        x, y, theta = states
        return np.stack(
            (x + control[0] * np.cos(theta), y + control[0] * np.sin(theta), wrap_angle(theta + control[1]))
        )

    def jacobian(self, states, control):
        result = np.repeat(np.eye(3)[:, :, None], states.shape[1], axis=2)
        result[0, 2] = -control[0] * np.sin(states[2])
        result[1, 2] = control[0] * np.cos(states[2])
        return result

    def covariance(self, states, _control):
        return np.repeat(self.process[:, :, None], states.shape[1], axis=2)


class Sightings(NamedTuple):
    """Ranges and bearings, each (K,), of landmarks at positions (K, 2)."""

    landmarks: np.ndarray
    ranges: np.ndarray
    bearings: np.ndarray


class SeenLandmarks:
    """Ranges, then bearings. Sightings that hold a NaN are not admitted."""

    def __init__(self, sigma_range=0.1, sigma_bearing=0.05):
        self.sigmas = (sigma_range, sigma_bearing)

    def see(self, pose, landmarks, rng):
        """Return noisy sightings of landmarks (K, 2) from a pose (3,)."""
        expected = self._expected(pose[:, None], landmarks)[..., 0]
        noise = np.array(self.sigmas)[:, None] * rng.standard_normal((2, len(landmarks)))
        return Sightings(landmarks, expected[0] + noise[0], wrap_angle(expected[1] + noise[1]))

    def admit(self, _particles, _weights, reading):
        kept = np.isfinite(reading.ranges) & np.isfinite(reading.bearings)
        return Sightings(*(field[kept] for field in reading)) if kept.any() else None

    def log_likelihood(self, particles, reading):
        raise NotImplementedError

    def innovation(self, states, reading):
        ranges, bearings = self._expected(states, reading.landmarks)
        return np.concatenate((reading.ranges[:, None] - ranges, wrap_angle(reading.bearings[:, None] - bearings)))

    def jacobian(self, states, reading):
        dx, dy = (reading.landmarks[:, axis, None] - states[axis] for axis in (0, 1))
        squared = dx**2 + dy**2
        distance, zero = np.sqrt(squared), np.zeros_like(dx)
        ranges = np.stack((-dx / distance, -dy / distance, zero), axis=1)
        bearings = np.stack((dy / squared, -dx / squared, zero - 1.0), axis=1)
        return np.concatenate((ranges, bearings))

    def noise(self, reading):
        return np.diag(np.repeat(np.square(self.sigmas), len(reading.ranges)))

    def angular(self, reading):
        return np.repeat((False, True), len(reading.ranges))

    @staticmethod
    def _expected(states, landmarks):
        dx, dy = (landmarks[:, axis, None] - states[axis] for axis in (0, 1))
        return np.stack((np.hypot(dx, dy), wrap_angle(np.arctan2(dy, dx) - states[2])))


LANDMARKS = np.array([[4.0, 1.0], [-3.0, 3.0], [0.0, -4.0]])


def drive(rng, steps=60, process=(1e-3, 1e-3, 1e-3), model=None):
    """Return the true poses (steps + 1, 3), controls and sightings of a robot that goes round in noisy circles.

    Entry k of the controls leads from pose k to pose k + 1, which sighting k was seen from; one landmark a step.
    """
    motion, model = Unicycle(process), model or SeenLandmarks()
    poses, controls, sightings = [np.array([1.5, -1.5, 3.0])], [], []
    for step in range(steps):
        control = (0.25, 0.15)
        moved = motion.expected(poses[-1][:, None], control)[:, 0] + np.sqrt(process) * rng.standard_normal(3)
        poses.append(np.append(moved[:2], wrap_angle(moved[2])))
        controls.append(control)
        sightings.append(model.see(poses[-1], LANDMARKS[[step % 3]], rng))
    return np.array(poses), controls, sightings
