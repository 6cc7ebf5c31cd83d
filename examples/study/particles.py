"""A study of one's own: how many particles a round among landmarks calls for: dynpf study particles.py"""

from dynpf_lab import sweep

SURE_M = 0.1


def sure(run):
    """Whether the filter knows at the end where the robot is: its standard deviation along x and y."""
    last = run.topic("estimator/state")[-1].message
    return max(last.covariance[0], last.covariance[4]) < SURE_M**2


STUDY = sweep(
    about="How many particles a round among landmarks calls for",
    scenario="landmark-room",
    grid={"estimator.n": (20, 50, 100, 500), "estimator.proposal": ("prior", "local_linearization")},
    measures={"rmse_m": "position_rmse_m", "lost": "lost_fraction", "sure": sure},
    trials=10,
)
