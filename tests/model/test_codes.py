"""Identity codes and compositional invariant learning."""

from __future__ import annotations

import pytest
import torch

from chona_model.field.codes import IdentityCodes, draw_invariant_codes, step_generator

RAYS = 600
PERSONS = torch.arange(RAYS) % 4
OBJECTS = (torch.arange(RAYS) % 3)[:, None].repeat(1, 2)
ON_PERSON = torch.arange(RAYS) < 200
ON_OBJECT = torch.arange(RAYS) >= 400
COUNTS = {"n_persons": 4, "n_objects": 3}


def test_only_the_other_code_is_drawn() -> None:
    persons, objects = draw_invariant_codes(PERSONS, OBJECTS, ON_PERSON, ON_OBJECT, **COUNTS, seed=1, step=7)
    assert torch.equal(persons[:400], PERSONS[:400]) and torch.equal(objects[200:], OBJECTS[200:])
    assert not torch.equal(persons[400:], PERSONS[400:]) and not torch.equal(objects[:200], OBJECTS[:200])
    assert set(persons[400:].tolist()) == {0, 1, 2, 3} and set(objects[:200].flatten().tolist()) == {0, 1, 2}
    # Every identity is equally likely: 200 draws of 4 leave each its 50 ± 5 standard deviations.
    assert ((torch.bincount(persons[400:]) - 50).abs() < 31).all()


def test_a_ray_of_the_background_is_exchanged_as_one_or_the_other() -> None:
    both = PERSONS, OBJECTS, ON_PERSON, ON_OBJECT
    persons, objects = draw_invariant_codes(*both, **COUNTS, seed=1, step=7, background=True)
    kept = draw_invariant_codes(*both, **COUNTS, seed=1, step=7)
    assert torch.equal(persons[400:], kept[0][400:]) and torch.equal(objects[:200], kept[1][:200])
    moved = (persons != PERSONS)[200:400], (objects != OBJECTS).any(dim=1)[200:400]
    assert not (moved[0] & moved[1]).any()
    # Half of 200 rays each; a draw of 4 persons, or of two out of 3 objects, changes 3 of 4 and 8 of 9.
    assert 50 < moved[0].sum() < 100 and 65 < moved[1].sum() < 115


def test_the_draw_depends_on_seed_and_step_alone() -> None:
    def draw(seed: int, step: int, mask: torch.Tensor = ON_OBJECT) -> torch.Tensor:
        return draw_invariant_codes(PERSONS, OBJECTS, ON_PERSON, mask, **COUNTS, seed=seed, step=step)[0]

    torch.manual_seed(5)
    first = draw(1, 7)
    torch.manual_seed(6)
    assert torch.equal(first, draw(1, 7))
    assert not torch.equal(first, draw(1, 8)) and not torch.equal(first, draw(2, 7))
    fewer = torch.arange(RAYS) >= 500
    assert torch.equal(first[500:], draw(1, 7, fewer)[500:])


def test_neighbouring_seeds_and_steps_differ() -> None:
    states = {step_generator(seed, step).initial_seed() for seed in range(20) for step in range(20)}
    assert len(states) == 400


def test_a_single_identity_stays() -> None:
    zeros = torch.zeros(RAYS, dtype=torch.int64)
    persons, objects = draw_invariant_codes(
        zeros, zeros[:, None], ON_PERSON, ON_OBJECT, n_persons=1, n_objects=1, seed=0, step=0
    )
    assert torch.equal(persons, zeros) and torch.equal(objects[:, 0], zeros)


def test_absent_identities_are_drawn_or_stay_absent() -> None:
    absent = torch.full((RAYS, 1), -1)
    _, objects = draw_invariant_codes(PERSONS, absent, ON_PERSON, ON_OBJECT, **COUNTS, seed=0, step=0)
    assert set(objects[:200, 0].tolist()) == {-1, 0, 1, 2} and (objects[200:] == -1).all()
    persons, objects = draw_invariant_codes(
        PERSONS, absent, ON_PERSON, ON_OBJECT, n_persons=0, n_objects=0, seed=0, step=0
    )
    assert torch.equal(persons, PERSONS) and torch.equal(objects, absent)


def test_inputs_are_not_changed_and_overlapping_masks_are_refused() -> None:
    before = PERSONS.clone()
    draw_invariant_codes(PERSONS, OBJECTS, ON_PERSON, ON_OBJECT, **COUNTS, seed=0, step=0)
    assert torch.equal(before, PERSONS)
    with pytest.raises(ValueError, match="200 rays lie on the person's and the object's mask"):
        draw_invariant_codes(PERSONS, OBJECTS, ON_PERSON, ON_PERSON, **COUNTS, seed=0, step=0)


def test_codes_are_looked_up_and_absent_ones_are_zero() -> None:
    codes = IdentityCodes(2, 3, 5)
    condition = codes(torch.tensor([1, -1]), torch.tensor([[2, -1], [0, 1]]))
    assert condition.shape == (2, 15)
    torch.testing.assert_close(condition[0], torch.cat([codes.persons[1], codes.objects[2], torch.zeros(5)]))
    torch.testing.assert_close(condition[1], torch.cat([torch.zeros(5), codes.objects[0], codes.objects[1]]))
    condition.sum().backward()
    assert codes.objects.grad is not None and codes.objects.grad.abs().sum(dim=1).tolist() == [5.0, 5.0, 5.0]
    assert IdentityCodes(0, 0, 5)(torch.tensor([-1]), torch.tensor([[-1]])).tolist() == [[0.0] * 10]
    with pytest.raises(IndexError, match="the model knows 2 person identities"):
        codes(torch.tensor([2]), torch.tensor([[0, 0]]))
