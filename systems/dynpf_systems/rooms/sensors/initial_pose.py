"""The pose at which a filter is to begin anew, told by somebody who knows where the robot is."""

import numpy as np
from dynpf_protocol.messages import InitialPose
from dynpf_services.sensors.kind import SensorKind, passed

from dynpf.portable import eigh

__all__ = ["INITIAL_POSE"]


def _possible(told: InitialPose) -> bool:
    """Return whether the numbers are finite, and the covariance is one."""
    covariance = np.array(told.covariance).reshape(3, 3)
    if not (np.isfinite([told.x, told.y, told.theta]).all() and np.isfinite(covariance).all()):
        return False
    return bool((covariance == covariance.T).all() and eigh(covariance)[0].min() >= 0.0)


INITIAL_POSE = SensorKind(name="initial_pose", message=InitialPose, checked=passed(_possible))
