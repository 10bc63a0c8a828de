import numpy as np
import pytest

from capsbayes.image.motion import drift, times_of, velocity

FRAMES = np.array([0.0, 1.0, 2.0, 4.0, 5.0, 6.0, 8.0, 9.0])  # two frames could not be read
NOISE = 0.05


def seen(seed, acceleration=0.0):
    noise = NOISE * np.random.default_rng(seed).standard_normal(len(FRAMES))
    return 50.0 - 12.3 * FRAMES - 0.5 * acceleration * FRAMES**2 + noise


def test_the_velocity_lies_within_its_error():
    fits = [velocity(FRAMES, seen(seed), np.full(len(FRAMES), NOISE**2)) for seed in range(400)]
    z = np.array([(fit.value + 12.3) / fit.error for fit in fits])
    assert z.std() == pytest.approx(1.0, abs=0.12)
    assert abs(z.mean()) < 0.15
    assert np.mean([fit.drift.significant for fit in fits]) < 0.02


def test_a_capsule_that_speeds_up_is_seen_to():
    fit = velocity(FRAMES, seen(1, acceleration=0.1), np.full(len(FRAMES), NOISE**2))
    assert fit.drift.change == pytest.approx(0.9 / 12.75, rel=0.15)
    assert abs(fit.drift.change) / fit.drift.error > 10.0
    assert fit.drift.unsteady


def test_three_frames_give_a_velocity_and_no_drift():
    fit = velocity(np.arange(3.0), np.array([0.0, 5.0, 10.0]), np.full(3, NOISE**2))
    assert fit.value == pytest.approx(5.0)
    assert fit.error == pytest.approx(NOISE / np.sqrt(2.0))  # no scatter at all is chance
    assert fit.drift is None


@pytest.mark.parametrize(("slope", "unsteady"), [(0.0, False), (1e-4, False), (1e-2, True)])
def test_a_length_that_changes_along_the_channel(slope, unsteady):
    along = 10.0 * FRAMES[::-1]
    lengths = 80.0 + slope * along + 0.02 * np.random.default_rng(2).standard_normal(len(along))
    found = drift(along, lengths, np.full(len(along), 4e-4))
    assert found.change == pytest.approx(-slope * 90.0 / 80.0, abs=3.0 * found.error)
    assert found.unsteady is unsteady


def test_the_times_of_dropped_and_repeated_frames_follow_from_the_steps():
    number, variance = np.arange(12.0), np.full(12, 0.01)
    true = np.array([0, 1, 2, 4, 5, 5, 6, 7, 10, 11, 12, 13.0])
    noise = 0.1 * np.random.default_rng(1).standard_normal(12)
    np.testing.assert_array_equal(times_of(number, 7.0 - 9.0 * true + noise, variance), true)
    np.testing.assert_array_equal(times_of(number, 0.3 * true + noise, variance), number)  # within the errors
    np.testing.assert_array_equal(times_of(number, 9.0 * true + 4.0 * (number > 6), variance), number)  # no multiple
    np.testing.assert_array_equal(times_of(2.0 * number, 18.0 * number, variance), 2.0 * number)
