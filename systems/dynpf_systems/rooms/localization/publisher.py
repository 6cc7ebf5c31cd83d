"""The estimator's output: the estimate at each step, and pictures of it at intervals."""

from collections.abc import Callable, Sequence

from dynpf_protocol import frames
from dynpf_protocol.landmarks import Landmark
from dynpf_protocol.messages import (
    Estimate,
    FilterHealth,
    PoseInFrame,
    planar_pose,
    timestamp,
)
from dynpf_runtime.every import Every
from dynpf_runtime.node import Output, State
from dynpf_services.estimates import particles_picture, robot_transform

from dynpf.types import FloatArray, Floats
from dynpf_systems.rooms.localization.localizers import Found
from dynpf_systems.rooms.localization.picture import draw_landmarks, draw_scene

__all__ = ["Publisher"]

SHOWN_PARTICLES = 200
SHOWN = Every(0.2)
SCENE = Every(1.0)


class Publisher:
    """Makes messages from estimates; keeps when particles and scene were last published."""

    def __init__(self, landmarks: Sequence[Landmark]) -> None:
        self._landmarks = draw_landmarks(landmarks)
        self._shown_ns: int | None = None
        self._scene_ns: int | None = None

    def messages(
        self,
        found: Found,
        health: FilterHealth,
        reckoned: FloatArray | None,
        particles: Callable[[int], Floats],
        stamp_ns: int,
    ) -> list[Output]:
        """Return the messages of a stamp; ``particles(most)`` returns poses (3, M), M <= most."""
        x, y, theta = found.estimate.mean.tolist()
        when = timestamp(stamp_ns)
        outputs = [
            Output(
                "estimator/state",
                Estimate(
                    x=x,
                    y=y,
                    theta=theta,
                    covariance=tuple(found.estimate.covariance.ravel().tolist()),
                    n_eff=found.n_eff,
                    health=health,
                ),
            ),
            Output("estimator/pose", PoseInFrame(timestamp=when, frame_id=frames.MAP, pose=planar_pose(x, y, theta))),
        ]
        if reckoned is not None:
            pose = PoseInFrame(timestamp=when, frame_id=frames.MAP, pose=planar_pose(*reckoned.tolist()))
            outputs.append(Output("estimator/dead_reckoning", pose))
        if SHOWN.due(stamp_ns, self._shown_ns):
            self._shown_ns = stamp_ns
            outputs.append(Output("estimator/particles", particles_picture(particles(SHOWN_PARTICLES), when)))
            outputs.append(Output("estimator/transforms", robot_transform(x, y, theta, when)))
        if SCENE.due(stamp_ns, self._scene_ns):
            self._scene_ns = stamp_ns
            scene = draw_scene(x, y, theta, self._landmarks, when, status=health.status)
            outputs.append(Output("estimator/scene", scene))
        return outputs

    def freeze(self) -> State:
        """Return when particles and scene were last published."""
        return {"shown_ns": self._shown_ns, "scene_ns": self._scene_ns}

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""
        self._shown_ns, self._scene_ns = state["shown_ns"], state["scene_ns"]
