"""Write equations as MathML, which browsers draw themselves: no script, nothing is downloaded."""

from __future__ import annotations

import html
import re

from latex2mathml.converter import convert

CODE = r"^(?P<fence> *```).*?^(?P=fence)`*$|(?P<ticks>`+)(?!`).+?(?<!`)(?P=ticks)(?!`)"
PARTS = re.compile(
    CODE + r"|\$\$(?P<displayed>.+?)\$\$|(?<![\\$])\$(?!\s)(?P<inline>(?:\\.|\n(?!\n)|[^\\$\n])+?)(?<!\s)\$",
    re.DOTALL | re.MULTILINE,
)
UPRIGHT = re.compile(r"\\mathrm\{([^{}]*)\}")  # a single upright letter would come out slanted
LOGARITHM = re.compile(r"<mi>ln</mi>(?!<mo)")
TAG = re.compile(r"\\tag\{([^}]*)\}")
SIGNS_OF_MARKDOWN = re.compile(r"[*_`\[\]|\\~^$!](?=[^<>]*<)")


def with_mathml(markdown: str) -> tuple[str, list[str]]:
    """Replace the equations of a page, outside its code; return the page and the equations that cannot be shown."""
    unknown: list[str] = []

    def replaced(part: re.Match[str]) -> str:
        latex = part["displayed"] or part["inline"]
        if latex is None:
            return part[0]
        mathml = _displayed(latex) if part["displayed"] else f"<span>{_mathml(latex, 'inline')}</span>"  # not a block
        if "\\" in html.unescape(mathml):
            unknown.append(latex.strip())
        return mathml

    return PARTS.sub(replaced, markdown), unknown


def _displayed(latex: str) -> str:
    """An equation on a line of its own, with its number; a span, which may stand in a paragraph and in a list."""
    number = TAG.search(latex)
    label = f'<span class="number">({number[1]})</span>' if number else ""
    anchor = f' id="eq-{number[1].lower()}"' if number else ""
    formula = _mathml(TAG.sub("", latex), "block")
    return f'<span class="equation"{anchor}><span class="formula">{formula}</span>{label}</span>'


def _mathml(latex: str, display: str) -> str:
    """Return the MathML of one equation, with the usual space around logarithms and strokes, safe within Markdown."""
    mathml = convert(UPRIGHT.sub(r"\\text{\1}", latex.strip()), display=display)
    mathml = LOGARITHM.sub('<mi>ln</mi><mspace width="0.167em" />', mathml)
    mathml = mathml.replace("<mo>&#x0002F;</mo>", '<mo lspace="0" rspace="0">&#x0002F;</mo>')
    return SIGNS_OF_MARKDOWN.sub(lambda sign: f"&#x{ord(sign[0]):X};", mathml)
