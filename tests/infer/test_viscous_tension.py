"""mu U known as one quantity, in place of viscosity and velocity: G_s = mu U / Ca."""

from dataclasses import replace

import numpy as np
import pytest

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.infer import Posterior, Prior, identify
from capsbayes.infer.batch import identify_folder
from capsbayes.quantity import Quantity
from capsbayes.report import corner_plot

TENSION = Experiment(cross_section="square", half_width="25.0 +/- 0.2 um", viscous_tension="3.3 mN/m")
PRIOR = Prior(surface_shear_modulus=Quantity.log_uniform(1e-4, 10.0))


@pytest.fixture(scope="module")
def still(capsule):
    """The capsule of the other tests, its velocity not measured."""
    return replace(capsule, capsule_velocity=None, capsule_velocity_error=np.nan)


@pytest.mark.parametrize("engine", ["emcee", "quadrature"])
def test_the_modulus_is_the_tension_over_the_capillary_number(model, still, engine):
    posterior = identify(still, model, TENSION, seed=1, prior=PRIOR, engine=engine)
    assert posterior.status.ok
    draws = posterior.draws
    np.testing.assert_allclose(draws["surface_shear_modulus"] * draws["capillary_number"], 3.3e-3, rtol=1e-9)
    np.testing.assert_allclose(draws["viscous_tension"], 3.3e-3)
    assert posterior.marginals["surface_shear_modulus"].contains(3.3e-3 / 0.082, level=95)
    for name in ("viscosity", "capsule_velocity", "mean_velocity", "velocity_ratio"):
        assert name not in draws
        assert name not in posterior.marginals


def test_lengths_tell_the_same_shape_as_with_viscosity_and_velocity(model, experiment, capsule, still):
    """With a prior of ln G_s that is flat, the flow does not tell the shape."""
    known = identify(capsule, model, experiment, seed=1, prior=PRIOR, engine="quadrature")
    posterior = identify(still, model, TENSION, seed=1, prior=PRIOR, engine="quadrature")
    for name in ("capillary_number", "size_ratio"):
        this, other = posterior.marginals[name], known.marginals[name]
        assert this.median == pytest.approx(other.median, abs=0.1 * other.sd)
        assert this.sd == pytest.approx(other.sd, rel=0.1)


def test_an_error_of_the_tension_is_one_of_the_modulus(model, still):
    rough = replace(TENSION, viscous_tension="3.3 +/- 0.66 mN/m")
    exact, uncertain = (
        identify(still, model, lab, seed=1, prior=PRIOR, engine="quadrature") for lab in (TENSION, rough)
    )
    added = uncertain.log_modulus_sd**2 - exact.log_modulus_sd**2
    assert added == pytest.approx(0.2**2, rel=0.25)
    assert uncertain.shares["viscous_tension"] == pytest.approx(0.2**2 / uncertain.log_modulus_sd**2, rel=0.25)
    assert "viscosity" not in uncertain.shares
    assert uncertain.marginals["capillary_number"].sd == pytest.approx(exact.marginals["capillary_number"].sd, rel=0.05)


def test_a_posterior_is_written_read_and_drawn(model, still, tmp_path):
    posterior = identify(still, model, TENSION, seed=1, prior=PRIOR, engine="quadrature")
    again = Posterior.read(posterior.write(tmp_path / "p.nc"))
    assert again.experiment.viscous_tension.value == 3.3e-3
    assert again.experiment.viscosity is None
    assert again.as_dict() == posterior.as_dict()
    inputs = again.as_dict()["inputs"]
    assert inputs["viscous_tension"] == {"value": 3.3e-3, "error": 0.0, "unit": "N/m"}
    assert "capsule_velocity" not in inputs
    assert again.as_dict()["reynolds_number"] is None
    assert corner_plot(again).axes


def test_what_contradicts_or_needs_more_is_refused(model, experiment, capsule, still, tmp_path):
    with pytest.raises(InputError, match="flow_rate: expected none: the experiment states viscous_tension"):
        identify(replace(still, flow_rate=1e-11), model, TENSION, seed=1)
    with pytest.raises(InputError, match=r"capsule_velocity: expected a value with an error, got nothing"):
        identify(still, model, experiment, seed=1)
    capsule.write(tmp_path / "capsule.toml")
    with pytest.raises(InputError, match="viscosity: expected one, and the velocity of the capsules"):
        identify_folder(tmp_path, model, TENSION, out=tmp_path / "out.nc", seed=1, workers=1)
