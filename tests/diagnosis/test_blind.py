"""Blind sessions: outlines as a microscope has them, and the population, errors and truth of drawn ones."""

import json
from dataclasses import replace

import numpy as np
import pytest

from capsbayes.database import Database
from capsbayes.diagnosis import blind
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


def breadth(profile):
    return np.ptp(profile.points[:, 1])


@pytest.mark.parametrize(
    ("change", "factor", "length", "numbers"),
    [
        (lambda edge: grown(edge, 0.02), 1.0, 0.04, ("axial_extent",)),
        (lambda edge: grown(edge, 0.02), 1.0, 0.0, ("parachute_depth",)),
        (lambda edge: smeared(edge, 0.05), 1.0, 0.05, ("axial_extent", "axial_length")),
        (lambda edge: smeared(edge, 0.05), 1.0, 0.0, ("breadth",)),
        (lambda edge: enlarged(edge, 1.03, 1.03), 1.03**2, 0.0, ("area",)),
        (lambda edge: enlarged(edge, 1.03, 1.03), 1.03, 0.0, ("axial_length",)),
        (lambda edge: enlarged(edge, 1.03, 1.0), 1.03, 0.0, ("area",)),
        (lambda edge: enlarged(edge, 1.03, 1.0), 1.0, 0.0, ("breadth",)),
    ],
)
def test_a_microscope_changes_a_parachute_as_geometry_says(parachute, change, factor, length, numbers):
    before, after = (Profile.from_outline(edge) for edge in (parachute, change(parachute)))
    for name in numbers:
        old, new = (breadth(seen) if name == "breadth" else getattr(seen, name) for seen in (before, after))
        assert new == pytest.approx(factor * old + length, abs=1e-4 if name == "parachute_depth" else 1e-6), name
    assert smeared(parachute, 0.0) is parachute


def test_a_circle_grows_to_a_circle_and_smears_over_the_area_of_its_way():
    np.testing.assert_allclose(np.hypot(*Profile.from_outline(grown(CIRCLE, 0.1)).points.T), 1.1, atol=1e-4)
    gained = Profile.from_outline(smeared(CIRCLE, 0.2)).area - Profile.from_outline(CIRCLE).area
    assert gained == pytest.approx(0.4, abs=3e-3)


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


@pytest.fixture(scope="module")
def sessions(square_database):
    return [drawn(square_database, seed=seed) for seed in range(10)]


def test_same_seed_gives_the_same_session_and_its_truth_can_be_kept_as_text(square_database, sessions):
    again = drawn(square_database, seed=5)
    for first, second in zip(sessions[5].session.measurements, again.session.measurements, strict=True):
        np.testing.assert_array_equal(first.outline.points, second.outline.points)
    assert sessions[5].truth() == again.truth()
    assert again.truth() != sessions[6].truth()
    stored = json.loads(json.dumps(drawn(square_database, TRUE_EFFECTS["halo"], 4e-7).truth()))
    assert (stored["effect"], stored["size"], len(stored["capsules"])) == ("halo", 4e-7, 40)


def test_population_is_that_of_the_lab_and_capsules_that_of_the_flow(sessions):
    moduli, lab = np.concatenate([blind.log_modulus for blind in sessions]), Lab()
    assert np.mean(moduli) == pytest.approx(np.log(0.05), abs=0.03)
    assert np.std(moduli) == pytest.approx(0.1, abs=0.04)
    for capsule in sessions[5].capsules:
        speed = capsule.capillary_number * capsule.surface_shear_modulus / lab.viscosity
        assert min(abs(speed / np.array(lab.mean_velocities) - 1.0)) < 1e-12
        assert 1.0 < capsule.capsule_velocity / speed < 2.0
        assert capsule.capsule_radius == pytest.approx(capsule.size_ratio * lab.half_width)


def test_modulus_does_not_depend_on_size_unless_that_is_the_effect(square_database, sessions):
    def slope(drawn_sessions):
        log_size = np.log([capsule.size_ratio for blind in drawn_sessions for capsule in blind.capsules])
        return np.polyfit(log_size, np.concatenate([blind.log_modulus for blind in drawn_sessions]), 1)[0]

    sloping = [drawn(square_database, TRUE_EFFECTS["modulus_slope"], 1.5, seed=seed) for seed in range(10)]
    assert slope(sessions) == pytest.approx(0.0, abs=0.25)
    assert slope(sloping) == pytest.approx(1.5, abs=0.3)


def test_lengths_and_outline_err_as_stated(sessions):
    pairs = [pair for blind in sessions for pair in zip(blind.capsules, blind.session.measurements, strict=True)]
    extent = [seen.axial_extent - Profile.from_outline(capsule.outline).axial_extent for capsule, seen in pairs]
    velocity = [seen.capsule_velocity / capsule.capsule_velocity for capsule, seen in pairs]
    assert np.mean(extent) == pytest.approx(0.0, abs=0.003)
    assert np.std(extent) == pytest.approx(np.sqrt(2.0) * 0.01, rel=0.15)
    assert np.std(velocity) == pytest.approx(0.01, rel=0.15)


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


def test_swelling_and_wrong_pixels_are_seen(square_database):
    before, swollen = drawn(square_database), drawn(square_database, TRUE_EFFECTS["swelling"], 5.0)
    for one, other in zip(before.capsules, swollen.capsules, strict=True):
        factor = 1.0 + 5.0 * one.capsule_velocity
        assert other.capsule_radius == pytest.approx(factor * one.capsule_radius)
        assert np.ptp(other.outline[:, 0]) == pytest.approx(factor * np.ptp(one.outline[:, 0]))
    for one in drawn(square_database, TRUE_EFFECTS["pixel_scale"], 0.02).capsules:
        assert one.velocity_seen == pytest.approx(1.02 * one.capsule_velocity)


def test_a_capsule_whose_edge_would_cross_itself_is_measured_once_more(square_database, monkeypatch):
    tried = []

    def errors(points, noise, rng):
        tried.append(len(points))
        return 0.2 * (-1.0) ** np.arange(len(points)) if len(tried) == 1 else edge_errors(points, noise, rng)

    monkeypatch.setattr(blind, "edge_errors", errors)
    session = draw_session(square_database, NONE, 0.0, lab=Lab(), capsules=3, seed=1).session
    assert (len(session), len(tried)) == (3, 4)


def test_unknown_names_and_too_many_capsules_are_refused(square_database):
    assert true_effect_named("Pre-inflation").simulated(0.03) == {"pre_inflation": 0.03}
    with pytest.raises(InputError, match="pre_inflation"):
        true_effect_named("gravity")
    lab = replace(Lab(), surface_shear_modulus=0.2)
    with pytest.raises(InputError, match="pairs of a shape and a flow rate"):
        draw_session(square_database, NONE, 0.0, lab=lab, capsules=400, seed=1)
