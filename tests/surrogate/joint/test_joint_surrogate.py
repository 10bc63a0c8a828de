"""The shipped effect databases as forward models with one more coordinate."""

from __future__ import annotations

import numpy as np
import pytest

from capsbayes.database import NO_EFFECT, Database
from capsbayes.errors import OutsideDatabaseError
from capsbayes.surrogate import Surrogate

QUANTITIES = ("axial_extent", "axial_length", "velocity_ratio")
EFFECTS = [name for name in Database.shipped() if Database.open(name).effect != NO_EFFECT]


@pytest.fixture(scope="module", params=EFFECTS)
def model(request):
    return Surrogate.open(request.param)


def points(model, count=300):
    """Random points of the domain at the null value."""
    (ca_low, ca_high), (size_low, size_high) = model.domain.bounds
    ca, size = np.random.default_rng(1).uniform([ca_low, size_low], [ca_high, size_high], (4 * count, 2)).T
    inside = model.domain.contains(ca, size)
    return {"capillary_number": ca[inside][:count], "size_ratio": size[inside][:count]}


def test_at_the_null_value_it_is_the_base(model):
    where = points(model)
    found, base = model(where, outline=True), model.base(where, outline=True)
    both = found.inside & base.inside
    assert both.sum() > 200
    np.testing.assert_allclose(found.values[both], base.values[both], atol=1e-10)
    np.testing.assert_allclose(found.outline[both], base.outline[both], atol=1e-10)
    np.testing.assert_array_equal(
        model(where | {model.coordinate: np.full(len(both), model.domain.ends.null_value)}).inside, found.inside
    )


def test_at_a_stored_value_it_differs_from_the_base_as_the_cases_differ(model):
    """By the difference of two cases on the same coarse mesh: exactly, but near a border that moves with the value."""
    database = model.effect_database
    null, compared = database.at_value(database.null_value).converged, 0
    known = dict(zip(zip(null["capillary_number"], null["size_ratio"], strict=True), range(len(null)), strict=True))
    for value in database.values:
        cases = database.at_value(float(value)).converged
        pairs = [
            (row, known[case])
            for row, case in enumerate(zip(cases["capillary_number"], cases["size_ratio"], strict=True))
            if case in known
        ]
        rows, nulls = np.array(pairs).T
        deep = (cases["parachute_depth"][rows] > 0.15) & (null["parachute_depth"][nulls] > 0.15)
        rows, nulls = rows[deep], nulls[deep]
        where = {name: cases[name][rows] for name in ("capillary_number", "size_ratio")}
        found, base = model(where | {model.coordinate: np.full(len(rows), value)}), model.base(where)
        both = found.inside & base.inside
        if both.sum() < 20:
            continue
        compared += 1
        change = np.stack([cases[name][rows] - null[name][nulls] for name in QUANTITIES], axis=1)
        error = np.abs(found.values - base.values - change)[both]
        sd = np.sqrt(found.covariance[both][:, range(3), range(3)])
        assert np.median(error, axis=0).max() < 1e-3
        assert np.mean(error < 2 * sd) > 0.97
    assert compared > 2


def test_its_error_grows_away_from_the_stored_values(model):
    values = model.effect_database.values
    one = {name: value[:50] for name, value in points(model).items()}

    def error(value):
        found = model(one | {model.coordinate: np.full(50, value)})
        return np.sqrt(np.nanmean(found.covariance[:, 2, 2]))

    assert error(0.5 * (values[0] + values[1])) > error(model.domain.ends.null_value)


def test_a_value_outside_is_refused_with_the_range(model):
    low, high = model.coordinates[model.coordinate][:2]
    with pytest.raises(OutsideDatabaseError, match=f"at {model.coordinate} = "):
        model.at(capillary_number=0.06, size_ratio=0.9, **{model.coordinate: high + 0.1 * (high - low)})


def test_a_fixed_value_is_a_plain_model(model):
    where, value = points(model, 50), float(model.effect_database.values[-1])
    there = model(where | {model.coordinate: np.full(50, value)})
    plain = model.fixed(**{model.coordinate: value})
    np.testing.assert_array_equal(plain(where).values, there.values)
    np.testing.assert_array_equal(plain.domain.contains(where["capillary_number"], where["size_ratio"]), there.inside)
    assert (dict(plain.coordinates), plain.cross_section, plain.view) == ({}, model.cross_section, model.view)
    caveats = model.caveats(where | {model.coordinate: np.full(50, value)})
    assert plain.caveats(where).keys() == caveats.keys()
    for kind, concerned in plain.caveats(where).items():
        np.testing.assert_array_equal(concerned, caveats[kind])


def test_modes_of_the_outline_at_the_null_value_are_those_of_the_base(model):
    one = {"capillary_number": 0.06, "size_ratio": 0.9}
    found, base = model.outline_modes(**one), model.base.outline_modes(**one)
    np.testing.assert_allclose(found.T @ found, base.T @ base, atol=1e-12)
    with pytest.raises(OutsideDatabaseError):
        model.outline_modes(capillary_number=0.5, size_ratio=0.9)


def test_modes_of_the_outline_say_what_the_covariance_of_the_lengths_says(model):
    """The length on the axis is the place of the nose less that of the rear."""
    one, (first, second) = {"capillary_number": 0.06, "size_ratio": 0.9}, model.effect_database.values[:2]
    held = model.fixed(**{model.coordinate: 0.6 * first + 0.4 * second})
    modes = held.outline_modes(**one)
    outline = model.at(**one, **held.values, outline=True).outline[0]
    on_axis = np.abs(outline[:, 1]) < 0.02
    nose, rear = (np.flatnonzero(on_axis & (sign * outline[:, 0] > 0.0)) for sign in (1.0, -1.0))
    change = modes[:, nose].mean(axis=1) + modes[:, rear].mean(axis=1)
    said = held({name: np.array([value]) for name, value in one.items()}).covariance[0, 1, 1]
    assert 0.5 < np.sqrt(np.sum(change**2) / said) < 2.0
    assert np.sum(modes**2) > np.sum(model.outline_modes(**one) ** 2)


def test_slices_that_start_above_the_convex_shapes_of_the_base_are_read_at_one_ca():
    """Their lowest Ca is that of the computation, not where the base's parachutes begin."""
    surrogate = Surrogate.open("square-corner-radius")
    places = surrogate._corresponding(np.array([0.05]), np.array([0.88]), np.array([0.05]))[1]
    np.testing.assert_allclose(places, 0.05, rtol=1e-3)
    between = surrogate.at(capillary_number=0.05, size_ratio=0.88, corner_radius=0.05)
    assert np.sqrt(between.covariance[0, 0, 0]) < 0.003
