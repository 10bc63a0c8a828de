"""Any result as a page: one self-contained HTML file, written whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from capsbayes.database import Database
from capsbayes.diagnosis import Study
from capsbayes.errors import InputError
from capsbayes.infer import Posterior
from capsbayes.output_file import replaced
from capsbayes.show.database_page import database_page
from capsbayes.show.population_page import MOST_ROWS, population_page
from capsbayes.show.posterior_page import posterior_page
from capsbayes.show.spread import Spread
from capsbayes.show.study_page import study_page

__all__ = ["opened", "report_page", "write_report"]

POSTERIOR = "posterior.nc"
_KINDS = "a posterior, a population or a database"


def write_report(
    result: Any,
    out: str | Path,
    *,
    picture: str | Path | None = None,
    spread: Spread | None = None,
    rows: int = MOST_ROWS,
    source: str = "",
) -> Path:
    """Write a result as one HTML file that holds its pictures and needs no network.

    Parameters
    ----------
    result : Posterior, Database, Study or Dataset
        Of a population, the dataset with one row a capsule, or an object that holds it as ``dataset``.
    out : path
        The file.
    picture : path, optional
        Of a posterior: picture of the capsule, to draw the predicted outline over.
    spread : Spread, optional
        Of a population: G_s from capsule to capsule with the errors removed.
    rows : int
        Of a population: at most so many capsules in the table.
    source : str
        File or name of the result, said on the page.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If the result is of no kind that has a page, or the file cannot be written.

    Examples
    --------
    ``write_report(identify(measurement, model, experiment, seed=1), "capsule.html")``
    """
    text = report_page(result, picture=picture, spread=spread, rows=rows, source=source)
    path = Path(out)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replaced(path, text)
    except OSError as error:
        raise InputError("report", str(out), "a file that can be written", str(error.strerror)) from None
    return path


def report_page(
    result: Any,
    *,
    picture: str | Path | None = None,
    spread: Spread | None = None,
    rows: int = MOST_ROWS,
    source: str = "",
) -> str:
    """The page of a result as text; see `write_report`."""
    if isinstance(result, Posterior):
        return posterior_page(result, capsule=picture, folder=Path(source).parent if source else None)
    if isinstance(result, Database):
        return database_page(result, source=source)
    if isinstance(result, Study):
        return study_page(result)
    population = getattr(result, "dataset", result)
    if "capsule" in getattr(population, "sizes", ()):
        return population_page(population, spread=spread, rows=rows, source=source)
    raise InputError("report", "result", f"{_KINDS}, or a study", type(result).__name__)


def opened(result: str | Path) -> tuple[Any, str]:
    """Open a file, a folder of ``capsbayes identify``, or a database by its name.

    Parameters
    ----------
    result : path or str

    Returns
    -------
    result : Posterior, Database or Dataset
    source : str
        Its file or name.

    Raises
    ------
    InputError
        If it is none of them.
    DatabaseError
        If a database is damaged.
    """
    path = Path(result)
    if path.is_dir():
        path = path / POSTERIOR
        if not path.is_file():
            raise InputError(str(result), "", f"a folder of capsbayes identify, with {POSTERIOR}", "another folder")
    if not path.is_file():
        if str(result) in Database.shipped():
            return Database.open(str(result)), str(result)
        shipped = ", ".join(Database.shipped())
        raise InputError(str(result), "", f"the file of a result, or one of the databases {shipped}", "nothing there")
    return _read(path), str(path)


def _read(path: Path) -> Any:
    """Read a file as what its dimensions and groups say it is."""
    import h5netcdf
    import xarray as xr

    try:
        with h5netcdf.File(path, "r") as file:
            groups, dimensions = set(file.groups), set(file.dimensions)
    except OSError:
        raise InputError(str(path), "", f"a NetCDF file of {_KINDS}", "a file that cannot be read as one") from None
    if "posterior" in groups:
        return Posterior.read(path)
    if "case" in dimensions:
        return Database.read(path)
    if "capsule" in dimensions:
        with xr.open_dataset(path, engine="h5netcdf") as file:
            return file.load()
    raise InputError(str(path), "", f"a NetCDF file of {_KINDS}", f"one with {', '.join(dimensions) or 'nothing'}")
