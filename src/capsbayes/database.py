"""Steady shapes on disk: one NetCDF file per membrane law and cross-section, with its pedigree.

Lengths are over the half width l of the channel, velocities over the mean undisturbed velocity U, pressures over
mu U/l, tensions over G_s. The file is plain NetCDF-4; ``xarray.open_dataset(path, engine="h5netcdf")`` reads it.

An *effect* file varies one more parameter of the simulator: it has one row for
each case at each of a few values. A plain file has the effect "none".
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self

import h5netcdf
import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.errors import DatabaseError
from capsbayes.files.output_file import write_dataset
from capsbayes.parameters import PARAMETERS
from capsbayes.status import Status

NO_EFFECT = "none"
"""Attribute `effect` of a plain database."""

LIMIT_OF_EXISTENCE, LIMIT_OF_DATABASE = "limit of existence", "limit of the database"
SNAP_THROUGH, LOST_FROM_REST = "snap-through", "lost from rest"
"""Kinds of borders.

The first two end the cases of one size ratio at high Ca. Below them, a snap-through ends the shapes that a capsule
takes from rest: up to there a parachute may be stable as well. Where a capsule beyond it was not observed to come to
rest, the branch is lost from rest: which shape it takes from there on is not established.
"""


class Variable(NamedTuple):
    """Description of a variable of the file."""

    dims: tuple[str, ...]
    kind: str  # numpy's letter: "f" float64, "i" int64, "U" text
    symbol: str
    units: str
    long_name: str


_CASE, _BORDER = ("case",), ("border",)


def _quantities(*names: str, kind: str = "f") -> dict[str, Variable]:
    """Return the variables over the cases that hold quantities of the one table."""
    known = {name: PARAMETERS[name] for name in names}
    return {
        name: Variable(_CASE, kind, quantity.symbol, "1" if quantity.unit == "-" else quantity.unit, quantity.meaning)
        for name, quantity in known.items()
    }


VARIABLES: dict[str, Variable] = {
    **_quantities("capillary_number", "size_ratio"),
    "effect_value": Variable(_CASE, "f", "e", "1", "value of the parameter named by the attribute effect"),
    **_quantities("axial_extent", "axial_length", "parachute_depth", "perimeter", "stretch_ratio", "velocity_ratio"),
    **_quantities("inner_pressure", "extra_pressure_drop", "residual", "slack", "minimum_tension", "wrinkling_rate"),
    **_quantities("maximum_tension"),
    "minimum_tension_place": Variable(("case", "axis"), "f", "x_min", "l", "where the smallest principal tension lies"),
    "maximum_tension_place": Variable(("case", "axis"), "f", "x_max", "l", "where the largest principal tension lies"),
    **_quantities("iterations", "refinement", kind="i"),
    "status": Variable(_CASE, "U", "status", "1", "why the computation ended, a name of capsbayes.Status"),
    "nodes": Variable(("case", "node", "axis"), "f", "x", "l", "nodes of the symmetry wedge"),
    "profile": Variable(("case", "point", "plane"), "f", "(z, y)", "l", "outline in the plane x = 0, from the nose"),
    "silhouette": Variable(("case", "point", "plane"), "f", "(z, y)", "l", "outline seen along x, from the nose"),
    "border_size_ratio": Variable(_BORDER, "f", "a/l", "1", "size ratio of each point of the upper border"),
    "border_capillary_number": Variable(_BORDER, "f", "Ca", "1", "largest capillary number with a steady state"),
    "border_effect_value": Variable(_BORDER, "f", "e", "1", "value of the effect of each point of the upper border"),
    "border_kind": Variable(_BORDER, "U", "kind", "1", "limit of existence, or limit of the database"),
    "axis": Variable(("axis",), "U", "axis", "1", "coordinate of a node"),
    "plane": Variable(("plane",), "U", "plane", "1", "coordinate of an outline's point"),
}
"""Every variable of a file."""

OPTIONAL = ("maximum_tension", "minimum_tension_place", "maximum_tension_place")
"""Those that files of earlier versions do not hold."""

ATTRIBUTES = (
    *("title", "source", "law", "cross_section", "bending", "pre_inflation", "effect", "null_value"),
    *("settings", "version", "created", "sha256"),
)
"""Every attribute a file must hold; `settings` is JSON, `created` alone is left out of the hash."""

_COORDINATES: dict[str, tuple[str, ...]] = {"axis": ("x", "y", "z"), "plane": ("z", "y")}


@dataclass(frozen=True, eq=False)
class StoredStates:
    """Steady shapes in one NetCDF file, that of the user or one that comes with the library.

    ``database[name]`` is a variable as a numpy array.
    """

    dataset: xr.Dataset

    FOLDER: ClassVar[str]  # of the files that come with the library
    KIND: ClassVar[str]  # what messages call such a file

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Self:
        """Read and check a file.

        Raises
        ------
        DatabaseError
            If the file is missing, cut short, lacks a variable or was changed.
        """
        dataset = read_dataset(path)
        present = dataset.copy()
        present.attrs = _renamed(dataset.attrs)
        cls._check(present, str(path))
        check_content(dataset, path)
        return cls(present)

    @classmethod
    def open(cls, source: str | os.PathLike[str]) -> Self:
        """Read a database that comes with the library, or a file.

        Parameters
        ----------
        source : str or path
            Name, as ``"square-neo-hookean"``, or path of a file with its ending .nc.

        Raises
        ------
        DatabaseError
            If no database of that name comes with the library, or the file cannot be read.
        """
        name = str(source)
        if name.endswith(".nc") or isinstance(source, os.PathLike):
            return cls.read(source)
        for folder in shipped_folders(cls.FOLDER):
            if (folder / f"{name}.nc").is_file():
                return cls.read(folder / f"{name}.nc")
        known = ", ".join(cls.shipped()) or "none"
        raise DatabaseError(f"no {cls.KIND} {name!r} comes with the library; it has {known}")

    @classmethod
    def shipped(cls) -> list[str]:
        """Return the names of the databases that come with the library."""
        return sorted({path.stem for folder in shipped_folders(cls.FOLDER) for path in folder.glob("*.nc")})

    @property
    def sha256(self) -> str:
        """Hash of the content, as kept in the file."""
        return str(self.dataset.attrs["sha256"])

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the simulator that made it."""
        return dict(json.loads(self.dataset.attrs["settings"]))

    def __getitem__(self, name: str) -> NDArray[Any]:
        return np.asarray(self.dataset[name].values)

    @staticmethod
    def _check(dataset: xr.Dataset, where: str) -> None:
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class Database(StoredStates):
    """Steady shapes over a set of cases (capillary number, size ratio).

    ``database[name]`` is a variable as a numpy array; the names are those of
    `VARIABLES`.

    Parameters
    ----------
    dataset : xarray.Dataset
        Contains the variables of `VARIABLES`. `assemble` makes a database from arrays; `read` and `open` read a file.
    """

    FOLDER, KIND = "databases", "database"

    @classmethod
    def assemble(cls, variables: Mapping[str, ArrayLike], attributes: Mapping[str, str | int | float]) -> Database:
        """Make a database from arrays; units, symbols, coordinates and hash are added.

        Parameters
        ----------
        variables : mapping of str to array
            An array for each of `VARIABLES` except the coordinates and perhaps the `OPTIONAL` ones, with the shape and
            unit stated there.
        attributes : mapping of str to str or number
            A value for each of `ATTRIBUTES` except ``sha256``.

        Raises
        ------
        DatabaseError
            If a variable or an attribute is missing or has a wrong shape.
        """
        dataset = xr.Dataset(attrs=dict(attributes))
        for name, values in {**_COORDINATES, **variables}.items():
            if name in VARIABLES:
                dims, kind, symbol, units, long_name = VARIABLES[name]
                array = np.asarray(values)
                if array.ndim != len(dims):
                    raise DatabaseError(f"database: {name}: expected dimensions {dims}, got shape {array.shape}")
                described = {"long_name": long_name, "symbol": symbol, "units": units}
                dataset[name] = (dims, array.astype(kind if kind == "U" else f"{kind}8"), described)
        dataset.attrs["sha256"] = content_hash(dataset)
        cls._check(dataset, "database")
        return cls(dataset)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write a NetCDF file, completely or not at all: an existing one is replaced when the new one is complete."""
        encoding: dict[str, dict[str, Any]] = {}
        for name, variable in _held(self.dataset):
            encoding[name] = {"_FillValue": None} if variable.kind == "f" else {}
            if len(variable.dims) > 1 and self.dataset[name].size:
                encoding[name] |= {"zlib": True, "complevel": 9, "shuffle": True}
                if np.array_equal(self[name].astype(np.float32), self[name], equal_nan=True):  # nothing is lost
                    encoding[name]["dtype"] = "f4"
        write_dataset(path, self.dataset.assign_attrs(sha256=content_hash(self.dataset)), encoding)

    def __len__(self) -> int:
        return int(self.dataset.sizes["case"])

    @property
    def effect(self) -> str:
        """Name of the simulator's parameter that varies, ``"none"`` in a plain database."""
        return str(self.dataset.attrs["effect"])

    @property
    def null_value(self) -> float:
        """Value of the effect at which it is absent, or that of the base where there is no such value."""
        return float(self.dataset.attrs["null_value"])

    @property
    def values(self) -> Floats:
        """Values of the effect in increasing order : (k,) array."""
        return np.unique(self["effect_value"])

    def at_value(self, value: float) -> Database:
        """Return the cases and borders of one value of the effect, with the hash of the whole database."""
        chosen = {
            dimension: _rows(self[name] == value)
            for dimension, name in (("case", "effect_value"), ("border", "border_effect_value"))
        }
        return Database(self.dataset.isel(chosen))

    def plain_relative(self) -> Database | None:
        """Return the plain database of the same cross-section and law that comes with the library, if there is one."""
        for folder in shipped_folders():
            for path in sorted(folder.glob("*.nc")):
                with h5netcdf.File(path, "r") as opened:
                    attributes = _renamed(opened.attrs)
                same = all(attributes[name] == self.dataset.attrs[name] for name in ("cross_section", "law"))
                if same and attributes.get("effect", NO_EFFECT) == NO_EFFECT:
                    return Database.read(path)
        return None

    @property
    def converged(self) -> Database:
        """The cases whose status is ``DONE``, with the hash of the whole database."""
        return Database(self.dataset.isel(case=_rows(self["status"] == Status.DONE.name)))

    def as_dict(self) -> dict[str, Any]:
        """Return the hash, the number of cases and how many ended with each status, ready for JSON."""
        statuses = Counter(map(str, self["status"])).most_common()
        return {"sha256": self.sha256, "cases": len(self), "statuses": dict(statuses)}

    def compact(self) -> Database:
        """Return the database as it is shipped: without the nodes of the membrane, outlines in single precision.

        Its file has a quarter of the size, and its outlines differ by less than 1e-7 l.
        """
        slim = self.dataset.isel(node=slice(0))
        single = {name: slim[name].astype(np.float32).astype(np.float64) for name in ("profile", "silhouette")}
        slim = slim.assign(single)
        return Database(slim.assign_attrs(sha256=content_hash(slim)))

    @staticmethod
    def _check(dataset: xr.Dataset, where: str) -> None:
        for name, variable in _held(dataset):
            if name not in dataset.variables:
                raise DatabaseError(f"{where}: variable {name} is missing")
            found = dataset[name]
            if found.dims != variable.dims:
                raise DatabaseError(f"{where}: {name}: expected dimensions {variable.dims}, got {found.dims}")
            if found.dtype.kind != variable.kind:
                raise DatabaseError(f"{where}: {name}: expected numpy kind {variable.kind!r}, got {found.dtype}")
        for name in ATTRIBUTES:
            if name not in dataset.attrs:
                raise DatabaseError(f"{where}: attribute {name} is missing")
        unknown = sorted(set(map(str, dataset["status"].values)) - set(Status.__members__))
        if unknown:
            raise DatabaseError(f"{where}: status: expected names of capsbayes.Status, got {', '.join(unknown)}")


def _held(dataset: xr.Dataset) -> list[tuple[str, Variable]]:
    """Return the variables that a dataset must hold, and those that it may hold and does."""
    return [(name, kind) for name, kind in VARIABLES.items() if name in dataset.variables or name not in OPTIONAL]


def read_dataset(path: str | os.PathLike[str]) -> xr.Dataset:
    """Read a NetCDF file of this library into memory, single precision as double."""
    if not Path(path).is_file():
        raise DatabaseError(f"{path}: no such file")
    try:
        with xr.open_dataset(path, engine="h5netcdf") as opened:
            dataset = opened.load()
    except Exception as error:  # h5py, h5netcdf and xarray each have their own errors for a damaged file
        reason = " ".join(str(error).split())[:120]
        raise DatabaseError(f"{path}: not a readable NetCDF file, damaged or cut short ({reason})") from error
    for name in dataset.variables:
        if dataset[name].dtype.kind in "OT":  # text of variable length comes back as objects
            dataset[name] = dataset[name].astype("U")
        elif dataset[name].dtype == np.float32:  # as outlines are stored where that loses nothing
            dataset[name] = dataset[name].astype(np.float64)
    return dataset


def check_content(dataset: xr.Dataset, path: str | os.PathLike[str]) -> None:
    """Refuse a dataset whose content does not match the hash that it holds."""
    with contextlib.suppress(TypeError, ValueError):  # of attributes that are neither texts nor numbers
        if content_hash(dataset) == str(dataset.attrs.get("sha256")):
            return
    raise DatabaseError(f"{path}: its content does not match its sha256; it was damaged or changed by hand")


def shipped_folders(kind: str = Database.FOLDER) -> tuple[Path, ...]:
    """Return the folders of shipped files of a kind: in the installed package, and in the source tree."""
    package = Path(__file__).resolve().parent
    return package / kind, package.parents[1] / "data" / kind


def _rows(chosen: Booleans) -> slice | Integers:
    """Return the rows that are chosen, as a slice where they follow each other: arrays are views then, not copies."""
    rows = np.flatnonzero(chosen)
    together = len(rows) > 0 and rows[-1] - rows[0] == len(rows) - 1
    return slice(int(rows[0]), int(rows[-1]) + 1) if together else rows


def _renamed(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the attributes of a file under their present names: up to 0.1.0 the cross-section was the section."""
    texts = {"settings": str(attributes.get("settings", "")).replace('"section":', '"cross_section":')}
    known = {"cross_section" if name == "section" else name: value for name, value in attributes.items()}
    return known | {name: text for name, text in texts.items() if name in known}


def content_hash(dataset: xr.Dataset) -> str:
    """sha256 of every variable in the order of names, then of the attributes that state the pedigree."""
    digest = hashlib.sha256()
    for name in sorted(map(str, dataset.variables)):
        values = dataset[name].values
        digest.update(f"{name} {dataset[name].dims} {values.shape} {sorted(dataset[name].attrs.items())}\n".encode())
        if values.dtype.kind == "f":
            values = np.where(np.isnan(values), np.nan, values)  # one NaN of the many
        if values.dtype.kind in "fi":
            digest.update(np.ascontiguousarray(values, dtype=f"<{values.dtype.kind}8").tobytes())
        else:
            digest.update("\0".join(map(str, values.ravel())).encode())
    attributes = {
        key: value if isinstance(value, str) else float(value)
        for key, value in dataset.attrs.items()
        if key not in ("sha256", "created")
    }
    digest.update(json.dumps(attributes, sort_keys=True).encode())
    return digest.hexdigest()
