"""The work folder of a database under way: one small file for each finished case.

A file is written under another name and then renamed, so it is either whole
or absent. It states the settings it was made with and a hash of its content:
a damaged one counts as absent. What it holds is pickled; use only a folder of
your own making.
"""

from __future__ import annotations

import hashlib
import json
import os
import pickle
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from capsbayes.errors import DatabaseError
from capsbayes.status import Status

__all__ = ["Outcome", "Parts"]

_MAGIC = b"capsbayes part 1"


@dataclass(frozen=True, eq=False)
class Outcome:
    """How one case ended.

    Parameters
    ----------
    capillary_number, size_ratio : float
        The case [-].
    start : float or str
        Capillary number of the steady state it was started from, ``"rest"``, or ``"parachute"`` for the first
        parachute found.
    status : Status
    variables : dict of str to value
        The case's row of the database; without NaN only if `status` is DONE.
    state : SteadyState or None
        The steady state itself if `status` is DONE.
    message : str
        What was raised, if anything was.
    """

    capillary_number: float
    size_ratio: float
    start: float | str
    status: Status
    variables: dict[str, Any] = field(default_factory=dict)
    state: Any = None
    message: str = ""

    @property
    def done(self) -> bool:
        """True when the case converged."""
        return self.status is Status.DONE


@dataclass(frozen=True)
class Parts:
    """The folder; safe to use from many processes at once.

    Parameters
    ----------
    folder : Path
    fingerprint : str
        Hash of the simulator's settings.
    """

    folder: Path
    fingerprint: str

    @classmethod
    def open(cls, folder: str | os.PathLike[str], settings: Mapping[str, Any]) -> Parts:
        """Make the folder, or take up the one that is there.

        Parameters
        ----------
        folder : path
        settings : mapping
            Settings of the simulator, as can be written in JSON.

        Returns
        -------
        Parts

        Raises
        ------
        DatabaseError
            If the folder holds parts made with other settings.
        """
        path = Path(folder)
        path.mkdir(parents=True, exist_ok=True)
        text = json.dumps(dict(settings), sort_keys=True, indent=1)
        parts = cls(path, hashlib.sha256(text.encode()).hexdigest())
        kept = path / "settings.json"
        if kept.exists():
            _compare(path, kept.read_text(), text)
        else:
            parts._replace(kept, text.encode())
        return parts

    def find(self, capillary_number: float, size_ratio: float, start: float | str) -> Outcome | None:
        """Outcome of a case already finished from this start.

        Returns
        -------
        Outcome or None

        Raises
        ------
        DatabaseError
            If the part was made with other settings.
        """
        case = _case_name(capillary_number, size_ratio)
        same = sorted(self.folder.glob(f"{case}_from-{_start_name(start)}.*.part"))
        return next((outcome for outcome in map(self._load, same) if outcome is not None), None)

    def save(self, outcome: Outcome) -> None:
        """Keep an outcome, whole or not at all."""
        case = _case_name(outcome.capillary_number, outcome.size_ratio)
        name = f"{case}_from-{_start_name(outcome.start)}.{outcome.status.name}.part"
        payload = pickle.dumps(outcome, protocol=5)
        header = b" ".join([_MAGIC, self.fingerprint.encode(), hashlib.sha256(payload).hexdigest().encode()])
        self._replace(self.folder / name, header + b"\n" + payload)

    def tally(self, cases: list[tuple[float, float]]) -> tuple[int, int]:
        """Number of the cases that have ended, and of those that have not converged."""
        statuses: dict[str, set[str]] = {}
        for path in self.folder.glob("*.part"):
            case, _, rest = path.name.partition("_from-")
            statuses.setdefault(case, set()).add(rest.split(".")[-2])
        ended = [found for case in cases if (found := statuses.get(_case_name(*case)))]
        return len(ended), sum(Status.DONE.name not in found for found in ended)

    def _load(self, path: Path) -> Outcome | None:
        header, _, payload = path.read_bytes().partition(b"\n")
        if not header.startswith(_MAGIC + b" "):
            return None
        fingerprint, _, digest = header[len(_MAGIC) + 1 :].decode(errors="replace").partition(" ")
        if digest != hashlib.sha256(payload).hexdigest():
            return None
        if fingerprint != self.fingerprint:
            raise DatabaseError(f"{path} was made with other settings; remove it, or build under another name")
        outcome = pickle.loads(payload)
        return outcome if isinstance(outcome, Outcome) else None

    def _replace(self, path: Path, content: bytes) -> None:
        partial = path.with_name(f".{path.name}.{os.getpid()}.tmp")
        partial.write_bytes(content)
        os.replace(partial, path)


def _case_name(capillary_number: float, size_ratio: float) -> str:
    return f"size-{size_ratio!r}_ca-{capillary_number!r}"


def _start_name(start: float | str) -> str:
    return start if isinstance(start, str) else repr(start)


def _compare(folder: Path, kept: str, asked: str) -> None:
    try:
        there, here = json.loads(kept), json.loads(asked)
    except ValueError as error:
        raise DatabaseError(f"{folder / 'settings.json'} is damaged; remove {folder} to start anew") from error
    changed = [key for key in sorted({*there, *here}) if there.get(key) != here.get(key)]
    if changed:
        found = ", ".join(f"{key} {there.get(key)!r} there and {here.get(key)!r} asked" for key in changed)
        raise DatabaseError(f"{folder} holds parts made with other settings: {found}; remove it, or choose another out")
