import numpy as np
import pytest

from capsbayes.physics.load import MembraneLoad
from capsbayes.physics.membrane import NeoHookean
from capsbayes.physics.surface import octasphere

MESH = octasphere(5)


def wavy(membrane):
    """Free coordinates of a smooth shape that is no sphere."""
    x = MESH.nodes[MESH.wedge]
    return membrane.radius * MESH.reduced(x * (1.05 + 0.2 * x[:, 2:] + 0.1 * (x[:, :1] ** 4 + x[:, 1:2] ** 4)))


def smooth_direction():
    x = MESH.nodes[MESH.wedge]
    return MESH.reduced(np.column_stack([x[:, 0] * x[:, 2], x[:, 1] * x[:, 2], np.cos(3 * x[:, 2])]))


either_bending = pytest.mark.parametrize("bending_energy", ["displacement", "curvature"])


@either_bending
@pytest.mark.parametrize("pre_inflation", [0.0, 0.05])
def test_gradient_and_tangent_are_derivatives_of_the_energy(pre_inflation, bending_energy):
    membrane = MembraneLoad(MESH, NeoHookean(), 0.8, 1e-3, pre_inflation, bending_energy=bending_energy)
    free, direction, step = wavy(membrane), smooth_direction(), 1e-5
    middle, ahead, behind = (membrane.elasticity(free + s * direction) for s in (0.0, step, -step))
    assert (ahead.energy - behind.energy) / (2 * step) == pytest.approx(middle.gradient @ direction, rel=1e-7)
    difference = (ahead.gradient - behind.gradient) / (2 * step)
    np.testing.assert_allclose(middle.tangent @ direction, difference, atol=1e-7 * np.abs(difference).max())
    np.testing.assert_allclose(middle.tangent, middle.tangent.T, atol=1e-11 * np.abs(middle.tangent).max())


@either_bending
def test_sphere_at_rest_has_no_energy_and_no_load(bending_energy):
    membrane = MembraneLoad(MESH, NeoHookean(), 0.9, 1e-3, bending_energy=bending_energy)
    elastic = membrane.elasticity(membrane.rest)
    assert elastic.energy == pytest.approx(0.0, abs=1e-12)
    assert np.max(np.abs(elastic.gradient)) < 1e-12


@pytest.mark.parametrize("alpha", [0.02, 0.1])
def test_pre_inflated_sphere_bears_the_tension_and_pressure_of_the_closed_form(alpha):
    """Isotropic stretch 1 + alpha of a neo-Hookean membrane: tension 1 - (1 + alpha)^-6, pressure 2 tension / a."""
    membrane = MembraneLoad(octasphere(8), NeoHookean(), 0.8, 0.0, alpha)
    tension = 1 - (1 + alpha) ** -6
    np.testing.assert_allclose(membrane.principal_tensions(membrane.rest), tension, rtol=0.02)
    load = membrane.elasticity(membrane.rest).gradient
    pressure = load @ membrane.rest / (membrane.enclosure(membrane.rest).volume_gradient @ membrane.rest)
    assert pressure == pytest.approx(2 * tension / 0.8, rel=2e-3)


def test_a_smoothed_shape_bears_no_forces_of_short_waves_and_keeps_the_long_ones():
    membrane = MembraneLoad(MESH, NeoHookean(), 0.8, 1e-3, 0.02, bending_energy="curvature")
    noise = 1e-4 * np.random.default_rng(0).standard_normal(len(membrane.rest))
    rough = membrane.rest + noise
    shape = membrane.smoothed(rough, 6)
    wrinkled, smooth, at_rest = (membrane.gradient(free) for free in (rough, shape, membrane.rest))
    assert np.linalg.norm(smooth - at_rest) < 0.25 * np.linalg.norm(wrinkled - at_rest)
    x = MESH.nodes[MESH.wedge]
    for wave in (x, x * x[:, 2:], x * x[:, 2:] ** 2):  # of degree 3 at most
        moved = MESH.reduced(wave) @ membrane.mass @ (shape - rough)
        assert abs(moved) < 1e-3 * np.sqrt((shape - rough) @ membrane.mass @ (shape - rough))


def test_volume_and_moment_of_a_moved_sphere():
    mesh = octasphere(8)
    membrane = MembraneLoad(mesh, NeoHookean(), 0.8, 0.0)
    lift = mesh.reduced(np.tile([0.0, 0.0, 0.3], (len(mesh.wedge), 1)))
    inside = membrane.enclosure(membrane.rest + lift)
    volume = 4 / 3 * np.pi * 0.8**3
    assert inside.volume == pytest.approx(volume, rel=1e-4)
    assert inside.moment == pytest.approx(0.3 * volume, rel=1e-4)


def test_gradients_of_volume_and_moment():
    membrane = MembraneLoad(MESH, NeoHookean(), 0.8, 0.0)
    free, direction, step = wavy(membrane), smooth_direction(), 1e-5
    middle, ahead, behind = (membrane.enclosure(free + s * direction) for s in (0.0, step, -step))
    assert (ahead.volume - behind.volume) / (2 * step) == pytest.approx(middle.volume_gradient @ direction, rel=1e-7)
    assert (ahead.moment - behind.moment) / (2 * step) == pytest.approx(middle.moment_gradient @ direction, rel=1e-7)


def test_bending_energy_of_a_spherical_harmonic():
    """Lap_0 of a degree-2 zonal field is -6 times it: the energy is 1/2 B 36 int u^2 dS_0, whatever the radius."""
    for radius in (0.5, 1.0):
        membrane = MembraneLoad(octasphere(10), NeoHookean(), radius, 0.1)
        plain = MembraneLoad(octasphere(10), NeoHookean(), radius, 0.0)
        mesh = membrane.mesh
        z = mesh.nodes[mesh.wedge, 2]
        change = 0.01 * mesh.reduced(np.column_stack([0 * z, 0 * z, 1.5 * z**2 - 0.5]))
        energy = membrane.elasticity(membrane.rest + change).energy - plain.elasticity(membrane.rest + change).energy
        assert energy == pytest.approx(0.05 * 36 * 0.01**2 * 4 * np.pi / 5, rel=2e-2)
