"""Page, terminal and figures of a population: worst first, at most so many, and nothing counted that should not be."""

import base64
import csv
import io
import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from matplotlib.patches import StepPatch
from printed import assert_same, plain
from results import grown, population

from capsbayes.errors import InputError
from capsbayes.infer.checks import Gate
from capsbayes.infer.hierarchy import Hierarchy, ModulusSpread, Update
from capsbayes.infer.population import Population
from capsbayes.infer.prior import Marginal
from capsbayes.report.population import hierarchy_parts, population_parts
from capsbayes.report.population_figures import modulus_against_radius, modulus_histogram, population_page


@pytest.fixture(scope="module")
def page():
    return population_page(population())


def headline_of(page):
    return plain(re.search(r'<p class="verdict">(.*?)</p>', page, re.S)[1])


def test_what_is_printed_of_capsules_and_their_population_stands_on_the_page():
    rng = np.random.default_rng(5)
    count = 4000
    medians = {
        "surface_shear_modulus": 0.05 * np.exp(0.03 * rng.standard_normal(count)),
        "capsule_radius": 24e-6 * np.exp(0.01 * rng.standard_normal(count)),
    }
    spreads = {name: np.abs(rng.normal(0.12, 0.02, count)) for name in ("modulus_spread", "radius_spread")}
    draws = medians | spreads | {"modulus_slope": rng.normal(0.3, 0.5, count)}
    gates = (Gate("effective draws of the population", 300.0, least=400.0),)
    others = {name: values[::-1] for name, values in medians.items()}
    hierarchy = Hierarchy(
        draws,
        others,
        {"surface_shear_modulus": 0.4, "capsule_radius": 0.1},
        7,
        None,
        0.2,
        gates,
        1,
        update=Update(*(Marginal.known(value) for value in (0.06, 0.05)), apart=2.4),
    )
    stored = hierarchy.added_to(population())  # which keeps a few of its draws only
    page = population_page(stored)
    assert_same([*population_parts(stored), *hierarchy_parts(hierarchy)], page)
    low, high = (1e3 * np.quantile(draws["surface_shear_modulus"], share) for share in (0.025, 0.975))
    assert f"95 % [{low:.1f}, {high:.1f}]" in plain(page)
    assert "20 % of the capsules lean on the border of the model" in plain(page)
    assert "Do not use the intervals of the population" in plain(page)
    assert "Median stated of the batch: Gs = 60" in plain(page)
    assert "by the capsules alone: Gs = 50" in plain(page)
    assert "stated of their batch are 2.4 standard deviations apart" in plain(page)
    assert headline_of(page).startswith("Median Gs = ")  # not the numbers that are not to be used
    assert "Valid if the membrane of each capsule is one of those of the model manufactured" in headline_of(page)
    passed = replace(hierarchy, gates=())
    assert headline_of(population_page(passed.added_to(population()))).startswith("With the errors removed")
    heavy = replace(passed, tail_p_values={"surface_shear_modulus": 1e-4})
    assert headline_of(population_page(heavy.added_to(population()))).startswith("Median Gs = ")


def test_one_capsule_is_said_in_the_singular():
    one = Population(population().dataset.isel(capsule=[0]))
    text = plain(population_page(one)) + str(list(population_parts(one)))
    assert "1 capsules" not in text
    assert "The intervals of 1 capsule can be used." in text


@pytest.mark.parametrize(("small", "said"), [(1, False), (3, True)])
def test_more_small_p_values_than_expected_are_said(small, said):
    p_values = np.where(np.arange(8) < small, 0.03, 0.5)
    one = Population.of_dataset(population().dataset.assign(p_value_axial_length=("capsule", p_values)))
    sentence = f"{small} of 8 predictive p-values of the lengths and flow rates are below 0.05, where 0 would be"
    assert any(sentence in str(part) for part in population_parts(one)) is said
    assert (sentence in plain(population_page(one))) is said


def test_worst_come_first():
    one = population()
    order = one.worst_first()
    assert list(one["status"][order[:3]]) == ["NO_CAPSULE", "LEANS_ON_BORDER", "DONE"]
    width = np.log(one["surface_shear_modulus_upper_95"] / one["surface_shear_modulus_lower_95"])[order[2:]]
    assert np.all(np.diff(width) < 0.0)
    assert sorted(order) == list(range(8))


def test_the_headline_is_of_the_capsules_that_can_be_used(page):
    one = population()
    used = one["surface_shear_modulus_median"][one["status"] == "DONE"]
    assert re.search(rf"Median G<sub>s</sub> = {1e3 * np.median(used):.0f}(\.\d+)? mN/m", page)
    assert "The intervals of 6 of 8 capsules can be used; the other 2 are omitted" in page
    assert "No capsule was found between the walls." in page
    assert "capsule 1 &lt;b&gt;" in page
    failed = Population.of_dataset(population().dataset.isel(capsule=[1, 1]))
    page = population_page(failed)
    assert "No capsule could be identified." in page
    assert "The intervals of 0 of 2 capsules can be used" in page


def test_rows_over_the_limit_are_elsewhere_and_the_table_can_be_downloaded_in_si():
    page = population_page(grown(40), rows=25, source="run_42.nc")
    assert page.count('<tr><td class="number" data-value="') == 25
    assert "The 25 worst of 40 are shown; the others are in run_42.nc." in page
    assert "worst of" not in population_page(population(), rows=25)
    one = population()
    data = re.search(r'download="capsules.csv" href="data:text/csv;base64,([^"]+)"', population_page(one, rows=5))[1]
    rows = list(csv.DictReader(io.StringIO(base64.b64decode(data).decode())))
    assert [row["name"] for row in rows] == [one["name"][k] for k in one.worst_first()[:5]]
    column = next(name for name in rows[0] if name.startswith("surface_shear_modulus_median"))
    shown = [float(row[column] or "nan") for row in rows]
    assert shown == pytest.approx(list(one["surface_shear_modulus_median"][one.worst_first()[:5]]), nan_ok=True)


def test_numbers_of_the_table_are_in_the_units_of_its_headings(page):
    one = population()
    table = page.partition("worst first</h2>")[2]
    row = re.search(r"<tr>((?!<tr>).)*capsule 3 &lt;b&gt;.*?</tr>", table, flags=re.S)[0]
    values = [float(value) for value in re.findall(r'data-value="([^"]+)"', row)]
    for name, scale, value in (
        ("surface_shear_modulus_median", 1e3, values[1]),
        ("capsule_radius_median", 1e6, values[4]),
        ("capillary_number_median", 1.0, values[5]),
    ):
        assert value == pytest.approx(scale * float(one[name][3]), rel=1e-8)


def test_figures_hold_each_capsule_once_and_the_spread_as_many():
    modulus = population()["surface_shear_modulus_median"]
    spread = ModulusSpread(np.log(np.nanmedian(modulus)), 0.2)
    ax = modulus_histogram(population(), spread).axes[0]
    (steps,) = (patch for patch in ax.patches if isinstance(patch, StepPatch))
    assert steps.get_data().values.sum() == 6
    (line,) = ax.lines
    edges = np.log(steps.get_data().edges)
    area = np.trapezoid(line.get_ydata(), np.log(line.get_xdata()))
    assert area == pytest.approx(6 * (edges[1] - edges[0]), rel=0.01)
    assert ax.get_xlabel() == r"$G_\mathrm{s}$ [mN/m]"
    ax = modulus_against_radius(population()).axes[0]
    drawn = {one.get_label(): len(one.lines[0].get_xdata()) for one in ax.containers}
    assert drawn == {"intervals can be used": 6, "intervals cannot be used": 1}


def test_the_spread_is_said_with_its_interval_and_comes_first():
    rng = np.random.default_rng(3)
    spread = ModulusSpread(rng.normal(np.log(0.05), 0.02, 800), np.abs(rng.normal(0.12, 0.01, 800)))
    text = plain(population_page(population(), spread=spread))
    assert re.search(r"the median Gs of the capsules is 50\.\d mN/m, 95 % \[48\.\d, 52\.\d\]", text)
    assert re.search(r"differ from it by 12 % \(standard deviation of ln Gs, 95 % \[10 %, 14 %\]\)", text)
    spread = ModulusSpread(np.log([0.049, 0.05, 0.051]), [0.11, 0.12, 0.13])
    verdict = re.search(r'<p class="verdict">(.*?)<small>(.*?)</p>', population_page(population(), spread=spread), re.S)
    headline, below = plain(verdict[1]), plain(verdict[2])
    assert re.search(r"errors removed, the median Gs .* is 50\.0 mN/m, 95 % \[49\.\d, 50\.9\], .* by 12 %", headline)
    assert re.search(r"Median Gs = .*, with the errors in them\.", below)


def test_bars_and_points_say_what_they_stand_for(page):
    titles = [unescape(title) for title in re.findall(r'class="mark"[^>]*>\s*<title>(.*?)</', page)]
    bars, points = ([one for one in titles if (" of 6 capsules" in one) is chosen] for chosen in (True, False))
    assert sum(int(re.search(r"(\d+) of 6", bar)[1]) for bar in bars) == 6
    modulus = 1e3 * float(population()["surface_shear_modulus_median"][3])
    assert f"capsule 3 <b>: {modulus:.3g} mN/m, 23 µm" in points
    assert len(points) == 7


def test_attributes_are_said_in_words():
    prior = '{"surface_shear_modulus": "50 +/- 10 mN/m", "levels": [1.0, 2.5]}'
    page = population_page(Population.of_dataset(population().dataset.assign_attrs(prior=prior)))
    assert "<td>prior: surface shear modulus</td><td>50 +/- 10 mN/m</td>" in page
    assert "<td>prior: levels</td><td>1, 2.5</td>" in page
    assert "{" not in page[page.index("<h2>Origin") :].partition("<script>")[0]


def test_what_is_no_population_is_refused():
    fine = ("capsule", ["FINE"] * 8)
    one = population().dataset
    for changed, message in (
        (one.rename(capsule="case"), "expected a table with the dimension capsule, got one with case"),
        (one.drop_vars("status"), "status: expected a variable of that name, got none"),
        (one.drop_vars("capsule_radius_median"), "capsule_radius_median: expected a variable"),
        (one.assign(status=fine), "status: expected names of capsbayes.Status, got FINE"),
    ):
        with pytest.raises(InputError, match=f"run.nc: {message}"):
            Population.of_dataset(changed, "run.nc")
