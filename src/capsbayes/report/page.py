"""The skeleton of a page: one HTML file that holds its style and its pictures and loads nothing."""

from __future__ import annotations

import base64
import functools
import io
import re
from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree

import matplotlib
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

import capsbayes
from capsbayes.report.numbers import counted
from capsbayes.report.tables import html_table, typeset

# The content of CITATION.cff
MESSAGE = "If you use capsbayes, please cite it, and the article whose method it extends."
SOFTWARE = (
    f"The capsbayes developers. capsbayes, version {capsbayes.__version__}. Shear modulus and radius of liquid-core "
    "microcapsules from a picture, with honest credible intervals. MIT licence."
)
ARTICLE = (
    "Carlos Quesada, Claire Dupont, Pierre Villon and Anne-Virginie Salsac. Diffuse approximation for identification "
    "of the mechanical properties of microcapsules. Mathematics and Mechanics of Solids, 2021."
)
DOI = "10.1177/1081286520977602"

_SVG = "{http://www.w3.org/2000/svg}"
ElementTree.register_namespace("", _SVG[1:-1])
ElementTree.register_namespace("xlink", "http://www.w3.org/1999/xlink")


def page(template: str, **content: Any) -> str:
    """Fill one of the templates, all of which stand on ``page.html``; text is escaped, `Markup` is not."""
    return _templates().get_template(template).render(**content) + "\n"


def picture(figure: Figure, alternative: str, caption: str = "", *, png: bool = False) -> Markup:
    """Return a figure as an SVG, or what has too many lines as a `png`, within the page, the same bytes each time."""
    points = 72.0 * figure.get_figwidth()
    if png:
        pixels = io.BytesIO()
        figure.savefig(pixels, format="png", dpi=160, metadata={"Software": None})
        return image(pixels.getvalue(), "png", alternative, caption, points)
    return image(_svg(figure).encode(), "svg+xml", alternative, caption, points)


def drawing(figure: Figure, marks: Mapping[str, Sequence[str]], alternative: str, caption: str) -> Markup:
    """Return a figure as an SVG whose marks, by the ``gid`` of their artist, say a text when they are pointed at."""
    root = ElementTree.fromstring(_svg(figure))
    root.attrib = {"role": "img", "aria-label": alternative, "viewBox": root.attrib["viewBox"]}
    root.remove(root[0])  # who made it
    for name, texts in marks.items():
        group = root.find(f".//{_SVG}g[@id='{name}']")
        if group is None:
            continue
        for mark, text in zip(list(group.iter(f"{_SVG}use")) or [group], texts, strict=True):
            mark.set("class", "mark")
            title = ElementTree.Element(f"{_SVG}title")
            title.text = text
            mark.insert(0, title)
    return _figure(Markup(ElementTree.tostring(root, encoding="unicode")), caption, 72.0 * figure.get_figwidth())


def _svg(figure: Figure) -> str:
    """Return a figure as the text of an SVG, which is the same each time."""
    text = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "capsbayes", "svg.fonttype": "path"}):
        figure.savefig(text, format="svg", metadata={"Date": None})
    return re.sub(r"^.*?(?=<svg)", "", text.getvalue(), flags=re.DOTALL)


def image(content: bytes, kind: str, alternative: str, caption: str = "", points: float = 0.0) -> Markup:
    """Return the bytes of a picture of a kind, as ``"png"``, as an image within the page; `points` are its width."""
    data = base64.b64encode(content).decode()
    shown = Markup('<img alt="{}" src="data:image/{};base64,{}">').format(alternative, kind, data)
    return _figure(shown, caption, points)


def _figure(shown: Markup, caption: str, points: float) -> Markup:
    """A figure in a box of its own, which scrolls where a point of it would be less than a pixel of the screen."""
    below = Markup("\n<figcaption>{}</figcaption>").format(caption) if caption else ""
    width = Markup(' style="--points: {:.0f}px"').format(points) if points else ""
    return Markup('<figure><div class="wide" tabindex="0"{}>{}</div>{}</figure>').format(width, shown, below)


@functools.cache
def _templates() -> Environment:
    loader = PackageLoader("capsbayes.report")
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.globals |= {"message": MESSAGE, "software": SOFTWARE, "article": ARTICLE, "doi": DOI}
    environment.globals |= {"version": capsbayes.__version__, "counted": counted}
    environment.filters |= {"table": html_table, "typeset": typeset, "picture": picture, "drawing": drawing}
    return environment
