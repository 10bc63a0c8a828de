"""The thickness of the membrane as what is known of its bending modulus: B = (t/a)^2 / 3."""

from dataclasses import replace

import numpy as np
import pytest
from membrane_model import MembraneModel

from capsbayes.errors import InputError
from capsbayes.infer import Posterior, Prior, identify
from capsbayes.infer.importance import ImportanceSampling
from capsbayes.quantity import Quantity
from capsbayes.report.posterior import prior_table
from capsbayes.surrogate import Surrogate

THICKNESS = "0.40 +/- 0.08 um"


@pytest.fixture(scope="module")
def blunt():
    """Lengths that tell of the bending modulus."""
    return MembraneModel(blunter=0.03)


@pytest.fixture(scope="module")
def shell(experiment):
    return replace(experiment, membrane_thickness=THICKNESS)


def _moments(values, weights):
    mean = np.average(values, weights=weights)
    return mean, np.sqrt(np.average((values - mean) ** 2, weights=weights))


@pytest.mark.parametrize("lengths", ["over the half width", "in metres"])
def test_the_posterior_is_that_of_the_prior_of_bending_weighted_by_the_thickness(
    blunt, experiment, shell, capsule, capsule_in_metres, lengths
):
    """Independent route: draws under the default prior, of log B, weighted by the prior of t over that of log t."""
    seen = capsule_in_metres if lengths == "in metres" else capsule
    draws = ImportanceSampling(blunt, experiment)(seen).drawn(np.random.default_rng(2), 80_000)
    thickness = draws["capsule_radius"] * np.sqrt(3.0 * draws["bending"])
    weights = np.exp(-0.5 * ((thickness - 0.40e-6) / 0.08e-6) ** 2) * thickness
    found = ImportanceSampling(blunt, shell)(seen)
    assert all(gate.passed for gate in found.gates), [str(gate) for gate in found.gates]
    wanted = {"membrane_thickness": thickness, "bending": draws["bending"]}
    for name, values in wanted.items():
        mean, sd = _moments(values, weights)
        assert (found.marginal(name).mean, found.marginal(name).sd) == pytest.approx((mean, sd), abs=0.06 * sd), name
    for name in ("surface_shear_modulus", "capsule_radius"):
        mean, sd = _moments(np.log(draws[name]), weights)
        assert found.log_marginal(name).mean == pytest.approx(mean, abs=0.06 * sd), name
        assert found.log_marginal(name).sd == pytest.approx(sd, rel=0.06), name


def test_draws_obey_the_relation_of_a_shell(blunt, shell, capsule):
    draws = ImportanceSampling(blunt, shell)(capsule).drawn(np.random.default_rng(0), 500)
    ratio = draws["membrane_thickness"] / draws["capsule_radius"]
    np.testing.assert_allclose(draws["bending"], ratio**2 / 3.0, rtol=1e-9)
    assert np.ptp(draws["half_width"]) > 0.0


def test_a_known_thickness_leaves_the_radius_alone_to_move_bending(blunt, experiment, capsule):
    found = ImportanceSampling(blunt, replace(experiment, membrane_thickness=0.4e-6))(capsule)
    assert all(gate.passed for gate in found.gates)
    radius, bending = found.log_marginal("capsule_radius"), found.marginal("bending")
    assert bending.sd / bending.mean == pytest.approx(2.0 * radius.sd, rel=0.05)
    assert bending.median == pytest.approx((0.4e-6 / found.marginal("capsule_radius").median) ** 2 / 3.0, rel=1e-3)


def test_one_coordinate_alone_may_be_told_by_the_thickness(blunt, shell, capsule):
    known = blunt.fixed(pre_inflation=0.0, area_dilation_modulus=3.0, strain_hardening=0.0)
    found = identify(capsule, known, shell, seed=1, engine="quadrature")
    assert all(gate.passed for gate in found.gates), [str(gate) for gate in found.gates]
    assert found.marginals["membrane_thickness"].mean == pytest.approx(0.4e-6, rel=0.1)


@pytest.mark.slow
def test_emcee_agrees(blunt, shell, capsule):
    found = identify(capsule, blunt, shell, seed=2)
    assert found.agreement.passed, str(found.agreement)


def test_the_file_holds_the_thickness(blunt, shell, capsule, tmp_path):
    found = identify(capsule, blunt, shell, seed=2, engine="quadrature")
    table = found.summary()
    assert table.loc["membrane_thickness", "unit"] == "m"
    assert 0.0 < table.loc["membrane_thickness", "width_over_prior"] < 1.1
    assert {"bending", "half_width"} <= set(found.shares)
    again = Posterior.read(found.write(tmp_path / "posterior.nc"))
    assert again.experiment.membrane_thickness.value == pytest.approx(0.40e-6)
    assert again.summary().equals(table)


def test_a_model_without_bending_refuses_a_thickness(shell, capsule):
    with pytest.raises(InputError, match=r"membrane_thickness: expected none, .* --membrane unknown"):
        identify(capsule, Surrogate.open("square-neo-hookean"), shell, seed=1)


def test_bending_and_thickness_are_not_both_stated(blunt, shell, capsule):
    with pytest.raises(InputError, match="one statement of what is known of the bending modulus"):
        identify(capsule, blunt, shell, seed=1, prior=Prior(coordinates={"bending": "1e-4 .. 4e-4"}))
    with pytest.raises(InputError, match="one of the two"):
        Prior(coordinates={"bending": "1e-4 .. 4e-4", "membrane_thickness": THICKNESS})


@pytest.mark.parametrize("thickness", ["20 +/- 2 nm", "5 um"])
def test_a_thickness_beyond_the_bending_moduli_of_the_model_is_refused(blunt, experiment, thickness):
    with pytest.raises(InputError, match="membrane_thickness: expected a thickness from"):
        ImportanceSampling(blunt, replace(experiment, membrane_thickness=Quantity.of(thickness, "membrane_thickness")))


def test_a_known_thickness_is_shown_as_such_and_nothing_is_said_of_measuring_bending(blunt, experiment, capsule):
    known = replace(experiment, membrane_thickness=0.4e-6)
    found = identify(capsule, blunt, known, seed=1, engine="quadrature")
    assert "known, 0.4 µm" in prior_table(found).to_string()
    assert "membrane_thickness" not in found.marginals
    assert not {"bending", "membrane_thickness"} & set(found.expected_log_modulus_sds)
