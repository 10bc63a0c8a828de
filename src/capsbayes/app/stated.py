"""What a person states of a capsule on the page, and the commands that repeat the work."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from capsbayes.files.input_file import PICTURES, VIDEOS

EXPERIMENT, MEASUREMENT, OVERLAY = "experiment.toml", "measurement.toml", "overlay.png"
STATED = ".stated.json"
EVENTS = (".rtdc",)
KINDS = (*PICTURES, *VIDEOS, *EVENTS)
"""Endings of the files that the page takes."""

PRIORS = ("surface_shear_modulus", "capsule_radius")
SEED = 1
EXAMPLE = {"half_width": "25 +/- 0.2 um", "viscosity": "0.8 +/- 0.02 Pa s", "velocity": "4.86 +/- 0.04 mm/s"}
EXAMPLE_PICTURE = Path(__file__).with_name("example.png")
"""A picture, and what is stated of its capsule, whose G_s is 50 mN/m and whose radius is 23.5 um."""
_TAKEN = {"overlay", "corner", "outline", "report", "silhouette"}  # names of what is written next to a picture
_LONGEST = 60  # letters of a name


@dataclass(unsafe_hash=True)
class Stated:
    """What is stated of one capsule; a text that is empty is not stated. Most are options of ``capsbayes identify``.

    `picture` and `background` are names of files in the capsule's folder; `measured` is that of a measurement, in place
    of a picture that is to be measured.
    """

    picture: str = ""
    background: str = ""
    velocity: str = ""
    measured: str = ""
    walls: str = ""
    wall_error: str = ""
    crop: str = ""
    erase: str = ""
    flow: str = ""
    contrast: str = ""
    rotate: str = ""
    gamma: str = ""
    membrane: str = ""
    engine: str = "quadrature"
    flow_rate: str = ""
    surface_shear_modulus: str = ""  # priors
    capsule_radius: str = ""

    def of(self, picture: str = "", **stated: str) -> Stated:
        """Return what is stated of another picture, with what steps 3 and 4 state."""
        further = {name: getattr(self, name) for name in ("velocity", "flow_rate", "membrane", "engine", *PRIORS)}
        return Stated(picture, **{**further, **stated})

    def asked(self, folder: Path) -> tuple[Any, ...]:
        """Return all on which a result depends: a copy of what is stated, and what tells its files from others."""
        speeds = {"velocity": "", "flow_rate": ""} if self.measured else {}  # a measurement has its own
        paths = [folder / name for name in (self.picture, self.background, self.measured) if name]
        stamps = [(path.stat().st_mtime_ns, path.stat().st_size) for path in paths if path.is_file()]
        known = folder / EXPERIMENT
        return replace(self, **speeds), *stamps, not self.measured and known.is_file() and known.read_bytes()

    def by_hand(self) -> dict[str, str]:
        """What `capsbayes.image.ByHand` takes, as far as it is stated."""
        return self._given("walls", "wall_error", "crop", "erase", "contrast", "rotate", "gamma")

    def priors(self) -> dict[str, str]:
        """What `capsbayes.infer.Prior` takes, as far as it is stated."""
        return self._given(*PRIORS)

    def _given(self, *names: str) -> dict[str, str]:
        return {name: getattr(self, name) for name in names if getattr(self, name)}

    def commands(self, folder: Path) -> list[str]:
        """Return the lines of a terminal that make the same files in the capsule's folder."""
        options: dict[str, str] = {}
        if not self.measured:
            options = {"experiment": EXPERIMENT, "velocity": self.velocity, "flow_rate": self.flow_rate}
            options |= {"background": self.background, "flow": self.flow, **self.by_hand()}
        options |= {"membrane": self.membrane, "engine": self.engine, "seed": str(SEED), "out": "."}
        priors = [word for name, text in self.priors().items() for word in ("--prior", f"{name}={text}")]
        identify = ["capsbayes", "identify", self.measured or self.picture, *_in_words(options), *priors]
        report = ["capsbayes", "report", ".", "--out", "report.html"]
        return [enter(folder), in_shell(identify), in_shell(report)]

    def script(self, folder: Path) -> str:
        """Return a script of Python that finds the same posterior, and writes it and its page."""
        by_hand, priors = (
            ", ".join(f"{name}={text!r}" for name, text in given.items()) for given in (self.by_hand(), self.priors())
        )
        options = {"capsule_velocity": self.velocity, "flow_rate": self.flow_rate}
        options |= {"background": self.background, "flow": self.flow}
        how = "".join(f", {name}={text!r}" for name, text in options.items() if text)
        how += f", by_hand=ByHand({by_hand})" if by_hand else ""
        first = f'known = cb.Experiment.read("{EXPERIMENT}")\nmeasurement = cb.measure({self.picture!r}, known{how})'
        if self.measured:
            first = f"measurement = cb.Measurement.read({self.measured!r})\n"
            first += f'known = cb.Experiment.read(measurement.experiment_file or "{EXPERIMENT}")'
        model, membrane = 'cb.Surrogate.open(f"{known.cross_section}-neo-hookean", view=view)', ""
        if self.membrane:
            model = "cb.MembraneSurrogate.open(known.cross_section, view=view)"
            membrane = f", membrane=cb.Membrane({self.membrane!r})"
        membrane += f", prior=cb.Prior({priors})" if priors else ""
        return f"""import os

import capsbayes as cb
{"from capsbayes.image import ByHand" if by_hand else ""}
os.chdir({str(folder)!r})
{first}
view = "mid-plane" if measurement.outline is None else measurement.outline.view
model = {model}
posterior = cb.identify(measurement, model, known, engine={self.engine!r}, seed={SEED}{membrane})
print(posterior)
posterior.write("posterior.nc")
cb.write_report(posterior, "report.html")
"""


def in_shell(words: Sequence[str]) -> str:
    """Return a command as a line for the shells of this system: cmd and PowerShell read the same."""
    return subprocess.list2cmdline(words) if os.name == "nt" else shlex.join(words)


def enter(folder: Path) -> str:
    """Return the line that goes to a folder, on Windows on any drive."""
    return in_shell(["pushd" if os.name == "nt" else "cd", str(folder)])


def measure_command(name: str, *, film: bool, velocity: str, flow_rate: str, pixel_size: str, flow: str) -> list[str]:
    """Return the command that measures one of several files in its folder, with the options that its kind takes."""
    events = Path(name).suffix.lower() in EVENTS
    speeds = {"shared_velocity" if events else "velocity": velocity, "flow_rate": flow_rate}
    options = {"experiment": EXPERIMENT, "pixel_size": pixel_size if events else ""}
    options |= {} if film else speeds
    return ["capsbayes", "measure", name, *_in_words({**options, "flow": flow, "out": "."})]


def _in_words(options: dict[str, str]) -> list[str]:
    """Options of a command line, as far as they are stated."""
    return [word for name, text in options.items() if text for word in (f"--{name.replace('_', '-')}", text)]


def safe_name(name: str, kinds: tuple[str, ...] = KINDS) -> str | None:
    """Return the name under which an uploaded file is kept, None for one of another kind.

    Examples
    --------
    >>> safe_name("../My capsule.PNG"), safe_name("overlay.png"), safe_name("x.sh")
    ('My-capsule.png', 'picture-overlay.png', None)
    """
    path = Path(name.replace("\\", "/").rpartition("/")[2])
    suffix = path.suffix.lower()
    if suffix not in kinds:
        return None
    stem = re.sub(r"[^A-Za-z0-9_]+", "-", path.stem).strip("-")[:_LONGEST] or "picture"
    return f"picture-{stem}{suffix}" if stem in _TAKEN else f"{stem}{suffix}"


def new_folder(bench: Path, stem: str) -> Path:
    """Make a folder for a capsule within the bench's folder, named after its picture; a number is added if needed."""
    number = 1
    while True:
        folder = bench / (stem if number == 1 else f"{stem}-{number}")
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            number += 1
        else:
            return folder


def page_words(sentence: object) -> str:
    """Return a status or an error in the words of the page, where what a command names as an option is a field.

    Examples
    --------
    >>> page_words("cut the picture (--crop) or repeat with t distributions"), page_words("--frame-rate: expected one")
    ('cut the picture or repeat with t distributions', 'frame rate: expected one')
    """
    bare = re.sub(r" \([^()]*--[^()]*\)", "", str(sentence).removeprefix("capsbayes: "))
    return re.sub(r"(?<![\w-])--([a-z]+(?:-[a-z]+)*)", lambda option: option[1].replace("-", " "), bare)
