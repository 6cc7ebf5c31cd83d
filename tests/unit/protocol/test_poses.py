import numpy as np
from dynpf_protocol.messages import heading, planar_pose


def test_a_pose_in_the_plane_has_its_heading():
    for x, y, theta in np.random.default_rng(1).uniform(-3.0, 3.0, (50, 3)).tolist():
        pose = planar_pose(x, y, theta)
        assert (pose.position.x, pose.position.y, pose.position.z) == (x, y, 0.0)
        np.testing.assert_allclose(heading(pose.orientation), theta, rtol=1e-12)
