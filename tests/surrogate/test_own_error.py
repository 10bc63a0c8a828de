import numpy as np
import pytest

from capsbayes.surrogate.plane import OwnError, mesh_error_of

RNG = np.random.default_rng(5)
NODES = RNG.uniform(0, 10, (150, 2))
QUERIES = RNG.uniform(1, 9, (100, 2))
MIXING = np.array([[2.0, 0.0, 0.0], [1.0, 1.0, 0.0], [-0.5, 0.2, 0.1]])


def test_the_covariance_of_known_residuals_comes_back():
    residuals = RNG.normal(size=(150, 3)) @ MIXING.T
    mean = OwnError(NODES, residuals).covariance(QUERIES).mean(axis=0)
    np.testing.assert_allclose(mean, MIXING @ MIXING.T, atol=1.2)
    assert mean[0, 0] > mean[1, 1] > mean[2, 2]


def test_it_is_a_covariance_everywhere_even_next_to_a_residual_of_zero():
    residuals = RNG.normal(size=(150, 3))
    residuals[10] = 0.0
    covariance = OwnError(NODES, residuals).covariance(np.concatenate([QUERIES, NODES[10:11]]))
    np.testing.assert_allclose(covariance, np.swapaxes(covariance, 1, 2), atol=1e-14)
    assert np.linalg.eigvalsh(covariance).min() > 1e-4


def test_large_residuals_on_the_border_stay_on_the_border():
    on_border = NODES[:, 0] > 9
    covariance = OwnError(NODES, np.where(on_border[:, None], 1.0, 0.01) * np.ones(3)).covariance(
        np.array([[9.8, 5.0], [4.0, 5.0]])
    )
    assert covariance[0, 0, 0] > 0.5
    assert covariance[1, 0, 0] == pytest.approx(1e-4)


def test_a_case_that_could_not_be_predicted_counts_as_the_worst():
    residuals = np.full((150, 3), 0.1)
    residuals[0], residuals[1] = np.nan, [3.0, 2.0, 1.0]
    covariance = OwnError(NODES, residuals).covariance(NODES[:1])
    assert covariance[0, 0, 0] > 1.0


def test_the_mesh_error_is_read_from_the_attributes():
    assert mesh_error_of({}).tolist() == [0.0, 0.0, 0.0]
    with pytest.raises(KeyError):
        mesh_error_of({"mesh_error": "{}"})
