"""One seam between the method and its fast kernels: numba on the CPU, plain torch everywhere else."""
