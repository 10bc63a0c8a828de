"""Commands of one capsule: its shear modulus and radius, the page of a result, and the bench in a browser."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import capsbayes as cb
from capsbayes.cli import options
from capsbayes.cli.command import Input, Option, Options, Reads, Writes, command, wants_json
from capsbayes.cli.measuring import DETECTED, is_picture, measured_picture
from capsbayes.cli.output import conclude, model_words, tell, waiting
from capsbayes.errors import InputError

if TYPE_CHECKING:
    from capsbayes.infer.sampling import Effort


@dataclass(frozen=True)
class EngineOptions(Options):
    """Which engine identifies a capsule, and how much emcee samples."""

    engine: Annotated[
        str | None,
        Option(
            "emcee or quadrature; default: emcee, checked by quadrature; quadrature alone for a model with several "
            "further coordinates, or with one and a silhouette."
        ),
    ] = None
    walkers: Annotated[int | None, Option("Of each ensemble of emcee; default: 64.", min=8)] = None
    steps: Annotated[
        int | None, Option("Of emcee before its checks are made the first time; default: 450.", min=50)
    ] = None
    ensembles: Annotated[
        int | None, Option("Independent ensembles of emcee, compared with each other; default: 4.", min=4)
    ] = None
    most_steps: Annotated[int | None, Option("Of emcee, at which it ends in any case; default: 10000.", min=50)] = None

    def effort(self) -> Effort | None:
        """Return how much is sampled; None if nothing is stated."""
        stated = {"walkers": self.walkers, "steps": self.steps, "ensembles": self.ensembles, "budget": self.most_steps}
        given = {name: value for name, value in stated.items() if value is not None}
        if not given:
            return None
        from capsbayes.infer.sampling import Effort

        effort = Effort(**given)
        if self.engine == "quadrature":
            expected = "emcee with --walkers, --steps, --ensembles or --most-steps"
            raise InputError("identify", "--engine", expected, self.engine)
        if effort.steps > effort.budget:
            raise InputError("identify", "--steps", f"at most --most-steps, {effort.budget}", str(effort.steps))
        return effort


def _written(values: Mapping[str, Any]) -> tuple[str, ...]:
    results = ["posterior.nc", "summary.json", "corner.png", "outline.png"]
    results += ["simulator.png"] * bool(values["resimulate"])
    return (*results, *DETECTED) if is_picture(values["capsule"]) else tuple(results)


@command
def identify(
    capsule: Annotated[
        Path,
        Input(
            "TOML file of the capsule: lengths, velocity, its experiment's file; or a picture (PNG, TIFF, JPEG, BMP), "
            "which is measured first."
        ),
    ],
    out: Annotated[
        Path | None,
        Writes(
            "Folder for posterior.nc, summary.json, corner.png, outline.png; of a picture, measurement.toml too.",
            within=_written,
        ),
    ] = None,
    experiment: options.ExperimentFile = None,
    database: options.ModelName = None,
    membrane: options.MembraneKnown = None,
    prior: options.Priors = None,
    refine: options.Refine = None,
    *,
    picture: options.PictureOptions,
    sampling: EngineOptions,
    resimulate: Annotated[
        int | None,
        Option(
            "Simulate so many draws of the posterior, some 3 s each, and correct it for what the model is off; the "
            "shapes are kept in the folder of --out. Default: none.",
            min=5,
            max=1000,
        ),
    ] = None,
    seed: options.Seed = 1,
) -> None:
    """Identify one capsule: posterior of the shear modulus of its membrane and of its radius."""
    from capsbayes.infer.identify import prepare, with_other_laws
    from capsbayes.report.files import posterior_files, posterior_summary
    from capsbayes.report.posterior import posterior_parts, status_words
    from capsbayes.run import resumable

    effort = sampling.effort()
    if resimulate is not None and out is None:
        raise InputError("identify", "--resimulate", "--out with it, the folder where the shapes are kept", "no --out")
    measurement = _measurement(capsule, experiment, picture, out)
    stated = not is_picture(capsule)
    believed = options.prior_of(prior, cb.Prior.read(capsule) if stated else None)
    sheet = options.membrane_of(cb.Membrane.read(capsule) if stated else None, membrane)
    if refine is not None and sheet is None:
        raise InputError("identify", "--refine", "--membrane unknown (or [membrane]) with it", "a model of one law")
    known = options.named_experiment(measurement, experiment)
    if sheet is None:
        prepare(known.cross_section)
    model = options.capsule_model(database, sheet, known, measurement)
    if resimulate is not None:
        from capsbayes.resimulation import ShapeSource

        ShapeSource.of(model)  # a model that the simulator does not follow is refused before a minute has passed
    with resumable(out):
        how: dict[str, Any] = {"engine": sampling.engine, "effort": effort, "prior": believed, "membrane": sheet}
        refined = None
        if refine is not None:
            of_membrane: dict[str, Any] = {"progress": not wants_json.get(), "membrane": sheet, "prior": believed}
            refined = cb.refine_model([measurement], known, states=refine, seed=seed, **of_membrane)
            model = refined.model
        posterior = cb.identify(measurement, model, known, seed=seed, **how)
        if resimulate is not None and out is not None:
            how = {"folder": out / "shapes", "membrane": sheet, "effort": effort}
            posterior = cb.resimulate(posterior, model, resimulate, **how)
        if refined:
            posterior = refined.noted_in(posterior)
        if not model.coordinates:
            posterior = with_other_laws(posterior)
        result = posterior_summary(posterior) if wants_json.get() else posterior.as_dict()  # the former imports ArviZ
        files = posterior_files(posterior)
        parts, words = [*posterior_parts(posterior), model_words(**result["model"], seed=seed)], status_words(posterior)
        conclude(result, parts, files, out=out, status=posterior.status, status_words=words)


def _measurement(
    capsule: Path, experiment: Path | None, picture: options.PictureOptions, out: Path | None
) -> cb.Measurement:
    """Read the measurement of a capsule, or measure its picture."""
    from capsbayes.files.input_file import PICTURES

    if is_picture(capsule):
        if experiment is None:
            raise InputError("identify", "--experiment", "the experiment's file with a picture", "nothing")
        return measured_picture(capsule, cb.Experiment.read(experiment), picture, out)
    for option in picture.given():
        name = {"--velocity": "capsule_velocity", "--flow-rate": "flow_rate"}.get(option, "")
        advice = f"state {name} in it" if name else ""
        raise InputError("identify", option, f"a picture ({', '.join(PICTURES)})", str(capsule), advice)
    return cb.Measurement.read(capsule)


@command
def report(
    result: Annotated[
        str,
        Input(
            "Folder or posterior.nc of capsbayes identify, .nc file of a population or of a database, or name of "
            "a shipped database."
        ),
    ],
    out: Annotated[Path, Writes("HTML file to write.", ".html", ".htm")] = Path("report.html"),
    picture: Annotated[
        Path | None, Reads("Of a posterior: picture of the capsule; default: the one it was measured in.")
    ] = None,
    rows: Annotated[int, Option("Of a population: most capsules in the table, worst first.", min=1)] = 500,
) -> None:
    """Write a result as one HTML page that holds its pictures, to read on a screen or a phone and to print."""
    from capsbayes.report import opened
    from capsbayes.run import only_run

    read, source = opened(result)
    if picture is not None and not isinstance(read, cb.Posterior):
        raise InputError("report", "--picture", "a posterior with a picture", source)
    with only_run(out), waiting("Drawing ..."):
        path = cb.write_report(read, out, picture=picture, rows=rows, source=source)
    size = path.stat().st_size
    tell({"file": str(path), "bytes": size}, f"Written to {path}, {size / 1e6:.1f} MB.")


@partial(command, has_result=False)
def bench(
    folder: Annotated[
        Path, Writes("Folder in which capsules are kept, one folder each; no other user can enter it.")
    ] = Path("capsbayes-bench"),
    port: Annotated[int, Option("Port on this machine; 0 for any that is free.", min=0, max=65535)] = 0,
    browser: Annotated[
        bool, Option("Open the page in the browser, or print its address only.", "--browser/--no-browser")
    ] = True,
) -> None:
    """Open the bench in a browser: from a picture to the report, without a line of code.

    The page is served on this machine alone, to the browser that opens the address that is printed; it works once.
    """
    if importlib.util.find_spec("nicegui") is None:
        advice = 'install it with pip install "capsbayes[app]"'
        raise InputError("app", "", "the package that serves the page", "no nicegui", advice)
    import webbrowser

    from capsbayes.app.server import serve

    serve(folder, port, webbrowser.open if browser else None)
