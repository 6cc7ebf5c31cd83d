"""The particle filter: propose, weigh, estimate, resample.

It is composed of a motion model, a measurement model for each type of reading, a proposal, a resampling scheme, and, if
wanted, a rule for the number of particles, a recovery from being lost, and a kernel that keeps survivors apart. It has
no state: clouds go in and come out.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

import msgspec
import numpy as np

from dynpf.filters.adaptation import Doubt, Rescuer, Sizing
from dynpf.filters.cloud import Cloud, gathered, uniform_cloud, weighted_cloud
from dynpf.filters.estimate import PoseEstimate, pose_estimate
from dynpf.filters.models import Models, Outcome
from dynpf.filters.proposal import Prior, Proposal, Proposed
from dynpf.filters.regularization import Regularization
from dynpf.filters.resampling import Indices, Resampling, Systematic
from dynpf.measurement.model import MeasurementModel
from dynpf.motion.model import MotionModel, Twist
from dynpf.params import validated
from dynpf.rng import Stream
from dynpf.se2 import Floats

__all__ = ["ParticleFilter", "Report"]

if TYPE_CHECKING:  # a filter that is not asked for another estimate makes this one; typing knows defaults from 3.13 on
    from typing_extensions import TypeVar as TypeVarWithDefault

    EstimateT = TypeVarWithDefault("EstimateT", default=PoseEstimate)
else:
    EstimateT = TypeVar("EstimateT")
PartT = TypeVar("PartT")


class Report(NamedTuple, Generic[EstimateT]):
    """What one update found: the estimate under the new weights, before resampling."""

    estimate: EstimateT
    n_eff: float
    outcomes: list[Outcome]  # one a reading, in their order
    log_evidence: float  # log p(readings | all before them); 0 without readings, -inf where no particle explains them
    survivors: Indices | None  # whose copies the particles are; None: as they were
    drawn_anew: int  # of the particles, the last ones
    readings: int = 0  # that the log-evidence speaks of, each of a batch by itself
    doubt: Doubt | None = None  # that a rescue had of the particles, before they were resampled


class ParticleFilter(Generic[EstimateT]):
    """Sequential importance resampling with any proposal (Arulampalam et al., 2002; Thrun et al., 2005, ch. 4)."""

    def __init__(
        self,
        motion: MotionModel[Any],
        measurements: Mapping[type, MeasurementModel[Any]],
        *,
        proposal: Proposal | None = None,
        resampling: Resampling | None = None,
        sizing: Sizing | None = None,
        rescue: Rescuer | None = None,
        regularization: Regularization | None = None,
        estimate: Callable[[Floats, Floats], EstimateT] = pose_estimate,  # type: ignore[assignment]
        threads: int = 1,
    ) -> None:
        """Take the parts; ``estimate`` makes of particles and weights what reports hold.

        The results are the same for any number of threads.
        """
        self.models = Models(motion, measurements, threads)
        self.proposal = Prior() if proposal is None else proposal
        self.resampling = _checked(Systematic() if resampling is None else resampling)
        self.sizing = sizing
        self.rescue = rescue
        self.regularization = _checked(regularization)
        self.estimate = estimate

    def start(self, poses: Floats, stream: Stream) -> Cloud:
        """Return a cloud of equal weights at the given poses (3, N); raises ValueError when there are none."""
        memory = () if self.rescue is None else self.rescue.begin()
        return uniform_cloud(self.models.motion.particles(poses, stream), memory)

    def predict(self, cloud: Cloud, control: Any, stream: Stream) -> Cloud:
        """Return the cloud after a control, without readings."""
        particles = self.models.propagate(cloud.particles, control, stream.part("motion"))
        return cloud._replace(particles=particles, moved=cloud.moved or moves(control))

    def update(
        self, cloud: Cloud, control: Any, readings: Sequence[Any], stream: Stream
    ) -> tuple[Cloud, Report[EstimateT]]:
        """Return the cloud after a control (None: none) and the readings at its end, and what was found.

        The readings are fused: each is compared with the same proposed particles. Raises TypeError for a reading
        that no measurement model takes.
        """
        weighted, proposed, log_evidence = self.weigh(cloud, control, readings, stream)
        estimate = self.estimate(weighted.particles, weighted.weights)
        resampled, survivors, anew, doubt = weighted, proposed.ancestors, 0, None
        if proposed.log_weights is not None:
            if self.rescue is not None:
                doubt = self.rescue.doubt(weighted, log_evidence, proposed.readings, readings)
                resampled = resampled._replace(memory=doubt.memory)
            if (doubt is not None and doubt.share > 0.0) or self.resampling.due(weighted):
                resampled, chosen, anew = self.resample(resampled, readings, stream, doubt)
                survivors = chosen if survivors is None else survivors[chosen]
        return resampled, Report(
            estimate, weighted.n_eff, proposed.outcomes, log_evidence, survivors, anew, proposed.readings, doubt
        )

    def weigh(
        self, cloud: Cloud, control: Any, readings: Sequence[Any], stream: Stream
    ) -> tuple[Cloud, Proposed, float]:
        """Return the proposed particles with their weights, what was proposed, and the log-evidence.

        Where no particle explains the readings the weights stay as they were and the log-evidence is -inf; without a
        reading that can be believed it is 0.
        """
        proposed = self.proposal.propose(self.models, cloud, control, readings, stream)
        moved = cloud.moved or moves(control)
        carried = Cloud(proposed.particles, cloud.weights, cloud.log_weights, cloud.n_eff, moved, cloud.memory)
        if proposed.log_weights is None:
            return carried, proposed, 0.0
        weighted, log_evidence = weighted_cloud(proposed.particles, proposed.log_weights)
        if log_evidence == -np.inf:
            impossible: list[Outcome] = [
                Outcome.IMPOSSIBLE if each is Outcome.USED else each for each in proposed.outcomes
            ]
            return carried, proposed._replace(outcomes=impossible), log_evidence
        particles, weights, log_weights, n_eff, *_ = weighted
        return Cloud(particles, weights, log_weights, n_eff, moved, cloud.memory), proposed, log_evidence

    def resample(
        self, cloud: Cloud, readings: Sequence[Any], stream: Stream, doubt: Doubt | None = None
    ) -> tuple[Cloud, Indices, int]:
        """Return survivors at equal weights, whose copies they are, and how many particles were drawn anew.

        The doubted share of the particles, those at the end, begin again where its source puts them.
        """
        count = cloud.weights.size if self.sizing is None else self.sizing.size(cloud.particles, cloud.weights)
        if self.sizing is not None and doubt is not None and doubt.places is not None and doubt.share > 0.0:
            count = max(count, self.sizing.size(doubt.places.poses, doubt.places.weights))
        anew = 0
        if doubt is not None and doubt.share > 0.0:
            anew = min(int(doubt.share * count + stream.part("share").uniform()), count)
        chosen = self.resampling.select(cloud.weights, count - anew, stream.part("resampling"))
        particles = gathered(cloud.particles, chosen)
        if self.regularization is not None:
            particles = self.regularization.spread(particles, cloud, stream.part("regularization"))
        if doubt is not None and anew > 0:
            poses = doubt.source.draw(anew, readings, stream.part("anew"))
            fresh = self.models.motion.particles(poses, stream.part("fresh"))
            particles = np.concatenate([particles, fresh], axis=1)
        return uniform_cloud(particles, cloud.memory), chosen, anew


def moves(control: Any) -> bool:
    """Return whether a control moves the robot: any of its numbers but a duration differs from zero."""
    if control is None:
        return False
    if isinstance(control, Twist):
        return control.v != 0.0 or control.w != 0.0
    return any(control) if isinstance(control, tuple) else bool(np.any(control))


def _checked(part: PartT) -> PartT:
    return validated(part) if isinstance(part, msgspec.Struct) else part
