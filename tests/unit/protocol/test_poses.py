import numpy as np
from dynpf_protocol.messages import heading, planar_pose, planar_poses


def test_many_poses_have_the_bits_of_one_after_another_and_their_headings():
    poses = np.random.default_rng(1).uniform(-3.0, 3.0, (3, 50)).astype(np.float32)
    together = planar_poses(poses)
    assert together == tuple(planar_pose(x, y, theta) for x, y, theta in poses.T.tolist())
    np.testing.assert_allclose([heading(pose.orientation) for pose in together], poses[2], rtol=1e-12)
