"""The error budget compared with error propagation by hand."""

import json
from dataclasses import replace

import numpy as np
import pytest
from membrane_model import RANGES, MembraneModel
from polynomial_model import PolynomialModel

from capsbayes.errors import InputError
from capsbayes.infer import identify
from capsbayes.infer.identify import REST
from capsbayes.measurement import MeasuredOutline, OutlineNoise
from capsbayes.plan import error_budget
from capsbayes.plan.budget import TOGETHER

QUANTITIES = ("surface_shear_modulus", "capsule_radius")


def identified(seen, model, experiment):
    return identify(seen, model, experiment, engine="quadrature", seed=1)


def budget_of(seen, model, experiment):
    return error_budget(identified(seen, model, experiment), model)


@pytest.fixture(scope="module")
def posterior(capsule, model, experiment):
    return identified(capsule, model, experiment)


@pytest.fixture(scope="module")
def budget(posterior, model):
    return error_budget(posterior, model)


def propagated(model):
    """Derivatives of log G_s and log a by (L_z, L_a), from those of the model : (2, 2) array."""
    step, at = 1e-4, np.array([np.log(0.082), 0.96])

    def values(point):
        return model({"capillary_number": np.exp(point[:1]), "size_ratio": point[1:]}).values[0]

    slopes = np.stack([(values(at + e) - values(at - e)) / (2.0 * step) for e in step * np.eye(2)], axis=1)
    modulus = -np.array([1.0, 0.0]) - slopes[2] / 1.29
    return np.stack([modulus, [0.0, 1.0 / 0.96]]) @ np.linalg.inv(slopes[:2])


def test_the_slopes_are_those_of_the_model(budget, model):
    by_length = propagated(model)
    for row, quantity in enumerate(QUANTITIES):
        for column, (name, length) in enumerate({"axial_extent": 2.14, "axial_length": 1.81}.items()):
            assert budget[name].log_slope[quantity] == pytest.approx(by_length[row, column] * length, rel=0.03), name
    for name, of_modulus, of_radius in (("viscosity", 1.0, 0.0), ("capsule_velocity", 1.0, 0.0), ("half_width", 0, 1)):
        assert budget[name].log_slope["surface_shear_modulus"] == pytest.approx(of_modulus, abs=0.003), name
        assert budget[name].log_slope["capsule_radius"] == pytest.approx(of_radius, abs=0.003), name
    row, modulus = budget["viscosity"], budget.value["surface_shear_modulus"]
    assert row.slope["surface_shear_modulus"] == pytest.approx(modulus / 0.85, rel=0.003)
    assert row.change["surface_shear_modulus"] == pytest.approx(0.02 * modulus / 0.85, rel=0.003)


def test_the_shares_add_up_are_the_squares_of_the_changes_and_those_that_identify_prints(posterior, budget):
    for name, share in posterior.shares.items():
        assert budget[name].share["surface_shear_modulus"] == pytest.approx(share), name
    for quantity in QUANTITIES:
        assert sum(row.share[quantity] for row in budget.rows) == pytest.approx(1.0)
        assert abs(budget[REST].share[quantity]) < 0.03
        for name in ("viscosity", "half_width", "capsule_velocity", "axial_extent", "axial_length"):
            square = (budget[name].change[quantity] / budget.value[quantity] / budget.sd[quantity]) ** 2
            assert budget[name].share[quantity] == pytest.approx(square, abs=0.02), name


def test_lengths_in_metres_scale_with_the_channel(capsule, model, experiment):
    """All lengths twice as large are a capsule twice as large, of the same G_s."""
    lengths = ("axial_extent", "axial_extent_error", "axial_length", "axial_length_error")
    metres = replace(capsule, over_half_width=False, **{name: 25e-6 * getattr(capsule, name) for name in lengths})
    budget = budget_of(metres, model, experiment)
    for quantity, power in zip(QUANTITIES, (0.0, 1.0), strict=True):
        total = sum(budget[name].log_slope[quantity] for name in ("axial_extent", "axial_length", "half_width"))
        assert total == pytest.approx(power, abs=0.02), quantity
    assert budget["axial_extent"].setting.unit == "m"
    assert budget["half_width"].share["surface_shear_modulus"] > 0.0


def test_a_length_on_the_axis_that_cannot_grow_is_moved_one_way(capsule, model, experiment):
    full = replace(capsule, axial_extent=1.9, axial_length=1.9)
    budget = budget_of(full, model, experiment)
    assert np.isfinite(budget["axial_length"].log_slope["capsule_radius"])


def test_an_outline_is_one_input(capsule, experiment):
    model = PolynomialModel()
    there = model({"capillary_number": np.array([0.082]), "size_ratio": np.array([0.96])}, outline=True)
    outline = MeasuredOutline(there.outline[0][::4], OutlineNoise(0.006, 0.4, 0.1))
    budget = budget_of(replace(capsule, outline=outline), model, experiment)
    names = [row.name for row in budget.rows]
    assert "outline" in names
    assert not {"axial_extent", "axial_length"} & set(names)
    assert budget["outline"].log_slope == {}
    assert sum(row.share["capsule_radius"] for row in budget.rows) == pytest.approx(1.0)
    assert "L_z and L_a have no separate share" in budget.notes[0]


def test_a_hidden_rear_and_a_border_are_said(capsule, model, experiment):
    budget = budget_of(replace(capsule, axial_length=None, axial_length_error=None), model, experiment)
    assert "L_a was not measured" in budget.notes[0]
    assert "Read the shares with care" in budget.notes[1]
    assert "axial_length" not in [row.name for row in budget.rows]


def test_the_table_and_the_json_hold_everything(budget):
    table = budget.table()
    assert list(table.index) == [row.name for row in budget.rows]
    assert table.loc["viscosity", "d ln G_s / d ln input"] == pytest.approx(1.0, abs=0.003)
    stored = json.loads(json.dumps(budget.as_dict()))
    assert stored["inputs"]["axial_extent"]["unit"] == "l"
    assert stored["status"] == "DONE"


def test_another_model_than_that_of_the_posterior_is_refused(posterior, model):
    with pytest.raises(InputError, match="expected the model of the posterior, manufactured polynomial, got nothing"):
        error_budget(posterior)
    with pytest.raises(InputError, match="give the model that it was identified with"):
        error_budget(posterior, replace(model, sha256="1" * 64))


def test_an_unknown_membrane_has_shares_and_a_known_one_slopes_alike(capsule, experiment):
    """Slopes by the inputs that the shape does not depend on are exact, whatever else is unknown."""
    budget = budget_of(capsule, MembraneModel(shorter=0.2, shallower=0.3), experiment)
    names = [row.name for row in budget.rows]
    assert names[-6:] == [*RANGES, TOGETHER, REST]
    for quantity in QUANTITIES:
        assert sum(row.share[quantity] for row in budget.rows) == pytest.approx(1.0)
    of_modulus = {row.name: row.share["surface_shear_modulus"] for row in budget.rows}
    assert of_modulus["area_dilation_modulus"] > of_modulus["bending"]  # which does nothing here
    assert abs(of_modulus[REST]) < 0.3
    assert budget["viscosity"].log_slope["surface_shear_modulus"] == pytest.approx(1.0, abs=0.01)
    assert any("in place of" in note for note in budget.notes)
