"""Equations as MathML, which browsers draw themselves: no script, nothing fetched."""

from __future__ import annotations

import html
import logging
import re

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import Files
from mkdocs.structure.pages import Page

LOG = logging.getLogger("mkdocs.hooks.equations")
INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.DOTALL)
DISPLAYED = re.compile(r'<div class="arithmatex">\s*\\\[(.*?)\\\]\s*</div>', re.DOTALL)
UPRIGHT = re.compile(r"\\mathrm\{([^{}]*)\}")  # a single upright letter would come out slanted
LOGARITHM = re.compile(r"<mi>ln</mi>(?!<mo)")
TAG = re.compile(r"\\tag\{([^}]*)\}")


def on_page_content(content: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Replace what the Markdown extension has marked as an equation."""
    where = page.file.src_uri

    def displayed(found: re.Match[str]) -> str:
        latex = html.unescape(found[1])
        number = TAG.search(latex)
        said = f'<span class="number">({number[1]})</span>' if number else ""
        anchor = f' id="eq-{number[1].lower()}"' if number else ""
        formula = _mathml(TAG.sub("", latex), "block", where)
        return f'<div class="equation"{anchor}><span class="formula">{formula}</span>{said}</div>'

    content = DISPLAYED.sub(displayed, content)
    return INLINE.sub(lambda found: _mathml(html.unescape(found[1]), "inline", where), content)


def _mathml(latex: str, display: str, where: str) -> str:
    """MathML of one equation, with the space around logarithms and strokes that books give them."""
    made = convert(UPRIGHT.sub(r"\\text{\1}", latex.strip()), display=display)
    made = LOGARITHM.sub('<mi>ln</mi><mspace width="0.167em" />', made)
    made = made.replace("<mo>&#x0002F;</mo>", '<mo lspace="0" rspace="0">&#x0002F;</mo>')
    if "\\" in html.unescape(made):
        LOG.warning("%s: the equation %r holds a command that was not understood", where, latex)
    return made
