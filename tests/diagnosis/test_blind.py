"""Blind sessions: outlines as a microscope has them, and the population, errors and truth of drawn ones."""

import json
from dataclasses import replace

import numpy as np
import pytest

from capsbayes.database import Database
from capsbayes.diagnosis.blind import (
    TRUE_EFFECTS,
    Lab,
    Noise,
    distorted,
    draw_session,
    edge_errors,
    enlarged,
    grown,
    in_perspective,
    smeared,
    true_effect_named,
)
from capsbayes.errors import InputError
from capsbayes.measurement import OutlineNoise
from capsbayes.profile import Profile

ANGLE = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
CIRCLE = np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1)


@pytest.fixture(scope="module")
def square_database():
    return Database.open("square-neo-hookean")


@pytest.fixture
def parachute(square_database):
    """A shape with a deep rear."""
    there = square_database.converged
    return np.array(there["profile"][np.argmax(there["parachute_depth"])])


def test_grown_circle_is_a_larger_circle():
    seen = Profile.from_outline(grown(CIRCLE, 0.1))
    np.testing.assert_allclose(np.hypot(*seen.points.T), 1.1, atol=1e-4)


def test_grown_parachute_is_longer_by_twice_the_distance_and_as_deep(parachute):
    before, after = Profile.from_outline(parachute), Profile.from_outline(grown(parachute, 0.02))
    assert after.axial_extent == pytest.approx(before.axial_extent + 0.04, abs=1e-6)
    assert after.parachute_depth == pytest.approx(before.parachute_depth, abs=1e-4)


def test_smear_covers_what_the_shape_covers_on_its_way(parachute):
    length = 0.05
    before, after = Profile.from_outline(parachute), Profile.from_outline(smeared(parachute, length))
    assert after.axial_extent == pytest.approx(before.axial_extent + length, abs=1e-6)
    assert after.axial_length == pytest.approx(before.axial_length + length, abs=1e-6)
    assert np.ptp(after.points[:, 1]) == pytest.approx(np.ptp(before.points[:, 1]))
    assert smeared(parachute, 0.0) is parachute


def test_smeared_circle_gains_the_area_of_its_way():
    seen = Profile.from_outline(smeared(CIRCLE, 0.2))
    assert seen.area == pytest.approx(Profile.from_outline(CIRCLE).area + 0.4, rel=1e-3)


def test_enlarged_shape_is_similar(parachute):
    before, after = Profile.from_outline(parachute), Profile.from_outline(enlarged(parachute, 1.03, 1.03))
    assert after.area == pytest.approx(1.03**2 * before.area)
    assert after.axial_length == pytest.approx(1.03 * before.axial_length)


def test_oblong_pixels_stretch_the_flow_direction_alone(parachute):
    before, after = Profile.from_outline(parachute), Profile.from_outline(enlarged(parachute, 1.03, 1.0))
    assert after.area == pytest.approx(1.03 * before.area)
    assert np.ptp(after.points[:, 1]) == pytest.approx(np.ptp(before.points[:, 1]))


def test_a_barrel_leaves_the_circle_through_the_walls_and_shortens_what_is_longer():
    np.testing.assert_allclose(np.hypot(*distorted(CIRCLE, -0.02).T), 1.0)
    seen = distorted(CIRCLE * [1.5, 0.5], -0.02)
    assert seen[:, 0].max() == pytest.approx(1.5 * (1.0 - 0.02 * 1.5**2) / 0.98)
    assert seen[:, 1].max() == pytest.approx(0.5 * (1.0 - 0.02 * 0.5**2) / 0.98, rel=1e-4)


def test_straight_lines_stay_straight_in_perspective():
    """A rectangle becomes a trapezoid, broader downstream by the ratio of the distances."""
    corners = np.array([[1.0, 0.5], [-1.0, 0.5], [-1.0, -0.5], [1.0, -0.5]])
    seen = in_perspective(corners, 0.02)
    breadth = [np.ptp(seen[sign * seen[:, 0] > 0.0, 1]) for sign in (1.0, -1.0)]
    assert breadth[0] / breadth[1] == pytest.approx(1.02 / 0.98)


NONE = TRUE_EFFECTS["none"]


def drawn(database, effect=NONE, size=0.0, *, capsules=40, seed=5):
    return draw_session(database, effect, size, lab=Lab(), capsules=capsules, seed=seed)


def test_same_seed_gives_the_same_session(square_database):
    first, again, other = (drawn(square_database, seed=seed) for seed in (5, 5, 6))
    for one, two in zip(first.session.measurements, again.session.measurements, strict=True):
        np.testing.assert_array_equal(one.outline.points, two.outline.points)
    assert first.truth() == again.truth()
    assert first.truth() != other.truth()


def test_population_is_that_of_the_lab(square_database):
    moduli = np.concatenate([drawn(square_database, seed=seed).log_modulus for seed in range(10)])
    assert np.mean(moduli) == pytest.approx(np.log(0.05), abs=0.03)
    assert np.std(moduli) == pytest.approx(0.1, abs=0.04)


def test_modulus_does_not_depend_on_size_unless_that_is_the_effect(square_database):
    def slope(effect, size):
        sessions = [drawn(square_database, effect, size, seed=seed) for seed in range(10)]
        log_size = np.log([one.size_ratio for each in sessions for one in each.capsules])
        return np.polyfit(log_size, np.concatenate([each.log_modulus for each in sessions]), 1)[0]

    assert slope(NONE, 0.0) == pytest.approx(0.0, abs=0.25)
    assert slope(TRUE_EFFECTS["modulus_slope"], 1.5) == pytest.approx(1.5, abs=0.3)


def test_capillary_number_size_and_velocity_belong_together(square_database):
    lab = Lab()
    for one in drawn(square_database).capsules:
        speed = one.capillary_number * one.surface_shear_modulus / lab.viscosity
        assert min(abs(speed / np.array(lab.mean_velocities) - 1.0)) < 1e-12
        assert 1.0 < one.capsule_velocity / speed < 2.0
        assert one.capsule_radius == pytest.approx(one.size_ratio * lab.half_width)


def test_lengths_and_outline_err_as_stated(square_database):
    away = []
    for seed in range(10):
        blind = drawn(square_database, seed=seed)
        for capsule, seen in zip(blind.capsules, blind.session.measurements, strict=True):
            truth = Profile.from_outline(capsule.outline)
            away.append([seen.axial_extent - truth.axial_extent, seen.capsule_velocity / capsule.capsule_velocity - 1])
    away = np.array(away)
    assert np.mean(away[:, 0]) == pytest.approx(0.0, abs=0.003)
    assert np.std(away[:, 0]) == pytest.approx(np.sqrt(2.0) * 0.01, rel=0.15)
    assert np.std(away[:, 1]) == pytest.approx(0.01, rel=0.15)


def test_errors_have_the_stated_covariance_and_heavy_tails_keep_it():
    angle = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    points = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rng = np.random.default_rng(1)
    for understated in (1.0, 1.2):
        noise = Noise(understated=understated)
        each = np.array([edge_errors(points, noise, rng) for _ in range(4000)])
        stated = OutlineNoise(noise.scale, noise.correlation_length).covariance(points)
        np.testing.assert_allclose(np.cov(each.T), understated**2 * stated, atol=0.15 * noise.scale**2)
    first = np.array([edge_errors(points, Noise(freedom=5.0), rng)[0] for _ in range(20000)])
    assert np.std(first) == pytest.approx(0.01, rel=0.05)
    assert np.mean((first / np.std(first)) ** 4) > 5.0


def test_truth_can_be_kept_as_text(square_database):
    blind = drawn(square_database, TRUE_EFFECTS["halo"], 4e-7)
    told = json.loads(json.dumps(blind.truth()))
    assert (told["effect"], told["size"], len(told["capsules"])) == ("halo", 4e-7, 40)


def test_swelling_wrong_pixels_and_a_pattern_are_seen(square_database):
    before, after = drawn(square_database), drawn(square_database, TRUE_EFFECTS["swelling"], 5.0)
    for one, other in zip(before.capsules, after.capsules, strict=True):
        factor = 1.0 + 5.0 * one.capsule_velocity
        assert other.capsule_radius == pytest.approx(factor * one.capsule_radius)
        assert np.ptp(other.outline[:, 0]) == pytest.approx(factor * np.ptp(one.outline[:, 0]))
    for one in drawn(square_database, TRUE_EFFECTS["pixel_scale"], 0.02).capsules:
        assert one.velocity_seen == pytest.approx(1.02 * one.capsule_velocity)
    before, after = drawn(square_database), drawn(square_database, TRUE_EFFECTS["pattern"], 0.02)
    for one, other in zip(before.capsules, after.capsules, strict=True):
        moved = np.hypot(*(other.outline - one.outline).T)
        assert np.sqrt(np.mean(moved**2)) == pytest.approx(0.02, rel=0.2)


def test_unknown_names_and_too_many_capsules_are_refused(square_database):
    assert true_effect_named("Pre-inflation").simulated(0.03) == {"pre_inflation": 0.03}
    with pytest.raises(InputError, match="pre_inflation"):
        true_effect_named("gravity")
    lab = replace(Lab(), surface_shear_modulus=0.2)
    with pytest.raises(InputError, match="pairs of a shape and a flow rate"):
        draw_session(square_database, NONE, 0.0, lab=lab, capsules=400, seed=1)
