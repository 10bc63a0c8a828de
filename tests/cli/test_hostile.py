"""Hostile input: one line, exit status 2, nothing left behind, within seconds; for every command and kind of input.

Commands, options and what they read and write are found from the command line itself. A new command joins by a line in
`USES`; a new kind of hostile input by an entry of one of the dictionaries below.
"""

import contextlib
import inspect
import os
import shutil
import signal
import sys
import typing
from pathlib import Path

import cv2
import manufactured
import numpy as np
import pytest
import typer
from drawn import drawn
from drawn_populations import drawn_population
from png_header import png_of_size
from results import posterior
from sessions import drawn_session

from capsbayes.cli import app, main
from capsbayes.cli.paths import Reads, Writes, option_name
from capsbayes.run import only_run
from capsbayes.surrogate import Surrogate

EXAMPLE = Path(__file__).parents[2] / "examples" / "ovalbumin"

# a command line of each command that would run, if it were not for the hostile part
USES = {
    "app": "--folder made --port 0 --no-browser",
    "measure": "picture.png --experiment experiment.toml --velocity 6.2+/-0.06mm/s --out made",
    "identify": "capsule.toml --experiment experiment.toml --out made",
    "report": "posterior.nc --out made.html",
    "batch": "set.csv --experiment experiment.toml --out made.nc --scheduler synchronous",
    "population": "population.nc",
    "membrane": "set.csv --experiment experiment.toml --out made --no-laws",
    "diagnose": "set.csv --experiment experiment.toml --out made",
    "sensitivity budget": "capsule.toml --out made",
    "sensitivity sobol": "capsule.toml --out made",
    "sensitivity map": "--like capsule.toml --out made",
    "sensitivity flow": "--shear-modulus 50mN/m --radius 24um --like capsule.toml --out made",
    "simulate": "--ca 0.05 --size-ratio 0.9",
    "transient": "--ca 0.05 --size-ratio 0.9 --until 0.1",
    "build": "--cases cases.csv --out made.nc",
    "atlas": "database.nc --out made",
    "validate": "database.nc --out made",
    "hide": "--effect none --out made",
}


def leaves(command, name=()):
    """Yield the name and the click command of every command."""
    if hasattr(command, "commands"):
        for part, below in command.commands.items():
            yield from leaves(below, (*name, part))
    else:
        yield " ".join(name), command


COMMANDS = dict(leaves(typer.main.get_command(app)))


def parameters(command):
    """Return the parameters of a command by the names under which they are typed: --option, or argument."""
    signature = inspect.signature(COMMANDS[command].callback, eval_str=True)
    found = {}
    for parameter in signature.parameters.values():
        is_argument = any(isinstance(about, typer.models.ArgumentInfo) for about in parameter.annotation.__metadata__)
        found[parameter.name if is_argument else option_name(parameter)] = parameter.annotation
    return found


def declared(command, kind):
    """Return the options and arguments of a command that are declared to be read or written."""
    found = {}
    for option, annotation in parameters(command).items():
        for about in annotation.__metadata__:
            if isinstance(about, kind):
                found[option] = about
    return found


def replaced(command, option, value):
    """Return the command line of a command with another value of one option or argument."""
    words = [*command.split(), *USES[command].split()]
    if not option.startswith("-"):
        words[len(command.split())] = value
    elif option in words:
        words[words.index(option) + 1] = value
    else:
        words += [option, value]
    return words


def short(text):
    return text if len(text) < 40 else f"{text[:10]}... {len(text)} letters"


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """A folder with one good file of each kind."""
    folder = tmp_path_factory.mktemp("inputs")
    for name in ("capsule.toml", "experiment.toml"):
        shutil.copy(EXAMPLE / name, folder)
    drawn_session(Surrogate.open("square-neo-hookean"), 4, seed=7)[0].write(folder / "set.csv")
    cv2.imwrite(str(folder / "picture.png"), drawn(0.08, 1.05).picture)
    (folder / "cases.csv").write_text("capillary_number,size_ratio\n0.05,0.9\n")
    manufactured.database(8, 6).write(folder / "database.nc")
    posterior().write(folder / "posterior.nc")
    drawn_population(Surrogate.open("square-neo-hookean"), 6, seed=1).write(folder / "population.nc")
    return folder


@pytest.fixture
def place(inputs, tmp_path, monkeypatch):
    """A working folder with these files, in which a command runs."""
    for file in inputs.iterdir():
        (tmp_path / file.name).hardlink_to(file)
    monkeypatch.chdir(tmp_path)
    return tmp_path


class TookTooLong(BaseException):
    """Raised by the alarm: no command catches it."""


@contextlib.contextmanager
def within(seconds):
    def over(*_):
        raise TookTooLong(f"not refused within {seconds} s of processor time")

    before = signal.signal(signal.SIGPROF, over)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def content(folder):
    return {path: (path.lstat().st_size, path.lstat().st_mtime_ns) for path in folder.rglob("*") if not path.is_dir()}


def refuse(words, place, monkeypatch, capfd):
    """Run a command line, which must end in one line, exit status 2, and nothing written; return the line."""
    before = content(place)
    monkeypatch.setattr(sys, "argv", ["capsbayes", *words])
    with within(5.0), pytest.raises(SystemExit) as end:
        main()
    lines = capfd.readouterr().err.splitlines()
    assert end.value.code == 2, lines
    assert len(lines) == 1, lines
    assert lines[0].startswith("capsbayes")
    assert content(place) == before
    return lines[0]


# what is written: kinds of paths, by what makes the place ready and returns the path
def existing(name):
    def make(place):
        (place / name).write_text("of somebody")
        return name

    return make


def linked(place):
    (place / "made.link").symlink_to(place / "capsule.toml")
    return "made.link"


FILES = {
    "empty": lambda place: "",
    "blank": lambda place: "  ",
    "another suffix": lambda place: "made.txt",
    "no suffix": lambda place: "made",
    "a folder": lambda place: (place / "made{suffix}").mkdir() or "made{suffix}",
    "in no folder": lambda place: "nowhere/made{suffix}",
    "in a file": lambda place: "capsule.toml/made{suffix}",
    "of somebody": existing("made{suffix}"),
    "too long": lambda place: "m" * 300 + "{suffix}",
    "in no writable folder": lambda place: "/proc/made{suffix}",
    "a device": lambda place: "/dev/full",
}
FOLDERS = {
    "empty": lambda place: "",
    "a file": existing("made"),
    "in a file": lambda place: "capsule.toml/made",
    "an input": lambda place: "capsule.toml",
    "a link to an input": linked,
    "too long": lambda place: "m" * 300,
    "in no writable folder": lambda place: "/proc/made",
    "a device": lambda place: "/dev/full",
}


def cases_of_outputs():
    for command in COMMANDS:
        for option, about in declared(command, Writes).items():
            for kind in FILES if about.suffixes else FOLDERS:
                yield command, option, kind


@pytest.mark.parametrize(("command", "option", "kind"), list(cases_of_outputs()))
def test_a_hostile_output(place, monkeypatch, capfd, command, option, kind):
    about = declared(command, Writes)[option]
    suffix = (about.suffixes or ("",))[0]
    path = (FILES if about.suffixes else FOLDERS)[kind](place)
    for left in list(place.glob("*{suffix}")):
        left.rename(left.with_name(left.name.format(suffix=suffix)))
    refuse(replaced(command, option, path.format(suffix=suffix)), place, monkeypatch, capfd)


def cases_of_results():
    for command in COMMANDS:
        for option, about in declared(command, Writes).items():
            values = {name: Path("picture.png") for name in ("capsule", "picture")}
            for form in about.within(values) if callable(about.within) else about.within:
                yield command, option, f"{{name}}/{form.replace('*', '1')}"
            yield from ((command, option, form.replace("*", "1")) for form in about.next_to)


@pytest.mark.parametrize(("command", "option", "form"), list(cases_of_results()))
def test_a_file_of_somebody_where_a_result_would_go(place, monkeypatch, capfd, command, option, form):
    suffix = (declared(command, Writes)[option].suffixes or ("",))[0]
    words = replaced(command, option, f"made{suffix}")
    if command == "identify":
        words = [*words[:1], "picture.png", *words[2:], "--velocity", "6.2+/-0.06mm/s"]
    path = place / form.format(name=f"made{suffix}", stem="made").rstrip("/")
    path.parent.mkdir(exist_ok=True)
    path.write_text("of somebody")
    refuse(words, place, monkeypatch, capfd)


# what is read: kinds of files, by their content
TEXTS = {
    "empty": b"",
    "zero bytes": bytes(1000),
    "not UTF-8": b"a = '\xff\xfe'\n",
    "nested 5000 times": b"a = " + b"[" * 5000 + b"]" * 5000,
    "5001 digits": b"a = " + b"9" * 5001,
    "another format": b'{"a": [1, 2]}\n',
    "noise": np.random.default_rng(1).bytes(5000),
    "a page": b"<html><body>=1+1</body></html>\n",
}
KINDS = {
    ".toml": TEXTS
    | {
        "a name with NUL": b'experiment = "a\\u0000b"\n[measurement]\naxial_extent = "2.1 +/- 0.1"\n',
        "itself as experiment": b'experiment = "hostile.toml"\n',
        "a device as experiment": b'experiment = "/dev/zero"\n',
    },
    ".csv": TEXTS
    | {
        "one column": b"a\n1\n",
        "ragged": b"capillary_number,size_ratio\n0.05,0.9,7\n",
        "a header twice": b"capillary_number,size_ratio\ncapillary_number,size_ratio\n0.05,0.9\n",
        "a column twice": b"size_ratio,size_ratio\n0.9,0.9\n",
        "only names": b"capillary_number,size_ratio\n",
    },
    ".py": TEXTS | {"no effect": b"import numpy\n", "a class for an effect": b"class Effect:\n    parameter = 1\n"},
    ".nc": TEXTS | {"cut short": b"\x89HDF\r\n\x1a\n" + bytes(100)},
    ".png": TEXTS
    | {"cut short": b"\x89PNG\r\n\x1a\n", "one pixel": png_of_size(1, 1), "16000 x 16000": png_of_size(16000, 16000)},
}
READ = {
    "--background": ".png",
    "--picture": ".png",
    "--like": ".toml",
    "--experiment": ".toml",
    "--cases": ".csv",
    "--database": ".nc",
    "--shapes": ".nc",
    "--effects": ".py",
}


def cases_of_inputs():
    for command in COMMANDS:
        for option in declared(command, Reads):
            suffix = READ.get(option) or Path(USES[command].split()[0]).suffix
            for kind in (*KINDS[suffix], "missing", "a folder", "a device", "a pipe", "too long"):
                yield command, option, suffix, kind


@pytest.mark.parametrize(("command", "option", "suffix", "kind"), list(cases_of_inputs()))
def test_a_hostile_input(place, monkeypatch, capfd, command, option, suffix, kind):
    name = f"hostile{suffix}"
    if kind in KINDS[suffix]:
        (place / name).write_bytes(KINDS[suffix][kind])
    elif kind == "a folder":
        (place / name).mkdir()
    elif kind == "a device":
        (place / name).symlink_to("/dev/zero")
    elif kind == "a pipe":
        os.mkfifo(place / name)
    elif kind == "too long":
        name = "h" * 300 + suffix
    words = replaced(command, option, name)
    if option in ("--background", "--picture") and command == "identify":
        words = [*words[:1], "picture.png", *words[2:], "--velocity", "6.2+/-0.06mm/s"]
    refuse(words, place, monkeypatch, capfd)


# numbers and texts, by the types of options
NUMBERS = {
    float: ("nan", "inf", "-inf", "1e300", "-1e300", "x", "1_0e", "0x10"),
    int: ("-1", "1.5", "x", "9" * 31, "9" * 5001, "1e3"),
}


def cases_of_numbers():
    for command in COMMANDS:
        for option, annotation in parameters(command).items():
            base = annotation.__origin__
            kind = next((kind for kind in (float, int) if kind in (base, *typing.get_args(base))), None)
            for value in NUMBERS.get(kind, ()) if typing.get_origin(base) is not tuple else ():
                yield command, option, value


@pytest.mark.parametrize(
    ("command", "option", "value"),
    list(cases_of_numbers()),
    ids=short,
)
def test_a_hostile_number(place, monkeypatch, capfd, command, option, value):
    refuse(replaced(command, option, value), place, monkeypatch, capfd)


# options of text, by what is wrong for each
QUANTITIES = (
    "",
    "x",
    "nan mm/s",
    "1e300 mm/s",
    "-1 mm/s",
    "0 mm/s",
    "6 kg",
    "6.2 +/- 0.06 mm/s * (9**9**9)",
    "6 +/- -1 mm/s",
    "6 +/- nan mm/s",
    "9" * 5000,
    "=cmd()",
    "6 +/- 1e300 mm/s",
)
OF_TEXT = {
    ("measure", "--velocity"): QUANTITIES,
    ("measure", "--flow-rate"): QUANTITIES,
    ("measure", "--flow"): ("up",),
    ("measure", "--walls"): ("", "x", "nan, 5", "5", "1, 2, 3", "1e300, 2e300", "190, -1", "0 199, 199 0", "9" * 5000),
    ("measure", "--wall-error"): ("", "x", "1 px"),
    ("measure", "--pixel-size"): ("", "x", "0.3 um", "0.3 +/- 0.1 s", "nan um", "-1 um"),
    ("measure", "--axis"): ("", "x", "99"),
    ("measure", "--contrast"): ("", "x"),
    ("measure", "--crop"): ("", "x", "0, 0, 1e9, 1e9", "0, 0, nan, 5", "5, 5, 1, 1", "-5, 0, 50, 50"),
    ("identify", "--prior"): ("x", "pre_inflation=", "pre_inflation=nan .. 1", "surface_shear_modulus=1"),
    ("identify", "--engine"): ("magic",),
    ("identify", "--database"): ("none", "../database.nc"),
    ("batch", "--walls"): ("", "x", "10, 70"),
    ("batch", "--scheduler"): ("tcp://127.0.0.1:1", "x"),
    ("population", "--velocity-error"): ("x", "-1 %", "nan", "200 %", "inf"),
    ("diagnose", "--candidates"): ("x", "halo,,x", ","),
    ("diagnose", "--measured"): ("x", "halo=", "halo=1 um", "halo=nan +/- 1 um", "halo=1 +/- 1 kg"),
    ("sensitivity sobol", "--range"): ("x", "viscosity=", "viscosity=2 .. 1 Pa s", "moon=1"),
    ("sensitivity flow", "--shear-modulus"): ("x", "nan mN/m", "-1 mN/m", "1e300 N/m", "5 m"),
    ("sensitivity flow", "--membrane"): ("x", "moon=1", "pre_inflation=nan", "hardening=1"),
    ("sensitivity flow", "--radius"): ("x", "nan um", "-1 um", "1e300 m", "5 N/m"),
    ("simulate", "--law"): (
        "x",
        "skalak:hardening=nan",
        "skalak:hardening=1e300",
        "hooke:poisson_ratio=5",
        "neo-hookean:x=1",
    ),
    ("simulate", "--cross-section"): ("x",),
    ("transient", "--scheme"): ("x",),
    ("build", "--grid"): ("x",),
    ("build", "--effect"): ("x",),
    ("validate", "database"): ("x", "square-bending", "square-pre-inflation"),
    ("atlas", "database"): ("x", "../square-bending"),
    ("hide", "--effect"): ("x",),
    ("hide", "--effect-size"): ("x", "nan", "1e300"),
}


@pytest.mark.parametrize(
    ("command", "option", "text"),
    [(*key, text) for key, texts in OF_TEXT.items() for text in texts],
    ids=short,
)
def test_a_hostile_text(place, monkeypatch, capfd, command, option, text):
    words = replaced(command, option, text)
    if (command, option) == ("hide", "--effect-size"):
        words[words.index("--effect") + 1] = "halo"
    refuse(words, place, monkeypatch, capfd)


LOCKED = sorted(
    command
    for command in USES
    if "--out" in declared(command, Writes) and command != "hide"  # which first builds shapes for minutes
)


@pytest.mark.parametrize("command", [*LOCKED, "population"])
def test_a_second_run(place, monkeypatch, capfd, command):
    out = place / "population.nc"
    if command != "population":
        out = place / f"made{next(iter(declared(command, Writes)['--out'].suffixes), '')}"
        if not declared(command, Writes)["--out"].suffixes:
            out.mkdir()
    with only_run(out):
        line = refuse([*command.split(), *USES[command].split()], place, monkeypatch, capfd)
    assert "expected no other run that writes it" in line


def test_every_command_is_tried():
    assert set(USES) == set(COMMANDS)
    assert all(declared(command, Reads | Writes) for command in COMMANDS)
