"""The verdict on a posterior that lies next to the ends of the ranges of a membrane's parameters."""

from dataclasses import replace

import numpy as np
import pytest
from membrane_model import RANGES, MembraneModel

from capsbayes.infer.importance import exact_engine
from capsbayes.infer.verdict import ONE_END, RANGE, leanings, range_leanings, shares_by_kind, verdict
from capsbayes.parameters import PARAMETERS
from capsbayes.report.posterior import border_words
from capsbayes.status import Status

NAMES = ("pre_inflation", "area_dilation_modulus", "strain_hardening", "bending")


@pytest.fixture(scope="module")
def model():
    return MembraneModel()


@pytest.fixture(scope="module")
def prior(model, experiment):
    """The prior with the ranges of the model for what is not stated."""
    return exact_engine(model, experiment).prior


def draws(**places):
    """Return draws of a narrow posterior inside the model, its further coordinates at shares of their ranges.

    The share is that from the lower to the upper end where the density is highest; None for one as the prior.
    """
    random, made = np.random.default_rng(1), {}
    for name, ends in RANGES.items():
        place, share = places.get(name, 0.5), random.uniform(size=20_000)
        if place is not None:  # narrow, and folded back at the ends
            share = np.abs(place + 0.05 * random.standard_normal(20_000))
            share = np.where(share > 1.0, 2.0 - share, share)
        low, high = (np.log(ends.low), np.log(ends.high)) if ends.logarithmic else (ends.low, ends.high)
        made[name] = np.exp(low + share * (high - low)) if ends.logarithmic else low + share * (high - low)
    made["capillary_number"] = 0.05 * np.exp(0.01 * random.standard_normal(20_000))
    made["size_ratio"] = 0.9 * np.exp(0.001 * random.standard_normal(20_000))
    made["surface_shear_modulus"] = 0.05 * np.exp(0.01 * random.standard_normal(20_000))
    made["capsule_radius"] = 25e-6 * np.exp(0.001 * random.standard_normal(20_000))
    return made


@pytest.fixture(scope="module")
def status(model, prior):
    return lambda **places: verdict((), None, leanings(draws(**places), model, prior))


@pytest.mark.parametrize(
    ("places", "wanted"),
    [
        ({}, Status.DONE),
        ({"bending": 1.0}, Status.DONE),
        ({"area_dilation_modulus": 0.0, "bending": 1.0}, Status.LEANS_ON_BORDER),
        ({"area_dilation_modulus": 0.0, "bending": 1.0, "strain_hardening": 1.0}, Status.LEANS_ON_BORDER),
    ],
)
def test_a_posterior_at_the_ends_of_several_ranges_leans_on_the_border(status, places, wanted):
    """As that of the real capsule in a tube: every one of them looks narrow, and none is where the model has more."""
    assert status(**places) is wanted


def test_a_parameter_that_the_data_do_not_tell_fills_its_range(prior, status):
    assert range_leanings(draws(**dict.fromkeys(NAMES)), RANGES, prior.uncertain) == {}
    assert status(**dict.fromkeys(NAMES)) is Status.DONE


def test_a_neo_hookean_membrane_without_inflation_is_at_no_border(prior, status):
    """No inflation and no hardening are ends of ranges, and the null values of the model."""
    found = range_leanings(draws(pre_inflation=0.0, strain_hardening=0.0), RANGES, prior.uncertain)
    assert found[f"{RANGE}pre_inflation"] < 0.01
    assert found[f"{RANGE}strain_hardening"] < 0.01
    assert status(pre_inflation=0.0, strain_hardening=0.0) is Status.DONE


def test_bending_of_a_known_thickness_has_no_range(prior):
    by_thickness = replace(prior, coordinates={name: prior.coordinates[name] for name in NAMES if name != "bending"})
    assert f"{RANGE}bending" not in range_leanings(draws(bending=1.0), RANGES, by_thickness.uncertain)


@pytest.mark.parametrize(
    ("name", "turned", "piles_up"),
    [
        ("bending", True, True),
        ("area_dilation_modulus", False, True),
        ("strain_hardening", True, True),
        ("strain_hardening", False, False),
        ("pre_inflation", False, False),
    ],
)
def test_a_wide_posterior_that_piles_up_on_one_end_is_said_and_none_at_a_null_value(
    prior, status, model, name, turned, piles_up
):
    """Its density falls to a tenth from one end of the range to the other, so that it is as wide as half the prior."""
    share = -np.log1p(-0.9 * (np.arange(20_000) + 0.5) / 20_000) / np.log(10.0)
    ends, drawn = RANGES[name], draws(**dict.fromkeys(NAMES))
    share = 1.0 - share if turned else share
    drawn[name] = ends.low * (ends.high / ends.low) ** share if ends.logarithmic else ends.high * share
    found = range_leanings(drawn, RANGES, prior.uncertain)
    assert list(found) == ([f"{ONE_END}{name}"] if piles_up else [])
    assert all(share > 0.2 for share in found.values())
    assert verdict((), None, leanings(drawn, model, prior)) is Status.DONE
    words = f"next to the end of the range of the model in {PARAMETERS[name].symbol}."
    assert any(words in sentence for sentence in border_words(found)) is piles_up


def test_the_share_of_several_ranges_is_the_second_largest():
    leans = {"model": 0.01, "prior of surface_shear_modulus": 0.0, f"{RANGE}bending": 0.4}
    assert shares_by_kind(leans)[0] == 0.01
    assert shares_by_kind(leans | {f"{RANGE}area_dilation_modulus": 0.2})[0] == 0.2
