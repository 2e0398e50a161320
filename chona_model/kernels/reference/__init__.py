"""Plain torch twins of the fast kernels: any float dtype, any device, gradients by autograd."""

from chona_model.kernels.reference.encode import encode
from chona_model.kernels.reference.integrate import integrate
from chona_model.kernels.reference.skinning import invert

__all__ = ["encode", "integrate", "invert"]
