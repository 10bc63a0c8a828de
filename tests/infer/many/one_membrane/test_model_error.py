"""The posterior averaged over what the model's error may be, compared with integrals, and the variance with draws."""

from dataclasses import replace

import numpy as np
import pytest
from linear_shapes import ALONG, Linear, linear_batch
from scipy import stats
from scipy.special import expit, softmax

from capsbayes.infer.conditional import Capsules
from capsbayes.infer.shared_membrane import FUNCTIONS, averaged, log_density_variance
from capsbayes.surrogate.membrane import OF_THE_MESH


@pytest.fixture
def batch():
    return linear_batch()


LOGS = np.array([0.0, -3.0, -1.0, -np.inf])
PLACES = np.array([[0.0], [1.0], [30.0], [0.5]])


def test_weights_of_an_exact_model_stay():
    found = averaged(LOGS, PLACES, np.zeros(4))
    np.testing.assert_allclose(softmax(found.log_weights), softmax(LOGS), atol=1e-12)
    np.testing.assert_allclose(found.log_evidence, np.log(np.mean(np.exp(LOGS))), rtol=1e-12)


def test_draws_of_one_membrane_have_one_error():
    found = averaged(LOGS, np.tile(PLACES[:1], (4, 1)), np.array([1.0, 9.0, 4.0, 2.0]))
    np.testing.assert_allclose(softmax(found.log_weights), softmax(LOGS), atol=1e-12)
    assert found.log_evidence.std() > 1.0


@pytest.mark.parametrize("away", [0.5, 1.0, 20.0])
def test_the_odds_of_two_membranes_are_averaged_over_the_difference_of_their_errors(away):
    """It is normal with the variance 2 V (1 - exp(-r^2 / 2))."""
    variance, log_odds = 16.0, 4.0
    places = np.array([[0.0, 0.0], [0.6 * away, 0.8 * away]])
    found = averaged(np.array([log_odds, 0.0]), places, np.full(2, variance))
    spread = np.sqrt(2.0 * variance * (1.0 - np.exp(-0.5 * away**2)))
    nodes = stats.norm.ppf((np.arange(2000) + 0.5) / 2000)
    wanted = np.mean(expit(log_odds + spread * nodes))
    assert softmax(found.log_weights)[0] == pytest.approx(wanted, abs=2.0 / np.sqrt(FUNCTIONS))
    assert wanted < expit(log_odds)


def test_the_variance_is_that_of_the_misfit_by_errors_that_no_shape_absorbs(batch):
    """Drawn errors of the numbers, less what the best Ca and a/l of each capsule make of them."""
    error, rng = 0.01, np.random.default_rng(3)
    capsules = Capsules(batch, Linear(error=error), 0.0)
    own = np.tile([np.log(0.05), 0.9], (1, len(batch), 1))
    found = log_density_variance(capsules, {"pre_inflation": np.array([0.05])}, own)
    squares = []
    for rows in batch.rows:
        wrong = rows @ (error * rng.standard_normal((3, 4000)))
        absorbed = rows @ ALONG
        squares.append(
            np.mean(np.sum((wrong - absorbed @ np.linalg.lstsq(absorbed, wrong, rcond=None)[0]) ** 2, axis=0))
        )
    assert OF_THE_MESH * found[0] == pytest.approx(np.sum(squares), rel=0.05)


def test_shapes_that_absorb_every_error_leave_no_variance(batch):
    """As where one length is measured of each capsule."""
    one = replace(batch, rows=batch.rows[:, :1], target=batch.target[:, :1], scale=batch.scale[:, :1])
    own = np.tile([np.log(0.05), 0.9], (1, len(batch), 1))
    found = log_density_variance(Capsules(one, Linear(error=0.1), 0.0), {"pre_inflation": np.array([0.05])}, own)
    assert found[0] == pytest.approx(0.0, abs=1e-6)
