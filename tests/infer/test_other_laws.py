"""The range of G_s over the laws of a membrane, next to posteriors with these laws."""

import contextlib
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from capsbayes.errors import NoShapeError
from capsbayes.infer import Posterior, Quadrature, identify
from capsbayes.infer.identify import modulus_over_laws
from capsbayes.report.posterior import caveats
from capsbayes.surrogate import MembraneSurrogate, Surrogate


@pytest.fixture(scope="module")
def model():
    return MembraneSurrogate.open("square")


def test_its_ends_are_those_of_the_posteriors_of_laws_that_have_such_a_shape(model, capsule, experiment):
    low, high = modulus_over_laws(capsule, experiment, model)
    found = {}
    for law in product((1.0, 3.0, 5.0), (0.0, 1.0)):
        known = dict(zip(("area_dilation_modulus", "strain_hardening"), law, strict=True))
        with contextlib.suppress(NoShapeError):
            posterior = Quadrature(model.fixed(**known, pre_inflation=0.0, bending=2e-4), experiment)(capsule)
            found[law] = posterior.marginal("surface_shear_modulus").median
    assert len(found) > 2
    assert low < 0.9 * found[3.0, 0.0] < 1.1 * found[3.0, 0.0] < high
    assert (low, high) == pytest.approx((min(found.values()), max(found.values())), rel=0.2)


def test_a_measurement_that_no_single_shape_explains_has_none(model, capsule, experiment):
    assert modulus_over_laws(replace(capsule, axial_length=None, axial_length_error=None), experiment, model) is None
    assert modulus_over_laws(replace(capsule, axial_extent=6.0), experiment, model) is None


def test_it_is_said_and_kept_in_the_file(capsule, experiment, tmp_path):
    found = identify(capsule, Surrogate.open("square-neo-hookean"), experiment, engine="quadrature", seed=1)
    assert not any("Another membrane law" in sentence for sentence in caveats(found))
    told = replace(found, modulus_over_laws=(0.021, 0.147))
    (sentence,) = (sentence for sentence in caveats(told) if "Another membrane law" in sentence)
    assert "21" in sentence
    assert "147" in sentence
    again = Posterior.read(told.write(tmp_path / "posterior.nc"))
    np.testing.assert_array_equal(again.modulus_over_laws, told.modulus_over_laws)
