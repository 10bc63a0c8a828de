"""Which effects stay in question once the second half has been looked at."""

from dataclasses import fields
from types import SimpleNamespace

import numpy as np
import pytest

from capsbayes.diagnosis import Verification
from capsbayes.diagnosis.verification import _in_question

STEADY = np.array([0.9, 1.1] * 10)  # ratios of capsules that hardly scatter


def tried(ratio, *, leaves_nothing=True, holds=None):
    """Verification of an effect that leaves nothing, or something."""
    return SimpleNamespace(
        log_likelihood_ratios=ratio * STEADY,
        leaves_nothing=leaves_nothing,
        holds=leaves_nothing if holds is None else holds,
    )


def scattered(ratio, *, opposite=False, leaves_nothing=True):
    """The same, with ratios that scatter so much that a lead tells little."""
    apart = np.array([0.8, -0.8] * 10) * (-1.0 if opposite else 1.0)
    return SimpleNamespace(**vars(tried(0.0, leaves_nothing=leaves_nothing)) | {"log_likelihood_ratios": ratio + apart})


def scored(ratio):
    return SimpleNamespace(log_likelihood_ratios=ratio * STEADY, log_likelihood_ratio=float(np.sum(ratio * STEADY)))


@pytest.mark.parametrize(
    ("first", "second", "left"),
    [
        ({"halo": 1.0, "bending": 0.95}, {"halo": tried(1.0), "bending": tried(0.95)}, ("halo", "bending")),
        ({"halo": 1.0, "bending": 0.9}, {"halo": tried(0.2), "bending": tried(1.5)}, ("bending",)),
        (
            {"halo": 1.0, "bending": 0.9},
            {"halo": tried(1.0, leaves_nothing=False), "bending": tried(1.05)},
            ("bending",),
        ),
        # a little behind one that leaves something over, which may be by chance: both
        (
            {"halo": 1.1, "bending": 0.95},
            {"halo": scattered(1.1, leaves_nothing=False), "bending": scattered(0.95, opposite=True)},
            ("bending", "halo"),
        ),
        # far behind one that leaves something over: neither
        ({"halo": 3.0, "bending": 1.0}, {"halo": tried(3.0, leaves_nothing=False), "bending": tried(1.0)}, ()),
        # the one that is established on the second half is added
        (
            {"halo": 1.0, "bending": 0.95},
            {"halo": tried(1.0, holds=False), "bending": tried(0.95)},
            ("bending", "halo"),
        ),
    ],
)
def test_effects_in_question_are_alike_in_both_halves_and_leave_nothing_over(first, second, left):
    step = SimpleNamespace(scores={name: scored(ratio) for name, ratio in first.items()})
    assert _in_question(step, second) == left


def held_out(gained, of_something_else, ahead_before, established):
    """Verification by twenty capsules that gain so much together."""
    ratios = np.full(20, gained / 20)
    numbers = {"of_something_else": of_something_else, "ahead_before": ahead_before, "established": (established,)}
    nothing = dict.fromkeys(field.name for field in fields(Verification))
    return Verification(**nothing | {"log_likelihood_ratios": ratios} | numbers)


@pytest.mark.parametrize(
    ("gained", "of_something_else", "ahead_before", "established", "beats"),
    [
        (10.0, 8.0, -20.0, False, True),
        (10.0, 12.0, 20.0, False, True),  # hardly behind, and far ahead by the first half
        (10.0, 12.0, 1.0, False, False),  # hardly behind, and hardly ahead by both
        (10.0, 16.0, 100.0, False, False),  # refuted by these capsules
        (10.0, 16.0, -20.0, True, True),
    ],
)
def test_an_effect_must_not_lose_against_something_else(gained, of_something_else, ahead_before, established, beats):
    assert held_out(gained, of_something_else, ahead_before, established).beats_something_else == beats


@pytest.mark.parametrize(
    ("ahead", "before", "established", "in_question"),
    [(3.0, 4.0, False, True), (3.0, 6.0, False, False), (3.0, 4.0, True, False)],
)
def test_something_else_is_in_question_until_both_halves_rule_it_out(ahead, before, established, in_question):
    assert held_out(ahead, 0.0, before, established).something_else_in_question is in_question
