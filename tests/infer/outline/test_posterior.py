"""Posteriors from a measured outline, by the shipped shapes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.infer import identify, quadrature
from capsbayes.infer.grid import Window
from capsbayes.infer.quadrature import Quadrature
from capsbayes.measurement import MeasuredOutline, Measurement, OutlineNoise
from capsbayes.profile import Profile, vertex_normals
from capsbayes.status import Status
from capsbayes.surrogate import Surrogate

NOISE = OutlineNoise(0.006, 0.4, 0.1)
FLOW = 4e-3  # mean velocity of the liquid [m/s]
EXPERIMENT = Experiment(cross_section="square", half_width=50e-6, viscosity=0.7)


@pytest.fixture(scope="module")
def model():
    return Surrogate.open("square-neo-hookean")


@pytest.fixture(scope="module")
def engine(model):
    return Quadrature(model, EXPERIMENT)


def measured(model, capillary_number, size_ratio, rng, noise=NOISE):
    """A capsule of that case, its outline with errors; the lengths are those of the outline."""
    there = model.at(capillary_number=capillary_number, size_ratio=size_ratio, outline=True)
    outline = there.outline[0]
    points = outline[::4] + noise.drawn(rng, outline[::4], 1)[0][:, None] * vertex_normals(outline)[::4]
    seen = Profile.from_outline(points)
    velocity = FLOW * float(there.velocity_ratio[0])
    return Measurement(
        axial_extent=seen.axial_extent,
        axial_extent_error=1.5 * noise.scale,
        axial_length=seen.axial_length,
        axial_length_error=1.5 * noise.scale,
        capsule_velocity=velocity,
        capsule_velocity_error=0.002 * velocity,
        outline=MeasuredOutline(points, noise),
    )


@pytest.mark.parametrize("case", [(0.08, 0.95), (0.03, 0.8)])
def test_the_outline_agrees_with_the_lengths_and_is_narrower(model, engine, case):
    seen = measured(model, *case, np.random.default_rng(3))
    outline, lengths = engine(seen), engine(replace(seen, outline=None))
    assert all(gate.passed for gate in outline.gates)
    for name in ("capillary_number", "size_ratio", "surface_shear_modulus"):
        fine, rough = outline.marginal(name), lengths.marginal(name)
        assert abs(fine.mean - rough.mean) < 3 * rough.sd
        assert fine.sd < 0.7 * rough.sd


def test_where_the_rear_is_convex_the_outline_breaks_the_ridge(model, engine):
    """There L_z and L_a are one number for two unknowns."""
    seen = measured(model, 0.01, 1.08, np.random.default_rng(5))
    assert seen.axial_extent - seen.axial_length < 0.01
    outline, lengths = (engine(one).log_marginal("capillary_number").sd for one in (seen, replace(seen, outline=None)))
    assert outline < 0.8 * lengths


def test_a_posterior_is_found_from_a_window_that_does_not_hold_it(model, monkeypatch):
    """Convex, with small errors: a ridge, along which a narrow window would creep and be taken for all there is."""
    seen = measured(model, 0.0075, 0.825, np.random.default_rng(5), noise=OutlineNoise(0.001, 0.3, 0.1))
    seen = replace(seen, axial_length=None, axial_length_error=None)
    engine = Quadrature(model, EXPERIMENT)
    far = Window((np.log(0.003), 0.811), (np.log(0.0032), 0.823), (77, 57))
    monkeypatch.setattr(engine, "_first_window", lambda *_: far)
    found = engine(seen)
    assert all(gate.passed for gate in found.gates)
    assert 0.001 < found.probability_below("capillary_number", 0.0075) < 0.999
    assert 0.001 < found.probability_below("size_ratio", 0.825) < 0.999
    monkeypatch.setattr(quadrature, "_ROUNDS", 1)
    assert [gate.name for gate in engine(seen).gates if not gate.passed][-1].startswith("density at an end")


@pytest.mark.slow
def test_the_interval_of_the_shear_modulus_covers(model, engine):
    """40 capsules over the plane: the truth's quantile is uniform."""
    rng, quantiles = np.random.default_rng(8), []
    truth = EXPERIMENT.viscosity.value * FLOW
    while len(quantiles) < 40:
        case = rng.uniform(0.03, 0.09), rng.uniform(0.78, 1.0)
        posterior = engine(measured(model, *case, rng))
        quantiles.append(posterior.probability_below("surface_shear_modulus", truth / case[0]))
    inside = np.mean(np.abs(np.array(quantiles) - 0.5) < 0.475)
    assert inside > 0.95 - 3 * np.sqrt(0.95 * 0.05 / 40)
    assert np.mean(np.abs(np.array(quantiles) - 0.5) < 0.34) == pytest.approx(0.68, abs=0.22)


@pytest.mark.slow
def test_emcee_agrees_and_the_shares_name_the_outline(model):
    found = identify(measured(model, 0.05, 0.9, np.random.default_rng(6)), model, EXPERIMENT, seed=1)
    assert found.status is Status.DONE
    assert found.agreement.passed
    assert found.shares["outline"] > 0.5
    assert "axial_extent" not in found.shares


def test_an_outline_that_no_shape_fits_is_told(model):
    """The same capsule, with a rear that is askew, and with a rim that is bent back on both sides."""
    seen = measured(model, 0.05, 0.9, np.random.default_rng(6), noise=OutlineNoise(0.003, 0.2, 0.1))
    y = seen.outline.points[:, 1]
    rear = seen.outline.points[:, 0] < seen.outline.points[:, 0].mean()
    right, askew, wrong = (
        identify(
            replace(seen, outline=replace(seen.outline, points=points)), model, EXPERIMENT, seed=1, engine="quadrature"
        )
        for points in (
            seen.outline.points + np.stack([rear * away, 0.0 * y], 1) for away in (0.0 * y, 0.06 * y, -0.3 * y**2)
        )
    )
    assert right.status is askew.status is Status.DONE
    misfit = next(gate.value for gate in right.gates if "outline" in gate.name)
    assert 0.5 < misfit < 1.6
    ca = askew.marginals["capillary_number"]
    assert ca.lower_95 < 0.05 < ca.upper_95
    assert wrong.status is Status.OUTLINE_MISFIT


def test_an_outline_is_over_the_half_width():
    angle = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    circle = MeasuredOutline(np.stack([np.cos(angle), np.sin(angle)], axis=1), NOISE)
    with pytest.raises(InputError, match="outline: expected lengths over l"):
        Measurement(
            axial_extent=1e-4,
            axial_extent_error=1e-6,
            capsule_velocity=4e-3,
            capsule_velocity_error=4e-5,
            over_half_width=False,
            outline=circle,
        )


@pytest.mark.parametrize("points", [np.zeros((4, 2)), np.full((40, 2), np.nan), np.zeros(40)])
def test_what_is_no_outline_is_refused(points):
    with pytest.raises(InputError, match="measurement: outline: expected"):
        MeasuredOutline(points, NOISE)


def test_the_sense_of_the_outline_does_not_matter():
    angle = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    points = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    np.testing.assert_array_equal(MeasuredOutline(points[::-1], NOISE).points, points)
