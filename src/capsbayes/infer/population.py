"""The population of a batch: one row a capsule."""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.errors import InputError
from capsbayes.files.csv_file import safe_cell
from capsbayes.files.output_file import write_dataset, write_lines
from capsbayes.infer.posterior import REPORTED, read_attributes
from capsbayes.infer.prior import Marginal
from capsbayes.infer.verdict import PREDICTED
from capsbayes.measurement_sets import NUMBERS, opened
from capsbayes.parameters import PARAMETERS
from capsbayes.quantity import Quantity
from capsbayes.readable import Readable
from capsbayes.status import Status

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


# Likelihood of (log G_s, log a) of one capsule as a mixture of Gaussians; compiled.
#
# The nodes of a posterior are shared linearly among overlapping slices along their longest axis; each slice is a
# component with its own mean and covariance. The mixture keeps the bend of a ridge, on which L_z alone was measured,
# and its total moments are those of the nodes. A Gaussian population then meets it in closed form

COMPONENTS = 12
COMPONENT = ("weight", "x", "y", "xx", "xy", "yy")
"""Of each component: its probability, means and covariances of two logarithms."""

_REACH = 4.0  # standard deviations on either side that the slices divide


@njit(cache=True, nogil=True, error_model="numpy")
def mixture(weights: Floats, x: Floats, y: Floats, into: Floats) -> None:
    """Represent points (n,) with weights of any sum by components (c, 6), see `COMPONENT`; zeros where none lie."""
    total = weights.sum()
    mx, my = np.sum(weights * x) / total, np.sum(weights * y) / total
    dx, dy = x - mx, y - my
    xx, xy, yy = (np.sum(weights * dx * dx), np.sum(weights * dx * dy), np.sum(weights * dy * dy))
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    along = np.cos(angle) * dx + np.sin(angle) * dy
    spread = np.sqrt(np.sum(weights * along * along) / total)
    low, high = max(along.min(), -_REACH * spread), min(along.max(), _REACH * spread)
    slices = len(into)
    width = (high - low) / (slices - 1)
    into[:] = 0.0
    for k in range(len(weights)):
        place = (along[k] - low) / width if width > 0.0 else 0.0
        place = min(max(place, 0.0), slices - 1.000001)
        left = int(place)
        for slot, share in ((left, 1.0 - (place - left)), (left + 1, place - left)):
            part = share * weights[k] / total
            into[slot, 0] += part
            into[slot, 1] += part * dx[k]
            into[slot, 2] += part * dy[k]
            into[slot, 3] += part * dx[k] * dx[k]
            into[slot, 4] += part * dx[k] * dy[k]
            into[slot, 5] += part * dy[k] * dy[k]
    for component in into:
        if component[0] > 0.0:
            component[1:] /= component[0]
            component[3] -= component[1] * component[1]
            component[4] -= component[1] * component[2]
            component[5] -= component[2] * component[2]
            component[1] += mx
            component[2] += my


def merged(components: NDArray[np.float32], neighbours: int) -> NDArray[np.float32]:
    """Merge neighbouring components, whose weight, mean and covariance stay : (n, c, 6) -> (n, c / k, 6) array."""
    parts = components.reshape(len(components), -1, neighbours, len(COMPONENT)).astype(np.float64)
    weight = parts[..., 0].sum(axis=2)
    shares = parts[..., 0] / np.where(weight > 0.0, weight, 1.0)[..., None]
    x, y, xx, xy, yy = (np.sum(shares * parts[..., k], axis=2) for k in range(1, len(COMPONENT)))
    dx, dy = parts[..., 1] - x[..., None], parts[..., 2] - y[..., None]
    between = (np.sum(shares * product, axis=2) for product in (dx * dx, dx * dy, dy * dy))
    seconds = [within + extra for within, extra in zip((xx, xy, yy), between, strict=True)]
    return np.stack([weight, x, y, *seconds], axis=2).astype(np.float32)


# Results of capsules by column, one row each

LEANINGS = ("border", "prior", "two_shapes", "wrinkles", "unsure_shapes")
"""Borders next to which a posterior may lie: of the model, of the prior ranges, of regions with a caveat."""

STATISTICS = tuple(statistic.name for statistic in fields(Marginal))  # of each quantity

TEXTS = ("name", "source", "sha256", "status", "reason", "engine")
"""Columns of text: source and sha256 are of the file that was read, a reason is where the status does not tell it."""


def _columns_of_engine() -> dict[str, dict[str, str]]:
    """Return the attributes of the columns that an engine fills."""
    columns = {}
    for parameter in (PARAMETERS[name] for name in REPORTED):
        about = {"units": parameter.unit, "symbol": parameter.symbol}
        for statistic in STATISTICS:
            meaning = f"{statistic} of the {parameter.meaning}"
            columns[f"{parameter.name}_{statistic}"] = {**about, "long_name": meaning}
    columns["distance"] = {"units": "1", "long_name": "standard errors to the likeliest"}
    for name in LEANINGS:
        meaning = f"share of the posterior that leans on: {name.replace('_', ' ')}"
        columns[f"leaning_{name}"] = {"units": "1", "long_name": meaning}
    for name in PREDICTED:
        meaning = f"predictive p-value of the {PARAMETERS[name].meaning}"
        columns[f"p_value_{name}"] = {"units": "1", "long_name": meaning}
    columns["reynolds_number"] = {"units": "1", "long_name": "rho U l / mu"}
    return columns


_OF_ENGINE = _columns_of_engine()
_MEASURED = {name: PARAMETERS.get(name.removesuffix("_error")) for name in NUMBERS}
_COLUMNS = {name: {"units": "1" if it is None else it.unit} for name, it in _MEASURED.items()} | _OF_ENGINE


class CapsuleRows(dict[str, NDArray[Any]]):
    """Results of n capsules by column: texts, numbers, and ``likelihood`` as a mixture of Gaussians (n, c, 6)."""

    @classmethod
    def empty(cls, names: Sequence[str], sources: Sequence[str]) -> CapsuleRows:
        """Return rows without results, to be filled."""
        count = len(names)
        texts = {name: np.full(count, "", dtype=object) for name in TEXTS}
        likelihood = np.zeros((count, COMPONENTS, len(COMPONENT)), np.float32)
        rows = cls(texts | {name: np.full(count, np.nan) for name in _COLUMNS} | {"likelihood": likelihood})
        rows.fill(slice(None), {"name": names, "source": sources})
        return rows

    @property
    def count(self) -> int:
        """Number of capsules."""
        return len(self["name"])

    def fill(self, row: int | slice, values: Mapping[str, Any]) -> None:
        """Set some columns of a row."""
        for name, value in values.items():
            self[name][row] = value

    def refuse(self, row: int, status: Status, reason: str) -> None:
        """Set status and reason of a row, and clear what an engine may have found for it under another prior."""
        none = {name: np.nan for name in _OF_ENGINE if name != "distance"}
        self.fill(row, {"status": status.name, "reason": reason, "likelihood": 0.0, **none})

    @classmethod
    def joined(cls, parts: Iterable[CapsuleRows], count: int) -> CapsuleRows:
        """Join the rows of several, one after the other, so that memory holds them once."""
        whole = cls()
        known: dict[str, str] = {}  # a million rows of one table name the same file
        first = 0
        for part in parts:
            for name, values in part.items():
                if name in TEXTS:
                    values[:] = [known.setdefault(text, text) for text in values.tolist()]
                if name not in whole:
                    whole[name] = np.empty((count, *values.shape[1:]), values.dtype)
                whole[name][first : first + part.count] = values
            first += part.count
        return whole

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> CapsuleRows:
        """Return the rows whose `arrays` these are."""
        texts = {name: arrays[name].astype(object) for name in TEXTS}
        return cls(texts | {name: arrays[name] for name in (*_COLUMNS, "likelihood")})

    @property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """The columns by name, text as numpy text."""
        return {**self, **{name: self[name].astype(np.str_) for name in TEXTS}}


# Posteriors of many capsules: one row each, with everything needed to repeat it

SUMMARISED = ("surface_shear_modulus", "capsule_radius", "capillary_number", "size_ratio")
"""Quantities in the summary of a population."""

LIMIT = ("limit_size_ratio", "limit_capillary_number")
"""Of steady shapes: coordinate and variable in the file of a population."""

_QUANTILES = {"median": 0.5, "lower_quartile": 0.25, "upper_quartile": 0.75, "lower_95": 0.025, "upper_95": 0.975}
_NEEDED = tuple(
    f"{name}_{end}"
    for name in ("surface_shear_modulus", "capsule_radius")
    for end in ("median", "lower_68", "upper_68", "lower_95", "upper_95")
)
_LINES = 10_000  # of a table formatted at once
_USABLE = (Status.DONE, Status.LEANS_ON_TWO_SHAPES, Status.LEANS_ON_WRINKLES, Status.LEANS_ON_UNSURE_SHAPES)


@dataclass(frozen=True, eq=False, repr=False)
class Population(Readable):
    """Posteriors of many capsules, one row each, status included.

    Parameters
    ----------
    dataset : xarray.Dataset
        Along ``capsule``: ``name``, ``source``, ``sha256``, ``status``, ``reason``, ``engine``; measured numbers; the
        `STATISTICS` of each quantity as ``surface_shear_modulus_median`` [SI]; the shares of the posterior next to each
        border; the ``likelihood`` of (log(G_s / mu), log(a / l)) as a mixture of Gaussians. Along ``limit_size_ratio``:
        ``limit_capillary_number``, above which the model has no steady shape. Attributes: model and its fingerprint,
        experiment, prior, seed, version, agreement of the engines.

    Examples
    --------
    ``Population.read("run_42.nc").table()[["name", "surface_shear_modulus_median"]]``
    """

    dataset: xr.Dataset

    @classmethod
    def of(
        cls, rows: CapsuleRows, attributes: dict[str, Any], limit: tuple[Floats, Floats] | None = None
    ) -> Population:
        """Gather rows, the attributes they share, and the highest Ca of steady shapes at some a/l : (k,), (k,)."""
        import xarray as xr

        along = ("capsule",)
        variables: dict[str, Any] = {name: (along, rows[name]) for name in TEXTS}
        variables |= {name: (along, rows[name], about) for name, about in _COLUMNS.items()}
        about = {"units": "1", "long_name": "likelihood of (log(G_s / mu), log(a / l)), a mixture of Gaussians"}
        variables["likelihood"] = (("capsule", "component", "number"), rows["likelihood"], about)
        coordinates: dict[str, Any] = {"number": list(COMPONENT)}
        if limit is not None:
            about = {"units": "1", "long_name": "highest capillary number of steady shapes"}
            variables[LIMIT[1]], coordinates[LIMIT[0]] = (LIMIT[0], limit[1], about), limit[0]
        return cls(xr.Dataset(variables, coordinates, attributes))

    @classmethod
    def of_dataset(cls, dataset: xr.Dataset, where: str = "population") -> Population:
        """Return the population that a dataset holds.

        Parameters
        ----------
        dataset : xarray.Dataset
            Along ``capsule``: at least ``status`` and the summaries of G_s and a.
        where : str
            File or name for the message.

        Raises
        ------
        InputError
            Naming what is missing.
        """
        if "capsule" not in dataset.sizes:
            got = f"one with {', '.join(map(str, dataset.sizes))}"
            raise InputError(where, "", "a table with the dimension capsule", got)
        for name in ("status", *_NEEDED):
            if name not in dataset.variables:
                raise InputError(where, name, "a variable of that name", "none")
        unknown = sorted(set(map(str, dataset["status"].values)) - set(Status.__members__))
        if unknown:
            raise InputError(where, "status", "names of capsbayes.Status", ", ".join(unknown))
        return cls(dataset)

    @classmethod
    def read(cls, path: str | Path) -> Population:
        """Read what `write` wrote.

        Raises
        ------
        InputError
            If it is not such a file.
        """
        path = Path(path)
        if not path.exists():
            raise InputError(str(path), "", "the file of a population", "nothing there")
        dataset = opened(path)
        if "likelihood" not in dataset or "status" not in dataset:
            raise InputError(str(path), "", "the file of a population, as `capsbayes batch` writes it", "another")
        return cls(dataset)

    def write(self, path: str | Path) -> Path:
        """Write one NetCDF file, or a CSV table with units in its header: whole or not at all."""
        path = Path(path)
        return write_lines(path, self.lines()) if path.suffix == ".csv" else write_dataset(path, self.dataset)

    def table(self) -> pd.DataFrame:
        """Return a table with one row for each capsule, in SI, without the likelihoods."""
        along = [name for name, variable in self.dataset.data_vars.items() if variable.dims == ("capsule",)]
        return self.dataset[along].to_dataframe().reset_index(drop=True)

    def described(self) -> dict[str, str]:
        """Return the numbers of capsules by status, the medians over those that can be used, and the model."""
        found = {"capsules": str(len(self))} | {status.name: str(count) for status, count in self.counts.items()}
        for name in ("surface_shear_modulus", "capsule_radius"):
            if self.usable.any():
                middle = float(np.median(self[f"{name}_median"][self.usable]))
                found[f"median {name}"] = Quantity(middle).shown(name)
        return found | {"model": str(self.attributes.get("model", ""))}

    def lines(self) -> Iterator[str]:
        """Yield the lines of a CSV table, numbers to eight digits; row by row, five times as fast as pandas."""
        along = [str(name) for name, variable in self.dataset.data_vars.items() if variable.dims == ("capsule",)]
        texts = [name for name in along if self.dataset[name].dtype.kind not in "fiu"]
        numbers = [name for name in along if name not in texts]
        columns = {name: self[name] for name in along}
        units = {name: self.dataset[name].attrs.get("units", "1") for name in numbers}
        heads = [name if unit in ("1", "-") else f"{name} [{unit}]" for name, unit in units.items()]
        yield ",".join([*texts, *map(_quoted, heads)]) + "\n"
        line = "," + ",".join(["%.8g"] * len(numbers)) + "\n"
        for first in range(0, len(self), _LINES):
            rows = slice(first, first + _LINES)
            words = zip(*(map(_quoted, columns[name][rows].tolist()) for name in texts), strict=True)
            values = np.stack([columns[name][rows] for name in numbers], axis=1).tolist()
            for begin, row in zip(words, values, strict=True):
                yield ",".join(begin) + (line % tuple(row)).replace("nan", "")

    def __len__(self) -> int:
        return int(self.dataset.sizes["capsule"])

    def __getitem__(self, name: str) -> NDArray[Any]:
        return np.asarray(self.dataset[name].values)

    @property
    def counts(self) -> dict[Status, int]:
        """Number of capsules by status, the most frequent first."""
        return {Status[name]: count for name, count in Counter(self["status"].tolist()).most_common()}

    @property
    def usable(self) -> Booleans:
        """True for capsules whose intervals can be used, which no border cuts off : (n,) array."""
        return np.isin(self["status"], [status.name for status in _USABLE])

    def worst_first(self) -> Integers:
        """Return the order of the capsules: those that cannot be used, then by falling relative width of G_s : (n,)."""
        return np.lexsort((-np.nan_to_num(self._log_width(), nan=np.inf), self.usable))

    def typical_width(self) -> float:
        """Return the median over the usable capsules of half of ln(upper / lower) of the 95 % interval of G_s."""
        widths = 0.5 * self._log_width()[self.usable]
        known = widths[np.isfinite(widths)]
        return float(np.median(known)) if known.size else float("nan")

    def _log_width(self) -> Floats:
        """Logarithm of the ratio of the ends of the 95 % interval of G_s : (n,) array."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.log(self["surface_shear_modulus_upper_95"] / self["surface_shear_modulus_lower_95"]))

    def summary(self) -> pd.DataFrame:
        """Return the distribution of the medians of the usable capsules, SI, one row a quantity.

        Columns: ``unit``, ``median``, quartiles and 95 % range of the medians, and ``error``, the median half width of
        the 68 % interval of one capsule. Without rows if no capsule can be used.
        """
        import pandas as pd

        rows = {}
        for name in SUMMARISED:
            medians = self[f"{name}_median"][self.usable] if f"{name}_median" in self.dataset else np.empty(0)
            if not np.isfinite(medians).any():
                continue
            quantiles = map(float, np.nanquantile(medians, list(_QUANTILES.values())))
            half = 0.5 * (self[f"{name}_upper_68"] - self[f"{name}_lower_68"])[self.usable]
            rows[name] = {
                "unit": PARAMETERS[name].unit,
                **dict(zip(_QUANTILES, quantiles, strict=True)),
                "error": float(np.nanmedian(half)),
            }
        return pd.DataFrame.from_dict(rows, orient="index")

    @property
    def limit(self) -> tuple[Floats, Floats] | None:
        """Highest Ca for which the model has a steady shape : a/l (k,), Ca (k,); None if it is not stored."""
        if any(name not in self.dataset.variables for name in LIMIT):
            return None
        size, highest = (self[name] for name in LIMIT)
        return size, highest

    @property
    def attributes(self) -> dict[str, Any]:
        """Attributes of the run, JSON values read."""
        return read_attributes(self.dataset.attrs)


@functools.lru_cache(maxsize=1024)  # most texts are those of the row before
def _quoted(text: str) -> str:
    """Return a text as a cell of a CSV table."""
    text = safe_cell(text)
    return '"' + text.replace('"', '""') + '"' if any(mark in text for mark in ',"\n\r') else text
