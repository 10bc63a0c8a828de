from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from polynomial_model import PolynomialModel

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.infer import identify
from capsbayes.infer.outline import band
from capsbayes.infer.posterior import DeterministicAnswer
from capsbayes.measurement import Measurement
from capsbayes.quantity import Quantity
from capsbayes.report import corner_plot, outline_figure, outline_plot


@pytest.fixture(scope="module")
def posterior():
    experiment = Experiment(cross_section="square", half_width=Quantity(25e-6, 0.2e-6), viscosity=Quantity(0.85, 0.02))
    seen = Measurement(2.14, 0.01, 5e-3, 5e-5, 1.81, 0.01)
    return identify(seen, PolynomialModel(), experiment, engine="quadrature", seed=1)


def texts(ax):
    return [text.get_text() for text in ax.texts]


def test_the_corner_plot_shows_every_pair_with_units_and_intervals(posterior):
    figure = corner_plot(posterior)
    axes = {ax.get_label(): ax for ax in figure.axes}
    assert len(axes) == 15
    assert axes["size_ratio surface_shear_modulus"].get_xlabel() == r"$G_\mathrm{s}$ [mN/m]"
    assert axes["capsule_radius surface_shear_modulus"].get_ylabel() == "$a$ [µm]"
    one = posterior.marginals["capsule_radius"]
    assert axes["capsule_radius"].get_title().startswith(f"$a = {1e6 * one.median:.2f}_{{-")
    assert axes["capsule_radius"].get_title().endswith("µm")
    (lines,) = (of for of in axes["capsule_radius"].collections if isinstance(of, LineCollection))
    shown = [line[0, 0] for line in lines.get_segments()]
    np.testing.assert_allclose(shown, [1e6 * one.lower_68, 1e6 * one.median, 1e6 * one.upper_68])
    low, high = axes["capillary_number"].get_xlim()
    assert low < posterior.marginals["capillary_number"].lower_95 < high
    assert figure.legends == []
    ax = next(of for of in corner_plot(posterior).axes if of.get_label() == "size_ratio capillary_number")
    draws = np.stack([np.ravel(posterior.draws[name]) for name in ("capillary_number", "size_ratio")], axis=1)
    _, outlines = (of for of in ax.collections if isinstance(of, ContourSet))
    held = [path.contains_points(draws).mean() for path in outlines.get_paths()]
    np.testing.assert_allclose(held, [0.95, 0.68], atol=0.02)


def test_the_corner_plot_marks_the_deterministic_answer_and_what_has_no_spread(posterior):
    answer = DeterministicAnswer(0.041, 24e-6, 3.88e-3, 0.081, 0.959, 1.29)
    figure = corner_plot(replace(posterior, deterministic=answer), ("surface_shear_modulus", "size_ratio"))
    pair = next(ax for ax in figure.axes if ax.get_label() == "size_ratio surface_shear_modulus")
    (marker,) = (line for line in pair.lines if line.get_marker() == "D")
    np.testing.assert_allclose([marker.get_xdata()[0], marker.get_ydata()[0]], [41.0, 0.959])
    assert "deterministic" in figure.legends[0].get_texts()[0].get_text()
    fixed = np.full_like(posterior.draws["size_ratio"], 0.9)
    same = replace(posterior, draws=posterior.draws | {"size_ratio": fixed})
    ax = corner_plot(same, ("capillary_number", "size_ratio")).axes[-1]
    low, high = ax.get_xlim()
    assert low < 0.9 < high


def test_the_band_lies_along_the_normal():
    angle = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    radii = np.random.default_rng(1).normal(2.0, 0.1, 4000)
    middle, inner, outer = band(radii[:, None, None] * circle)
    np.testing.assert_allclose(np.hypot(*middle.T), radii.mean())
    np.testing.assert_allclose(np.hypot(*inner.T), np.quantile(radii, 0.025), rtol=1e-6)
    np.testing.assert_allclose(np.hypot(*outer.T), np.quantile(radii, 0.975), rtol=1e-6)


def test_the_outline_is_drawn_with_walls_lengths_and_both_scales(posterior):
    figure = outline_figure(posterior)
    ax = figure.axes[0]
    assert ax.get_xlabel() == r"$z/\ell$"
    assert any("2.140" in text and "0.010" in text for text in texts(ax))
    assert any("1.810" in text for text in texts(ax))
    horizontal = [line.get_ydata()[0] for line in ax.lines if np.ptp(line.get_ydata()) == 0.0]
    assert {-1.0, 1.0} <= set(horizontal)
    (scale,) = ax.child_axes
    assert "25 µm" in scale.get_xlabel()
    figure.draw_without_rendering()
    np.testing.assert_allclose(scale.get_xlim(), np.multiply(25.0, ax.get_xlim()), rtol=1e-3)
    assert {text.get_text() for text in ax.get_legend().get_texts()} == {
        "predicted outline", "95 % of the posterior", "measured, ±2 standard errors"
    }  # fmt: skip
    pixels = ax.get_window_extent()
    wide, high = np.ptp(ax.get_xlim()), np.ptp(ax.get_ylim())
    assert pixels.width / pixels.height == pytest.approx(wide / high, rel=1e-3)


def test_lengths_in_metres_are_drawn_over_l_and_missing_ones_are_not(posterior):
    seen = posterior.measurement
    names = ("axial_extent", "axial_extent_error", "axial_length", "axial_length_error")
    lengths = {name: 25e-6 * getattr(seen, name) for name in names}
    in_metres = replace(seen, **lengths, over_half_width=False)
    ax = outline_figure(replace(posterior, measurement=in_metres)).axes[0]
    assert any("2.140" in text for text in texts(ax))
    seen = replace(posterior.measurement, axial_length=None, axial_length_error=None)
    ax = outline_plot(replace(posterior, measurement=seen), Figure().subplots())
    assert not any("mathrm{a}" in text for text in texts(ax))
    with pytest.raises(InputError, match="expected a posterior with outlines"):
        outline_figure(replace(posterior, outlines=None))
