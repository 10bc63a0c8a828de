import numpy as np
import pytest

from capsbayes.infer.prior import Marginal


def test_intervals_are_equal_tailed():
    draws = np.random.default_rng(1).exponential(size=400_000).reshape(100, -1)
    one = Marginal.of_draws(draws)
    assert one.median == pytest.approx(np.log(2.0), abs=0.01)
    assert one.lower_68 == pytest.approx(-np.log(0.84), abs=0.01)
    assert one.upper_68 == pytest.approx(-np.log(0.16), abs=0.02)
    assert one.lower_95 == pytest.approx(-np.log(0.975), abs=0.01)
    assert one.upper_95 == pytest.approx(-np.log(0.025), abs=0.05)
    assert one.mean == pytest.approx(1.0, abs=0.01)
    assert one.sd == pytest.approx(1.0, abs=0.01)


def test_an_interval_contains_what_lies_between_its_ends():
    one = Marginal(1.0, 1.0, 1.0, 0.0, 2.0, -1.0, 3.0)
    assert one.contains(0.0, level=68)
    assert not one.contains(2.5, level=68)
    assert one.contains(2.5, level=95)
    assert one.as_dict()["upper_95"] == 3.0


def test_a_known_number_has_no_spread():
    assert Marginal.known(2.0).as_dict() == {
        "mean": 2.0,
        "sd": 0.0,
        "median": 2.0,
        "lower_68": 2.0,
        "upper_68": 2.0,
        "lower_95": 2.0,
        "upper_95": 2.0,
    }
