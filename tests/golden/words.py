"""What every command prints and writes, for inputs as they should be and for mistakes."""

from __future__ import annotations

import functools
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import inputs
import touches
from commands import Desk
from environment import REPOSITORY

LAB = ("--extent-error", "0.01", "--length-error", "0.01", "--velocity-error", "0.01")
SPEED = ("--velocity", "6.20 +/- 0.06 mm/s")
COARSE = ("--ca", "0.05", "--size-ratio", "0.8", "--refinement", "4")
OVALBUMIN, DRIFT = "ovalbumin/capsule.toml", "drift"


def words(work: Path) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Helps, mistakes, and each command at work."""
    desk = Desk(work)
    _prepare(desk)
    yield "no arguments", functools.partial(desk.run)
    for command in ("", *touches.COMMANDS):
        yield f"{command} --help".strip(), functools.partial(desk.run, *command.split(), "--help")
    for arguments in MISTAKES:
        yield f"mistake: {' '.join(arguments)}", functools.partial(desk.run, *arguments)
    for arguments in AT_WORK:
        yield " ".join(arguments), functools.partial(desk.run, *arguments)
    for name in ("own_law", "own_effect", "film", "batch", "drifting_modulus"):
        script = str(REPOSITORY / "examples" / name / f"{name}.py")
        yield f"examples/{name}/{name}.py", functools.partial(desk.run, script, program=[sys.executable])


def _prepare(desk: Desk) -> None:
    """Put all inputs into the folder."""
    folder, examples = desk.folder, REPOSITORY / "examples"
    for name in ("ovalbumin", "batch"):
        shutil.copytree(examples / name, folder / name)
    shutil.copytree(examples / "drifting_modulus" / "capsules", folder / DRIFT)
    (folder / "few").mkdir()
    for name in ("experiment.toml", "capsule-001.toml", "capsule-001.outline.csv", "capsule-002.toml"):
        shutil.copy(folder / DRIFT / name, folder / "few")
    shutil.copy(folder / DRIFT / "capsule-002.outline.csv", folder / "few")
    film = Desk(folder).run("--out", "film", program=[sys.executable, str(examples / "film" / "film.py")], keep=())
    if film["status"]:
        raise RuntimeError(film["stderr"])
    frames = sorted((folder / "film" / "frames").iterdir())
    shutil.copy(frames[4], folder / "film" / "capsule.png")
    (folder / "film" / "short").mkdir()
    for frame in frames[:9]:
        shutil.copy(frame, folder / "film" / "short")
    inputs.contour_file(
        folder / "contour.csv", inputs.case("square-neo-hookean", 0.08, 1.05)["silhouette"], pixels=55.0, seed=1
    )
    inputs.rtdc_file(folder / "events.rtdc")
    inputs.experiment_file(folder / "experiment.toml")
    (folder / "sphere.toml").write_text('section = "square"\nhalf_width = "10 um"\nviscosity = "0.015 Pa s"\n')
    (folder / "pools").symlink_to(REPOSITORY / "data" / "pools")
    (folder / "empty").mkdir()
    (folder / "text.nc").write_text("no numbers")
    (folder / "cases.csv").write_text("capillary_number,size_ratio\n0.05,0.8\n")
    (folder / "bad-cases.csv").write_text("capillary_number,size_ratio\n0.05,0.9\n0.2,large\n")
    text = (folder / OVALBUMIN).read_text()
    for name, old, new in (
        ("misspelt", "axial_extent", "axial_extend"),
        ("unit", "mm/s", "mm"),
        ("nan", "6.20", "nan"),
        ("unlike", 'axial_extent = "', 'axial_extent = "3'),
        ("longer", 'axial_length = "', 'axial_length = "9'),
        ("nowhere", "experiment.toml", "tunnel.toml"),
        ("unfinished", "[measurement]", "[measurement"),
    ):
        (folder / "ovalbumin" / f"{name}.toml").write_text(text.replace(old, new))
    lines = [line for line in text.splitlines() if not line.startswith("axial_length")]
    (folder / "ovalbumin" / "short.toml").write_text("\n".join(lines) + "\n")
    (folder / "bad.csv").write_text("name,axial_extent_over_l\n1,2.0\n")


MISTAKES = (
    ("wobble",),
    ("identify",),
    ("identify", "none.toml"),
    ("identify", OVALBUMIN, "--engine", "x"),
    ("identify", OVALBUMIN, "--seed", "-1"),
    ("identify", OVALBUMIN, "--database", "moon"),
    ("identify", OVALBUMIN, "--database", "text.nc"),
    ("identify", OVALBUMIN, "--database", "circular-skalak"),
    ("identify", OVALBUMIN, "--prior", "halo=0 .. 1"),
    ("identify", OVALBUMIN, "--out", "text.nc"),
    ("identify", OVALBUMIN, "--velocity", "6 mm/s"),
    ("identify", "film/capsule.png", "--experiment", "experiment.toml"),
    *(
        ("identify", f"ovalbumin/{name}.toml")
        for name in ("misspelt", "unit", "nan", "unlike", "longer", "nowhere", "unfinished")
    ),
    ("batch", "empty", "--out", "no.nc"),
    ("batch", "batch/capsules.csv", "--out", "no.nc"),
    ("batch", "batch/capsules.csv", "--out", "no.txt"),
    ("batch", "bad.csv", "--out", "no.nc", "--experiment", "experiment.toml"),
    ("batch", "none.csv", "--out", "no.nc"),
    ("population", "text.nc"),
    ("population", "none.nc"),
    ("diagnose", "empty"),
    ("diagnose", "few", "--candidates", "gravity"),
    ("diagnose", "few", "--measured", "halo=0.3 um"),
    ("report", "moon"),
    ("report", "empty"),
    ("report", "text.nc"),
    ("report", "square-neo-hookean", "--picture", "film/capsule.png"),
    ("report", "square-neo-hookean", "--rows", "0"),
    ("atlas", "moon"),
    ("validate", "moon"),
    ("rebuild", "moon", "--out", "moon.nc"),
    ("simulate", "--ca", "0.05"),
    ("simulate", "--ca", "-0.05", "--size-ratio", "0.8"),
    ("simulate", "--ca", "0.05", "--size-ratio", "0.8", "--law", "rubber"),
    ("simulate", "--ca", "0.05", "--size-ratio", "0.8", "--cross-section", "star"),
    ("simulate", "--ca", "0.05", "--size-ratio", "0.8", "--corner-radius", "1.5"),
    ("simulate", "--ca", "0.05", "--size-ratio", "0.8", "--paraview", "shape.stl"),
    ("transient", *COARSE, "--until", "-1"),
    ("transient", *COARSE, "--until", "1", "--scheme", "wild"),
    ("transient", *COARSE, "--until", "1", "--viscosity-ratio", "2"),
    ("build", "--out", "no.nc"),
    ("build", "--out", "no.nc", "--cases", "cases.csv", "--grid", "default"),
    ("build", "--out", "no.nc", "--cases", "bad-cases.csv"),
    ("build", "--out", "no.nc", "--grid", "fine"),
    ("build", "--out", "no.nc", "--grid", "default", "--effect", "bending"),
    ("build", "--out", "no.nc", "--grid", "default", "--workers", "0"),
    ("hide", "--effect", "gravity", "--out", "set"),
    ("hide", "--effect", "halo", "--effect-size", "3", "--out", "set"),
    ("hide", "--effect", "none", "--out", "batch"),
    ("exam", "--out", "examined", "--pools", "pools", "--only", "nonsense"),
    ("verify", "--out", "verified", "--only", "nonsense"),
    ("measure", "film/capsule.png", "--experiment", "experiment.toml"),
    ("measure", "film/capsule.png", "--experiment", "experiment.toml", "--velocity", "6.2 mm/s"),
    ("measure", "film/frames", "--experiment", "experiment.toml"),
    ("measure", "contour.csv", "--experiment", "experiment.toml", *SPEED),
    ("measure", "none.png", "--experiment", "experiment.toml", *SPEED),
    ("sensitivity", "map", *LAB),
    ("sensitivity", "map", "--like", OVALBUMIN, *LAB),
    ("sensitivity", "flow", "--shear-modulus", "50", "--radius", "24 um", "--like", OVALBUMIN),
    ("sensitivity", "sobol", OVALBUMIN, "--range", "colour=1 .. 2"),
    ("sensitivity", "sobol", OVALBUMIN, "--samples", "100"),
    ("sensitivity", "budget", "none.toml"),
)
"""Each ends with exit status 2 and a line that says what was expected."""

AT_WORK = (
    ("identify", OVALBUMIN, "--out", "ovalbumin-result"),
    ("identify", OVALBUMIN, "--engine", "quadrature", "--json"),
    ("identify", "ovalbumin/short.toml", "--engine", "quadrature"),
    ("identify", "few/capsule-001.toml", "--engine", "quadrature", "--out", "few-result", "--seed", "3"),
    (
        *("identify", OVALBUMIN, "--engine", "quadrature", "--database", "square-pre-inflation"),
        *("--prior", "pre_inflation=0.02 +/- 0.01", "--out", "inflated-result"),
    ),
    ("identify", "film/capsule.png", "--experiment", "experiment.toml", *SPEED, "--background", "film/empty.png"),
    ("report", "ovalbumin-result", "--out", "posterior.html"),
    ("report", "few-result", "--out", "outline.html"),
    ("report", "inflated-result/posterior.nc", "--out", "inflated.html", "--picture", "film/capsule.png"),
    (
        *("batch", "batch/capsules.csv", "--experiment", "batch/experiment.toml", "--out", "run.nc"),
        *("--workers", "1", "--check", "0.05"),
    ),
    ("batch", "few", "--out", "few.nc", "--workers", "1", "--check", "0"),
    ("population", "run.nc"),
    ("population", "run.nc", "--least-stretch", "1.04", "--velocity-error", "0.5 %", "--json"),
    ("report", "run.nc", "--out", "population.html", "--rows", "20"),
    ("report", "few.nc", "--out", "few.html"),
    ("diagnose", "few"),
    ("diagnose", DRIFT, "--out", "study"),
    (
        *("diagnose", "batch/capsules.csv", "--experiment", "batch/experiment.toml", "--json"),
        *("--candidates", "halo,pixel_scale", "--measured", "halo=0.1 +/- 0.05 um"),
    ),
    ("report", "square-neo-hookean", "--out", "database.html"),
    ("report", "square-pre-inflation", "--out", "effect.html"),
    ("report", "circular-skalak", "--out", "tube.html"),
    ("atlas", "circular-skalak", "--out", "atlas"),
    ("atlas", "square-rest-aspect", "--out", "effect-atlas", "--json"),
    ("validate", "circular-skalak", "--out", "validated"),
    ("validate", "square-skalak", "--json"),
    ("simulate", *COARSE, "--paraview", "shape.vtu", "--plot", "shape.png"),
    ("simulate", *COARSE, "--json", "--law", "skalak:hardening=1", "--pre-inflation", "0.02"),
    ("simulate", "--ca", "0.5", "--size-ratio", "0.9", "--refinement", "4"),
    ("transient", *COARSE, "--until", "0.4", "--table", "steps.csv", "--plot", "steps.png", "--paraview", "steps.pvd"),
    ("transient", *COARSE, "--until", "0.1", "--every", "0.05", "--scheme", "explicit"),
    ("build", "--out", "one.nc", "--cases", "cases.csv", "--refinement", "4", "--workers", "1"),
    (
        *("hide", "--effect", "halo", "--effect-size", "0.4 um", "--capsules", "2", "--refinement", "4"),
        *("--workers", "1", "--out", "hidden"),
    ),
    (
        *("exam", "--out", "examined", "--pools", "pools", "--workers", "1"),
        *("--only", "lengths alone", "--sessions", "1"),
    ),
    ("verify", "--out", "verified", "--only", "membrane-laws"),
    (
        *("measure", "film/capsule.png", "--experiment", "experiment.toml", *SPEED),
        *("--background", "film/empty.png", "--out", "measured"),
    ),
    ("measure", "film/empty.png", "--experiment", "experiment.toml", *SPEED, "--out", "nothing"),
    (
        *("measure", "film/short", "--experiment", "film/experiment.toml", "--background", "film/empty.png"),
        *("--out", "filmed"),
    ),
    (
        *("measure", "contour.csv", "--experiment", "experiment.toml", *SPEED, "--pixel-size", "0.45 +/- 0.002 um"),
        *("--edge-error", "0.1 um", "--flow", "right", "--out", "traced"),
    ),
    (
        *("measure", "events.rtdc", "--experiment", "sphere.toml", "--shared-velocity", "150 +/- 5 mm/s"),
        *("--pixel-size", "0.34 +/- 0.003 um", "--out", "sorted"),
    ),
    ("sensitivity", "budget", OVALBUMIN, "--out", "budget"),
    ("sensitivity", "budget", "ovalbumin/short.toml", "--json"),
    (
        *("sensitivity", "flow", "--shear-modulus", "50 +/- 5 mN/m", "--radius", "24 um", "--like", OVALBUMIN),
        *("--simulate", "5", "--out", "flow"),
    ),
    ("sensitivity", "flow", "--shear-modulus", "50 mN/m", "--radius", "29.9 um", "--like", OVALBUMIN, "--json"),
    ("sensitivity", "map", "--like", OVALBUMIN, "--points", "6", "5", "--noises", "3", "--out", "map"),
    (
        *("sensitivity", "map", "--experiment", "experiment.toml", *LAB, "--points", "5", "4", "--noises", "2"),
        "--json",
    ),
    ("sensitivity", "sobol", OVALBUMIN, "--samples", "64", "--out", "sobol", "--range", "viscosity=0.80 .. 0.90 Pa s"),
    ("sensitivity", "sobol", OVALBUMIN, "--samples", "32", "--json"),
)
"""In an order in which each finds what those before it wrote."""
