"""The range of G_s over the laws of a membrane, next to posteriors with these laws."""

from dataclasses import replace

import numpy as np
import pytest

from capsbayes.infer import Posterior, Quadrature, identify
from capsbayes.infer.other_laws import modulus_over_laws
from capsbayes.measurement import Measurement
from capsbayes.show.words.posterior import caveats
from capsbayes.surrogate import MembraneSurrogate, Surrogate


@pytest.fixture(scope="module")
def model():
    return MembraneSurrogate.open("square")


@pytest.fixture(scope="module")
def sharp(model):
    """Lengths of a neo-Hookean capsule, measured well."""
    there = model.at(capillary_number=0.035, size_ratio=0.9)
    extent, length = float(there.axial_extent[0]), float(there.axial_length[0])
    return Measurement(extent, 0.004, 5e-3, 5e-5, axial_length=length, axial_length_error=0.004)


def test_its_ends_are_the_moduli_of_the_softest_and_the_hardest_law(model, sharp, experiment):
    low, high = modulus_over_laws(sharp, experiment, model)
    ends = {"soft": (1.0, 0.0), "usual": (3.0, 0.0), "hard": (5.0, 1.0)}
    null = {"pre_inflation": 0.0, "bending": 2e-4}
    found = {
        name: Quadrature(model.fixed(area_dilation_modulus=area, strain_hardening=hardening, **null), experiment)(sharp)
        for name, (area, hardening) in ends.items()
    }
    soft, usual, hard = (found[name].marginal("surface_shear_modulus").median for name in ends)
    assert low < 0.9 * usual < 1.1 * usual < high
    assert low == pytest.approx(hard, rel=0.1)
    assert high == pytest.approx(soft, rel=0.1)


def test_a_measurement_that_no_single_shape_explains_has_none(model, sharp, experiment):
    assert modulus_over_laws(replace(sharp, axial_length=None, axial_length_error=None), experiment, model) is None
    assert modulus_over_laws(replace(sharp, axial_extent=6.0), experiment, model) is None


def test_it_is_said_and_kept_in_the_file(sharp, experiment, tmp_path):
    found = identify(sharp, Surrogate.open("square-neo-hookean"), experiment, engine="quadrature", seed=1)
    assert not any("Other laws" in sentence for sentence in caveats(found))
    told = replace(found, modulus_over_laws=(0.021, 0.147))
    (sentence,) = (sentence for sentence in caveats(told) if "Other laws" in sentence)
    assert "21" in sentence
    assert "147" in sentence
    again = Posterior.read(told.write(tmp_path / "posterior.nc"))
    np.testing.assert_array_equal(again.modulus_over_laws, told.modulus_over_laws)
