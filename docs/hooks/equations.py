"""Write equations as MathML, which browsers draw themselves: no script, nothing is downloaded."""

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
    """Replace the parts that the Markdown extension has marked as equations."""
    where = page.file.src_uri

    def displayed(match: re.Match[str]) -> str:
        latex = html.unescape(match[1])
        number = TAG.search(latex)
        label = f'<span class="number">({number[1]})</span>' if number else ""
        anchor = f' id="eq-{number[1].lower()}"' if number else ""
        formula = _mathml(TAG.sub("", latex), "block", where)
        return f'<div class="equation"{anchor}><span class="formula">{formula}</span>{label}</div>'

    content = DISPLAYED.sub(displayed, content)
    return INLINE.sub(lambda match: _mathml(html.unescape(match[1]), "inline", where), content)


def _mathml(latex: str, display: str, where: str) -> str:
    """Return the MathML of one equation, with the usual space around logarithms and strokes."""
    mathml = convert(UPRIGHT.sub(r"\\text{\1}", latex.strip()), display=display)
    mathml = LOGARITHM.sub('<mi>ln</mi><mspace width="0.167em" />', mathml)
    mathml = mathml.replace("<mo>&#x0002F;</mo>", '<mo lspace="0" rspace="0">&#x0002F;</mo>')
    if "\\" in html.unescape(mathml):
        LOG.warning("%s: the equation %r contains a command that is not supported", where, latex)
    return mathml
