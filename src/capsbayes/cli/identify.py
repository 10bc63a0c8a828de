"""``capsbayes identify``: shear modulus and radius of a measured capsule."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from capsbayes.cli.measure.picture import DETECTED, is_picture, measured_picture
from capsbayes.cli.options import (
    BY_HAND,
    AsJson,
    Background,
    ExperimentFile,
    Flow,
    FlowRate,
    MembraneKnown,
    ModelName,
    Priors,
    Seed,
    Velocity,
    by_hand_of,
    capsule_model,
    effort_of,
    membrane_of,
    named_experiment,
    prior_texts,
    speeds_of,
    with_options_of,
)
from capsbayes.cli.output import conclude, model_words
from capsbayes.cli.paths import Reads, Writes
from capsbayes.errors import InputError


def _written(values: Mapping[str, Any]) -> tuple[str, ...]:
    results = ("posterior.nc", "summary.json", "corner.png", "outline.png")
    return (*results, *DETECTED) if is_picture(values["capsule"]) else results


@with_options_of(effort_of, "effort")
@with_options_of(by_hand_of, "by_hand")
def identify(
    capsule: Annotated[
        Path,
        typer.Argument(
            help="TOML file of the capsule: lengths, velocity, its experiment's file; or a picture (PNG, TIFF, JPEG), "
            "which is measured first."
        ),
        Reads(),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for posterior.nc, summary.json, corner.png, outline.png; of a picture, measurement.toml too."
        ),
        Writes(within=_written),
    ] = None,
    experiment: ExperimentFile = None,
    database: ModelName = None,
    membrane: MembraneKnown = None,
    prior: Priors = None,
    velocity: Velocity = None,
    flow_rate: FlowRate = None,
    background: Background = None,
    flow: Flow = None,
    by_hand: Any = None,
    engine: Annotated[
        str | None,
        typer.Option(
            help="emcee or quadrature; default: emcee, checked by quadrature; quadrature alone for a model with "
            "several further coordinates, or with one and a silhouette."
        ),
    ] = None,
    effort: Any = None,
    seed: Seed = 1,
    as_json: AsJson = False,
) -> None:
    """Identify one capsule: posterior of the shear modulus of its membrane and of its radius."""
    from capsbayes.experiment import Experiment
    from capsbayes.files.input_file import PICTURES
    from capsbayes.infer import Membrane, Prior
    from capsbayes.infer import identify as identified
    from capsbayes.infer.identify import prepare, with_other_laws
    from capsbayes.measurement import Measurement
    from capsbayes.report.files import posterior_files
    from capsbayes.report.posterior import posterior_parts, status_words
    from capsbayes.run import resumable

    speeds = {"--velocity": velocity, "--flow-rate": flow_rate}
    if is_picture(capsule):
        if experiment is None:
            raise InputError("identify", "--experiment", "the experiment's file with a picture", "nothing")
        channel = Experiment.read(experiment)
        how = speeds_of(speeds, channel), background, flow, out
        measurement = measured_picture(capsule, channel, *how, by_hand=by_hand, quiet=as_json)
        written, stated = Prior(), None
    else:
        of_pictures = {option: by_hand and getattr(by_hand, name) for name, option in BY_HAND.items()}
        of_pictures |= speeds | {"--background": background, "--flow": flow}
        for option, given in of_pictures.items():
            if given is not None:
                name = {"--velocity": "capsule_velocity", "--flow-rate": "flow_rate"}.get(option, "")
                advice = f"state {name} in it" if name else ""
                raise InputError("identify", option, f"a picture ({', '.join(PICTURES)})", str(capsule), advice)
        measurement, written, stated = Measurement.read(capsule), Prior.read(capsule), Membrane.read(capsule)
    if effort is not None and engine == "quadrature":
        raise InputError("identify", "--engine", "emcee with --walkers, --steps, --ensembles or --most-steps", engine)
    believed = written.with_texts(prior_texts(prior), where="--prior")
    known = named_experiment(measurement, experiment)
    view = None if measurement.outline is None else measurement.outline.view
    sheet = membrane_of(stated, membrane)
    if sheet is None:
        prepare(known.cross_section)
    model = capsule_model(database, sheet, known.cross_section, view)
    with resumable(out):
        settings = {"engine": engine, "effort": effort, "prior": believed, "membrane": sheet}
        posterior = identified(measurement, model, known, seed=seed, **settings)
        if not model.coordinates:
            posterior = with_other_laws(posterior)
        model_line = model_words(posterior.model_name, posterior.model_sha256, posterior.seed)
        conclude(
            posterior.as_dict(),
            lambda: [*posterior_parts(posterior), model_line],
            posterior_files(posterior),
            out=out,
            as_json=as_json,
            status=posterior.status,
            status_words=status_words(posterior),
        )
