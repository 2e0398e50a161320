"""Bakes on a farm: the job type for Flamenco, the script for Slurm, and the job for Dask (docs/farm.md)."""
