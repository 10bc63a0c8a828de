"""The tests on other versions of Python, and with the lowest versions of what the package needs.

``nox`` runs the whole suite on every version of Python that is installed, and with the lowest versions that
``pyproject.toml`` allows. ``nox -s smoke smoke_lowest`` runs the tests of the basic types there. ``nox -s wheel`` runs
the first command of the README with the built wheel alone. ``nox -s browser`` walks through the page of the bench.
What follows ``--`` goes to pytest.
"""

from __future__ import annotations

import os
import re
import shlex
from pathlib import Path

import nox
from nox.command import CommandFailed

PYTHONS = ("3.11", "3.12", "3.13", "3.14")
LOWEST = "--resolution=lowest-direct"
SMOKE = (
    "-m",
    "not slow",
    "tests/test_package.py",
    "tests/test_measurement.py",
    "tests/test_quantity.py",
    "--deselect=tests/test_package.py::test_the_lines_of_the_design_on_many_capsules_run",  # a minute of compilation
)

nox.options.error_on_missing_interpreters = False
nox.options.sessions = ["tests", "lowest"]
versions = sorted(Path.home().glob(".pyenv/versions/3.*/bin"))  # where pyenv keeps interpreters, off the path
os.environ["PATH"] = os.pathsep.join([os.environ["PATH"], *map(str, versions)])


def _tested(session: nox.Session, *options: str, tests: tuple[str, ...] = ()) -> None:
    try:
        session.install(*options, ".[test]", env={"UV_COMPILE_BYTECODE": "1"})  # many tests start a new process
    except CommandFailed:
        session.skip("what the package needs cannot be installed there")
    session.run("python", "-m", "pytest", *tests, *session.posargs)


@nox.session(python=PYTHONS)
def tests(session: nox.Session) -> None:
    """Run the whole suite."""
    _tested(session)


@nox.session(python=PYTHONS[0], venv_backend="uv")  # pip cannot choose the lowest versions
def lowest(session: nox.Session) -> None:
    """Run the whole suite with the lowest versions of what the package needs."""
    _tested(session, LOWEST)


@nox.session(python=PYTHONS[1:], venv_backend="uv|virtualenv")  # uv installs in a tenth of the time
def smoke(session: nox.Session) -> None:
    """Import the package and run the tests of the basic types, with the newest versions of what it needs."""
    _tested(session, tests=SMOKE)


@nox.session(python=PYTHONS[0], venv_backend="uv")  # pip cannot choose the lowest versions
def smoke_lowest(session: nox.Session) -> None:
    """Run the same with the lowest versions."""
    _tested(session, LOWEST, tests=SMOKE)


@nox.session(python="3.13", venv_backend="uv|virtualenv")  # which the page of the bench advises
def browser(session: nox.Session) -> None:
    """Walk through the page of the bench in a Chromium of the system, with the mouse and with the keyboard."""
    session.install(".[dev]")
    session.run("python", "-m", "pytest", "-n", "0", "tests/app", *session.posargs)


@nox.session(python=PYTHONS, venv_backend="uv|virtualenv")
def wheel(session: nox.Session) -> None:
    """Build wheel and archive, install the wheel with what it needs alone, and run the first command of the README."""
    built = Path(session.create_tmp()).resolve()
    session.run("uv", "build", "--quiet", "--out-dir", str(built), external=True)
    try:
        session.install(*map(str, built.glob("*.whl")))
    except CommandFailed:
        session.skip("what the package needs cannot be installed there")
    size = sum(path.stat().st_size for path in Path(session.virtualenv.location).rglob("*") if path.is_file())
    session.log(f"installed: {size / 1e6:.0f} MB")
    first = re.search(r"\.venv/bin/(capsbayes identify .*?)\n```", Path("README.md").read_text(), re.DOTALL)
    assert first is not None, "the README begins with a command"
    words = shlex.split(first[1].replace("\\\n", " ").replace("result/", str(built / "result")))
    session.run(*words)
