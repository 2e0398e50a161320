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
        predict: spacing of the grid that leads starts to their roots before the perceptron is asked, metres (see
            ``deform.predict``); 0 follows every start through the perceptron alone.
    """

    starts: int = 5
    steps: int = 20
    tolerance: float = 1e-5
    divergence: float = 2.0
    background: bool = True
    predict: float = 0.0


@dataclass(frozen=True)
class ExactSettings:
    """The paper's path: nothing cached, nothing skipped.

    Attributes:
        samples: points a ray.
        covariance: ``warped`` carries the cone's covariance through the inverse Jacobian; ``plain`` passes it
            unrotated, as TAVA does (kept to be measured).
        offset: whether the pose-conditioned offset F_Δ is applied.
        shading: whether the pose-dependent ambient occlusion is applied.
        bounded: whether samples out of reach of every bone and object are empty, as what bounds the rays has it.
    """

    samples: int = 64
    inverse: InverseSettings = InverseSettings()
    covariance: str = "warped"
    offset: bool = True
    shading: bool = True
    bounded: bool = False


PREDICTED = 0.05
"""Spacing of the grid that leads starts wherever speed counts, metres."""


@dataclass(frozen=True)
class RenderSettings:
    """One point on the curve between speed and accuracy.

    Attributes:
        preset: the name it goes by.
        step: distance between samples, metres (models on grids).
        newton_steps: Newton steps at most in the voxel volume.
        stop: transmittance behind which nothing is evaluated; 0 evaluates everything.
        starts: kept a posed cell, 1 or 2: where two body parts meet, the second is the other one's.
        supersampling: rays a pixel along each axis.
        occupancy: whether empty cells of the occupancy grids are skipped.
        offset, shading: whether F_Δ and the ambient occlusion are applied.
        resolution: share of the image's width and height that is rendered; the rest is interpolated.
        exact: settings of models that follow the paper's path.
    """

    preset: str
    step: float
    newton_steps: int
    stop: float
    starts: int = 2
    supersampling: int = 1
    occupancy: bool = True
    offset: bool = True
    shading: bool = True
    resolution: float = 1.0
    exact: ExactSettings = ExactSettings(bounded=True, inverse=InverseSettings(predict=PREDICTED))


RENDER_PRESETS = {
    "draft": RenderSettings(
        "draft", step=0.016, newton_steps=2, stop=0.05, starts=1, offset=False, resolution=0.5,
        exact=ExactSettings(24, InverseSettings(1, 8, tolerance=1e-4, predict=PREDICTED), bounded=True),
    ),
    "preview": RenderSettings(
        "preview", step=0.012, newton_steps=3, stop=0.02,
        exact=ExactSettings(32, InverseSettings(2, 12, tolerance=1e-4, predict=PREDICTED), bounded=True),
    ),
    "final": RenderSettings("final", step=0.008, newton_steps=4, stop=0.003, supersampling=2),
    "exact": RenderSettings(
        "exact", step=0.004, newton_steps=20, stop=0.0, supersampling=3, occupancy=False,
        exact=ExactSettings(bounded=True),
    ),
}  # fmt: skip
"""Presets by name, in order of quality."""
