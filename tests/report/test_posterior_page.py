"""The page of a posterior says what it found, its caveats, and where it comes from."""

import re
import shutil
from dataclasses import replace
from html import unescape

import cv2
import numpy as np
import pytest
import scipy.stats
from drawn import drawn
from markupsafe import Markup
from results import posterior

import capsbayes as cb
from capsbayes.image.files import Picture
from capsbayes.image.measure import detect
from capsbayes.infer.checks import Agreement, Gate
from capsbayes.infer.identify import REST
from capsbayes.report.numbers import value_words
from capsbayes.report.posterior import budget_sentence, caveats, posterior_parts, status_words
from capsbayes.report.posterior_figures import capsule_pictures, on_picture, picture_figure, posterior_page
from capsbayes.report.tables import typeset
from capsbayes.status import Status


def words(page):
    """The text of a page without its pictures."""
    return unescape(re.sub(r"\s+", " ", re.sub(r"<[^>]+>", "", re.sub(r"<style>.*?</style>", "", page, flags=re.S))))


@pytest.fixture(scope="module")
def page():
    return posterior_page(posterior())


def test_the_page_has_each_part_and_the_error_budget_of_the_posterior(page, tmp_path):
    text, one = words(page), posterior()
    parts = (
        value_words("surface_shear_modulus", one.marginals["surface_shear_modulus"]).replace("_", ""),
        value_words("capsule_radius", one.marginals["capsule_radius"]),
        "The interval is valid if the membrane is one of those of the model manufactured polynomial.",
        "The capsule",
        "All quantities",
        "Error budget",
        "Inputs",
        "25.00 ± 0.20 µm",
        "Priors",
        "log-uniform from 0.1 to 10000 mN/m",
        "Checks of the computation",
        "Origin",
        "capsule.toml" + "ab" * 32,
        "manufactured polynomial" + "0" * 64,
        "quadrature",
        "How to cite",
        "10.1177/1081286520977602",
    )
    places = [text.index(part) for part in parts]
    assert places == sorted(places)
    assert f"version {cb.__version__}" in text
    assert re.search(r"seed\s*3", text)
    assert page.count("<img") == 2  # outline and corner
    for share in posterior().shares.values():
        assert f">{100.0 * share:.1f} %<" in page
    first = max(posterior().shares.values())
    assert f"({100.0 * first:.0f} % of the variance of ln Gs)" in words(page)
    assert page.count('class="bar') == len(posterior().shares)
    assert posterior_page(cb.Posterior.read(posterior().write(tmp_path / "posterior.nc"))) == page


def test_shares_that_do_not_add_up_are_not_printed_as_shares():
    longer = {"axial_length": -0.01, "outline": 0.91, REST: 0.1}
    for shares in ({"outline": 1.17, REST: -0.17}, longer, {"outline": 0.3}):
        odd = replace(posterior(), shares={REST: 1.0 - sum(shares.values())} | shares)
        assert budget_sentence(odd) == "The largest contribution to the uncertainty of G_s is the measured outline."
        assert 'class="bar' not in posterior_page(odd)
        assert not any("share of the variance" in str(part) for part in posterior_parts(odd))


def test_intervals_are_valid_for_the_law_of_the_model():
    for model, words in (
        ("square-neo-hookean", "is neo-Hookean"),
        ("circular-skalak-c-1 (silhouettes)", "obeys Skalak's law with C = 1"),
        ("square-neo-hookean with pre_inflation", "is neo-Hookean"),
        ("square-neo-hookean with hooke_share", "is one of those of the model square-neo-hookean with hooke_share"),
        ("square-membrane at pre_inflation = 0.02", "obeys one of the model's laws"),
        ("square-membrane at area_dilation_modulus = 3, strain_hardening = 0", "is neo-Hookean"),
    ):
        valid = f"The interval is valid if the membrane {words}."
        said = status_words(replace(posterior(), model_name=model))
        assert said == f"The computation succeeded (9 of 9 checks). {valid}"


def test_caveats_are_shown():
    assert caveats(posterior()) == []
    one = posterior()
    loose = replace(one.marginals["surface_shear_modulus"], lower_95=0.01, upper_95=0.05)
    slack = replace(one.marginals["stretch_ratio"], median=1.02)
    questionable = replace(
        one,
        status=Status.ENGINES_DISAGREE,
        gates=(Gate("stuck walkers", 2, most=0),),
        agreement=Agreement(0.3, 0.01, 0.2, "size_ratio", passed=False),
        leaning={"model": 0.2, "prior of capsule_radius": 0.3, "wrinkles": 0.01},
        measurement=replace(one.measurement, axial_length=None, axial_length_error=None),
        marginals={**one.marginals, "surface_shear_modulus": loose, "stretch_ratio": slack},
    )
    assert status_words(questionable) == f"{Status.ENGINES_DISAGREE} (0 of 1 checks of the computation passed.)"
    text = " ".join(caveats(questionable))
    for part in (
        "A check failed: stuck walkers is 2, wanted at most 0.",
        "the engines DISAGREE: means within 0.300 sd",
        "20 % of the posterior lies next to the border of the database.",
        "30 % of the posterior lies next to the end of the prior range of a.",
        *("L_a was not seen", "stretched by 2 % only", "its ends differ by a factor of 5."),
    ):
        assert part in text, part
    assert "wrinkle" not in text
    page = posterior_page(questionable)
    assert "<b>FAILED</b>" in page
    assert 'class="status caveat"' in page
    assert all(words(one) in words(page) for one in map(typeset, caveats(questionable)))


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
    text = words(page)
    assert "normal, 0.03 ± 0.01" in text
    assert "quadrature" in text
    assert "The engines agree: means within 0.010 sd" in text
    assert page.count("<img") == 2


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
    ax = picture_figure(posterior(), photograph).axes[0]
    assert {line.get_label() for line in ax.lines} >= {"measured edge", "predicted outline"}
    bar = next(line for line in ax.lines if line.get_color() == "white")
    width = posterior().inputs.half_width.value
    assert np.ptp(bar.get_xdata()) == pytest.approx(20e-6 / width * seen.walls.half_width)


def shown(*arguments, **options):
    return words(Markup().join(capsule_pictures(*arguments, **options)))


def test_the_picture_it_was_measured_in_or_what_was_drawn_then_is_shown(photograph, tmp_path):
    named = replace(posterior().measurement, source=str(photograph), sha256=Picture.read(photograph).sha256)
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
    assert "The half width in px is that of walls by hand at rows 12, 187 px" in words(posterior_page(stated))


def test_a_picture_in_which_no_capsule_is_found_is_shown_as_it_is(tmp_path):
    grey = tmp_path / "grey.png"
    cv2.imwrite(str(grey), np.full((40, 60), 120, dtype=np.uint8))
    assert picture_figure(posterior(), grey) is None
    assert "no single capsule between two walls was found in it" in shown(posterior(), grey)
    assert list(capsule_pictures(replace(posterior(), outlines=None))) == []
