"""A study of one's own: how many particles a round among landmarks calls for. Run it: python particles.py"""

from dynpf_experiments.drive import drive
from dynpf_services.scenario.load import load_scenario
from dynpf_systems.rooms.measures import localization

TOPICS = ("truth/robot", "estimator/state", "estimator/dead_reckoning")


def rmse_m(particles: int, seed: int, ticks: int) -> float:
    """Return the position's root mean square error of one run, m: the run is that of `dynpf run`, byte for byte."""
    settings = (f"estimator.n={particles}", f"max_ticks={ticks}")
    run = drive(load_scenario("landmark-room", overrides=settings, seed=seed), TOPICS)
    return float(localization(run)["position_rmse_m"])


def table(counts: tuple[int, ...] = (20, 50, 100, 500), trials: int = 10, ticks: int = 900) -> list[str]:
    """Return a line for each number of particles: mean and worst of the trials."""
    lines = ["particles  mean RMSE m  worst"]
    for particles in counts:
        errors = [rmse_m(particles, seed, ticks) for seed in range(1, trials + 1)]
        lines.append(f"{particles:9d}  {sum(errors) / len(errors):11.4f}  {max(errors):.4f}")
    return lines


if __name__ == "__main__":
    print("\n".join(table()))
