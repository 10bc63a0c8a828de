"""Results show themselves in one line at a prompt and as a table in a notebook."""

from __future__ import annotations

import numpy as np

import capsbayes as cb
from capsbayes.plan.budget import BudgetRow, ErrorBudget
from capsbayes.plan.sobol import SobolStudy
from capsbayes.readable import Readable

EXPERIMENT = cb.Experiment("square", "25 +/- 0.2 um", "0.85 +/- 0.02 Pa s", frame_rate="2 kHz", source="<lab>.toml")
MEASUREMENT = cb.Measurement(
    axial_extent="2.14 +/- 0.01", capsule_velocity="5.00 +/- 0.05 mm/s", axial_length="1.81 +/- 0.01",
    flow_rate="0.6 uL/min",
)  # fmt: skip


def test_an_experiment_and_a_measurement_show_their_numbers_in_the_units_that_people_read():
    line = (
        "<Experiment: cross_section square; half_width 25 +/- 0.2 µm; viscosity 0.85 +/- 0.02 Pa s; frame_rate 2000 1/s"
    )
    assert repr(EXPERIMENT) == line + "; source <lab>.toml>"
    line = "<Measurement: axial_extent 2.14 +/- 0.01 l; axial_length 1.81 +/- 0.01 l; capsule_velocity 5 +/- 0.05 mm/s"
    assert repr(MEASUREMENT) == line + "; flow_rate 0.6 µL/min>"
    in_metres = cb.Measurement(axial_extent="53.5 +/- 0.3 um", capsule_velocity="5.00 +/- 0.05 mm/s")
    assert "axial_extent 53.5 +/- 0.3 µm" in repr(in_metres)
    assert "status No capsule was found" in repr(cb.Measurement.refused(cb.Status.NO_CAPSULE, source="one.png"))
    table = EXPERIMENT._repr_html_()
    assert "<td>25 +/- 0.2 µm</td>" in table
    assert "&lt;lab&gt;.toml" in table


def test_a_posterior_of_a_population_shows_medians_and_intervals():
    rng = np.random.default_rng(1)
    names = ("surface_shear_modulus", "capsule_radius", "modulus_spread")
    draws = {
        name: np.exp(rng.normal(np.log(scale), 0.01, 500))
        for name, scale in zip(names, (0.05, 24e-6, 0.2), strict=True)
    }
    found = cb.Hierarchy(draws, {}, {}, 30, None, 0.0, (), 1)
    assert repr(found).startswith("<Hierarchy: capsules 30; surface_shear_modulus 5")
    assert "mN/m" in found._repr_html_()


def test_what_a_person_meets_at_a_prompt_is_readable():
    for kind in (cb.Experiment, cb.Measurement, cb.Population, cb.Hierarchy, cb.Study, ErrorBudget, SobolStudy):
        assert issubclass(kind, Readable)
        assert kind.__repr__ is Readable.__repr__


def test_an_error_budget_shows_shares_only_if_they_add_up():
    def shown(*shares):
        rows = tuple(
            BudgetRow(name, None, {"surface_shear_modulus": share}, {}, {})
            for name, share in zip(("viscosity", "axial_extent"), shares, strict=True)
        )
        return repr(ErrorBudget(rows, {}, {"surface_shear_modulus": 0.045}, (), "model", "", cb.Status.DONE))

    assert shown(0.4, 0.6) == "<ErrorBudget: sd of ln G_s 0.045; viscosity 40 %; axial_extent 60 %>"
    assert shown(1.4, 0.2) == "<ErrorBudget: sd of ln G_s 0.045>"


def test_a_model_shows_its_name_and_range():
    shown = "<Surrogate square-neo-hookean: Ca 0.003 to 0.15; a/l 0.7 to 1.15; mid-plane>"
    assert repr(cb.Surrogate.open("square-neo-hookean")) == shown
    assert repr(cb.MembraneSurrogate.open("square")).endswith("; strain_hardening; bending>")
