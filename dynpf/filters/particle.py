"""The particle filter: propose, weigh, doubt, refine, estimate, resample, spread, renew.

It is composed of a motion model, a measurement model for each type of reading, a proposal, a resampling scheme, and, if
wanted, a rule for the number of particles, a recovery from being lost, and a kernel that keeps survivors apart. It has
no state: clouds go in and come out.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

import msgspec
import numpy as np

from dynpf.filters.adaptation import Doubt, Following, Rescuer, Sizing
from dynpf.filters.cloud import Cloud, gathered, uniform_cloud, weighted_cloud
from dynpf.filters.estimate import PoseEstimate, pose_estimate
from dynpf.filters.models import Models, Outcome
from dynpf.filters.proposal import Prior, Proposal, Proposed
from dynpf.filters.refinement import Refinement
from dynpf.filters.regularization import Regularization
from dynpf.filters.resampling import Indices, Resampling, Systematic
from dynpf.measurement.model import MeasurementModel
from dynpf.motion.model import MotionModel, Twist
from dynpf.params import validated
from dynpf.rng import Stream
from dynpf.types import Floats

__all__ = ["ParticleFilter", "Report", "Survivors", "Weighed"]

if TYPE_CHECKING:  # a filter that is not asked for another estimate makes this one; typing knows defaults from 3.13 on
    from typing_extensions import TypeVar as TypeVarWithDefault

    EstimateT = TypeVarWithDefault("EstimateT", default=PoseEstimate)
else:
    EstimateT = TypeVar("EstimateT")
PartT = TypeVar("PartT")


class Weighed(NamedTuple):
    """The proposed particles under their new weights, and what the readings came to."""

    cloud: Cloud
    outcomes: list[Outcome]  # one for each reading, in their order
    log_evidence: float  # log p(readings | all before them); 0 without readings, -inf where no particle explains them
    informed: bool  # whether any reading could be believed
    readings: int  # that the log-evidence speaks of, each of a batch by itself


class Survivors(NamedTuple):
    """The particles (D, M) that resampling has left, at equal weights."""

    particles: Floats
    chosen: Indices  # (M,): whose copies they are
    missing: int  # particles that are to be drawn from elsewhere


class Report(NamedTuple, Generic[EstimateT]):
    """What one update found: the estimate under the new weights, before resampling."""

    estimate: EstimateT
    n_eff: float
    outcomes: list[Outcome]  # one for each reading, in their order
    log_evidence: float  # log p(readings | all before them); 0 without readings, -inf where no particle explains them
    survivors: Indices | None  # whose copies the particles are; None: as they were
    renewed: int  # particles drawn from elsewhere, the last ones
    readings: int = 0  # that the log-evidence speaks of, each of a batch by itself
    doubt: Doubt | None = None  # that a rescue had of the particles, before they were resampled


class ParticleFilter(Generic[EstimateT]):
    """Sequential importance resampling with any proposal (Arulampalam et al., 2002, algorithm 3).

    ``update`` is the algorithm; each of its steps is a method.
    """

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
        refinement: Refinement | None = None,
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
        self.refinement = refinement
        self.estimate = estimate

    def start(self, poses: Floats, stream: Stream) -> Cloud:
        """Return a cloud of equal weights at the given poses (3, N); raises ValueError when there are none."""
        memory = () if self.rescue is None else self.rescue.begin()
        return uniform_cloud(self.models.motion.particles(poses, stream), memory)

    def predict(self, cloud: Cloud, control: Any, stream: Stream) -> Cloud:
        """Return the cloud after a control, without readings."""
        particles = self.models.propagate(cloud.particles, control, stream.part("motion"))
        memory = self.carried(cloud.memory, control)
        return cloud._replace(particles=particles, moved=cloud.moved or moves(control), memory=memory)

    def update(
        self, cloud: Cloud, control: Any, readings: Sequence[Any], stream: Stream
    ) -> tuple[Cloud, Report[EstimateT]]:
        """Return the cloud after a control (None: none) and the readings at its end, and what was found.

        The readings are fused: each is compared with the same proposed particles. Raises TypeError for a reading
        that no measurement model takes.
        """
        proposed = self.propose(cloud, control, readings, stream)
        weighed = self.weigh(proposed, cloud, control)
        after, outcomes, log_evidence, informed, count = weighed
        n_eff = after.n_eff
        ancestors, missing, doubt = proposed.ancestors, 0, None
        if self.rescue is not None and informed:
            judged = weighed
            if isinstance(self.rescue, Following):
                judged = weighed._replace(cloud=self.unheard(after, cloud)._replace(n_eff=n_eff))
            doubt = self.doubt(self.rescue, judged, readings)
            after = after._replace(memory=doubt.memory)
            if doubt.unheard > 0:
                after, informed = self.unheard(after, cloud), False
        if self.refinement is not None and informed and (doubt is None or not doubt.share > 0.0):
            after = after._replace(particles=self.refine(self.refinement, after, readings, stream))
        estimate = self.estimate(after.particles, after.weights)
        if informed and self.due(after, doubt):
            particles, chosen, missing = self.resample(after, doubt, stream)
            if self.regularization is not None:
                particles = self.spread(self.regularization, particles, after, stream)
            if doubt is not None and missing > 0:
                particles = self.renew(doubt, particles, missing, readings, stream)
            after = uniform_cloud(particles, after.memory)
            if doubt is not None and doubt.settled:
                if self.refinement is not None:
                    after = after._replace(particles=self.refine(self.refinement, after, readings, stream))
                estimate = self.estimate(after.particles, after.weights)
            ancestors = chosen if ancestors is None else ancestors[chosen]
        return after, Report(estimate, n_eff, outcomes, log_evidence, ancestors, missing, count, doubt)

    def propose(self, cloud: Cloud, control: Any, readings: Sequence[Any], stream: Stream) -> Proposed:
        """Draw x_k ~ q(x_k | x_k-1, z_k) for each particle (Arulampalam et al., 2002, algorithm 1)."""
        return self.proposal.propose(self.models, cloud, control, readings, stream)

    def weigh(self, proposed: Proposed, cloud: Cloud, control: Any) -> Weighed:
        """Weigh by w_k ~ w_k-1 p(z_k | x_k) p(x_k | x_k-1) / q(x_k | x_k-1, z_k) (Arulampalam et al., 2002, eq. 48).

        ``cloud``: that the proposed particles come from. Where no particle explains the readings its weights stay and
        the log-evidence is -inf; without a reading that can be believed it is 0.
        """
        particles, outcomes, log_evidence = proposed.particles, proposed.outcomes, 0.0
        belief = cloud
        if proposed.log_weights is not None:
            weighted, log_evidence = weighted_cloud(particles, proposed.log_weights)
            if log_evidence == -np.inf:
                outcomes = [Outcome.IMPOSSIBLE if outcome is Outcome.USED else outcome for outcome in outcomes]
            else:
                belief = weighted
        moved = cloud.moved or moves(control)
        memory = self.carried(cloud.memory, control)
        belief = Cloud(particles, belief.weights, belief.log_weights, belief.n_eff, moved, memory)
        return Weighed(belief, outcomes, log_evidence, proposed.log_weights is not None, proposed.readings)

    def carried(self, memory: tuple[float, ...], control: Any) -> tuple[float, ...]:
        """Return the rescue's memory after a control: one that follows other places moves them."""
        if control is None or not isinstance(self.rescue, Following):
            return memory
        return self.rescue.carried(memory, self.models, control)

    def doubt(self, rescue: Rescuer, weighed: Weighed, readings: Sequence[Any]) -> Doubt:
        """Ask the rescue how far the particles can be trusted (Thrun et al., 2005, table 8.3)."""
        return rescue.doubt(weighed.cloud, weighed.log_evidence, weighed.readings, readings)

    def unheard(self, weighed: Cloud, cloud: Cloud) -> Cloud:
        """Return the proposed particles under the weights before the readings, which are not believed."""
        return weighed._replace(weights=cloud.weights, log_weights=cloud.log_weights, n_eff=cloud.n_eff)

    def refine(self, refinement: Refinement, cloud: Cloud, readings: Sequence[Any], stream: Stream) -> Floats:
        """Move the particles to where the readings say more exactly that they are."""
        return refinement.refine(cloud, readings, stream.part("refinement"))

    def due(self, cloud: Cloud, doubt: Doubt | None) -> bool:
        """Return whether to resample: N_eff is low (Arulampalam et al., 2002, eq. 51), or particles are doubted."""
        return (doubt is not None and doubt.share > 0.0) or self.resampling.due(cloud)

    def resample(self, cloud: Cloud, doubt: Doubt | None, stream: Stream) -> Survivors:
        """Choose survivors so that each has N w copies in the mean (Arulampalam et al., 2002, algorithm 2).

        As many are missing as the doubted share of the particles that there are to be.
        """
        count, missing = cloud.weights.size, 0
        if self.sizing is not None:
            count = self.size(self.sizing, cloud, doubt)
        if doubt is not None and doubt.share > 0.0:
            missing = min(int(doubt.share * count + stream.part("share").uniform()), count)
        chosen = self.resampling.select(cloud.weights, count - missing, stream.part("resampling"))
        return Survivors(gathered(cloud.particles, chosen), chosen, missing)

    def size(self, sizing: Sizing, cloud: Cloud, doubt: Doubt | None) -> int:
        """Return the number of particles that the sizing calls for (Fox, 2003), here and where the robot is sought."""
        count = sizing.size(cloud.particles, cloud.weights)
        if doubt is None or doubt.places is None or not doubt.share > 0.0:
            return count
        return max(count, sizing.size(doubt.places.poses, doubt.places.weights))

    def spread(self, kernel: Regularization, particles: Floats, cloud: Cloud, stream: Stream) -> Floats:
        """Set copies apart by draws from a kernel about each (Arulampalam et al., 2002, algorithm 6)."""
        return kernel.spread(particles, cloud, stream.part("regularization"))

    def renew(self, doubt: Doubt, particles: Floats, missing: int, readings: Sequence[Any], stream: Stream) -> Floats:
        """Append the missing particles, drawn where the rescue looks for the robot (Thrun et al., 2005, table 8.3)."""
        poses = doubt.source.draw(missing, readings, stream.part("anew"))
        fresh = self.models.motion.particles(poses, stream.part("fresh"))
        return np.concatenate([particles, fresh], axis=1)


def moves(control: Any) -> bool:
    """Return whether a control moves the robot: any of its numbers but a duration differs from zero."""
    if control is None:
        return False
    if isinstance(control, Twist):
        return control.v != 0.0 or control.w != 0.0
    return any(control) if isinstance(control, tuple) else bool(np.any(control))


def _checked(part: PartT) -> PartT:
    return validated(part) if isinstance(part, msgspec.Struct) else part
