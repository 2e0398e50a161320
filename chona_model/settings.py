"""Every approximation as a named field. Presets are points in this space and nothing else.

Frozen dataclasses, created once and written into every output.
"""

from __future__ import annotations

from dataclasses import dataclass

PRESETS = ("draft", "preview", "final", "exact")
"""Rendering presets in order of quality."""


@dataclass(frozen=True)
class InverseSettings:
    """Root finding for the canonical point (see ``deform.inverse``).

    Attributes:
        starts: K nearest bones in posed space that Newton starts from.
        steps: Newton steps at most.
        tolerance: residual at which a root counts as found, as a share of the figure's size.
        divergence: residual beyond which a start is given up, as a share of the figure's size.
        background: whether Newton also starts from the posed point itself, the background bone's inverse.
    """

    starts: int = 5
    steps: int = 20
    tolerance: float = 1e-5
    divergence: float = 2.0
    background: bool = True


@dataclass(frozen=True)
class ExactSettings:
    """The paper's path: nothing cached, nothing skipped.

    Attributes:
        samples: points a ray.
        covariance: ``warped`` carries the cone's covariance through the inverse Jacobian; ``plain`` passes it
            unrotated, as TAVA does (kept to be measured).
        offset: whether the pose-conditioned offset F_Δ is applied.
        shading: whether the pose-dependent ambient occlusion is applied.
    """

    samples: int = 64
    inverse: InverseSettings = InverseSettings()
    covariance: str = "warped"
    offset: bool = True
    shading: bool = True
