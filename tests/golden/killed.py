"""Coarse databases: one made at a stretch, one killed half-way and taken up again, one of an effect."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import touches
from commands import Desk
from values import flat, of_netcdf

_CASES = ((0.04, 0.8), (0.06, 0.8), (0.04, 0.85), (0.06, 0.85), (0.04, 0.9), (0.06, 0.9))
_OPTIONS = ("--refinement", "4", "--workers", "1")
_PATIENCE = 1800.0  # seconds


def build(work: Path) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Build at a stretch, build again with a kill, and build an effect database."""
    desk = Desk(work)
    _write_cases(desk.folder / "cases.csv", _CASES)
    _write_cases(desk.folder / "two.csv", _CASES[2:4])

    def built(*options: str, out: str, cases: str = "cases.csv") -> dict[str, Any]:
        said = desk.run("build", "--cases", cases, "--out", out, *_OPTIONS, *options, keep=())
        said.pop("names")
        return {"said": said, "database": of_netcdf(desk.folder / out, whole=4000)}

    def resumed() -> dict[str, Any]:
        arguments = ("build", "--cases", "cases.csv", "--out", "killed.nc", *_OPTIONS)
        found = _killed_half_way(desk, arguments, desk.folder / "killed.nc.parts")
        found |= built(out="killed.nc")
        found["beside that at a stretch"] = _apart(found["database"], of_netcdf(desk.folder / "whole.nc", whole=4000))
        return found

    yield "at a stretch", lambda: built(out="whole.nc")
    yield "killed and resumed", resumed
    yield "with a finer mesh beside", lambda: built("--compare", "5", out="compared.nc", cases="two.csv")
    effect = ("--effect", "pre_inflation", "--values", "0,0.02,0.05")
    yield "effect", lambda: built(*effect, out="effect.nc", cases="two.csv")
    tube = ("--cross-section", "circular", "--law", "skalak:hardening=1")
    yield "tube", lambda: built(*tube, out="tube.nc", cases="two.csv")


def _apart(one: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    """Largest difference of the numbers of two databases, and whether all words are the same but the hashes."""
    ours, theirs = dict(flat(one)), dict(flat(other))
    numbers = {key: (value, theirs.get(key)) for key, value in ours.items() if isinstance(value, float)}
    largest = max((abs(a - b) for a, b in numbers.values() if not (math.isnan(a) and math.isnan(b))), default=0.0)
    words = {key for key in {*ours, *theirs} - {*numbers} if ours.get(key) != theirs.get(key)}
    return {"largest difference": largest, "other differences": sorted(words - {"attributes/sha256"})}


def _write_cases(path: Path, cases: tuple[tuple[float, float], ...]) -> None:
    path.write_text("capillary_number,size_ratio\n" + "".join(f"{ca},{size}\n" for ca, size in cases))


def _killed_half_way(desk: Desk, arguments: tuple[str, ...], parts: Path) -> dict[str, Any]:
    """Start a command, kill it with all its workers when half of the cases are kept."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen([*touches.COMMAND, *arguments], cwd=desk.folder, start_new_session=True, **quiet)
    end = time.monotonic() + _PATIENCE
    while process.poll() is None and _kept(parts) < len(_CASES) // 2 and time.monotonic() < end:
        time.sleep(0.05)
    unfinished = process.poll() is None
    if unfinished:
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    kept = _kept(parts)
    return {"killed": unfinished, "some cases were kept": kept > 0}


def _kept(parts: Path) -> int:
    """Files of finished cases."""
    return sum(1 for _ in parts.glob(f"**/*{touches.PART}")) if parts.exists() else 0
