"""numba kernels for two cores and more, float32. Each has a plain torch twin in ``kernels.reference``."""
