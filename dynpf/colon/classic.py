"""COLON's own filter: a blunt likelihood in the one map reported to it, and resampling at every step."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from dynpf.filters.cloud import Cloud
from dynpf.filters.estimate import pose_estimate
from dynpf.filters.particle import ParticleFilter
from dynpf.filters.resampling import Multinomial
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.measurement.range_vector import RangeVector, RangeVectorModel, RangeVectorParams
from dynpf.motion.capsule import CapsuleMotion, CapsuleStep, CapsuleStepParams
from dynpf.rng import Stream
from dynpf.types import FloatArray, Floats

__all__ = ["Classic", "ClassicFinding"]


class ClassicFinding(NamedTuple):
    """``pose`` (3,): the weighted mean. ``program_pose`` (3,): what COLON's program reports instead, the survivor whose
    number is that of the heaviest particle before resampling: as good as a random survivor.
    """

    pose: FloatArray
    program_pose: FloatArray


class _Estimate(NamedTuple):
    mean: FloatArray
    heaviest: int


class Classic:
    """Sequential importance resampling as COLON describes it (sections 4.3 and 4.4).

    Noise of 0.1 px and 0.1 rad a step, a Gaussian of 100 px over the five ranges, zero outside of the map, multinomial
    resampling at each step. Where no particle explains the ranges the weights stay as they are: COLON's program ended.
    """

    def __init__(self, maps: Mapping[str, OccupancyGrid]) -> None:
        """Take the maps that may be reported, by name."""
        self._filters = {
            name: ParticleFilter(
                CapsuleStep(CapsuleStepParams()),
                {RangeVector: RangeVectorModel(RangeVectorParams(), grid)},
                resampling=Multinomial(when="always"),
                estimate=_estimate,
            )
            for name, grid in maps.items()
        }

    def start(self, poses: Floats, stream: Stream) -> Cloud:
        """Return a cloud at poses (3, N)."""
        return next(iter(self._filters.values())).start(poses, stream)

    def update(
        self, cloud: Cloud, motion: CapsuleMotion | None, ranges: Floats, stream: Stream, reference: str
    ) -> tuple[Cloud, ClassicFinding]:
        """Return the cloud after a motion (None: none) and ranges (B,) in the reported map, and what was found."""
        readings = [RangeVector(np.asarray(ranges, dtype=np.float32))]
        resampled, report = self._filters[reference].update(cloud, motion, readings, stream)
        program = resampled.particles[:3, report.estimate.heaviest].astype(np.float64)
        return resampled, ClassicFinding(report.estimate.mean, program)


def _estimate(particles: Floats, weights: Floats) -> _Estimate:
    return _Estimate(pose_estimate(particles, weights).mean, int(weights.argmax()))
