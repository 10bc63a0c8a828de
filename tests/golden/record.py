"""Write and compare golden records: every number and every word that the package gives for fixed inputs.

Write the record of this checkout, all of it (an hour or two) or some sections, and compare two records::

    python tests/golden/record.py write now.json.gz
    python tests/golden/record.py write now.json.gz --only identify,batch
    python tests/golden/record.py compare tests/golden/record.json.gz now.json.gz

The sections, in the order in which they are run:

=============  =====================================================================================
``models``     predictions of every shipped database, and of every effect of the catalogue
``identify``   posteriors of some fifty capsules by quadrature, of some by emcee as well
``batch``      500 rows of ``capsbayes batch`` with ``--check``, and the population
``words``      what each command prints and writes, the text of each kind of page, mistakes
``build``      coarse databases, one of them killed half-way and taken up again
``exam``       one diagnosed session of each cell of ``evidence.exam``
``verify``     the numbers of ``evidence.verification`` but for its slowest section
``transients`` that section
=============  =====================================================================================

Numbers are kept in full and compared with ``--rtol``. Words are compared apart from the numbers in them, so that a
sentence can be changed and its numbers still be held. ``write`` adds to a file that is there and replaces the sections
it runs; with ``--resume`` it keeps what a stopped run had finished. What was renamed on purpose is said to ``compare``
with ``--rename 'OLD=NEW'``, regular expressions for the keys of the first record.

Numbers of the simulator scatter from run to run, in the thirteenth digit and residuals in the sixth, as the derivatives
that steer Newton's method depend on where arrays lie in memory. What is within that scatter is counted but is no
difference, unless ``--strict`` is given; hashes of simulated shapes are passed over.

The exit status of ``compare`` is 0 if no number differs, 1 if one does or is missing; words alone do not count.

The tool uses the public names of the package and its command line, so that it outlives changes within. Whatever else it
touches is in ``touches.py``. Results depend on the versions of numpy, scipy and numba in the last digits, and chains of
emcee carry these on. The environment in which all runs (``environment.py``) leaves them no choice of the processor's
instructions, but to be sure write both records on one machine.
"""

from __future__ import annotations

import argparse
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from environment import ENVIRONMENT, REPOSITORY, restart_in_it

SLOWLY = 20.0  # seconds between two savings of a section that is under way
RESUMABLE = ("models", "identify", "exam", "verify", "transients")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    writing = commands.add_parser("write", help="write a record of this checkout")
    writing.add_argument("out", type=Path, help="a .json or .json.gz file")
    writing.add_argument("--only", default="", help="sections, as identify,batch; default: all")
    writing.add_argument("--resume", action="store_true", help="keep what a stopped run had finished")
    comparing = commands.add_parser("compare", help="compare two records")
    comparing.add_argument("first", type=Path)
    comparing.add_argument("second", type=Path)
    comparing.add_argument("--only", default="", help="sections; default: those that both records have")
    comparing.add_argument("--rtol", type=float, default=1e-12, help="relative difference that counts as none")
    comparing.add_argument("--atol", type=float, default=0.0, help="absolute difference that counts as none")
    comparing.add_argument("--strict", action="store_true", help="count the scatter of the simulator as well")
    comparing.add_argument("--most", type=int, default=20, help="differing keys and lines shown of each kind")
    comparing.add_argument("--rename", action="append", default=[], metavar="OLD=NEW", help="of keys of the first")
    asked = parser.parse_args()
    if asked.command == "compare":
        from comparison import compare

        how = {name: getattr(asked, name) for name in ("rtol", "atol", "most", "strict")}
        renames = [tuple(rename.split("=", 1)) for rename in asked.rename]
        return compare(asked.first, asked.second, only=_names(asked.only), renames=renames, **how)
    restart_in_it()
    return write(asked.out, _names(asked.only), resume=asked.resume)


def write(out: Path, only: list[str], *, resume: bool) -> int:
    """Run the sections and store each result as it comes."""
    from sections import SECTIONS
    from storage import load, save
    from values import plain

    unknown = sorted(set(only) - set(SECTIONS))
    if unknown:
        print(f"no section {', '.join(unknown)}; there are {', '.join(SECTIONS)}", file=sys.stderr)
        return 2
    record = load(out) if out.exists() else {"sections": {}}
    if "sections" not in record:
        print(f"{out} is there and no record", file=sys.stderr)
        return 2
    for name in only or SECTIONS:
        known = record["sections"].get(name, {})
        keep = resume and name in RESUMABLE
        if keep and known.get("finished"):
            continue
        items = known.get("items", {}) if keep else {}
        section = {"finished": False, "about": _about(), "cpu_seconds": known.get("cpu_seconds", 0.0) if keep else 0.0}
        record["sections"][name] = section | {"items": items}
        work = _work_folder(out, name, keep=keep)
        begin, saved = time.perf_counter(), time.perf_counter()
        try:
            for key, made in SECTIONS[name](work):
                if key in items:
                    continue
                started = _processor_time()
                items[key] = plain(made())
                spent = _processor_time() - started
                record["sections"][name]["cpu_seconds"] += spent
                print(f"{name}: {key} ({spent:.1f} s)", flush=True)
                if time.perf_counter() - saved > SLOWLY:
                    save(out, record)
                    saved = time.perf_counter()
        except BaseException:
            save(out, record)
            raise
        record["sections"][name]["finished"] = True
        save(out, record)
        shutil.rmtree(work, ignore_errors=True)
        spent = record["sections"][name]["cpu_seconds"]
        print(f"{name}: {len(items)} items, {spent:.0f} s of processor, {time.perf_counter() - begin:.0f} s in all")
    return 0


def _work_folder(out: Path, name: str, *, keep: bool) -> Path:
    """A new folder, or for a section that can be taken up again the one next to the record."""
    if name not in RESUMABLE:
        return Path(tempfile.mkdtemp(prefix="golden-"))
    work = Path(f"{out}.{name}")
    if not keep:
        shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True, exist_ok=True)
    return work


def _names(text: str) -> list[str]:
    return [one.strip() for one in text.split(",") if one.strip()]


def _processor_time() -> float:
    """Seconds of this process and of those it started and saw end."""
    return sum(os.times()[:4])


def _about() -> dict[str, object]:
    """What made a section: commit, machine and libraries."""
    from importlib.metadata import version

    told = subprocess.run(
        ["git", "-C", str(REPOSITORY), "log", "-1", "--format=%H"], capture_output=True, text=True, check=False
    )
    libraries = ("numpy", "scipy", "numba", "emcee", "xarray", "matplotlib", "typer", "rich")
    return {
        "commit": told.stdout.strip(),
        "machine": platform.machine(),
        "processor": _processor(),
        "python": platform.python_version(),
        "libraries": {name: version(name) for name in libraries},
        "environment": ENVIRONMENT,
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "")


if __name__ == "__main__":
    sys.exit(main())
