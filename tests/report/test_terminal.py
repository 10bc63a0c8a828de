"""Terminal and page of a result say the same: every number, every sentence, every caveat."""

import io
from contextlib import redirect_stdout
from dataclasses import replace

import numpy as np
import pytest
from printed import assert_same, plain
from results import population, posterior
from rich.console import Console

from capsbayes.infer.checks import Agreement, Gate
from capsbayes.infer.hierarchy import Hierarchy
from capsbayes.model import TWO_SHAPES
from capsbayes.report.population import hierarchy_parts, population_parts
from capsbayes.report.population_figures import population_page
from capsbayes.report.posterior import posterior_parts
from capsbayes.report.posterior_figures import posterior_page
from capsbayes.report.tables import print_parts, table, terminal_table


@pytest.fixture(scope="module")
def questionable():
    """A posterior with a caveat of every kind, and a second engine."""
    one = posterior()
    return replace(
        one,
        gates=(Gate("stuck walkers", 2, most=0),),
        reference=one.marginals,
        agreement=Agreement(0.3, 0.01, 0.2, "size_ratio", passed=False),
        leaning={"model": 0.2, TWO_SHAPES: 0.3},
        measurement=replace(one.measurement, axial_length=None, axial_length_error=None),
    )


def test_a_posterior(questionable):
    parts = list(posterior_parts(questionable))
    sentences = [part for part in parts if isinstance(part, str)]
    assert "30 % of the posterior lies next to capillary numbers at which two steady shapes are stable." in sentences
    assert_same(parts, posterior_page(questionable))


@pytest.fixture(scope="module")
def run():
    """Capsules and the population they come from; the file keeps a few of its draws only."""
    rng = np.random.default_rng(5)
    count = 4000
    medians = {
        "surface_shear_modulus": 0.05 * np.exp(0.03 * rng.standard_normal(count)),
        "capsule_radius": 24e-6 * np.exp(0.01 * rng.standard_normal(count)),
    }
    spreads = {name: np.abs(rng.normal(0.12, 0.02, count)) for name in ("modulus_spread", "radius_spread")}
    draws = medians | spreads | {"modulus_slope": rng.normal(0.3, 0.5, count)}
    gates = (Gate("effective draws of the population", 300.0, least=400.0),)
    found = Hierarchy(draws, {name: values[::-1] for name, values in medians.items()}, 7, None, 0.2, gates, 1)
    return found, found.added_to(population())


def test_a_population(run):
    hierarchy, stored = run
    page = population_page(stored)
    parts = [*population_parts(stored), *hierarchy_parts(hierarchy)]
    assert_same(parts, page)
    low, high = (1e3 * np.quantile(hierarchy.draws["surface_shear_modulus"], share) for share in (0.025, 0.975))
    assert f"95 % [{low:.1f}, {high:.1f}]" in plain(page)
    assert "20 % of the capsules lean on the border of the model" in plain(page)
    assert "Do not use the intervals of the population" in plain(page)


def test_what_is_printed_keeps_brackets_and_skips_nothing_else():
    shown = io.StringIO()
    with redirect_stdout(shown):
        print_parts("[bold]text[/bold]", "", table(("", "G_s [mN/m]"), [("a [b]", "5")], numbers=(1,)), status="Done.")
    assert "[bold]text[/bold]" in shown.getvalue()
    assert "G_s [mN/m]" in shown.getvalue()
    assert "a [b]" in shown.getvalue()
    assert "Status: Done." in shown.getvalue()


def test_a_table_wider_than_a_line_is_printed_in_parts_and_breaks_sentences_alone():
    sentence = "Two steady shapes are stable at such a capillary number, and the capsule takes either of them. " * 3
    head = ("effect", "log-likelihood ratio", "odds against the best", "size", "median G_s", "in question?")
    rows = [("pre-inflation", "12.3", "1 : 10^4", "alpha = 0.031 ± 0.004", "49.8 mN/m", sentence)]
    shown = Console(width=80, file=io.StringIO())
    shown.print(terminal_table(table(head, rows, numbers=(1,)), 80))
    lines = [line.rstrip() for line in shown.file.getvalue().splitlines()]
    assert max(map(len, lines)) <= 80
    assert len(lines) < 20
    assert [line.split()[0] for line in lines if line.startswith("pre-inflation")] == ["pre-inflation"] * 2
    for cell in rows[0][:-1]:
        assert any(cell in line for line in lines)
    assert " ".join(sentence.split()) in " ".join(" ".join(lines).split())


def test_a_line_does_not_end_between_a_number_and_its_unit(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "40")
    print_parts(
        "The median of the 59 capsules is about 50 mN/m, ± 34 %.", status="Ends near a capillary number of 12 %."
    )
    lines = capsys.readouterr().out.splitlines()
    assert lines == [
        "The median of the 59 capsules is about",
        "50 mN/m, ± 34 %.",
        "Status: Ends near a capillary number of",
        "12 %.",
    ]
