"""Pages in a real browser: tables sort, pictures load, the console is silent, a phone need not scroll sideways."""

import math

import manufactured
import pytest
from browser import needs_browser, seen_in_browser
from results import grown, population, posterior

from capsbayes.report import write_report

pytestmark = needs_browser

LOADED = """return {
  pictures: [...document.images].map((one) => one.complete && one.naturalWidth > 0 && one.alt !== ""),
  width: innerWidth,
  overflow: document.documentElement.scrollWidth - document.documentElement.clientWidth,
};"""

SORTED = """
const table = document.querySelector("table.sortable"), headings = [...table.tHead.rows[0].cells];
const shown = (k) => [...table.tBodies[0].rows].map((row) => row.cells[k].dataset.value ?? row.cells[k].textContent);
return headings.map((heading, k) => {
  const found = [[null, shown(k)]];
  for (let click = 0; click < 3; click++) {
    heading.querySelector("button").click();
    found.push([heading.getAttribute("aria-sort"), shown(k)]);
  }
  return [found, table.querySelectorAll("[aria-sort]").length];
});"""
WORDS = (1, 5)  # columns of names and of statuses


def page_of(result, folder):
    return write_report(result, folder / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def population_of_30(tmp_path_factory):
    return page_of(grown(30), tmp_path_factory.mktemp("population"))


@pytest.mark.parametrize(
    ("made", "pictures"),
    [
        (posterior, 2),
        (population, 0),  # its figures are drawn within the page
        (lambda: manufactured.database(2, 3), 2),
    ],
    ids=("posterior", "population", "database"),
)
def test_pictures_load_nothing_is_too_wide_and_the_console_is_silent(tmp_path, made, pictures):
    seen = seen_in_browser(page_of(made(), tmp_path), LOADED, tmp_path, widths=(360, 1200))
    for width in (360, 1200):
        assert seen.found[width] == {"pictures": [True] * pictures, "width": width, "overflow": 0}
    assert seen.console == []


@pytest.fixture(scope="module")
def clicked(population_of_30, tmp_path_factory):
    """Each column of the table before and after three clicks on its heading, one column after the other."""
    seen = seen_in_browser(population_of_30, SORTED, tmp_path_factory.mktemp("clicked"))
    assert seen.console == []
    return seen.found[1200]


def test_columns_sort_both_ways_by_value_and_what_has_none_stays_last(clicked):
    assert len(clicked) == 12
    for found, marked in clicked:
        assert [order for order, _ in found] == [None, "ascending", "descending", "ascending"]
        assert marked == 1
    for column, (found, _) in enumerate(clicked):
        if column in WORDS:
            continue
        values = [[float(text) if text else math.nan for text in texts] for _, texts in found]
        numbers = [[value for value in one if not math.isnan(value)] for one in values]
        assert len(set(numbers[0])) > 3
        assert numbers[1] == sorted(numbers[0]) == numbers[3]
        assert numbers[2] == sorted(numbers[0], reverse=True)
        for one, known in zip(values[1:], numbers[1:], strict=True):
            assert one[: len(known)] == known
    for column in WORDS:
        names = [texts for _, texts in clicked[column][0]]
        assert names[1] == sorted(names[0])
        assert names[2] == sorted(names[0], reverse=True)
        assert len(set(names[0])) > 2
    assert clicked[0][0][1][1] == [str(k) for k in range(1, 31)]


def test_a_page_that_is_broken_or_fetches_something_would_be_noticed(population_of_30, tmp_path):
    broken = (
        '<html><body><img alt="x" src="data:image/png;base64,AAAA"><div style="width: 2000px">x</div>'
        "<script>nowhere();</script></body></html>"
    )
    seen = seen_in_browser(broken, LOADED, tmp_path, widths=(360,))
    assert seen.found[360]["pictures"] == [False]
    assert seen.found[360]["overflow"] > 1000
    assert any("nowhere is not defined" in line for line in seen.console)
    fetching = population_of_30.replace("</body>", '<img alt="x" src="http://localhost:9/x.png"></body>')
    seen = seen_in_browser(fetching, LOADED, tmp_path)
    assert False in seen.found[1200]["pictures"]
    assert any("Content Security Policy" in line for line in seen.console)
