"""What the second process apart computes: posteriors and saved files, from names in a capsule's folder.

They call what the commands ``identify`` and ``report`` call, with the same names of files, from the capsule's folder:
the files that they write are the same byte for byte.
"""

from __future__ import annotations

import contextlib
import functools
from pathlib import Path
from typing import Any, NamedTuple

from capsbayes.app.measuring import detected
from capsbayes.app.stated import EXAMPLE, EXAMPLE_PICTURE, EXPERIMENT, SEED, Stated, page_words
from capsbayes.errors import CapsbayesError, InputError
from capsbayes.experiment import Experiment
from capsbayes.files.output_file import guarded, together
from capsbayes.image.detect import Detection
from capsbayes.image.files import Picture
from capsbayes.image.measure import detect, measurement_of, write_detection
from capsbayes.infer import Membrane, Posterior, Prior
from capsbayes.infer.identify import identify, with_other_laws
from capsbayes.infer.outline import band
from capsbayes.measurement import Measurement
from capsbayes.quantity import Quantity, uncertain
from capsbayes.report import posterior as texts
from capsbayes.report.files import posterior_files
from capsbayes.report.numbers import value_words
from capsbayes.report.page import picture as figure_html
from capsbayes.report.posterior_figures import SHOWN, corner_of_few, densities_figure, density_figure, on_picture
from capsbayes.report.tables import html_table, typeset
from capsbayes.report.write import POSTERIOR, opened, write_report
from capsbayes.surrogate.open import model_named


class _Answer(NamedTuple):
    """Picture and detection of a capsule, if it was measured in one, and what was found."""

    seen: tuple[Picture, Detection] | None
    measurement: Measurement
    posterior: Posterior


def identified(folder: str, stated: Stated) -> dict[str, Any]:
    """Measure and identify; return the headlines, the tables as HTML, and the predicted outline on the picture."""
    with contextlib.chdir(folder):
        asked = stated.asked(Path())
        answer = _answer(folder, asked)
    posterior, marginals, predicted = answer.posterior, answer.posterior.marginals, None
    if answer.seen is not None and posterior.outlines is not None:
        predicted = on_picture(band(posterior.outlines)[0], answer.seen[1]).tolist()
    budget = texts.budget_table(posterior)
    return {
        "asked": asked,
        "headlines": [typeset(value_words(name, marginals[name])) for name in SHOWN[:2]],
        "ok": posterior.status.ok,
        "status": texts.status_words(posterior),
        "caveats": [typeset(page_words(caveat)) for caveat in texts.caveats(posterior)],
        "densities": [str(figure_html(density_figure(posterior, name), f"density of {name}")) for name in SHOWN[:2]],
        "All quantities": html_table(texts.quantity_table(posterior)),
        "budget_sentence": typeset(texts.budget_sentence(posterior)),
        "budget": "" if budget is None else html_table(budget),
        "Checks of the computation": html_table(texts.check_table(posterior)),
        "predicted": predicted,
        "summary": {name: (marginals[name].median, marginals[name].sd) for name in SHOWN[:2]},
    }


def corner(folder: str, stated: Stated) -> str:
    """Return the corner plot of an identified capsule as HTML."""
    with contextlib.chdir(folder):
        posterior = _answer(folder, stated.asked(Path())).posterior
    return str(figure_html(corner_of_few(posterior), "corner plot of the posterior", png=True))


def saved(folder: str, stated: Stated) -> list[str]:
    """Write what ``capsbayes identify --out .`` and ``capsbayes report .`` write; return the names of the files."""
    with contextlib.chdir(folder), guarded():
        answer, here = _answer(folder, stated.asked(Path())), Path()
        with together():
            if answer.seen is not None:
                write_detection(here, *answer.seen, answer.measurement, answer.posterior.experiment)
            for name, write in posterior_files(answer.posterior).items():
                write(here / name)
        posterior, source = opened(here)
        write_report(posterior, "report.html", source=source)
        return sorted(path.name for path in here.iterdir() if not path.name.startswith("."))


def compared(capsules: dict[str, tuple[str, tuple[Any, ...] | None]]) -> tuple[str, str]:
    """Return densities and table of G_s as HTML, of capsules by folder and what `Stated.asked` gave, None if saved."""
    posteriors = {}
    for name, (folder, asked) in capsules.items():
        with contextlib.chdir(folder):
            if asked is not None and asked[0].asked(Path()) != asked:
                raise InputError(name, "", "what it was identified from", "other numbers", "identify it again")
            posteriors[name] = Posterior.read(POSTERIOR) if asked is None else _answer(folder, asked).posterior
    drawn = figure_html(densities_figure(posteriors, SHOWN[0]), f"densities of G_s of {', '.join(posteriors)}")
    return drawn, html_table(texts.comparison_table(posteriors))


@functools.lru_cache(maxsize=4)  # a picture may take 64 MB
def _answer(folder: str, asked: tuple[Any, ...]) -> _Answer:
    """Measure and identify what `Stated.asked` returned of a folder."""
    stated: Stated = asked[0]
    measurement = Measurement.read(stated.measured) if stated.measured else None
    experiment = Experiment.read((measurement and measurement.experiment_file) or EXPERIMENT)
    seen = None
    if measurement is None:
        seen = detected(stated, experiment)
        measurement = measurement_of(seen[1], seen[0], experiment, *_speeds(stated, experiment))
    if not measurement.status.ok:
        raise InputError(stated.picture, "", "a capsule that can be measured", page_words(measurement.status))
    membrane = Membrane(stated.membrane) if stated.membrane else None
    law = "neo-hookean" if membrane is None else "membrane"
    model = _opened(f"{experiment.cross_section}-{law}", measurement.view)
    prior = Prior().with_texts(stated.priors())
    posterior = identify(
        measurement, model, experiment, engine=stated.engine, seed=SEED, prior=prior, membrane=membrane
    )
    if not model.coordinates:
        posterior = with_other_laws(posterior)
    return _Answer(seen, measurement, posterior)


_opened = functools.lru_cache(maxsize=4)(model_named)


def _speeds(stated: Stated, experiment: Experiment) -> tuple[Quantity | None, Quantity | None]:
    """Return the velocity and the flow rate of step 3, at least one of them unless mu U is stated there."""
    if experiment.viscous_tension is not None:
        return None, None
    rate = speed = None
    if stated.flow_rate:
        example = "0.56 +/- 0.01 uL/min"
        rate = uncertain(stated.flow_rate, "flow_rate", where="flow rate", units=("m^3/s",), example=example)
    if stated.velocity or rate is None:
        example = "6.20 +/- 0.06 mm/s"
        speed = uncertain(stated.velocity, "capsule_velocity", where="velocity", units=("m/s",), example=example)
    return speed, rate


def warm() -> None:
    """Measure and identify the example: compiled functions are loaded before a person waits for them."""
    stated = Stated(velocity=EXAMPLE["velocity"])
    experiment = Experiment("square", EXAMPLE["half_width"], EXAMPLE["viscosity"])
    with contextlib.suppress(CapsbayesError):
        seen = Picture.read(EXAMPLE_PICTURE)
        measurement = measurement_of(detect(seen), seen, experiment, *_speeds(stated, experiment))
        model = _opened("square-neo-hookean", measurement.view)
        with_other_laws(identify(measurement, model, experiment, engine="quadrature", seed=SEED))


TASKS = {task.__name__: task for task in (identified, corner, saved, compared)}
