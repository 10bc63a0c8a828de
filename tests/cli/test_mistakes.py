"""What a person may get wrong in each command: one line that says what is expected, exit status 2, nothing written."""

import shlex
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LAWS = "neo-hookean, skalak:hardening=1.0, hooke:poisson_ratio=0.5"
PICTURE = "--experiment experiment.toml --velocity '6.20 +/- 0.06 mm/s'"
LAB = "--extent-error 0.01 --length-error 0.01 --velocity-error 0.01"
FLOW = "--shear-modulus '50 +/- 2 mN/m' --radius '22.5 +/- 0.5 um' --like capsule.toml"
UNKNOWN = f"{FLOW} --membrane neo-Hookean --membrane bending=1e-4"
KNOWN = "--membrane neo-Hookean --membrane pre_inflation=0 --membrane bending=1e-4"
GRID = "--out made.nc --grid default"
CASE = "--ca 0.05 --size-ratio 0.8"
MOVING = "--ca 0.1 --size-ratio 0.8 --refinement 4"
SECTIONS = (
    ("--cross-section oval", "cross_section: expected one of square, rectangular, circular, got 'oval'"),
    ("--cross-section circular --section-aspect 1.1", "section_aspect: expected 1 for a circular"),
    ("--cross-section rectangular --section-aspect 3", "section_aspect: expected a number from 0.5 to 2"),
    ("--corner-radius 1.5", "cross_section: corner_radius: expected a number between 0 and 1, got 1.5"),
    ("--rest-aspect 3", "rest_aspect: expected a number from 0.5 to 2, got 3.0"),
)
MISTAKES = {
    "measure": [
        ("picture.png --experiment experiment.toml", "or --flow-rate, got nothing"),
        ("picture.png --experiment experiment.toml --velocity '6.2 mm/s'", "--velocity: expected a standard error"),
        ("picture.png --experiment experiment.toml --velocity '6.2 +/- 0.1 mm'", "--velocity: expected a text in m/s"),
        (
            "picture.png --experiment tension.toml --velocity '6.20 +/- 0.06 mm/s'",
            "--velocity: expected none: the experiment states viscous_tension",
        ),
        ("picture.png --experiment experiment.toml --frame-rate '2 kHz'", "measure: --frame-rate: expected one of --"),
        ("film --experiment experiment.toml", "measure: --frame-rate: expected the rate at which the film was"),
        (f"film {PICTURE}", "measure: --velocity: expected one of --"),
        ("film --experiment experiment.toml --erase '1, 2, 3, 4'", "measure: --erase: expected one of --"),
        ("contour.csv --experiment experiment.toml --background empty.png", "measure: --background: expected one of"),
        ("contour.csv --experiment experiment.toml --crop '0, 0, 50, 50'", "measure: --crop: expected one of --"),
        ("contour.csv --experiment experiment.toml --contrast bright", "measure: --contrast: expected one of --"),
        (f"contour.csv {PICTURE} --walls '44.5, 154.5'", "--flow: expected right or left, got nothing; a contour does"),
        ("cells.rtdc --experiment experiment.toml --edge-error '0.1 um'", "measure: --edge-error: expected one of --"),
        ("cells.rtdc --experiment experiment.toml --walls '10, 70'", "measure: --walls: expected one of --"),
        (f"cells.rtdc {PICTURE}", "each has a velocity of its own, got the events of a file; give --flow-rate"),
        (f"other.dat {PICTURE}", "other.dat: expected a file that shows a capsule: PNG, TIFF, "),
        (f"picture.rtdc {PICTURE}", "show to be PNG; rename it"),
        (f"picture.csv {PICTURE}", "got zero bytes"),
        (f"none.csv {PICTURE} --quiet", "none.csv"),
    ],
    "identify": [
        ("misspelt.toml", "misspelt.toml: measurement.axial_extend: expected one of axial_extent"),
        ("long.toml --database manufactured.nc", "a shape that a case of square-manufactured has (nearest: L_z/l"),
        ("tunnel.toml --out made", "no-tunnel.toml: expected a file, got nothing there"),
        ("alone.toml", "alone.toml: experiment: expected the name of a file, got nothing"),
        (
            "capsule.toml --refine 5",
            "--refine: expected --membrane unknown (or [membrane]) with it, got a model of one",
        ),
        ("capsule.toml --membrane unknown --refine 0", "'--refine': Input should be greater than or equal to 1"),
        (f"capsule.toml {KNOWN} --refine 5", "membrane: expected one of which something is unknown, got a known one"),
        ("capsule.toml --engine x", "expected emcee or quadrature"),
        ("capsule.toml --out bad.csv", "expected a folder"),
        ("capsule.toml --velocity '6.20 +/- 0.06 mm/s'", "identify: --velocity: expected a picture (.png, .tif"),
        ("capsule.toml --membrane rubber", "--membrane: law: expected one of unknown, neo-Hookean"),
        ("capsule.toml --membrane stiffness=3", "--membrane: expected a law, or NAME=TEXT with one of the names"),
        ("capsule.toml --membrane unknown --database square-skalak", "expected one of the two, got both"),
        ("capsule.toml --resimulate 20", "identify: --resimulate: expected --out with it, the folder where the shapes"),
        ("capsule.toml --resimulate 2 --out made", "--resimulate"),
        (
            "capsule.toml --database manufactured.nc --engine quadrature --resimulate 9 --out made",
            "resimulate: model: expected a database that this simulator made, got one without",
        ),
        ("capsule.toml --engine quadrature --steps 500", "--engine: expected emcee with --walkers, --steps"),
        ("capsule.toml --steps 500 --most-steps 400", "--steps: expected at most --most-steps, 400, got 500"),
        ("picture.png", "--experiment: expected the experiment's file with a picture"),
        ("picture.png --experiment experiment.toml", "--velocity: expected"),
    ],
    "report": [
        ("moon", "moon: expected the file of a result, or one of the databases"),
        ("nothing", "nothing: expected a folder of capsbayes identify, with posterior.nc, got another folder"),
        ("text.nc", "text.nc: expected a NetCDF file of a posterior, a population or a database"),
        ("population.nc --picture a.png", "report: --picture: expected a posterior with a picture, got population.nc"),
        ("posterior.nc --out nothing", "--out: expected a file name that ends in .html or .htm"),
    ],
    "batch --out made.nc": [
        (f"pictures {PICTURE}", "expected one capsule, as each has a velocity of its own, got 2 pictures; give"),
        (
            "pictures --experiment experiment.toml --shared-velocity '5 mm/s'",
            "--shared-velocity: expected a standard error",
        ),
        (
            "pictures --experiment experiment.toml --flow-rate '0.5 .. 0.9 uL/min'",
            "--flow-rate: expected a standard error, as in",
        ),
        (f"set.csv {PICTURE}", "got set.csv; a table states it in its columns"),
    ],
    "membrane": [
        ("set.csv", "set.csv: experiment"),
        ("set.csv --refine -1", "'--refine': Input should be greater than or equal to 1"),
        (f"set.csv --experiment experiment.toml {KNOWN} --refine 5", "membrane: expected one of which something is"),
    ],
    "diagnose": [
        ("set --candidates glow", "diagnose: --candidates: expected one of"),
        ("set --experiment missing.toml", "missing.toml: expected a file, got nothing there"),
        ("set --out bad.csv", "--out: expected a folder, got the file"),
        ("missing", "expected a folder of measurement files"),
        ("set --effects idle.py", "capsbayes: idle.py: expected an effect"),
    ],
    "sensitivity map": [
        ("--like capsule.toml --guess hardening=1", "map: --guess: expected --membrane with it, got"),
        ("--like capsule.toml --membrane unknown --noises 3", "--noises: expected no such option"),
        (f"{LAB} --outline-error 0.01 --experiment channel.toml", "--outline-correlation: expected one"),
        (LAB, "sensitivity: errors: expected --like CAPSULE, or --experiment with --extent-error"),
        (f"--like capsule.toml {LAB}", "--extent-error: expected no such option together with --like, got 0.01"),
        ("--like capsule.toml --points 1 5", "map: --points: expected two numbers from 2 to 200, got 1 5"),
    ],
    "sensitivity flow": [
        (f"{FLOW} --flows 2", "flow: --flows: expected --membrane with it, got 2 without"),
        (f"{UNKNOWN} --simulate 5", "--simulate: expected no such option with the membrane unknown, got 5"),
        (f"{UNKNOWN} --mean-velocity fast", "--mean-velocity: expected"),
        (f"{UNKNOWN} --guess stiff", "--guess: law: expected one of"),
        ("--like capsule.toml --shear-modulus 50 --radius '24 um'", "flow: --shear-modulus: expected a text in N/m"),
        ("--like capsule.toml --shear-modulus '50 mN/m' --radius '90 um'", "capsule_radius: expected a radius between"),
    ],
    "sensitivity sobol": [
        ("capsule.toml --range viscosity", "--range: expected NAME=RANGE, got 'viscosity'"),
        ("capsule.toml --range 'viscosity=1 Pa s'", "--range: viscosity: expected a range like"),
    ],
    "simulate": [
        ("--ca -1 --size-ratio 0.8", "capillary_number: expected a number between 0 and 10, got -1"),
        ("--ca nan --size-ratio 0.8", "--ca: expected a finite number, got nan"),
        ("--ca 0.05 --size-ratio 2", "size_ratio: expected a number between 0.2 and 1.3, got 2"),
        (f"{CASE} --law rubber", f"law: expected one of {LAWS}"),
        (f"{CASE} --paraview state.stl", "--paraview: expected a file name that ends in .vtu"),
        (f"{CASE} --plot no/such/s.png", "--plot: expected a folder that exists"),
        (f"{CASE} --bending-energy rubber", "bending_energy: expected one of displacement, curvature"),
        (f"{CASE} --refinement 2", "refinement: expected at least 4, got 2"),
        *((f"{CASE} {options}", message) for options, message in SECTIONS),
    ],
    "transient": [
        (f"{MOVING} --until 0", "until: expected a number between 0 and 1000, got 0"),
        (f"{MOVING} --until 1 --viscosity-ratio 5", "viscosity_ratio: expected 1, because the double layer"),
        (f"{MOVING} --until 1 --scheme magic", "scheme: expected one of semi-implicit, explicit, got 'magic'"),
        (f"{MOVING} --until 1 --paraview way.vtu", "--paraview: expected a file name that ends in .pvd"),
    ],
    "build": [
        ("--out made.nc", "build: --cases, --grid: expected one of the two, got neither"),
        (f"{GRID} --cases cases.csv", "build: --cases, --grid: expected one of the two, got both"),
        ("--out made.nc --grid fine", "build: --grid: expected one of default, got 'fine'"),
        ("--out made.nc --cases none.csv", "none.csv: expected a table of cases, got nothing there"),
        ("--out made.nc --cases bad.csv", "capillary_number: expected a column of that name, got columns Ca, size_rat"),
        (f"{GRID} --effect bending", "build: --effect, --values: expected both or neither, got only one"),
        (f"{GRID} --effect bending --values 0,few", "--values: expected numbers with commas between them, got '0,few'"),
        (f"{GRID} --effect bending --values 0,1 --compare 12", "build: --compare: expected nothing with --effect"),
        (f"{GRID} --compare 8", "build: --compare: expected more than --refinement, got 8"),
        (f"{GRID} --effect bending --values 0,1e-4", "expected at least 3 values of bending"),
        (f"{GRID} --bending -1", "capsbayes: Simulator: bending: expected a number from 0 to 1, got -1.0"),
        (f"{GRID} --workers 0", "capsbayes build: Invalid value for '--workers'"),
        (f"{GRID} --speed 1", "capsbayes build: No such option: --speed"),
        *((f"{GRID} {options}", message) for options, message in SECTIONS),
    ],
    "atlas": [
        ("moon", "capsbayes: no database 'moon' comes with the library"),
        ("none.nc", "capsbayes: none.nc: no such file"),
        ("database.nc --out database.nc", "capsbayes: --out: expected a folder, got the file database.nc"),
    ],
    "hide --out made": [
        ("--effect gravity", "effect: expected one of none, pre_inflation"),
        ("--effect halo --effect-size 3", 'hide: --effect-size: expected a text in m like "0.4 um", got no unit'),
        ("--effect halo --effect-size '3 +/- 1 um'", "hide: --effect-size: expected a number without an error"),
        ("--effect halo --effect-size '5 m'", "hide: --effect-size: expected a size of at most 0.0001 m"),
        ("--effect none --effect-size '5 m'", "hide: --effect-size: expected nothing with --effect none"),
        ("--effect swelling --effect-size '5 m'", "hide: --effect-size: expected a text in s/m"),
        ("--effect none --effects idle.py", "capsbayes: idle.py: expected an effect"),
        ("--effect none --out set", "--out: expected an empty folder, or none, got set, which holds files"),
    ],
    "identfy": [("", "capsbayes: No such command 'identfy'")],
}


@pytest.mark.parametrize(
    ("command", "options", "message"),
    [
        pytest.param(command, options, message, id=f"{command.split(' --')[0]} {options}"[:80])
        for command, rows in MISTAKES.items()
        for options, message in rows
    ],
)
def test_a_mistake_is_one_line_and_leaves_nothing_behind(linked, mistaken, tmp_path, command, options, message):
    linked(tmp_path / "here")
    before = sorted((tmp_path / "here").rglob("*"))
    assert message in mistaken(*command.split(), *shlex.split(options))
    assert sorted((tmp_path / "here").rglob("*")) == before
