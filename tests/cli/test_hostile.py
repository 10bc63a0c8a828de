"""Hostile input: one line, exit status 2, nothing left behind, within seconds; for every command and kind of input.

Commands, options and what they read and write are found from the command line itself. Each option is tried once, and
each kind of hostile input once for each type of option. A new command joins by a line in `USES`; a new kind of hostile
input by an entry of one of the dictionaries below.
"""

import contextlib
import inspect
import itertools
import os
import signal
import sys
import typing
from pathlib import Path

import numpy as np
import pytest
import typer
from png_header import png_of_size

from capsbayes.cli import app, main
from capsbayes.cli.command import Input, Reads, Writes, option_name, path_of
from capsbayes.run import only_run

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
OF_PICTURE = "picture.png --experiment experiment.toml --velocity 6.2+/-0.06mm/s --out made"


def leaves(command, name=()):
    """Yield the name and the click command of every command."""
    if hasattr(command, "commands"):
        for part, below in command.commands.items():
            yield from leaves(below, (*name, part))
    else:
        yield " ".join(name), command


COMMANDS = dict(leaves(typer.main.get_command(app)))


def parameters(*kinds):
    """Return declarations of all paths of these kinds, without a kind the types of all parameters, by name as typed."""
    found = {}
    for command, made in COMMANDS.items():
        for parameter in inspect.signature(made.callback).parameters.values():
            about = path_of(parameter)
            if not kinds or isinstance(about, kinds):
                typed = parameter.name if isinstance(about, Input) else option_name(parameter)
                found[command, typed] = about if kinds else parameter.annotation
    return found


def replaced(command, option, value):
    """Return the command line of a command with another value of one option or argument."""
    of_picture = command == "identify" and option in ("--background", "--picture")
    words = [*command.split(), *(OF_PICTURE if of_picture else USES[command]).split()]
    if option == "--effect-size":
        words[words.index("--effect") + 1] = "halo"
    if not option.startswith("-"):
        words[len(command.split())] = value
    elif option in words:
        words[words.index(option) + 1] = value
    else:
        words += [option, value]
    return words


def spread(options, kinds):
    """Return which kinds each command tries at which options: each option and each kind comes at least once."""
    number = max(len(options), len(kinds))
    options, kinds = itertools.cycle(options), itertools.cycle(kinds)
    return [(*next(options), next(kinds)) for _ in range(number)]


def by_command(triples):
    """Return parameters of a test for each command, with what it tries."""
    found = {}
    for command, *trial in triples:
        found.setdefault(command, []).append(trial)
    return pytest.mark.parametrize(("command", "trials"), list(found.items()), ids=list(found))


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


@pytest.fixture
def refused(linked, tmp_path, monkeypatch, capfd):
    """A function that runs a command line in a new folder, which must end in one line, exit status 2, nothing written.

    A function may put something into the folder before. The line is returned.
    """
    places = (tmp_path / str(number) for number in itertools.count())

    def refused(words, prepare=lambda place: None, *, guard=contextlib.nullcontext):
        place = next(places)
        linked(place)
        prepare(place)
        before = content(place)
        monkeypatch.setattr(sys, "argv", ["capsbayes", *words])
        with guard(), within(5.0), pytest.raises(SystemExit) as end:
            main()
        lines = capfd.readouterr().err.splitlines()
        tried = " ".join(word[:40] for word in words)
        assert (end.value.code, len(lines)) == (2, 1), (tried, lines)
        assert lines[0].startswith("capsbayes"), tried
        assert content(place) == before, tried
        return lines[0]

    return refused


# what is written: paths of files and of folders, to a folder that `trap` prepared
SHARED = ("", "trap{0}", "capsule.toml/made{0}", "m" * 300 + "{0}", "/proc/made{0}", "/dev/full")
FILES = (*SHARED, "  ", "made.txt", "made", "folder{0}", "nowhere/made{0}")
FOLDERS = (*SHARED, "capsule.toml", "link")


def trap(place, suffix):
    """Put files, folders, links, devices and pipes of a suffix into a folder."""
    (place / f"trap{suffix}").write_text("of somebody")
    (place / f"folder{suffix}").mkdir()
    (place / f"device{suffix}").symlink_to("/dev/zero")
    os.mkfifo(place / f"pipe{suffix}")
    (place / "link").symlink_to(place / "capsule.toml")


WRITTEN = parameters(Writes)


def suffix_of(about):
    return (about.suffixes or ("",))[0]


@by_command(
    [
        *spread([key for key, about in WRITTEN.items() if about.suffixes], FILES),
        *spread([key for key, about in WRITTEN.items() if not about.suffixes], FOLDERS),
    ]
)
def test_hostile_outputs(refused, command, trials):
    for option, form in trials:
        suffix = suffix_of(WRITTEN[command, option])
        refused(replaced(command, option, form.format(suffix)), lambda place: trap(place, suffix))  # noqa: B023


def results():
    """Yield what commands write next to their output, or within it."""
    for (command, option), about in WRITTEN.items():
        values = {"capsule": Path("picture.png"), "picture": Path("picture.png"), "resimulate": None}
        within = about.within(values) if callable(about.within) else about.within
        for form in (*(f"{{name}}/{form}" for form in within), *about.next_to):
            yield command, option, form.replace("*", "1")


@by_command(results())
def test_files_of_somebody_where_results_would_go(refused, command, trials):
    for option, form in trials:
        name = f"made{suffix_of(WRITTEN[command, option])}"
        path = Path(form.format(name=name, stem="made").rstrip("/"))

        def prepare(place, path=path):
            (place / path).parent.mkdir(exist_ok=True)
            (place / path).write_text("of somebody")

        words = ["identify", *OF_PICTURE.split()] if command == "identify" else replaced(command, option, name)
        refused(words, prepare)


# what is read: kinds of content, by a name or by themselves, and places that `trap` prepared
CONTENTS = {
    "empty": b"",
    "zero bytes": bytes(1000),
    "not UTF-8": b"a = '\xff\xfe'\n",
    "nested 5000 times": b"a = " + b"[" * 5000 + b"]" * 5000,
    "5001 digits": b"a = " + b"9" * 5001,
    "another format": b'{"a": [1, 2]}\n',
    "noise": np.random.default_rng(1).bytes(5000),
    "a page": b"<html><body>=1+1</body></html>\n",
    "a name with NUL": b'experiment = "a\\u0000b"\n[measurement]\naxial_extent = "2.1 +/- 0.1"\n',
    "itself as experiment": b'experiment = "hostile.toml"\n',
    "a device as experiment": b'experiment = "/dev/zero"\n',
    "one column": b"a\n1\n",
    "ragged": b"capillary_number,size_ratio\n0.05,0.9,7\n",
    "a header twice": b"capillary_number,size_ratio\ncapillary_number,size_ratio\n0.05,0.9\n",
    "a column twice": b"size_ratio,size_ratio\n0.9,0.9\n",
    "only names": b"capillary_number,size_ratio\n",
    "no effect": b"import numpy\n",
    "a class for an effect": b"class Effect:\n    parameter = 1\n",
    "HDF5 cut short": b"\x89HDF\r\n\x1a\n" + bytes(100),
    "PNG cut short": b"\x89PNG\r\n\x1a\n",
    "one pixel": png_of_size(1, 1),
    "16000 x 16000 pixels": png_of_size(16000, 16000),
}
PLACES = ("missing", "folder", "device", "pipe", "h" * 300)
SUFFIXES = {"--background": ".png", "--picture": ".png", "--like": ".toml", "--experiment": ".toml", "--cases": ".csv"}
SUFFIXES |= {"--database": ".nc", "--shapes": ".nc", "--effects": ".py"}
READ = {key: SUFFIXES.get(key[1]) or Path(USES[key[0]].split()[0]).suffix for key in parameters(Input, Reads)}


@by_command(
    [
        *(
            trial
            for suffix in sorted(set(READ.values()))
            for trial in spread([key for key, of in READ.items() if of == suffix], [*CONTENTS, *PLACES])
        ),
        *((*key, kind) for key in parameters(Input) for kind in ("missing", "folder")),
    ]
)
def test_hostile_inputs(refused, command, trials):
    for option, kind in trials:
        suffix = READ[command, option]
        content = CONTENTS.get(kind)
        name = f"{kind if content is None else 'hostile'}{suffix}"

        def prepare(place, name=name, content=content, suffix=suffix):
            trap(place, suffix)
            if content is not None:
                (place / name).write_bytes(content)

        refused(replaced(command, option, name), prepare)


# numbers and texts, by the types of options
NUMBERS = {
    float: ("nan", "inf", "-inf", "1e300", "-1e300", "x", "1_0e", "0x10"),
    int: ("-1", "1.5", "x", "9" * 31, "9" * 5001, "1e3"),
}


def numbers_of(kind):
    """Return the options that take a number of a type, or none."""
    bases = {key: annotation.__origin__ for key, annotation in parameters().items()}
    return [key for key, base in bases.items() if base is kind or set(typing.get_args(base)) == {kind, type(None)}]


@by_command(trial for kind, values in NUMBERS.items() for trial in spread(numbers_of(kind), values))
def test_hostile_numbers(refused, command, trials):
    for option, value in trials:
        refused(replaced(command, option, value))


# options of text, one of each type, by what is wrong for it; what is read in test_mistakes.py is left out
OF_TEXT = {
    ("measure", "--velocity"): (
        "",
        "nan mm/s",
        "6.2 +/- 0.06 mm/s * (9**9**9)",
        "6 +/- nan mm/s",
        "9" * 5000,
        "=cmd()",
        "6 +/- 1e300 mm/s",
    ),
    ("measure", "--flow-rate"): ("-1 mm/s", "0 mm/s", "6 kg", "6 +/- -1 mm/s"),
    ("measure", "--flow"): ("up",),
    ("measure", "--walls"): ("x", "nan, 5", "5", "1, 2, 3", "1e300, 2e300", "190, -1", "0 199, 199 0", "9" * 5000),
    ("measure", "--wall-error"): ("x", "1 px"),
    ("measure", "--pixel-size"): ("x", "0.3 um", "0.3 +/- 0.1 s", "nan um", "-1 um"),
    ("measure", "--axis"): ("x", "99"),
    ("measure", "--contrast"): ("x",),
    ("measure", "--gamma"): ("x", "", "0", "-1", "4.1", "nan", "2.2, 2.2"),
    ("measure", "--crop"): ("x", "0, 0, 1e9, 1e9", "0, 0, nan, 5", "5, 5, 1, 1", "-5, 0, 50, 50"),
    ("identify", "--prior"): ("x", "pre_inflation=", "pre_inflation=nan .. 1", "surface_shear_modulus=1"),
    ("identify", "--database"): ("none", "../database.nc"),
    ("batch", "--scheduler"): ("tcp://127.0.0.1:1", "x"),
    ("population", "--velocity-error"): ("x", "-1 %", "nan", "200 %", "inf"),
    ("diagnose", "--candidates"): ("halo,,x", ","),
    ("diagnose", "--measured"): ("x", "halo=", "halo=1 um", "halo=nan +/- 1 um", "halo=1 +/- 1 kg"),
    ("sensitivity sobol", "--range"): ("viscosity=", "viscosity=2 .. 1 Pa s", "moon=1"),
    ("sensitivity flow", "--shear-modulus"): ("x", "nan mN/m", "-1 mN/m", "1e300 N/m", "5 m"),
    ("sensitivity flow", "--membrane"): ("x", "moon=1", "pre_inflation=nan", "hardening=1"),
    ("simulate", "--law"): (
        "skalak:hardening=nan",
        "skalak:hardening=1e300",
        "hooke:poisson_ratio=5",
        "neo-hookean:x=1",
    ),
    ("validate", "database"): ("x", "square-bending", "square-pre-inflation"),
    ("atlas", "database"): ("../square-bending",),
    ("hide", "--effect-size"): ("nan", "1e300"),
}


@by_command((*key, text) for key, texts in OF_TEXT.items() for text in texts)
def test_hostile_texts(refused, command, trials):
    for option, text in trials:
        refused(replaced(command, option, text))


LOCKED = {command: about for (command, option), about in WRITTEN.items() if option == "--out" and command != "hide"}
"""Commands that write, but for the one that first builds shapes for minutes."""


@pytest.mark.parametrize("command", [*LOCKED, "population"])
def test_a_second_run(refused, command):
    out = Path(f"made{suffix_of(LOCKED[command])}" if command in LOCKED else "population.nc")

    def prepare(place):
        if not out.suffix:
            (place / out).mkdir()

    line = refused([*command.split(), *USES[command].split()], prepare, guard=lambda: only_run(out))
    assert "expected no other run that writes it" in line


def test_every_command_is_tried():
    assert set(USES) == set(COMMANDS) == {command for command, _ in parameters(Input, Reads, Writes)}
