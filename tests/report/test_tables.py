"""Numbers, tables and the skeleton of pages: what is text stays text, and nothing is broken where it may not be."""

import base64
import io
import re
from pathlib import Path

import pytest
import yaml
from markupsafe import Markup
from matplotlib.figure import Figure
from rich.console import Console

from capsbayes.infer import Marginal
from capsbayes.report import page as citation
from capsbayes.report.numbers import decimals, per_cent, rounded, together, value_words
from capsbayes.report.page import image, page, picture
from capsbayes.report.tables import Strong, html_table, print_parts, table, terminal_table, typeset

STATED = yaml.safe_load((Path(__file__).parents[2] / "CITATION.cff").read_text(encoding="utf-8"))


def test_an_error_below_36_is_worth_two_digits():
    digits = {0.00101: 4, 0.0354: 3, 0.0356: 2, 0.9: 1, 1.0: 1, 3.5: 1, 4.0: 0, 40.0: -1, 0.0: 3}
    assert {error: decimals(error) for error in digits} == digits
    assert decimals(float("nan")) == 3
    assert rounded(5128.0, -2) == "5100"  # tens are left out where the error is hundreds
    assert rounded(float("nan"), 2) == "not known"
    assert together((0.02, -0.1, 0.14), 2) == ["0.02", "-0.10", "0.14"]  # what may be negative keeps its decimals


@pytest.mark.parametrize(
    ("name", "numbers", "words"),
    [
        ("surface_shear_modulus", (0.071, 0.067, 0.075, 0.0638, 0.0792), "G_s = 71 mN/m, 95 % [64, 79]"),
        ("surface_shear_modulus", (7.1, 6.7, 7.5, 6.38, 7.92), "G_s = 7100 mN/m, 95 % [6400, 7900]"),
        ("capsule_radius", (23.97e-6, 23.68e-6, 24.26e-6, 23.4e-6, 24.54e-6), "a = 23.97 µm, 95 % [23.40, 24.54]"),
        ("mean_velocity", (4.772e-3, 4.713e-3, 4.833e-3, 4.657e-3, 4.89e-3), "U = 4.77 mm/s, 95 % [4.66, 4.89]"),
        ("surface_shear_modulus", (0.296, 0.12, 0.84, 0.0314, 1.412), "G_s = 300 mN/m, 95 % [31, 1400]"),
        ("capillary_number", (0.0138, 0.005, 0.07, 0.003, 0.123), "Ca = 0.014, 95 % [0.0030, 0.12]"),
        ("capillary_number", (0.0811, 0.0726, 0.0895, 0.0649, 0.0982), "Ca = 0.081, 95 % [0.065, 0.098]"),
    ],
)
def test_a_headline_has_the_unit_people_speak_and_the_digits_of_its_error(name, numbers, words):
    middle, low_68, high_68, low_95, high_95 = numbers
    assert value_words(name, Marginal(middle, 0.5 * (high_68 - low_68), *numbers[:3], low_95, high_95)) == words


def test_shares():
    assert [per_cent(share) for share in (0.0042, 0.042, 0.0999, 0.42, -0.039)] == [
        "0.4 %", "4.2 %", "10 %", "42 %", "-3.9 %"
    ]  # fmt: skip


def test_text_is_escaped_and_a_page_may_fetch_nothing():
    made = page("page.html", title="<a> & b", body=Markup("<p>{}</p>").format("<script>x</script>"))
    assert "<title>&lt;a&gt; &amp; b</title>" in made
    assert "<p>&lt;script&gt;x&lt;/script&gt;</p>" in made
    assert "<b>kept</b>" in page("page.html", title="", body=Markup("<b>kept</b>"))
    assert "default-src 'none'; img-src data:" in page("page.html", title="", body="")


def test_pictures_lie_within_and_are_the_same_each_time():
    figure = Figure()
    figure.subplots().plot([0, 1])
    vector, pixels = picture(figure, 'a "line"', "below"), picture(figure, "a line", png=True)
    assert vector == picture(figure, 'a "line"', "below")
    assert base64.b64decode(re.search('svg.xml;base64,([^"]+)', vector)[1]).startswith(b"<svg")
    assert base64.b64decode(re.search('png;base64,([^"]+)', pixels)[1]).startswith(b"\x89PNG")
    assert 'alt="a &#34;line&#34;"' in vector
    assert "<figcaption>below</figcaption>" in vector
    assert pixels.startswith('<figure><div class="wide" tabindex="0" style="--points: 461px"><img')
    assert "figcaption" not in image(b"", "png", "nothing")


def test_cells_are_escaped_and_numbers_are_marked():
    made = html_table(table(("name", "value"), [("<a>", "1"), (Strong("<b>"), "2")], numbers=(1,), bars=(1.0, -0.5)))
    assert '<thead><tr><th>name</th><th class="number">value</th></tr></thead>' in made
    assert (
        '<td class="lead">&lt;a&gt;<span class="bar" style="width: 100.0%"></span></td><td class="number">1</td>'
        in made
    )
    assert '<td class="lead"><b>&lt;b&gt;</b><span class="bar below" style="width: 50.0%"></span></td>' in made
    assert "thead" not in html_table(table(("", ""), [("a", "b")]))


def test_symbols():
    assert typeset("L_z over l, mu and Lambda, v_o/U") == "L<sub>z</sub> over ℓ, µ and Λ, v<sub>o</sub>/U"
    written = "ε<sub>p</sub> = 2 %, 10<sup>15</sup> &amp; G<sub>s</sub> a<sup>2</sup>"
    assert typeset("eps_p = 2 %, 10^15 & G_s a^2") == written


def test_what_pages_say_of_citing_is_what_the_file_for_citing_says():
    assert STATED["message"] == citation.MESSAGE
    for words in (STATED["title"], str(STATED["version"]), STATED["abstract"], STATED["authors"][0]["name"]):
        assert words in citation.SOFTWARE
    assert STATED["license"] in citation.SOFTWARE
    article = STATED["preferred-citation"]
    names = [f"{one['given-names']} {one['family-names']}" for one in article["authors"]]
    authors = f"{', '.join(names[:-1])} and {names[-1]}"
    assert f"{authors}. {article['title']}. {article['journal']}, {article['year']}." == citation.ARTICLE
    assert article["doi"] == citation.DOI


def test_what_is_printed_keeps_brackets_and_units_and_skips_what_is_empty(monkeypatch, capsys):
    print_parts("[bold]text[/bold]", "", table(("", "G_s [mN/m]"), [("a [b]", "5")], numbers=(1,)), status="Done.")
    printed = capsys.readouterr().out
    assert all(part in printed for part in ("[bold]text[/bold]", "G_s [mN/m]", "a [b]", "Status: Done."))
    monkeypatch.setenv("COLUMNS", "40")
    sentence = "The median of the 59 capsules is about 50 mN/m, ± 34 %."
    print_parts(sentence, status="Ends near a capillary number of 12 %.")
    assert capsys.readouterr().out.splitlines() == [
        "The median of the 59 capsules is about",
        "50 mN/m, ± 34 %.",
        "Status: Ends near a capillary number of",
        "12 %.",
    ]


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
