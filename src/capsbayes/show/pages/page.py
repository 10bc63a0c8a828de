"""The skeleton of a page: one HTML file that holds its style and its pictures and loads nothing."""

from __future__ import annotations

import base64
import functools
import io
import re
from typing import Any

import matplotlib
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from capsbayes.show.pages import citation


def page(template: str, **content: Any) -> str:
    """Fill one of the templates, all of which stand on ``page.html``; text is escaped, `Markup` is not."""
    return _templates().get_template(template).render(**content) + "\n"


def picture(figure: Figure, alternative: str, caption: str = "", *, png: bool = False, fit: str = "") -> Markup:
    """Return a figure as an image within the page; the same figure gives the same bytes.

    The alternative is for those who do not see it. It is an SVG; what has too many lines is better drawn in pixels
    (`png`). With ``scroll`` in `fit`, a narrow screen scrolls it instead of making it small; with ``narrow``, a wide
    one does not make it as wide as the page.
    """
    if png:
        pixels = io.BytesIO()
        figure.savefig(pixels, format="png", dpi=160, metadata={"Software": None})
        return image(pixels.getvalue(), "png", alternative, caption, fit=fit)
    text = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "capsbayes", "svg.fonttype": "path"}):
        figure.savefig(text, format="svg", metadata={"Date": None})
    svg = re.sub(r"^.*?(?=<svg)", "", text.getvalue(), flags=re.DOTALL)
    return image(svg.encode(), "svg+xml", alternative, caption, fit=fit)


def image(content: bytes, kind: str, alternative: str, caption: str = "", *, fit: str = "") -> Markup:
    """Return the bytes of a picture of a kind, as ``"png"``, as an image within the page; see `picture`."""
    data = base64.b64encode(content).decode()
    shown = Markup('<img alt="{}" src="data:image/{};base64,{}">').format(alternative, kind, data)
    if "scroll" in fit:
        shown = Markup('<div class="wide" tabindex="0">{}</div>').format(shown)
    below = Markup("\n<figcaption>{}</figcaption>").format(caption) if caption else ""
    size = Markup(' class="narrow"') if "narrow" in fit else ""
    return Markup("<figure{}>{}{}</figure>").format(size, shown, below)


@functools.cache
def _templates() -> Environment:
    environment = Environment(
        loader=PackageLoader("capsbayes.show.pages"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["cite"] = citation
    return environment
