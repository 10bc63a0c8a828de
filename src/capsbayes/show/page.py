"""The pages of reports: one HTML file each, its style and its pictures within, nothing from elsewhere."""

from __future__ import annotations

import base64
import functools
import io
import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from capsbayes.show import citation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["image", "page", "picture", "table", "typeset"]

_SIGNS = {"alpha": "α", "delta": "δ", "eps": "ε", "mu": "µ", "Lambda": "Λ", "l": "ℓ"}


def page(template: str, **content: Any) -> str:
    """Fill a template; text among the content is escaped, `Markup` is not.

    Parameters
    ----------
    template : str
        Name of one of the templates, all of which stand on ``page.html``.
    **content
        What the template names.

    Returns
    -------
    str
        A whole page.
    """
    return _templates().get_template(template).render(**content) + "\n"


def picture(figure: Figure, alternative: str, caption: str = "", *, png: bool = False, fit: str = "") -> Markup:
    """A figure as an image within the page, the same each time.

    Parameters
    ----------
    figure : Figure
    alternative : str
        What it shows, for those who do not see it.
    caption : str or Markup
    png : bool
        As pixels, for what has too many lines; else as SVG.
    fit : str
        With ``scroll``, a narrow screen scrolls it instead of making it small; with ``narrow``, a wide one does not
        make it as wide as the page.

    Returns
    -------
    Markup
    """
    import matplotlib

    if png:
        pixels = io.BytesIO()
        figure.savefig(pixels, format="png", dpi=160, metadata={"Software": None})
        return image(pixels.getvalue(), "png", alternative, caption, fit=fit)
    made = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "capsbayes", "svg.fonttype": "path"}):
        figure.savefig(made, format="svg", metadata={"Date": None})
    svg = re.sub(r"^.*?(?=<svg)", "", made.getvalue(), flags=re.DOTALL)
    return image(svg.encode(), "svg+xml", alternative, caption, fit=fit)


def image(content: bytes, kind: str, alternative: str, caption: str = "", *, fit: str = "") -> Markup:
    """The bytes of a picture of a kind, as ``"png"``, within the page; see `picture`."""
    data = base64.b64encode(content).decode()
    shown = Markup('<img alt="{}" src="data:image/{};base64,{}">').format(alternative, kind, data)
    if "scroll" in fit:
        shown = Markup('<div class="wide" tabindex="0">{}</div>').format(shown)
    below = Markup("\n<figcaption>{}</figcaption>").format(caption) if caption else ""
    size = Markup(' class="narrow"') if "narrow" in fit else ""
    return Markup("<figure{}>{}{}</figure>").format(size, shown, below)


def table(
    head: Sequence[str], rows: Iterable[Sequence[str]], *, numbers: Sequence[int] = (), lead: bool = False
) -> Markup:
    """An HTML table in a box of its own that scrolls.

    Parameters
    ----------
    head : sequence of str or Markup
        Of the columns; empty for a table without a line of headings.
    rows : iterable of sequences of str or Markup
    numbers : sequence of int
        Columns of numbers, set to the right.
    lead : bool
        Whether the first column holds words that need their breadth.

    Returns
    -------
    Markup
    """
    names = dict.fromkeys(numbers, "number") | ({0: "lead"} if lead else {})

    def line(tag: str, cells: Sequence[str]) -> Markup:
        kinds = (Markup(' class="{}"').format(names[k]) if k in names else "" for k in range(len(cells)))
        pieces = (
            Markup("<{0}{1}>{2}</{0}>").format(Markup(tag), kind, cell) for kind, cell in zip(kinds, cells, strict=True)
        )
        return Markup("<tr>{}</tr>").format(Markup().join(pieces))

    above = Markup("<thead>{}</thead>\n").format(line("th", head)) if head else ""
    body = Markup("\n").join(line("td", row) for row in rows)
    return Markup('<div class="wide"><table>\n{}<tbody>\n{}\n</tbody></table></div>').format(above, body)


def typeset(text: str) -> Markup:
    """HTML of a text with plain symbols, as G_s or 10^3."""
    made = re.sub(r"\b([A-Za-z]+)_([A-Za-z0-9]+)\b", r"\1<sub>\2</sub>", str(Markup.escape(text)))
    made = re.sub(r"\^(\w+)", r"<sup>\1</sup>", made)
    return Markup(re.sub(rf"\b({'|'.join(_SIGNS)})\b", lambda found: _SIGNS[found[0]], made))


@functools.cache
def _templates() -> Environment:
    made = Environment(
        loader=PackageLoader("capsbayes.show"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.globals["cite"] = citation
    return made
