"""Figures of plans and of simulated capsules."""

import numpy as np
import pytest
import xarray as xr
from matplotlib.collections import PolyCollection
from polynomial_model import PolynomialModel

from capsbayes import Simulator
from capsbayes.experiment import Experiment
from capsbayes.infer import Membrane, identify
from capsbayes.measurement import Measurement
from capsbayes.physics.stokes import WallDiscretisation
from capsbayes.plan import (
    LabErrors,
    SobolIndex,
    SobolStudy,
    error_budget,
    flow_design,
    identifiability_map,
    membrane_flow_design,
)
from capsbayes.quantity import Quantity
from capsbayes.report import budget_figure, flow_figure, identifiability_figure, sobol_figure
from capsbayes.report.plan import membrane_flow_figure, membrane_map_figure
from capsbayes.report.simulation import shape_figure, transient_figure
from capsbayes.status import Status

LAB = Experiment(cross_section="square", half_width=25e-6, viscosity=Quantity(0.85, 0.02))
ERRORS = LabErrors(axial_extent=0.01, axial_length=0.01, capsule_velocity=0.01)


def drawn(figure):
    figure.canvas.draw()
    return figure


def test_the_budget_has_a_bar_for_each_input_and_quantity():
    seen = Measurement(2.14, 0.01, 5e-3, 5e-5, 1.81, 0.01)
    model = PolynomialModel()
    budget = error_budget(identify(seen, model, LAB, engine="quadrature", seed=1), model)
    left, right = drawn(budget_figure(budget)).axes
    assert len(left.patches) == 2 * len(budget.rows)
    widths = sorted(patch.get_width() for patch in left.patches[: len(budget.rows)])
    assert widths == pytest.approx(sorted(100 * row.share["surface_shear_modulus"] for row in budget.rows))
    labels = [label.get_text() for label in left.get_yticklabels()]
    assert r"$\mu$, viscosity of the suspending liquid" in labels
    assert "$L_z$, maximum extension along the flow" in labels
    assert "standard error" in right.get_xlabel()


def test_sobol_indices_have_bars_alone_and_with_others():
    index = {"viscosity": SobolIndex(0.2, 0.05, 0.3, 0.05), "axial_extent": SobolIndex(0.7, 0.1, 0.8, 0.1)}
    answers = ("surface_shear_modulus", "capsule_radius")
    ranges = {"viscosity": Quantity(0.85, 0.02), "axial_extent": Quantity.uniform(2.1, 2.2)}
    one, tenth = dict.fromkeys(answers, 1.0), dict.fromkeys(answers, 0.1)
    counted = {"samples": 32, "outside": 0, "change": 0.0, "groups": 8, "seed": 1, "notes": ()}
    named = {"model_name": "", "model_sha256": "", "status": Status.DONE}
    study = SobolStudy(ranges=ranges, indices=dict.fromkeys(answers, index), mean=one, sd=tenth, **counted, **named)
    first, _ = drawn(sobol_figure(study)).axes
    assert [patch.get_width() for patch in first.patches] == [0.2, 0.7, 0.3, 0.8]
    assert [label.get_text() for label in first.get_yticklabels()] == [r"$\mu$", "$L_z$"]


def test_the_map_shows_its_border_and_its_errors():
    found = identifiability_map(PolynomialModel(), LAB, ERRORS, grid=(6, 5), noises=0)
    figure = drawn(identifiability_figure(found))
    ax, bar = figure.axes
    assert (ax.get_xlabel(), ax.get_ylabel(), ax.get_xscale()) == (r"$\mathrm{Ca}$ [-]", r"$a/\ell$ [-]", "log")
    assert r"0.01 $\ell$" in ax.get_title()
    assert "68 %" in bar.get_ylabel()
    widths = 100.0 * found["width_of_surface_shear_modulus"]
    assert bar.get_ylim()[0] <= widths.min() < widths.max() <= bar.get_ylim()[1]  # the colours leave no number out
    assert ax.collections[0].extend == "neither"
    border = ax.patches[0].get_xy()
    np.testing.assert_allclose([border[:, 1].min(), border[:, 1].max()], [0.70, 1.15])


def test_the_flow_is_drawn_in_both_units_with_its_limit():
    design = flow_design(0.05, 24e-6, LAB, ERRORS, PolynomialModel(), seed=1, noises=0)
    figure = drawn(flow_figure(design))
    upper, lower = figure.axes
    assert f"{1e3 * design.best.mean_velocity:.3g} mm/s" in upper.get_title()
    assert "µL/min" in upper.get_title()
    assert lower.get_xlabel() == "$U$ [mm/s]"
    limit = [line.get_xdata()[0] for line in lower.lines if line.get_linestyle() == "--"]
    assert limit == pytest.approx([1e3 * design.limit_velocity])
    assert any("the end of the database" in text.get_text() for text in lower.get_legend().get_texts())


def test_the_flow_rates_of_a_batch_are_drawn_with_what_they_tell():
    membrane = Membrane("neo-Hookean", bending=1e-4)
    expected = "50 +/- 5 mN/m", "23 +/- 1 um", LAB, ERRORS
    design = membrane_flow_design(*expected, seed=1, membrane=membrane, capsules=4, velocities=(2e-3, 4e-3))
    upper, lower = drawn(membrane_flow_figure(design)).axes
    np.testing.assert_allclose(upper.lines[0].get_xdata(), [2.0, 4.0])
    sd = 100.0 * design.best.sds["surface_shear_modulus"]
    assert [label.get_text() for label in upper.get_yticklabels()] == [f"2: ± {sd:.2g} %"]
    assert lower.get_xlabel() == "$U$ [mm/s]"
    without = lower.lines[0].get_ydata()
    np.testing.assert_allclose(without, [100.0 * risk.without_shape for risk in design.risks])


def test_the_map_of_an_unknown_membrane_has_a_panel_for_each_measurement_and_membrane():
    ca, size = np.geomspace(0.01, 0.1, 5), np.linspace(0.8, 1.0, 3)
    plane = np.linspace(0.02, 0.6, 15).reshape(3, 5)
    names = [f"{known}_{kind}" for kind in ("lengths", "outline") for known in ("unknown", "known")]
    places = {"capillary_number": ca, "size_ratio": size}
    values = dict.fromkeys(names, (("size_ratio", "capillary_number"), plane))
    values |= {end: ("size_ratio", np.full(3, at)) for end, at in (("lowest", 0.01), ("highest", 0.1))}
    axes = drawn(membrane_map_figure(xr.Dataset(values, places))).axes
    assert axes[4].get_ylim() == (2.0, 70.0)
    titles = [ax.get_title() for ax in axes[:4]]
    assert titles == [f"{seen}, membrane {known}" for seen in ("lengths", "outlines") for known in ("unknown", "known")]
    assert "ln" in axes[4].get_ylabel()
    np.testing.assert_allclose(axes[0].patches[0].get_xy()[:, 1].max(), 1.0)


@pytest.fixture(scope="module", params=["square", "circular"])
def moment(request):
    walls = WallDiscretisation(spacing=0.16, far_spacing=0.3, end=2.5)
    simulator = Simulator(refinement=4, cross_section=request.param, walls=walls)
    return next(simulator.transient(capillary_number=0.1, size_ratio=0.8, until=1.0))


def collections(figure):
    figure.draw_without_rendering()
    channel, membrane = (child for child in figure.axes[0].get_children() if isinstance(child, PolyCollection))
    return channel, membrane


def test_a_shape_is_drawn_in_the_colours_of_its_tensions():
    state = Simulator(refinement=4, bending=1e-3).run(capillary_number=0.05, size_ratio=0.8)
    figure = drawn(shape_figure(state))
    (membrane,) = (child for child in figure.axes[2].get_children() if isinstance(child, PolyCollection))
    tensions, largest = membrane.get_array(), state.principal_tensions.max()
    assert 0.9 * largest < tensions.max() <= membrane.get_clim()[1] == largest
    centres = np.array([path.vertices[:3].mean(axis=0) for path in membrane.get_paths()])
    assert np.ptp(centres[:, 0]) > 0.8 * np.ptp(state.profile.points[:, 0])
    foremost = centres[:, 0] > np.quantile(centres[:, 0], 0.9)
    assert tensions[foremost].mean() > 1.5 * tensions[~foremost].mean()  # the nose bears most
    assert f"at most {largest:.3f}" in figure.axes[2].get_title()


def test_every_moment_has_a_view_with_its_time(moment):
    figure = transient_figure([moment] * 3)
    assert [ax.get_title() for ax in figure.axes] == [rf"({letter})   $Ut/\ell = 0$" for letter in "abc"]
    assert (
        figure.axes[0].texts[-1].get_text()
        == r"$L_z/\ell = 1.60$,   $v_\mathrm{o}/U = " + f"{moment.velocity_ratio:.2f}$"
    )


def test_a_sphere_looks_round_lit_from_above_and_half_of_the_walls_is_behind_it(moment):
    channel, membrane = collections(transient_figure([moment]))
    centres = np.array([path.vertices[:3].mean(axis=0) for path in membrane.get_paths()])
    assert np.hypot(*centres.T).max() == pytest.approx(0.8, rel=0.01)
    brightness = membrane.get_facecolor()[:, :3].sum(axis=1)
    assert brightness[centres[:, 1] > 0.4].mean() > 1.3 * brightness[centres[:, 1] < -0.4].mean()
    pieces = 8 * len(moment.channel.outline(0.005, 0.0)[0])
    assert len(channel.get_paths()) == pieces / 2
    assert channel.get_zorder() < membrane.get_zorder()
