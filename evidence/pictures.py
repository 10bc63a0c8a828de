"""Renew pictures of ``docs/pictures``: ``python -m evidence.pictures batch diagnosis``; without names, all below.

The commands that the pages show draw them, or the figures of the reports; ``reports`` needs a Chromium and playwright.
Those of the page of the bench are renewed by ``tests/app/test_walk.py``.
"""

from __future__ import annotations

import argparse
import io
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from shutil import which

from matplotlib.figure import Figure
from PIL import Image

import capsbayes as cb
from capsbayes.effects import SIMULATED
from capsbayes.infer.hierarchy import ModulusSpread
from capsbayes.report.population_figures import modulus_histogram
from capsbayes.report.study_figures import outline_finding
from evidence.command import Arguments, run

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
_DPI = 130
_COLOURS = 128  # of a picture; more make the file larger only
_PAGES = (("capsule.html", 540), ("population.html", 540), ("capsule.html", 330))
"""Pages of reports, and the width of the window of each in px."""
_HEIGHT, _GAP = 760, 16  # px


def corner() -> bytes:
    """Return the corner plot of the first command of the page of one capsule."""
    with tempfile.TemporaryDirectory() as folder:
        _capsbayes(f"identify examples/ovalbumin/capsule.toml --out {folder}/result")
        return _few_colours(Image.open(f"{folder}/result/corner.png"))


@cache
def population() -> cb.Population:
    """Return the batch of sixty capsules, with what they have in common."""
    experiment = cb.Experiment.read(EXAMPLES / "batch" / "experiment.toml")
    model = cb.Surrogate.open("square-neo-hookean")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "run.nc")
        table = EXAMPLES / "batch" / "capsules.csv"
        made = cb.identify_folder(table, model, experiment, out=out, seed=1, check=0.0, progress=False)
    return cb.hierarchy(made, seed=1).added_to(made)


def batch() -> bytes:
    """Return the histogram of the batch."""
    return _drawn(modulus_histogram(population(), ModulusSpread.of_population(population())))


def reports() -> bytes:
    """Return the pages of a capsule, of a population, and of the capsule on a phone, side by side."""
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        _capsbayes(
            "identify examples/pictures/capsule.png --experiment examples/pictures/experiment.toml "
            f"--velocity '4.86 +/- 0.04 mm/s' --background examples/pictures/empty.png --out {folder}/result"
        )
        _capsbayes(f"report {folder}/result --out {folder}/capsule.html")
        cb.write_report(population(), f"{folder}/population.html")
        browser = playwright.chromium.launch(executable_path=which("chromium"), args=["--no-sandbox"])
        whole, left = Image.new("RGB", (sum(width + _GAP for _, width in _PAGES) - _GAP, _HEIGHT), "#cccccc"), 0
        for name, width in _PAGES:
            page = browser.new_page(viewport={"width": width, "height": _HEIGHT})
            page.goto(Path(folder, name).as_uri())
            whole.paste(Image.open(io.BytesIO(page.screenshot())), (left, 0))
            left += width + _GAP
        browser.close()
    return _few_colours(whole)


@cache
def study() -> cb.Study:
    """Return the study of the drifting modulus with the effect that explains it alone, and none."""
    session = cb.Session.read(EXAMPLES / "drifting_modulus" / "capsules")
    effects = {"pre_inflation": SIMULATED["pre_inflation"]}
    return cb.diagnose(session, cb.Surrogate.open("square-neo-hookean"), seed=1, candidates=effects)


def deviation() -> bytes:
    """Return where the capsules of the drifting modulus deviate from the model."""
    compared = study().comparison
    assert compared is not None
    assert compared.along_outline is not None
    return _drawn(outline_finding(compared.along_outline, study().finding))


PICTURES: dict[str, Callable[[], bytes]] = {
    "one-capsule-corner": corner,
    "batch": batch,
    "diagnosis": deviation,
    "reports": reports,
}


def _capsbayes(words: str) -> None:
    subprocess.run([sys.executable, "-m", "capsbayes", *shlex.split(words), "--quiet"], check=True, cwd=ROOT)


def _drawn(figure: Figure) -> bytes:
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=_DPI, metadata={"Software": None})
    return content.getvalue()


def _few_colours(picture: Image.Image) -> bytes:
    content = io.BytesIO()
    picture.convert("RGB").quantize(_COLOURS).save(content, format="png", optimize=True)
    return content.getvalue()


def renew(given: argparse.Namespace) -> int:
    """Draw the pictures that are named, or all."""
    for name in given.names or PICTURES:
        content = PICTURES[name]()
        (ROOT / "docs" / "pictures" / f"{name}.png").write_bytes(content)
        print(f"{name}.png is renewed", flush=True)
    return 0


def main() -> None:
    """Renew the pictures that the command line names."""
    arguments = Arguments("pictures", __doc__ or "")
    arguments.add_argument("names", nargs="*", choices=[[], *PICTURES], metavar="NAME", help=", ".join(PICTURES))
    run(arguments, renew)


if __name__ == "__main__":
    main()
