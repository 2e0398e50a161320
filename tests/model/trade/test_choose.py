"""The front, the choice under a budget or above a floor, and the search: on made-up measurements with known answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chona_model.actor import Picture
from chona_model.settings import RENDER_PRESETS, RenderSettings, SettingsError
from chona_model.trade.choose import choose, descend, front
from chona_model.trade.cost import Cost, fit_cost
from chona_model.trade.knobs import EXACT, GRID, Knob, knobs_of
from chona_model.trade.measure import Measured, differences

FINAL = RENDER_PRESETS["final"]


def measured(seconds: float, error: float, psnr: float = 30.0, settings: RenderSettings = FINAL) -> Measured:
    return Measured(
        settings, seconds, seconds, Cost(0.0, 1e-5), None, psnr, 0.9, None, error, 0.0, None, 0.0, 0.0, 1000.0, 3
    )


POINTS = st.lists(st.tuples(st.floats(0.01, 10.0), st.floats(0.0, 1.0)), min_size=1, max_size=30)


@given(POINTS)
def test_the_front_holds_exactly_what_nothing_beats(points: list[tuple[float, float]]) -> None:
    everything = [measured(*point) for point in points]
    kept = front(everything)
    times, errors = [m.full_seconds for m in kept], [m.error for m in kept]
    assert times == sorted(set(times)) and errors == sorted(set(errors), reverse=True)
    for each in everything:
        beaten = any(
            other.full_seconds <= each.full_seconds and other.error <= each.error
            and (other.full_seconds, other.error) != (each.full_seconds, each.error)
            for other in everything
        )  # fmt: skip
        shown = any((m.full_seconds, m.error) == (each.full_seconds, each.error) for m in kept)
        assert shown != beaten


def test_a_budget_buys_the_most_accurate_and_a_floor_the_fastest() -> None:
    rows = [measured(0.1, 0.06, 28.0), measured(0.5, 0.02, 31.0), measured(0.6, 0.03, 32.0), measured(4.0, 0.0, 31.9)]
    assert choose(rows, 0.55, None) is rows[1]
    assert choose(rows, 10.0, None) is rows[3]
    assert choose(rows, None, 30.0) is rows[1]
    assert choose(rows, 1.0, 31.5) is rows[2]
    with pytest.raises(SettingsError, match=r"no settings render a frame in 0.05 s: the fastest measured take 0.1 s"):
        choose(rows, 0.05, None)
    with pytest.raises(SettingsError, match=r"no settings reach 40 dB: the best measured have 32.00 dB \(0.6 s\)"):
        choose(rows, None, 40.0)
    with pytest.raises(SettingsError, match=r"no settings reach 31 dB within 0.2 s: the best measured have 28.00 dB"):
        choose(rows, 0.2, 31.0)


def test_the_search_takes_cheap_knobs_first_and_stops_when_asked() -> None:
    """Times multiply and squared errors add in this world, as the search supposes: its path must be the greedy one."""
    effects = {
        Knob("step", 0.016): (0.5, 0.02), Knob("supersampling", 1): (0.4, 0.03), Knob("stop", 0.02): (0.9, 0.001),
        Knob("shading", False): (0.95, 0.2), Knob("occupancy", False): (3.0, 0.0),
    }  # fmt: skip
    base = measured(1.0, 0.0)
    alone = [(knob, measured(share, error)) for knob, (share, error) in effects.items()]

    def world(settings: RenderSettings) -> Measured:
        used = [effects[knob] for knob in effects if knob.applied(FINAL) != FINAL and _has(settings, knob)]
        return measured(
            float(np.prod([share for share, _ in used])), float(np.sqrt(sum(error**2 for _, error in used))),
            settings=settings,
        )  # fmt: skip

    path = descend(base, alone, world)
    assert [round(m.full_seconds, 4) for m in path] == [0.9, 0.45, 0.18, 0.171]
    assert path[-1].settings.occupancy, "a knob that costs time was turned"
    assert [m.error for m in path] == sorted(m.error for m in path)
    assert descend(base, alone, lambda _: None) == []


def _has(settings: RenderSettings, knob: Knob) -> bool:
    return knob.applied(settings) == settings


@pytest.mark.parametrize(("fixed", "per_ray"), [(0.02, 1e-5), (0.0, 1e-4), (0.5, 0.0)])
def test_costs_are_found_again(fixed: float, per_ray: float) -> None:
    rays = [500.0, 4000.0, 60000.0, 1000.0]
    found = fit_cost(rays, [fixed + per_ray * each for each in rays])
    assert found.fixed == pytest.approx(fixed, abs=1e-9)
    assert found.per_ray == pytest.approx(per_ray, abs=1e-12)
    assert found.seconds(1e6) == pytest.approx(fixed + per_ray * 1e6)


def test_costs_are_never_negative() -> None:
    """Times that fall with the rays, as noise can have it: a constant fits best."""
    found = fit_cost([100.0, 200.0], [2.0, 1.0])
    assert found.per_ray == 0.0 and 1.0 <= found.fixed <= 2.0


@pytest.mark.parametrize(("kind", "table"), [("grid", GRID), ("exact", EXACT)])
def test_every_knob_changes_its_field_alone(kind: str, table: dict) -> None:
    full = knobs_of(kind, full=True)
    assert {knob.name for knob in full} == set(table)
    assert {knob.label for knob in knobs_of(kind, full=False)} <= {knob.label for knob in full}
    for knob in full:
        changed = knob.applied(FINAL)
        assert changed != FINAL
        undone = changed
        for name in knob.name.split("+"):
            first = name.split(".")[0]
            undone = replace(undone, **{first: getattr(FINAL, first)})
        assert undone == FINAL


def test_differences_of_known_pictures() -> None:
    def picture(rgb: float, alpha: float, depth: float) -> Picture:
        full = np.zeros((2, 2), np.float32)
        shown = full.copy()
        shown[0, 0] = alpha
        colour = np.zeros((2, 2, 3), np.float32)
        colour[0, 0] = rgb
        return Picture(colour, shown, np.full((2, 2), depth, np.float32), full, full, full, 1, 0.0)

    error, alpha, depth = differences(picture(0.5, 0.9, 2.0), picture(0.4, 1.0, 2.25))
    assert (error, alpha, depth) == (pytest.approx(0.1), pytest.approx(0.1), pytest.approx(0.25))
    assert differences(picture(0.5, 0.4, 2.0), picture(0.5, 1.0, 9.0))[2] is None, "depth of what is hardly there"
    assert differences(picture(0.0, 0.0, 1.0), picture(0.0, 0.0, 2.0)) == (0.0, 0.0, None)
