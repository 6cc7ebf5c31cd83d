"""The kernels' twins in plain NumPy, as a textbook has them: what the tests hold ``dynpf.kernels`` to."""
