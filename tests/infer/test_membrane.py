"""What is known of a membrane, as a model and a prior."""

from dataclasses import replace

import numpy as np
import pytest
from membrane_model import MembraneModel
from polynomial_model import PolynomialModel

from capsbayes.errors import InputError
from capsbayes.infer import Membrane, Prior, identify
from capsbayes.infer.prior import LAWS, Marginal, refuse_membrane
from capsbayes.physics.membrane import GeneralLaw, NeoHookean, Skalak
from capsbayes.report.posterior import quantity_table
from capsbayes.surrogate import MembraneSurrogate, Surrogate

MEASURED = """experiment = "experiment.toml"
[measurement]
axial_extent = "2.14 +/- 0.02"
capsule_velocity = "6.2 +/- 0.06 mm/s"
"""


ALL_KNOWN = {"area_dilation_modulus": 2.0, "strain_hardening": 0.4, "pre_inflation": 0.01, "bending": 2e-4}


@pytest.fixture(scope="module")
def model():
    return MembraneModel()


def file_with(tmp_path, table):
    path = tmp_path / "capsule.toml"
    path.write_text(f"{MEASURED}[membrane]\n{table}\n")
    return path


def test_nothing_known_leaves_model_and_prior_as_they_are(model):
    prior = Prior(coordinates={"bending": "1e-4 .. 2e-4"})
    same, left = Membrane().applied(model, prior)
    assert same is model
    assert left == prior


def test_known_numbers_are_fixed_and_uncertain_ones_are_priors(model):
    membrane = Membrane(
        area_dilation_modulus=2.0, strain_hardening="0.4", pre_inflation="0.02 +/- 0.01", bending="unknown"
    )
    fixed, prior = membrane.applied(model, Prior())
    assert list(fixed.coordinates) == ["pre_inflation", "bending"]
    theta = {"capillary_number": np.array([0.06]), "size_ratio": np.array([0.9])}
    there = model(theta | {"area_dilation_modulus": np.array([2.0]), "strain_hardening": np.array([0.4])})
    np.testing.assert_array_equal(fixed(theta).values, there.values)
    assert list(prior.coordinates) == ["pre_inflation"]
    assert prior.coordinates["pre_inflation"].cdf(0.02) == pytest.approx(0.5)


@pytest.mark.parametrize("law", ["neo-Hookean", "Skalak"])
def test_a_law_has_the_energy_of_its_name(law):
    """That of the general law at the values of the table; Skalak's with its own K = 1 + 2 C."""
    values = dict(LAWS[law])
    own, modulus = (NeoHookean(), 3.0) if law == "neo-Hookean" else (Skalak(0.7), 2.4)
    general = GeneralLaw(values.pop("area_dilation_modulus", modulus), values["strain_hardening"])
    first, second = np.array([0.3, 0.1]), np.array([0.5, -0.2])
    for here, there in zip(general.derivatives(first, second), own.derivatives(first, second), strict=True):
        np.testing.assert_allclose(here, there, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("hardening", "modulus"), [(1.0, 3.0), ("0.5 +/- 0.1", (2.0, 0.2)), ("0.2 .. 0.6", (1.4, 2.2)), (None, None)]
)
def test_skalak_states_hardening_and_leaves_the_area_modulus_to_its_own_constant(model, hardening, modulus):
    fixed, prior = Membrane("skalak", hardening=hardening).applied(model, Prior())
    assert "strain_hardening" not in fixed.coordinates
    if isinstance(modulus, float):
        assert fixed.values["area_dilation_modulus"] == pytest.approx(modulus)
    elif modulus is None:
        assert "area_dilation_modulus" in fixed.coordinates
        assert not prior.coordinates
    else:
        assert prior.coordinates["area_dilation_modulus"].parameters == pytest.approx(modulus)


def test_the_table_of_a_file_is_the_class_of_the_same_names(tmp_path):
    text = 'law = "Skalak"\nhardening = 1\npre_inflation = "0 .. 0.02"\nmembrane_thickness = "0.6 +/- 0.2 um"'
    read = Membrane.read(file_with(tmp_path, text))
    stated = Membrane("Skalak", hardening=1, pre_inflation="0 .. 0.02", membrane_thickness="0.6 +/- 0.2 um")
    assert [getattr(read, name) for name in ("law", "hardening", "pre_inflation", "membrane_thickness")] == [
        getattr(stated, name) for name in ("law", "hardening", "pre_inflation", "membrane_thickness")
    ]
    plain = tmp_path / "plain.toml"
    plain.write_text(MEASURED)
    assert Membrane.read(plain) is None
    refuse_membrane(plain, "a batch")
    with pytest.raises(InputError, match=r"capsule.toml: membrane: expected no such table in a capsule of a batch"):
        refuse_membrane(tmp_path / "capsule.toml", "a batch")


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({"law": "rubber"}, "law: expected one of unknown, neo-Hookean, Blatz-Ko, Skalak, got 'rubber'"),
        ({"law": "neo-Hookean", "strain_hardening": 0.2}, "strain_hardening: expected nothing, as neo-Hookean"),
        ({"law": "Blatz-Ko", "hardening": 1}, "hardening: expected nothing but with the law Skalak"),
        ({"law": "Skalak", "hardening": 1, "area_dilation_modulus": 3}, "hardening: expected nothing but with"),
        ({"law": "Skalak", "hardening": "log-uniform 0.1 .. 1"}, "hardening: expected a number, a range"),
        ({"bending": 1e-4, "membrane_thickness": "1 um"}, "expected one of the two"),
        ({"bending": "1e-4 .. 3e-4"}, "bending: expected one statement of it"),
        ({"pre_inflation": "soft"}, "pre_inflation: expected a number, a text as"),
        ({"area_dilation_modulus": 9}, "area_dilation_modulus: expected 1 to 5, got 9"),
        ({"membrane_thickness": "0.6"}, "membrane_thickness: expected a number, a text as \"0.6 \\+/- 0.2 um\""),
    ],
)  # fmt: skip
def test_mistakes_are_named(model, stated, message):
    with pytest.raises(InputError, match=message):
        Membrane(**stated).applied(model, Prior(coordinates={"bending": "1e-4 .. 2e-4"}))


def test_a_model_without_these_coordinates_is_refused():
    with pytest.raises(InputError, match=r"expected nothing, as .* does not have it"):
        Membrane("neo-Hookean").applied(Surrogate.open("square-neo-hookean"), Prior())


@pytest.mark.parametrize("flow_rate", [None, "0.63 +/- 0.02 uL/min"])
@pytest.mark.parametrize("stated", [{}, {"area_dilation_modulus": 2.0}, dict(ALL_KNOWN)])
def test_the_area_dilation_modulus_is_that_of_each_draw(model, capsule, experiment, flow_rate, stated):
    """K known or not, with further unknowns or a grid, and with one source of the mean velocity or two."""
    measured = replace(capsule, flow_rate=flow_rate)
    found = identify(
        measured, model, experiment, seed=1, engine="quadrature", membrane=Membrane(**stated), error_budget=False
    )
    assert list(found.marginals)[:2] == ["surface_shear_modulus", "surface_dilation_modulus"]
    draws, marginal = found.draws, found.marginals["surface_dilation_modulus"]
    ratio = draws["surface_dilation_modulus"] / draws["surface_shear_modulus"]
    np.testing.assert_allclose(ratio, draws.get("area_dilation_modulus", 2.0))
    drawn = Marginal.of_draws(draws["surface_dilation_modulus"])
    for end in ("median", "lower_68", "upper_68", "lower_95", "upper_95"):
        assert getattr(marginal, end) == pytest.approx(getattr(drawn, end), abs=0.1 * marginal.sd), end
    assert "K_s [mN/m]" in quantity_table(found).to_string()
    assert found.as_dict()["quantities"]["surface_dilation_modulus"]["unit"] == "N/m"


def test_a_model_without_it_has_no_area_dilation_modulus(capsule, experiment):
    found = identify(capsule, PolynomialModel(), experiment, seed=1, engine="quadrature", error_budget=False)
    assert "surface_dilation_modulus" not in {*found.draws, *found.marginals}


@pytest.mark.parametrize(
    "membrane",
    [
        Membrane("neo-Hookean", pre_inflation=0.0, bending=2e-4),
        Membrane("neo-Hookean", pre_inflation=0.0),
        Membrane("neo-Hookean", pre_inflation=0.0, membrane_thickness="0.6 um"),
        Membrane("neo-Hookean"),
    ],
    ids=["all known", "one unknown", "thickness known", "two unknown"],
)
def test_any_number_of_them_may_be_known(capsule, experiment, membrane):
    found = identify(
        capsule, MembraneSurrogate.open("square"), experiment, engine="quadrature", seed=1, membrane=membrane
    )
    assert all(gate.passed for gate in found.gates), [str(gate) for gate in found.gates]
    assert set(found.prior.uncertain) == {
        name for name in ("pre_inflation", "bending") if getattr(membrane, name) is None
    } - ({"bending"} if membrane.membrane_thickness is not None else set())
