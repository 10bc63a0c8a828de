"""Measurement of one capsule: its lengths and its velocity, each with its standard error."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.files.input_file import InputFile, Reader, file_name, quantity, unread
from capsbayes.files.output_file import together, write_file
from capsbayes.measured_outline import SILHOUETTE, MeasuredOutline, check_placed
from capsbayes.parameters import STATED
from capsbayes.quantity import Given, Quantity
from capsbayes.readable import Readable
from capsbayes.status import Status

_FLOW_RATE = STATED["flow_rate"].example

CONDITIONS = ("half_width", "viscosity")
"""Conditions of an experiment that may differ from capsule to capsule of a set."""


@dataclass(frozen=True, eq=False, repr=False)
class Measurement(Readable):
    """Lengths and velocity of one capsule at steady state.

    The error of the velocity is taken as independent of those of the lengths. A length and the velocity are given with
    their errors, in any form that `Quantity.of` reads, or with the error apart, a number in SI or a quantity of the
    same unit.

    Parameters
    ----------
    axial_extent, axial_extent_error : float
        Maximum extension along the flow L_z and its standard error, over l or
        in metres.
    capsule_velocity, capsule_velocity_error : float [m/s]
        Velocity of the capsule v_o and its standard error; both are missing, None and NaN, where it was not measured
        because the flow rate is known or the experiment states the viscous tension.
    axial_length, axial_length_error : float, optional
        Length on the axis L_a and its standard error, in the unit of L_z;
        missing where the rear is hidden behind its rim.
    length_correlation : float
        Correlation of the errors of the two lengths, between -1 and 1.
    over_half_width : bool
        True for lengths over l (measured against the walls on the same picture), False for lengths in metres; lengths
        given with a unit decide it themselves.
    outline : MeasuredOutline, optional
        The whole edge, over l. It replaces the lengths in the likelihood; they then only give initial values. A
        silhouette does not show L_a, which is used in addition.
    source : str
        File the measurement was read from, empty if none.
    sha256 : str
        Fingerprint of that file.
    experiment_file : Path, optional
        The experiment the file names.
    status : Status
        How the measurement ended; the numbers are NaN unless it is ``DONE``.
    axial_length_bound : float, optional
        Upper limit of a missing L_a: the length of the silhouette with two standard errors.
    flow_rate, flow_rate_error : float, optional
        Flow rate in the channel [m^3/s] and its standard error, zero if it is taken as known: a source of the mean
        velocity U, which is the flow rate over the area of the cross-section, next to the velocity or in its place.
    conditions : mapping of str to float
        ``half_width`` and ``viscosity`` of this capsule of a set, in SI, if they differ from those of the experiment. A
        measurement file states them by the experiment that it names.
    walls : str
        How the walls, and thus l in pixels, were stated by hand; empty if they were found in the picture.
    doubt : str
        What is doubtful about the walls, a sentence; empty if nothing.

    Raises
    ------
    InputError
        On a value that is not positive, finite and plausible, or L_a > L_z.

    Examples
    --------
    >>> seen = Measurement(axial_extent=2.14, axial_extent_error=0.01, capsule_velocity=5e-3,
    ...                    capsule_velocity_error=5e-5, axial_length=1.81, axial_length_error=0.01)
    >>> seen.lengths, seen.covariance.shape
    (array([2.14, 1.81]), (2, 2))
    >>> Measurement(axial_extent="53.5 +/- 0.3 um", capsule_velocity="5.00 +/- 0.05 mm/s").over_half_width
    False
    >>> Measurement(axial_extent="2.14 +/- 0.01", capsule_velocity="5.00 +/- 0.05 mm/s")
    <Measurement: axial_extent 2.14 +/- 0.01 l; capsule_velocity 5 +/- 0.05 mm/s>
    """

    axial_extent: Given
    axial_extent_error: float = float("nan")
    capsule_velocity: Given = None
    capsule_velocity_error: float = float("nan")
    axial_length: Given | None = None
    axial_length_error: float | None = None
    length_correlation: float = 0.0
    over_half_width: bool = True
    outline: MeasuredOutline | None = None
    source: str = ""
    sha256: str = ""
    experiment_file: Path | None = None
    status: Status = Status.DONE
    axial_length_bound: float | None = None
    flow_rate: Given | None = None
    flow_rate_error: float | None = None
    conditions: Mapping[str, float] = field(default_factory=dict)
    walls: str = ""
    doubt: str = ""

    def __post_init__(self) -> None:
        where = self.source or "measurement"
        for key, kind in (("status", Status), ("outline", MeasuredOutline | None), ("conditions", Mapping)):
            if not isinstance(given := getattr(self, key), kind):
                raise InputError(where, key, getattr(kind, "__name__", str(kind)), repr(given)[:60])
        if not self.status.ok:
            return
        if (unit := self._split(where, "axial_extent", ("", "m"))) is not None:
            object.__setattr__(self, "over_half_width", not unit)
        self._split(where, "axial_length", ("",) if self.over_half_width else ("m",))
        self._split(where, "capsule_velocity", ("m/s",))
        for key in ("axial_extent", "capsule_velocity", "axial_length"):
            self._check_pair(where, key)
        if self.flow_rate is not None:
            rate = Quantity.of(self.flow_rate, "flow_rate", where=where)
            if rate.shape != "normal":
                raise InputError(where, "flow_rate", f'a standard error, as in "{_FLOW_RATE}"', str(self.flow_rate))
            error = rate.error or _apart(self.flow_rate_error, where, "flow_rate_error", ("m^3/s",)) or 0.0
            if not 0.0 <= error <= rate.value:
                raise InputError(where, "flow_rate_error", f"a number from 0 to {rate.value:g}", repr(error))
            object.__setattr__(self, "flow_rate", rate.value)
            object.__setattr__(self, "flow_rate_error", error)
        bound = self.axial_length_bound
        if bound is not None and not (_is_number(bound) and np.isfinite(bound) and bound > 0.0):
            raise InputError(where, "axial_length_bound", "a positive finite number", repr(bound))
        if self.axial_length is not None and self.axial_length > self.axial_extent:
            raise InputError(
                where, "axial_length", f"at most the axial extent {self.axial_extent:g}", f"{self.axial_length:g}"
            )
        if self.outline is not None and not self.over_half_width:
            raise InputError(where, "outline", "lengths over l, as the outline is", "lengths in metres", "divide by l")
        for key in self.conditions:
            if key not in CONDITIONS:
                raise InputError(where, "conditions", " or ".join(CONDITIONS), repr(key))
        read = {key: Quantity.of(value, key, where=where).value for key, value in self.conditions.items()}
        object.__setattr__(self, "conditions", read)
        if not (_is_number(self.length_correlation) and -1.0 < self.length_correlation < 1.0):
            raise InputError(where, "length_correlation", "a number between -1 and 1", repr(self.length_correlation))

    def _split(self, where: str, key: str, units: tuple[str, ...]) -> str | None:
        """Split a quantity into its value and its error; return its unit, None if it is a number or missing."""
        given, error = getattr(self, key), getattr(self, f"{key}_error")
        if given is None or _is_number(given):
            bare = units if key == "capsule_velocity" else ("",) if self.over_half_width else ("m",)
            object.__setattr__(self, f"{key}_error", _apart(error, where, f"{key}_error", bare))
            return None
        apart = error is not None and not _is_number(error)  # a bare number beside a unit could be in either
        found = Quantity.of(given, key, where=where, units=units) if apart else _measured(*units)(given, where, key)
        stated = _apart(error, where, f"{key}_error", (found.unit,)) if apart else found.error
        if apart and found.error:
            raise InputError(where, f"{key}_error", "one error", f"{found}, and {error}")
        object.__setattr__(self, key, found.value)
        object.__setattr__(self, f"{key}_error", stated)
        return found.unit

    def _check_pair(self, where: str, key: str) -> None:
        """Refuse a value or an error that is missing, NaN, infinite, not positive or not plausible."""
        value, error = getattr(self, key), getattr(self, f"{key}_error")
        if key == "axial_length" and value is None and error is None:
            return
        if key == "capsule_velocity" and value is None and np.isnan(error):
            return
        for name, number in ((key, value), (f"{key}_error", error)):
            if number is None or not (np.isfinite(number) and number > 0.0):
                raise InputError(where, name, "a positive finite number", repr(number))
        if error > value:
            raise InputError(where, f"{key}_error", f"at most the value {value:g}", f"{error:g}")
        if key == "capsule_velocity" or self.over_half_width:
            Quantity.of(float(value), key, where=where)

    @classmethod
    def refused(
        cls, status: Status, *, source: str = "", sha256: str = "", experiment_file: Path | None = None
    ) -> Measurement:
        """Return a measurement that failed: its status says why, its numbers are NaN."""
        nothing = (float("nan"),) * 4
        return cls(*nothing, status=status, source=source, sha256=sha256, experiment_file=experiment_file)

    @classmethod
    def read(cls, path: str | Path) -> Measurement:
        """Read a measurement from TOML with units and errors.

        Parameters
        ----------
        path : path
            File with a table ``[measurement]``: ``axial_extent``,
            ``capsule_velocity`` or ``flow_rate`` or both, unless the experiment states a viscous tension, and
            optionally ``axial_length`` and ``length_correlation``, or ``axial_length_bound``, ``walls`` and ``doubt``.
            It may name its experiment file (``experiment = "..."``, relative to itself) and state a ``[prior]``, which
            `capsbayes.infer.Prior.read` reads, a ``[membrane]``, which `capsbayes.infer.Membrane.read` reads, and an
            ``[outline]``, which `MeasuredOutline.read` reads.

        Returns
        -------
        Measurement

        Raises
        ------
        InputError
            Naming file, key, what was expected and what was found.
        """
        file = InputFile.read(path)
        others = dict.fromkeys(("prior", "membrane", "outline"), unread)
        top = file.table(required=("measurement",), optional={"experiment": file_name("experiment.toml"), **others})
        table = file.table(
            "measurement",
            required={"axial_extent": _measured("", "m")},
            optional={
                "capsule_velocity": _measured("m/s"),
                "axial_length": unread,
                "length_correlation": unread,
                "axial_length_bound": unread,
                "flow_rate": quantity("flow_rate"),
                "walls": _text,
                "doubt": _text,
            },
        )
        if "axial_length" in table:
            read = _measured(table["axial_extent"].unit)
            table["axial_length"] = read(table["axial_length"], str(path), "measurement.axial_length")
        found = cls(
            **table,
            outline=MeasuredOutline.read(file) if "outline" in top else None,
            source=str(path),
            sha256=file.sha256,
            experiment_file=top.get("experiment"),
        )
        found.check_outline(found.source)
        return found

    def check_outline(self, where: str) -> None:
        """Refuse an outline that is not over l, or whose flow is not along its first column, towards larger z.

        Raises
        ------
        InputError
        """
        if self.outline is not None:
            check_placed(self.outline, float(self.axial_extent), where)

    def write(self, path: str | Path) -> None:
        """Write a file that `read` reads.

        Parameters
        ----------
        path : path
            The experiment is named in it by its absolute path, or by its name alone if it lies in the same folder; an
            outline is written next to it, in a CSV file of the same name.

        Raises
        ------
        InputError
            If the measurement failed.
        """
        if not self.status.ok:
            raise InputError("measurement", "status", "a measurement that ended as it should", str(self.status))
        unit = "" if self.over_half_width else " m"
        lines = [f"experiment = {json.dumps(_name_of(self.experiment_file, path))}"] if self.experiment_file else []
        lines += ["", "[measurement]", f'axial_extent = "{_pair(self.axial_extent, self.axial_extent_error)}{unit}"']
        if self.axial_length is not None and self.axial_length_error is not None:
            lines += [
                f'axial_length = "{_pair(self.axial_length, self.axial_length_error)}{unit}"',
                f"length_correlation = {float(self.length_correlation)!r}",
            ]
        if self.axial_length_bound is not None:
            lines.append(f"axial_length_bound = {float(self.axial_length_bound)!r}")
        if self.capsule_velocity is not None:
            lines.append(f'capsule_velocity = "{_pair(self.capsule_velocity, self.capsule_velocity_error)} m/s"')
        if self.flow_rate is not None:
            error = f" +/- {float(self.flow_rate_error)!r}" if self.flow_rate_error else ""
            lines.append(f'flow_rate = "{float(self.flow_rate)!r}{error} m^3/s"')
        for name, text in {"walls": self.walls, "doubt": self.doubt}.items():
            if text:
                lines.append(f"{name} = {json.dumps(text)}")
        with together():
            if self.outline is not None:
                lines += ["", *self.outline.write(Path(path).with_suffix(".outline.csv"))]
            write_file(path, "\n".join(lines).lstrip() + "\n")

    def described(self) -> dict[str, str]:
        """Return what was measured in display units; the status alone where the measurement failed."""
        found = {} if self.status.ok else {"status": str(self.status)}
        for key in ("axial_extent", "axial_length", "capsule_velocity") if self.status.ok else ():
            if getattr(self, key) is not None:
                unit = "m/s" if key == "capsule_velocity" else "" if self.over_half_width else "m"
                found[key] = Quantity(getattr(self, key), getattr(self, f"{key}_error"), unit).shown(key)
        if self.flow_rate is not None:
            found["flow_rate"] = Quantity(self.flow_rate, self.flow_rate_error or 0.0, "m^3/s").shown("flow_rate")
        if self.outline is not None:
            found["outline"] = f"{len(self.outline.points)} points, {self.outline.view}"
        stated = {"walls": self.walls, "doubt": self.doubt, "source": self.source}
        return found | {name: text for name, text in stated.items() if text}

    def flowing(self, rate: Quantity | None) -> Measurement:
        """Return the same with a flow rate [m^3/s], if there is one and the measurement did not fail."""
        if rate is None or not self.status.ok:
            return self
        return replace(self, flow_rate=rate.value, flow_rate_error=rate.error)

    @property
    def known_velocity(self) -> Quantity:
        """v_o with its standard error [m/s].

        Raises
        ------
        InputError
            If it is missing.
        """
        if self.capsule_velocity is None:
            where, advice = self.source or "measurement", "the flow rate alone identifies a capsule, but is no velocity"
            if self.flow_rate is None:
                advice = "or state flow_rate, or viscous_tension = mu U in the experiment"
            raise InputError(where, "measurement.capsule_velocity", "a value with an error", "nothing", advice)
        return Quantity(self.capsule_velocity, self.capsule_velocity_error, "m/s")

    @property
    def lengths(self) -> Floats:
        """Measured lengths, L_z or (L_z, L_a) : (k,) array."""
        both = [self.axial_extent] if self.axial_length is None else [self.axial_extent, self.axial_length]
        return np.array(both)

    @property
    def length_with_outline(self) -> tuple[float, float] | None:
        """L_a and its standard error where the outline is a silhouette, which does not show it, else None."""
        if self.outline is None or self.outline.view != SILHOUETTE:
            return None
        if self.axial_length is None or self.axial_length_error is None:
            return None
        return self.axial_length, self.axial_length_error

    @property
    def covariance(self) -> Floats:
        """Covariance of the errors of `lengths` : (k, k) array."""
        if self.axial_length_error is None:
            return np.array([[self.axial_extent_error**2]])
        cross = self.length_correlation * self.axial_extent_error * self.axial_length_error
        return np.array([[self.axial_extent_error**2, cross], [cross, self.axial_length_error**2]])


def _is_number(given: object) -> bool:
    return isinstance(given, (int, float, np.floating, np.integer)) and not isinstance(given, bool)


def _measured(*units: str) -> Reader:
    """Return a reader of measured quantities, which refuses one without an error: nothing would follow from it."""

    def read(given: Given, where: str, key: str) -> Quantity:
        name = key.removeprefix("measurement.")
        found = Quantity.of(given, name, where=where, key=key, units=units)
        if found.known or found.shape != "normal":
            raise InputError(where, key, f'a standard error, as in "{STATED[name].example}"', str(given))
        return found

    return read


def _apart(given: Given, where: str, key: str, units: tuple[str, ...]) -> Any:
    """Return a number that is stated apart from another in SI; what is a number or missing as it is."""
    if given is None or _is_number(given):
        return given
    return Quantity.of(given, where=where, key=key, units=units).value


def _text(value: object, where: str, key: str) -> str:
    if not isinstance(value, str):
        raise InputError(where, key, "a text", repr(value))
    return value


def _pair(value: float, error: float) -> str:
    return f"{float(value)!r} +/- {float(error)!r}"


def _name_of(file: Path, reader: str | Path) -> str:
    """Return the name under which one file names another: bare in the same folder, else absolute."""
    whole = file.resolve()
    return whole.name if whole.parent == Path(reader).resolve().parent else str(whole)
