"""Plain NumPy twins of dynpf.kernels, written as the textbooks have them: what the tests hold the kernels to."""
