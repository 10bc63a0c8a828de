"""Which effects stay in question once the second half has been looked at."""

from types import SimpleNamespace

import numpy as np
import pytest

from capsbayes.diagnosis.verification import _in_question

STEADY = np.array([0.9, 1.1] * 10)  # ratios of capsules that hardly scatter


def tried(ratio, *, leaves_nothing=True, clearly=True, holds=None):
    """Verification of an effect that leaves nothing, or something: clearly or by a hair."""
    return SimpleNamespace(
        log_likelihood_ratios=ratio * STEADY,
        leaves_nothing=leaves_nothing,
        clearly_leaves_something=clearly and not leaves_nothing,
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
        # one that leaves something by a hair is not refuted, next to one that leaves nothing; alone it explains nothing
        (
            {"halo": 1.0, "bending": 0.95},
            {"halo": tried(1.0, leaves_nothing=False, clearly=False), "bending": tried(0.95)},
            ("bending", "halo"),
        ),
        ({"halo": 1.0}, {"halo": tried(1.0, leaves_nothing=False, clearly=False)}, ()),
        # a little behind one that leaves something over, which may be by chance: both
        (
            {"halo": 1.1, "bending": 0.9},
            {"halo": scattered(1.1, leaves_nothing=False), "bending": scattered(0.9, opposite=True)},
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
