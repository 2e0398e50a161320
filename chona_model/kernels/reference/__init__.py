"""Plain torch twins of the fast kernels: any float dtype, any device, gradients by autograd."""

from chona_model.kernels.reference.adam import adam_rows
from chona_model.kernels.reference.encode import encode
from chona_model.kernels.reference.integrate import integrate
from chona_model.kernels.reference.light import FAINT, gains, normals_at
from chona_model.kernels.reference.march import carve, march, mark_starts, prune, splat_spans
from chona_model.kernels.reference.skinning import blended_rotations, invert, warp

__all__ = [
    "FAINT", "adam_rows", "blended_rotations", "carve", "encode", "gains", "integrate", "invert", "march",
    "mark_starts", "normals_at", "prune", "splat_spans", "warp",
]  # fmt: skip
