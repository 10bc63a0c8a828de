"""Page, terminal and figures of a posterior say what was found, its caveats, and where it comes from."""

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
import scipy.stats
from drawn import drawn
from markupsafe import Markup
from matplotlib.collections import LineCollection
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from printed import assert_same, plain
from results import posterior

import capsbayes as cb
from capsbayes.errors import InputError
from capsbayes.image.files import Picture
from capsbayes.image.measure import detect
from capsbayes.image.overlay import PREDICTED, overlay
from capsbayes.infer.checks import Agreement, Gate
from capsbayes.infer.identify import REST
from capsbayes.infer.outline import band
from capsbayes.infer.posterior import DeterministicAnswer
from capsbayes.measurement import MeasuredOutline, OutlineNoise
from capsbayes.model import TWO_SHAPES
from capsbayes.report import corner_plot, outline_figure, outline_plot
from capsbayes.report.numbers import value_words
from capsbayes.report.posterior import (
    budget_sentence,
    caveats,
    comparison_table,
    posterior_parts,
    sensitivity_words,
    status_words,
    update_words,
)
from capsbayes.report.posterior_figures import (
    capsule_pictures,
    corner_of_few,
    densities_figure,
    on_picture,
    posterior_page,
)
from capsbayes.status import Status


@pytest.fixture(scope="module")
def page():
    return posterior_page(posterior())


def test_the_page_has_each_part_and_the_error_budget_of_the_posterior(page, tmp_path):
    text, one = plain(page), posterior()
    parts = (
        value_words("surface_shear_modulus", one.marginals["surface_shear_modulus"]).replace("_", ""),
        "The interval is valid if the membrane is one of those of the model manufactured polynomial.",
        value_words("capsule_radius", one.marginals["capsule_radius"]),
        "The capsule",
        "All quantities",
        "Error budget",
        f"({100.0 * max(one.shares.values()):.0f} % of the variance of ln Gs)",
        "Inputs",
        "25.00 ± 0.20 µm",
        "Priors",
        "log-uniform from 0.1 to 10000 mN/m",
        "Checks of the computation",
        "Origin",
        "capsule.toml" + "ab" * 32,
        "manufactured polynomial" + "0" * 64,
        "quadrature",
        "seed3",
        f"version {cb.__version__}",
        "How to cite",
        "10.1177/1081286520977602",
    )
    places = [text.index(part) for part in parts]
    assert places == sorted(places)
    assert page.count("<img") == 2  # outline and corner
    for share in one.shares.values():
        assert f">{100.0 * share:.1f} %<" in page
    assert page.count('class="bar') == len(one.shares)
    assert posterior_page(cb.Posterior.read(one.write(tmp_path / "posterior.nc"))) == page


def test_shares_that_do_not_add_up_are_not_printed_as_shares():
    longer = {"axial_length": -0.01, "outline": 0.91, REST: 0.1}
    for shares in ({"outline": 1.17, REST: -0.17}, longer, {"outline": 0.3}):
        odd = replace(posterior(), shares={REST: 1.0 - sum(shares.values())} | shares)
        assert budget_sentence(odd) == "The largest contribution to the uncertainty of G_s is the measured outline."
        assert 'class="bar' not in posterior_page(odd)
        assert not any("share of the variance" in str(part) for part in posterior_parts(odd))


def test_intervals_are_valid_for_the_law_of_the_model():
    for model, membrane in (
        ("square-neo-hookean", "is neo-Hookean"),
        ("circular-skalak-c-1 (silhouettes)", "obeys Skalak's law with C = 1"),
        ("square-neo-hookean with pre_inflation", "is neo-Hookean"),
        ("square-neo-hookean with hooke_share", "is one of those of the model square-neo-hookean with hooke_share"),
        ("square-membrane at pre_inflation = 0.02", "obeys one of the model's laws"),
        ("square-membrane at area_dilation_modulus = 3, strain_hardening = 0", "is neo-Hookean"),
    ):
        valid = f"The interval is valid if the membrane {membrane}."
        said = status_words(replace(posterior(), model_name=model))
        assert said == f"The computation succeeded (9 of 9 checks). {valid}"


def test_caveats_and_the_second_engine_are_printed_and_stand_on_the_page():
    assert caveats(posterior()) == []
    one = posterior()
    loose = replace(one.marginals["surface_shear_modulus"], lower_95=0.01, upper_95=0.05)
    slack = replace(one.marginals["stretch_ratio"], median=1.02)
    questionable = replace(
        one,
        status=Status.ENGINES_DISAGREE,
        gates=(Gate("stuck walkers", 2, most=0),),
        reference=one.marginals,
        agreement=Agreement(0.3, 0.01, 0.2, "size_ratio", passed=False),
        leaning={"model": 0.2, TWO_SHAPES: 0.3, "prior of capsule_radius": 0.3, "wrinkles": 0.01},
        measurement=replace(one.measurement, axial_length=None, axial_length_error=None),
        marginals={**one.marginals, "surface_shear_modulus": loose, "stretch_ratio": slack},
    )
    assert status_words(questionable) == f"{Status.ENGINES_DISAGREE} (0 of 1 checks of the computation passed.)"
    text = " ".join(caveats(questionable))
    for part in (
        "A check failed: stuck walkers is 2, wanted at most 0.",
        "the engines DISAGREE: means within 0.300 sd",
        "20 % of the posterior lies next to the border of the database.",
        "30 % of the posterior lies next to capillary numbers at which two steady shapes are stable.",
        "30 % of the posterior lies next to the end of the prior range of a.",
        *("L_a was not seen", "stretched by 2 % only", "its ends differ by a factor of 5."),
    ):
        assert part in text, part
    assert "wrinkle" not in text
    page = posterior_page(questionable)
    headline = plain(page.partition('class="verdict"')[2].partition("</p>")[0])
    assert headline.startswith(f">{status_words(questionable)} Not to be used: Gs = ")
    assert "<b>FAILED</b>" in page
    assert 'class="status caveat"' in page
    assert_same(posterior_parts(questionable), page)


def test_the_headline_states_what_it_assumes_and_nothing_below_takes_it_back():
    one = replace(posterior(), modulus_over_laws=(0.021, 0.143), deterministic=DeterministicAnswer(*[0.1] * 6))
    page = posterior_page(one)
    headline = plain(page.partition('class="verdict"')[2].partition("</p>")[0])
    assert status_words(one) in headline
    assert "Another membrane law could give the same lengths with any Gs from 21" in headline
    assert page.count("Another membrane law") == 1
    assert 'class="status' not in page
    assert "published: what the procedure of Quesada et al. (2021) answers, without errors" in plain(page)
    assert_same(posterior_parts(one), page)


def test_a_prior_that_decides_and_one_that_the_capsule_contradicts_are_said():
    one, name = posterior(), "surface_shear_modulus"
    here = one.marginals[name]
    wide = replace(one, prior=replace(one.prior, surface_shear_modulus=f"{here.median} +/- {10.0 * here.sd} N/m"))
    assert caveats(wide) == []
    assert update_words(one) == ""
    assert update_words(wide).endswith(f"With this capsule: {value_words(name, here)}.")
    assert update_words(wide).replace("_", "") in plain(posterior_page(wide))
    near = replace(one, prior=replace(one.prior, surface_shear_modulus=f"{here.median} +/- {1.1 * here.sd} N/m"))
    said = f"its sensitivity is {near.prior_sensitivity[name]:.2g}, above 0.05."
    assert sensitivity_words(near) == f"The prior of G_s decides a part of it: {said}"
    assert said in plain(posterior_page(near))
    assert sensitivity_words(wide) == ""
    sd = np.std(np.log(one.draws[name]))
    for sds in (1.5, 2.5):  # by which the capsule by itself is off, of the sum of both variances
        spread = 2.0 * sd
        before = here.median * np.exp(-sds * np.sqrt(spread**2 - sd**2))
        stated = scipy.stats.lognorm(spread, scale=before)
        far = caveats(replace(one, prior=replace(one.prior, surface_shear_modulus=stated)))
        assert any(f"are {sds:.1f} standard deviations apart" in line for line in far) == (sds > 2.0)


def test_a_name_from_outside_cannot_write_html():
    named = replace(posterior(), measurement=replace(posterior().measurement, source="<img src=x onerror=y>.toml"))
    page = posterior_page(named)
    assert "<img src=x" not in page
    assert "&lt;img src=x onerror=y&gt;.toml" in page


def test_a_further_coordinate_and_the_second_engine_are_shown():
    one = posterior()
    draws = np.random.default_rng(2).normal(0.03, 0.01, one.draws["size_ratio"].shape)
    marginals = {**one.marginals, "pre_inflation": one.marginals["size_ratio"].of_draws(draws)}
    prior = replace(one.prior, coordinates={"pre_inflation": scipy.stats.norm(0.03, 0.01)})
    more = replace(one, draws={**one.draws, "pre_inflation": draws}, marginals=marginals, prior=prior)
    agreed = Agreement(0.01, 0.01, 0.02, "size_ratio", passed=True)
    page = posterior_page(replace(more, reference=marginals, agreement=agreed))
    text = plain(page)
    assert "normal, 0.03 ± 0.01" in text
    assert "quadrature" in text
    assert "The engines agree: means within 0.010 sd" in text
    assert page.count("<img") == 2
    labels = {ax.get_label() for ax in corner_of_few(more).axes}
    assert {"surface_shear_modulus", "capsule_radius", "pre_inflation"} < labels
    assert len(labels) == 15  # five quantities, and their pairs


def test_capsules_side_by_side_are_marked_where_they_were_stated_differently_or_their_intervals_are_apart():
    one = posterior()
    modulus = one.marginals["surface_shear_modulus"]
    shift = 1.01 * (modulus.upper_95 - modulus.lower_95)
    values = {name: value + shift for name, value in vars(modulus).items() if name != "sd"}
    stiff = replace(modulus, **values)
    known = replace(one.inputs, viscosity=replace(one.inputs.viscosity, value=0.9))
    marginals = {**one.marginals, "surface_shear_modulus": stiff}
    other = replace(one, marginals=marginals, inputs=known, status=Status.LEANS_ON_BORDER)
    rows = {row[0]: row[1:] for row in comparison_table({"one": one, "<b>": other}).itertuples(index=False, name=None)}
    assert {label for label in rows if label.startswith("≠")} == {
        "≠ G_s [mN/m]",
        "≠ can be used",
        "≠ mu, viscosity of the suspending liquid",
    }
    assert rows["≠ can be used"] == ("yes", f"no: {Status.LEANS_ON_BORDER}")
    assert rows["≠ mu, viscosity of the suspending liquid"] == ("0.850 ± 0.020 Pa s", "0.900 ± 0.020 Pa s")
    assert rows["l, half width of the channel"] == ("25.00 ± 0.20 µm",) * 2
    assert rows["prior of G_s"] == ("log-uniform from 0.1 to 10000 mN/m",) * 2
    assert rows["a [µm]"][0].endswith(")")
    assert not any(label.startswith("L_") for label in rows), "what was measured always differs"
    alone = comparison_table({"one": one})
    assert not any(label.startswith("≠") for label in alone.iloc[:, 0])


def test_densities_of_several_capsules_share_an_axis_and_a_height():
    figure = densities_figure({"one": posterior(), "two": posterior()}, "surface_shear_modulus")
    (ax,) = figure.axes
    assert ax.get_xlabel() == r"$G_\mathrm{s}$ [mN/m]"
    assert [line.get_ydata().max() for line in ax.lines] == [1.0, 1.0]
    assert len({(line.get_color(), line.get_linestyle()) for line in ax.lines}) == 2
    median = 1e3 * posterior().marginals["surface_shear_modulus"].median
    assert ax.lines[0].get_xdata()[np.argmax(ax.lines[0].get_ydata())] == pytest.approx(median, rel=0.05)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["one", "two"]


@pytest.fixture(scope="module")
def photograph(tmp_path_factory):
    """A drawn capsule in a channel of 55 pixels."""
    path = tmp_path_factory.mktemp("picture") / "photograph.png"
    cv2.imwrite(str(path), drawn(0.08, 1.05, half_width=55.0).picture)
    return path


def test_the_outline_is_laid_over_the_picture_nose_on_nose(photograph):
    seen = detect(Picture.read(photograph))
    outline = posterior().outlines[0]
    laid = on_picture(outline, seen)
    downstream = seen.flow * seen.walls.along
    assert (laid @ downstream).max() == pytest.approx(seen.nose.distance, abs=1e-6)
    assert np.ptp(laid @ downstream) == pytest.approx(seen.walls.half_width * np.ptp(outline[:, 0]))
    beside = np.add(laid, [0.0, 3.0])  # so that the measured edge does not cover it
    canvas = overlay(Picture.read(photograph), seen, posterior().inputs.half_width.value, beside)
    columns, rows = np.rint(4.0 * beside + 1.5).astype(int).T
    assert np.mean(np.abs(canvas[rows, columns].astype(int) - PREDICTED).max(axis=1) < 40) > 0.9


def shown(*arguments, **options):
    return plain(Markup().join(capsule_pictures(*arguments, **options)))


def test_the_picture_it_was_measured_in_or_what_was_drawn_then_is_shown(photograph, tmp_path):
    extent, _, _, half_width = detect(Picture.read(photograph)).lengths
    named = replace(posterior().measurement, source=str(photograph), sha256=Picture.read(photograph).sha256)
    assert "the measured edge" not in shown(replace(posterior(), measurement=named)), "as with another background"
    named = replace(named, axial_extent=extent / half_width)
    assert "photograph.png: the measured edge" in shown(replace(posterior(), measurement=named))
    changed = replace(named, sha256="other")
    assert "the measured edge" not in shown(replace(posterior(), measurement=changed))
    shutil.copy(photograph, tmp_path / "overlay.png")
    assert "What was found in the picture" in shown(posterior(), folder=tmp_path)
    beside = replace(posterior().measurement, source=str(tmp_path / "measurement.toml"))
    assert "What was found in the picture" in shown(replace(posterior(), measurement=beside))


def test_walls_that_were_stated_by_hand_are_shown_and_said(photograph, tmp_path):
    seen = posterior().measurement
    by_hand = replace(
        seen,
        source=str(photograph),
        sha256=Picture.read(photograph).sha256,
        walls="walls by hand at rows 12, 187 px, each +/- 1 px",
    )
    stated = replace(posterior(), measurement=by_hand)
    assert "the measured edge" not in shown(stated)  # with other walls, which would be found in the picture
    shutil.copy(photograph, tmp_path / "overlay.png")
    assert "Dashed walls and a dotted axis were stated by hand" in shown(stated, folder=tmp_path)
    assert "by hand" not in shown(posterior(), folder=tmp_path)
    assert "The half width in px is that of walls by hand at rows 12, 187 px" in plain(posterior_page(stated))


def test_a_picture_in_which_no_capsule_is_found_is_shown_as_it_is(tmp_path):
    grey = tmp_path / "grey.png"
    cv2.imwrite(str(grey), np.full((40, 60), 120, dtype=np.uint8))
    assert "no single capsule between two walls was found in it" in shown(posterior(), grey)
    assert list(capsule_pictures(replace(posterior(), outlines=None))) == []


def texts(ax):
    return [text.get_text() for text in ax.texts]


def test_the_corner_plot_shows_every_pair_with_units_and_intervals():
    known = posterior()
    figure = corner_plot(known)
    axes = {ax.get_label(): ax for ax in figure.axes}
    assert len(axes) == 15
    assert axes["size_ratio surface_shear_modulus"].get_xlabel() == r"$G_\mathrm{s}$ [mN/m]"
    assert axes["capsule_radius surface_shear_modulus"].get_ylabel() == "$a$ [µm]"
    one = known.marginals["capsule_radius"]
    assert axes["capsule_radius"].get_title().startswith(f"$a = {1e6 * one.median:.2f}_{{-")
    assert axes["capsule_radius"].get_title().endswith("µm")
    (lines,) = (of for of in axes["capsule_radius"].collections if isinstance(of, LineCollection))
    shown = [line[0, 0] for line in lines.get_segments()]
    np.testing.assert_allclose(shown, [1e6 * one.lower_68, 1e6 * one.median, 1e6 * one.upper_68])
    low, high = axes["capillary_number"].get_xlim()
    assert low < known.marginals["capillary_number"].lower_95 < high
    assert figure.legends == []
    ax = next(of for of in corner_plot(known).axes if of.get_label() == "size_ratio capillary_number")
    draws = np.stack([np.ravel(known.draws[name]) for name in ("capillary_number", "size_ratio")], axis=1)
    _, outlines = (of for of in ax.collections if isinstance(of, ContourSet))
    held = [path.contains_points(draws).mean() for path in outlines.get_paths()]
    np.testing.assert_allclose(held, [0.95, 0.68], atol=0.02)


def test_the_corner_plot_marks_the_deterministic_answer_and_what_has_no_spread():
    known = posterior()
    answer = DeterministicAnswer(0.041, 24e-6, 3.88e-3, 0.081, 0.959, 1.29)
    figure = corner_plot(replace(known, deterministic=answer), ("surface_shear_modulus", "size_ratio"))
    pair = next(ax for ax in figure.axes if ax.get_label() == "size_ratio surface_shear_modulus")
    (marker,) = (line for line in pair.lines if line.get_marker() == "D")
    np.testing.assert_allclose([marker.get_xdata()[0], marker.get_ydata()[0]], [41.0, 0.959])
    assert "published" in figure.legends[0].get_texts()[0].get_text()
    fixed = np.full_like(known.draws["size_ratio"], 0.9)
    same = replace(known, draws=known.draws | {"size_ratio": fixed})
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


def test_the_outline_is_drawn_with_walls_lengths_and_both_scales():
    known = posterior()
    figure = outline_figure(known)
    ax = figure.axes[0]
    assert ax.get_xlabel() == r"$z/\ell$"
    seen = known.measurement
    assert any(f"{seen.axial_extent:.3f}" in text and "0.010" in text for text in texts(ax))
    assert any(rf"$L_a/\ell = {seen.axial_length:.3f}" in text for text in texts(ax))
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


def test_the_arrow_of_the_length_on_the_axis_ends_at_the_rear_which_is_marked_where_it_is_hidden():
    known = posterior()
    middle = band(known.outlines)[0]
    for view in ("mid-plane", "silhouette"):
        outline = MeasuredOutline(known.outlines[0], OutlineNoise(0.01, 0.0), view=view)
        ax = outline_plot(replace(known, measurement=replace(known.measurement, outline=outline)), Figure().subplots())
        (end,) = (text.xy for text in ax.texts if getattr(text, "xy", (0.0, 1.0))[1] == 0.0)
        assert end[0] == pytest.approx(middle[:, 0].max() - known.measurement.axial_length)
        assert end[0] == pytest.approx(middle[np.abs(middle[:, 1]) < 0.1, 0].min(), abs=0.02)
        assert ("rear on the axis" in texts(ax)) is (view == "silhouette")


def test_lengths_in_metres_are_drawn_over_l_and_missing_ones_are_not():
    known = posterior()
    seen = known.measurement
    names = ("axial_extent", "axial_extent_error", "axial_length", "axial_length_error")
    lengths = {name: 25e-6 * getattr(seen, name) for name in names}
    in_metres = replace(seen, **lengths, over_half_width=False)
    ax = outline_figure(replace(known, measurement=in_metres)).axes[0]
    assert any(f"{seen.axial_extent:.3f}" in text for text in texts(ax))
    seen = replace(known.measurement, axial_length=None, axial_length_error=None)
    ax = outline_plot(replace(known, measurement=seen), Figure().subplots())
    assert not any("L_a" in text for text in texts(ax))
    with pytest.raises(InputError, match="expected a posterior with outlines"):
        outline_figure(replace(known, outlines=None))
