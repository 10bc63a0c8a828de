"""The skeleton of pages: what is text stays text, what is drawn lies within."""

import base64
import re

from markupsafe import Markup
from matplotlib.figure import Figure

from capsbayes.report.page import image, page, picture
from capsbayes.report.tables import Strong, html_table, table, typeset


def test_text_is_escaped_and_a_page_may_fetch_nothing():
    made = page("page.html", title="<a> & b", body=Markup("<p>{}</p>").format("<script>x</script>"))
    assert "<title>&lt;a&gt; &amp; b</title>" in made
    assert "<p>&lt;script&gt;x&lt;/script&gt;</p>" in made
    assert "<b>kept</b>" in page("page.html", title="", body=Markup("<b>kept</b>"))
    assert "default-src 'none'; img-src data:" in page("page.html", title="", body="")


def test_pictures_lie_within_and_are_the_same_each_time():
    figure = Figure()
    figure.subplots().plot([0, 1])
    vector, pixels = picture(figure, 'a "line"', "below"), picture(figure, "a line", png=True, fit="narrow scroll")
    assert vector == picture(figure, 'a "line"', "below")
    assert base64.b64decode(re.search('svg.xml;base64,([^"]+)', vector)[1]).startswith(b"<svg")
    assert base64.b64decode(re.search('png;base64,([^"]+)', pixels)[1]).startswith(b"\x89PNG")
    assert 'alt="a &#34;line&#34;"' in vector
    assert "<figcaption>below</figcaption>" in vector
    assert pixels.startswith('<figure class="narrow"><div class="wide"')
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
