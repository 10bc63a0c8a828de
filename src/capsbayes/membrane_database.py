"""Steady shapes over the parameters of flow and membrane: one NetCDF file per cross-section, with its pedigree.

The states are scattered over six parameters, and each has its derivatives along all of them. Lengths are over the half
width l of the channel, velocities over the mean undisturbed velocity U. The file is plain NetCDF-4.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from capsbayes.arrays import Booleans, Floats
from capsbayes.database import StoredStates, content_hash
from capsbayes.errors import DatabaseError
from capsbayes.files.output_file import write_dataset
from capsbayes.parameters import OF_THE_MEMBRANE

FREE_PARAMETERS = ("capillary_number", "size_ratio", *OF_THE_MEMBRANE)
"""Parameters over which the states are scattered, in their order."""

RANGES = ((0.01, 0.208), (0.75, 1.1), (0.0, 0.1), (1.0, 5.0), (0.0, 1.0), (1e-5, 1e-2))
"""Lowest and highest value of each."""

THICK = 1e-3
"""Bending stiffness above which a membrane is a thick one; states of these are fewer."""

NULL_VALUES = (0.05, 0.9, 0.0, 3.0, 0.0, 2e-4)
"""Values of a neo-Hookean membrane without inflation, of the bending stiffness of the plain databases."""

PLAIN_LAW = "neo-Hookean"
"""Law of that membrane, as databases call it."""

OMITTED = 1e-4
"""Rms of outlines and coordinates in modes that are left out [l]."""

_HIGHEST, _HARDER = 0.13, 0.6
_UNHINDERED, _NARROWING = {"square": 0.9, "circular": 0.86}, {"square": 0.25, "circular": 0.31}
_LOWEST, _NOT_INFLATED, _LOWEST_PARACHUTE, _RISE = 0.01, 0.02, 0.018, 0.9

_VIEWS = ("profile", "silhouette")
_DIMENSIONS = {
    "values": ("state", "parameter"),
    "lost": ("lost_state", "parameter"),
    "slack": ("state",),
    "numbers": ("state", "number"),
    "numbers_along": ("state", "number", "parameter"),
    "mesh_mean": ("coordinate",),
    "mesh_modes": ("mesh_mode", "coordinate"),
    "mesh": ("state", "mesh_mode"),
    "tension": ("state", "extreme"),
    "tension_along": ("state", "extreme", "parameter"),
    "tension_place": ("state", "extreme", "axis"),
    **{
        f"{view}{part}": dims
        for view in _VIEWS
        for part, dims in {
            "": ("state", f"{view}_mode"),
            "_along": ("state", f"{view}_mode", "parameter"),
            "_mean": ("point", "plane"),
            "_modes": (f"{view}_mode", "point", "plane"),
        }.items()
    },
}
_OF_THE_MESH = {f"{part}_mesh_error": _DIMENSIONS[part] for part in ("numbers", "profile", "silhouette")}
_SINGLE = (*(f"{view}_{part}" for view in _VIEWS for part in ("along", "modes")), "mesh_modes", "mesh", *_OF_THE_MESH)
_MODE = "_mode"  # ending of the dimensions of modes


def highest_ca(size_ratio: ArrayLike, strain_hardening: ArrayLike, cross_section: str = "square") -> Floats:
    """Return the highest Ca of the states: about where neo-Hookean parachutes end, and further for harder membranes."""
    falling = _HIGHEST - _NARROWING[cross_section] * (np.asarray(size_ratio) - _UNHINDERED[cross_section])
    return np.minimum(_HIGHEST, falling) * (1.0 + _HARDER * np.asarray(strain_hardening))


def lowest_ca(pre_inflation: ArrayLike) -> Floats:
    """Return the lowest Ca of the states; with little inflation it lies above the snap-through to convex shapes."""
    inflation = np.asarray(pre_inflation)
    return np.where(inflation < _NOT_INFLATED, _LOWEST_PARACHUTE + _RISE * inflation, _LOWEST)


def covered(values: Floats, cross_section: str = "square") -> Booleans:
    """Return whether values (n, 6) of the parameters lie where states were sought : (n,) bool array."""
    low, high = np.array(RANGES).T
    rounding = 1e-12 * (high - low)
    ca, size, inflation, _, hardening, _ = values.T
    within = np.all((values >= low - rounding) & (values <= high + rounding), axis=1)
    return np.asarray(within & (ca >= lowest_ca(inflation)) & (ca <= highest_ca(size, hardening, cross_section)))


def fewest_modes(vectors: Floats, omitted: float = OMITTED) -> Floats:
    """Return the fewest orthonormal modes (m, d) that leave out of vectors (n, d) no more than an rms [l]."""
    _, sizes, rows = np.linalg.svd(vectors, full_matrices=False)
    left = np.sqrt(np.cumsum(sizes[::-1] ** 2)[::-1] / vectors.size)  # rms without a mode and those after it
    return np.asarray(rows[: int(np.count_nonzero(left > omitted))])


@dataclass(frozen=True, eq=False)
class MembraneDatabase(StoredStates):
    """Scattered states of one cross-section.

    Parameters
    ----------
    dataset : xarray.Dataset
        As `capsbayes.physics.scattered.scattered_dataset` makes it, over `FREE_PARAMETERS`.
    """

    FOLDER, KIND = "membranes", "membrane database"

    @classmethod
    def of(cls, dataset: xr.Dataset) -> MembraneDatabase:
        """Check a dataset, round what single precision holds well enough, and note its hash."""
        slim = dataset.assign(
            {name: dataset[name].astype(np.float32).astype(np.float64) for name in _SINGLE if name in dataset}
        )
        cls._check(slim, "database")
        return cls(slim.assign_attrs(sha256=content_hash(slim)))

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the file whole or not at all."""
        packed = {"zlib": True, "complevel": 9, "shuffle": True, "_FillValue": None}
        encoding: dict[str, dict[str, Any]] = {
            name: {**(packed if self.dataset[name].ndim > 1 and self.dataset[name].size else {"_FillValue": None})}
            for name in _dimensions_of(self.dataset)
        }
        for name in encoding.keys() & set(_SINGLE):
            encoding[name]["dtype"] = "f4"
        write_dataset(path, self.dataset, encoding)

    def __len__(self) -> int:
        return int(self.dataset.sizes["state"])

    def taken(self, states: ArrayLike) -> MembraneDatabase:
        """Return some of the states, with the hash of the whole."""
        return MembraneDatabase(self.dataset.isel(state=np.asarray(states)))

    def joined(self, further: xr.Dataset) -> MembraneDatabase:
        """Return these states followed by others of the same mesh, in the modes of these and as many as they lack."""
        # What the new modes add is nothing but the others', so that the outlines of these states stay as they are.
        others = MembraneDatabase(further)
        self._check(further, "further states")
        self.check_settings(others.settings)
        changed = {}
        for name, dims in _dimensions_of(self.dataset).items():
            of_states = dims[0] in ("state", "lost_state") and not any(_MODE in dim for dim in dims)
            if of_states and name not in _OF_THE_MESH:
                changed[name] = (dims, np.concatenate([self[name], others[name]]))
        for name in (*_VIEWS, "mesh"):
            changed |= self._in_common_modes(others, name)
        if self.has_mesh_error:
            changed |= self._mesh_errors_with(others, {name: values for name, (_, values) in changed.items()})
        kept = self.dataset.drop_vars(list(changed))
        return MembraneDatabase.of(kept.assign(changed))

    def _mesh_errors_with(
        self, others: MembraneDatabase, both: Mapping[str, Floats]
    ) -> dict[str, tuple[tuple[str, ...], Floats]]:
        """Return the errors of the mesh of both: other states without one have that of the nearest of these."""
        away = (others["values"][:, None] - self["values"]) / np.ptp(RANGES, axis=1)
        nearest = np.argmin(np.sum(away**2, axis=2), axis=1)
        parts: dict[str, tuple[tuple[str, ...], Floats]] = {}
        for name, dims in _OF_THE_MESH.items():
            part = name.removesuffix("_mesh_error")
            own = np.pad(self[name], ((0, 0), (0, both[part].shape[1] - self[name].shape[1])))
            if not others.has_mesh_error:
                error = own[nearest]
            elif part == "numbers":
                error = others[name]
            else:
                error = np.einsum("nk,kij,mij->nm", others[name], others[f"{part}_modes"], both[f"{part}_modes"])
            parts[name] = (dims, np.concatenate([own, error]))
        return parts

    def check_settings(self, settings: Mapping[str, Any]) -> None:
        """Refuse settings of a continuation whose states are not those of this database."""
        here, there = ({**each, "axes": None} for each in (self.settings, json.loads(json.dumps(settings))))
        different = [name for name in sorted({*here, *there}) if here.get(name) != there.get(name)]
        if different:
            expected = ", ".join(f"{name} {here.get(name)!r}" for name in different)
            raise DatabaseError(f"states to be added to the database: expected {expected}, got other ones")

    def _in_common_modes(self, others: MembraneDatabase, name: str) -> dict[str, tuple[tuple[str, ...], Floats]]:
        """Return the modes of both and the coefficients of the states of both, with their derivatives if there are."""
        shape = self[f"{name}_mean"].shape
        modes, theirs = (np.reshape(each[f"{name}_modes"], (-1, np.prod(shape))) for each in (self, others))
        away = np.ravel(others[f"{name}_mean"] - self[f"{name}_mean"]) + others[name] @ theirs
        more = fewest_modes(away - away @ modes.T @ modes)
        every = np.concatenate([modes, more])
        parts = {f"{name}_modes": every.reshape(-1, *shape), name: np.pad(self[name], ((0, 0), (0, len(more))))}
        parts[name] = np.concatenate([parts[name], away @ every.T])
        if f"{name}_along" in self.dataset:
            along = np.pad(self[f"{name}_along"], ((0, 0), (0, len(more)), (0, 0)))
            turned = np.einsum("nkp,mk->nmp", others[f"{name}_along"], every @ theirs.T)
            parts[f"{name}_along"] = np.concatenate([along, turned])
        return {part: (_DIMENSIONS[part], values) for part, values in parts.items()}

    def as_dict(self) -> dict[str, Any]:
        """Return the hash, and the numbers of states and of places where none was reached, ready for JSON."""
        return {"sha256": self.sha256, "states": len(self), "lost": int(self.dataset.sizes["lost_state"])}

    @property
    def has_mesh_error(self) -> bool:
        """Whether the states have the error of their mesh."""
        return "numbers_mesh_error" in self.dataset

    @property
    def cross_section(self) -> str:
        """Cross-section of the channel."""
        return str(self.settings["cross_section"])

    @staticmethod
    def _check(dataset: xr.Dataset, where: str) -> None:
        for name, dims in _dimensions_of(dataset).items():
            if name not in dataset.variables:
                raise DatabaseError(f"{where}: variable {name} is missing")
            if dataset[name].dims != dims:
                raise DatabaseError(f"{where}: {name}: expected dimensions {dims}, got {dataset[name].dims}")
        if "settings" not in dataset.attrs:
            raise DatabaseError(f"{where}: attribute settings is missing")
        found = tuple(map(str, dataset["parameter"].values)) if "parameter" in dataset.coords else ()
        if found != FREE_PARAMETERS:
            expected = ", ".join(FREE_PARAMETERS)
            raise DatabaseError(f"{where}: parameter: expected {expected}, got {', '.join(found) or 'none'}")


def _dimensions_of(dataset: xr.Dataset) -> dict[str, tuple[str, ...]]:
    """Return the variables of a dataset with their dimensions; states of a single mesh have no error of it."""
    return _DIMENSIONS | {name: dims for name, dims in _OF_THE_MESH.items() if name in dataset}
