"""The bending energy of a shell: what a rotation leaves, closed forms, and an independent axisymmetric shell."""

from __future__ import annotations

import numpy as np
import pytest
from pressed_shell import BENDING, distances

from capsbayes.physics.load import BentShell, MembraneLoad, spheroid
from capsbayes.physics.membrane import NeoHookean
from capsbayes.physics.surface import C2H, octasphere


def turned(mesh, nodes, angle):
    """Free coordinates of nodes (N, 3) turned about x."""
    turn = np.eye(3)
    turn[1:, 1:] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return mesh.reduced((nodes @ turn.T)[mesh.wedge])


@pytest.mark.parametrize("angle", [0.1, 1.3])
def test_a_rotation_costs_nothing(angle):
    mesh = octasphere(6, C2H)
    rotated = BentShell(mesh, turned(mesh, mesh.nodes, angle), 1.0, 1.0)
    assert rotated.energy == pytest.approx(0.0, abs=1e-20)
    np.testing.assert_allclose(rotated.gradient, 0.0, atol=1e-10)
    stretched = mesh.nodes * [1.2, 0.7, 1.4]
    before, after = (BentShell(mesh, turned(mesh, stretched, one), 1.0, 1.0) for one in (0.0, angle))
    assert after.energy == pytest.approx(before.energy, rel=1e-11)
    assert np.linalg.norm(after.gradient) == pytest.approx(np.linalg.norm(before.gradient), rel=1e-10)


def test_the_displacement_form_resists_a_rotation():
    mesh = octasphere(6, C2H)
    membrane = MembraneLoad(mesh, NeoHookean(), 1.0, BENDING, bending_energy="displacement")
    assert membrane.elasticity(turned(mesh, mesh.nodes, 0.1)).energy > 1e-4


@pytest.mark.parametrize("aspect", [1.0, 1.2])
def test_an_unstressed_spheroid_bears_no_moment(aspect):
    mesh = octasphere(5)
    rest = BentShell(mesh, 0.8 * mesh.reduced(spheroid(mesh, aspect)[mesh.wedge]), 0.8, aspect)
    assert rest.energy == pytest.approx(0.0, abs=1e-20)
    np.testing.assert_allclose(rest.gradient, 0.0, atol=1e-10)


@pytest.mark.parametrize(("radius", "growth"), [(1.0, 1.1), (0.6, 0.9)])
def test_growth_of_a_sphere_has_the_energy_of_its_closed_form(radius, growth):
    """Both principal components of rho are (growth - 1) / radius: E = 4 pi (1 + nu) (growth - 1)^2."""
    mesh = octasphere(8)
    energy = BentShell(mesh, growth * radius * mesh.reduced(mesh.nodes[mesh.wedge]), radius, 1.0).energy
    assert energy == pytest.approx(4 * np.pi * 1.5 * (growth - 1) ** 2, rel=1e-3)


def test_gradient_and_tangent_are_derivatives_of_the_energy():
    mesh, step = octasphere(5), 1e-5
    x = mesh.nodes[mesh.wedge]
    free = mesh.reduced(x * (1.05 + 0.2 * x[:, 2:] + 0.1 * (x[:, :1] ** 4 + x[:, 1:2] ** 4)))
    direction = np.random.default_rng(0).normal(size=len(free))
    middle, ahead, behind = (BentShell(mesh, free + s * direction, 0.9, 1.1) for s in (0.0, step, -step))
    assert (ahead.energy - behind.energy) / (2 * step) == pytest.approx(middle.gradient @ direction, rel=1e-4)
    difference = (ahead.gradient - behind.gradient) / (2 * step)
    np.testing.assert_allclose(middle.tangent @ direction, difference, atol=1e-6 * np.abs(difference).max())
    np.testing.assert_allclose(middle.tangent, middle.tangent.T, atol=1e-11 * np.abs(middle.tangent).max())


def test_a_shell_pressed_in_has_the_shape_of_the_independent_one():
    assert np.max(distances(5, "curvature", 0.8)) < 2e-3


@pytest.mark.slow
def test_the_shape_converges_to_that_of_the_independent_shell():
    """At a rate of 3.5; the displacement form does not come nearer than 0.0004 (rms)."""
    refinements = np.array([5, 6, 8, 12])
    errors = [np.sqrt(np.mean(distances(n, "curvature", 0.8) ** 2)) for n in refinements]
    assert -np.polyfit(np.log(refinements), np.log(errors), 1)[0] > 3.0
    assert np.sqrt(np.mean(distances(12, "displacement", 0.8) ** 2)) > 5 * errors[-1]
