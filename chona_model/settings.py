"""Every approximation as a named field. Presets are points in this space and nothing else.

Frozen dataclasses, checked when they are made and written into every output.
"""

from __future__ import annotations

from dataclasses import dataclass

PRESETS = ("draft", "preview", "final", "exact")
"""Rendering presets in order of quality."""

UPSAMPLINGS = ("bilinear", "guided")
PRECISIONS = ("float32", "float64")
FIELD_PRECISIONS = ("own", "bfloat16")
COVARIANCES = ("warped", "plain")
ROOTS = ("network", "grid")
BLURS = ("shot", "on", "off")
"""What can be asked of a blur: as the shot has it, that it must have it, none."""
MOST_BLUR_SAMPLES = 1024


class SettingsError(ValueError):
    """A setting outside its range: the message names the field, what was given and what was expected."""


def _between(name: str, value: float, low: float, high: float) -> None:
    if not (isinstance(value, int | float) and low <= value <= high):
        raise SettingsError(f"the setting '{name}' is {str(value)[:40]}, expected a number from {low:g} to {high:g}")


def _one_of(name: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise SettingsError(f"the setting '{name}' is '{value}', expected one of {', '.join(known)}")


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

    Raises:
        SettingsError: a value out of range.
    """

    starts: int = 5
    steps: int = 20
    tolerance: float = 1e-5
    divergence: float = 2.0
    background: bool = True
    predict: float = 0.0

    def __post_init__(self) -> None:
        _between("starts", self.starts, 1, 64)
        _between("steps", self.steps, 1, 1000)
        _between("tolerance", self.tolerance, 0.0, 1.0)
        _between("divergence", self.divergence, 0.0, 1e6)
        _between("predict", self.predict, 0.0, 1.0)


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
        roots: what decides where a root lies: ``network``, the skinning perceptron with its offset, or ``grid``, the
            perceptron's weights and the offset read off ``inverse.predict`` metres apart.
        field_precision: of the field's perceptrons: the model's ``own``, or ``bfloat16``.

    Raises:
        SettingsError: a value out of range, or roots in a grid without its spacing.
    """

    samples: int = 64
    inverse: InverseSettings = InverseSettings()
    covariance: str = "warped"
    offset: bool = True
    shading: bool = True
    bounded: bool = False
    roots: str = "network"
    field_precision: str = "own"

    def __post_init__(self) -> None:
        _between("samples", self.samples, 1, 4096)
        _one_of("covariance", self.covariance, COVARIANCES)
        _one_of("roots", self.roots, ROOTS)
        _one_of("field_precision", self.field_precision, FIELD_PRECISIONS)
        if self.roots == "grid" and self.inverse.predict == 0:
            raise SettingsError("the setting 'roots' is 'grid', which needs its spacing: set 'predict' above 0")


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
        tolerance: residual that ends Newton's method in the voxel volume, metres.
        supersampling: rays a pixel along each axis.
        occupancy: whether empty cells of the occupancy grids are skipped.
        occupancy_threshold: cells whose cached density is at most this are empty too, 1/m.
        occupancy_cell: cells of the occupancy that are taken together along each axis.
        offset, shading: whether F_Δ and the ambient occlusion are applied.
        resolution: share of the image's width and height that is rendered; the rest is interpolated.
        upsampling: ``bilinear`` interpolates everything; ``guided`` traces the pixels whose neighbours differ.
        precision: of all arithmetic on the model's side; ``float64`` is for comparisons.
        exact: settings of models that follow the paper's path.

    Raises:
        SettingsError: a value out of range.
    """

    preset: str
    step: float
    newton_steps: int
    stop: float
    starts: int = 2
    tolerance: float = 2e-4
    supersampling: int = 1
    occupancy: bool = True
    occupancy_threshold: float = 0.0
    occupancy_cell: int = 1
    offset: bool = True
    shading: bool = True
    resolution: float = 1.0
    upsampling: str = "bilinear"
    precision: str = "float32"
    exact: ExactSettings = ExactSettings(bounded=True, inverse=InverseSettings(predict=PREDICTED))

    def __post_init__(self) -> None:
        _between("step", self.step, 1e-4, 1.0)
        _between("newton_steps", self.newton_steps, 1, 1000)
        _between("stop", self.stop, 0.0, 0.5)
        _between("starts", self.starts, 1, 2)
        _between("tolerance", self.tolerance, 0.0, 0.01)
        _between("supersampling", self.supersampling, 1, 16)
        _between("occupancy_threshold", self.occupancy_threshold, 0.0, 1e4)
        _between("occupancy_cell", self.occupancy_cell, 1, 4)
        _between("resolution", self.resolution, 1 / 16, 1.0)
        _one_of("upsampling", self.upsampling, UPSAMPLINGS)
        _one_of("precision", self.precision, PRECISIONS)


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
        "exact", step=0.004, newton_steps=20, stop=0.0, tolerance=2e-5, supersampling=3, occupancy=False,
        exact=ExactSettings(bounded=True),
    ),
}  # fmt: skip
"""Presets by name, in order of quality."""
