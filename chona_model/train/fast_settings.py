"""Settings of preset ``fast``."""

from __future__ import annotations

from dataclasses import dataclass

from chona_model.render.tracing import TraceSettings


@dataclass(frozen=True)
class FastSettings:
    """Settings of preset ``fast``.

    Attributes:
        rays, poses: rays a step, spread over this many poses.
        grid_rate, mlp_rate, light_rate, skin_rate, offset_rate: Adam's initial rates; all fall to ``last_rate`` times
            that.
        weight_loss, offset_loss: the paper's λ and β.
        skin_from: share of the schedule before which skinning keeps its initial weights; skin_every: steps between
            gradients through the root finder.
        refine_given_weights: whether weights that came from a body model are learned further; those guessed from bones
            always are.
        part_loss: weight of the share of a ray that lands on the person where the masks say object, and the reverse.
            What is always held would otherwise be learned as a part of the hand.
        random_background: composite prediction and target over one random colour a ray, so that dark clothes are
            told from an empty background; black otherwise, as in the paper.
        cull_from, cull_until, cull_every: steps between which occupancy follows the density, and how often.  It must
            end: every refresh cuts a little off the soft outside of surfaces, learned anew inside the cut.
        rebuild: steps after which posed grids and pixel pools are made anew.
        trace: shortcuts of ray tracing at first; fine_trace: those from the share ``fine_from`` of the schedule on.
    """

    rays: int = 2048
    poses: int = 4
    grid_rate: float = 3e-2
    mlp_rate: float = 3e-3
    light_rate: float = 1e-2
    skin_rate: float = 2e-4
    offset_rate: float = 1e-5
    last_rate: float = 0.03
    weight_loss: float = 1.0
    offset_loss: float = 0.1
    skin_from: float = 0.25
    skin_every: int = 4
    refine_given_weights: bool = True
    part_loss: float = 0.3
    random_background: bool = True
    cull_from: int = 128
    cull_until: int = 1024
    cull_every: int = 64
    rebuild: tuple[int, ...] = (256, 512, 1024)
    trace: TraceSettings = TraceSettings(step=0.015, stop=3e-2)
    fine_trace: TraceSettings = TraceSettings(step=0.01, stop=1e-2)
    fine_from: float = 0.5
