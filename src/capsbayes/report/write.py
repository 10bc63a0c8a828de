"""Any result as a page: one self-contained HTML file, written whole or not at all."""

from __future__ import annotations

from pathlib import Path

import h5netcdf
import xarray as xr

from capsbayes.arguments import checked
from capsbayes.database import Database
from capsbayes.diagnosis import Study
from capsbayes.errors import InputError
from capsbayes.files.input_file import parsing
from capsbayes.files.output_file import write_file
from capsbayes.infer import Posterior
from capsbayes.infer.hierarchy import ModulusSpread
from capsbayes.infer.population import Population
from capsbayes.measurement_sets import opened as opened_dataset
from capsbayes.report.database import database_page
from capsbayes.report.population_figures import MOST_ROWS, population_page
from capsbayes.report.posterior_figures import posterior_page
from capsbayes.report.study_figures import study_page

Result = Posterior | Population | Study | Database

POSTERIOR = "posterior.nc"
_KINDS = "a posterior, a population or a database"


@checked
def write_report(
    result: Result | xr.Dataset,
    out: str | Path,
    *,
    picture: str | Path | None = None,
    spread: ModulusSpread | None = None,
    rows: int = MOST_ROWS,
    source: str = "",
) -> Path:
    """Write a result as one HTML file that holds its pictures and needs no network.

    Parameters
    ----------
    result : Posterior, Population, Study, Database or Dataset
        A dataset is one of a population, with one row a capsule.
    out : path
        The file.
    picture : path, optional
        Of a posterior: picture of the capsule, to draw the predicted outline over.
    spread : ModulusSpread, optional
        Of a population: G_s from capsule to capsule with the errors removed.
    rows : int
        Of a population: at most so many capsules in the table.
    source : str
        File or name of the result, named on the page.

    Raises
    ------
    InputError
        If the result is of no kind that has a page, or the file cannot be written.

    Examples
    --------
    ``write_report(identify(measurement, model, experiment, seed=1), "capsule.html")``
    """
    if isinstance(result, xr.Dataset):
        result = Population.of_dataset(result, source or "population")
    match result:
        case Posterior():
            text = posterior_page(result, capsule=picture, folder=Path(source).parent if source else None)
        case Database():
            text = database_page(result, source=source)
        case Study():
            text = study_page(result)
        case Population():
            text = population_page(result, spread=spread, rows=rows, source=source)
    return write_file(out, text)


def opened(result: str | Path) -> tuple[Result, str]:
    """Open a file, a folder of ``capsbayes identify``, or a database by its name; return the result and its source."""
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


def _read(path: Path) -> Result:
    """Read a file as what its dimensions and groups say it is."""
    with parsing(str(path), f"a NetCDF file of {_KINDS}"), h5netcdf.File(path, "r") as file:
        groups, dimensions = set(file.groups), set(file.dimensions)
    if "posterior" in groups:
        return Posterior.read(path)
    if "case" in dimensions:
        return Database.read(path)
    if "capsule" in dimensions:
        return Population.of_dataset(opened_dataset(path), str(path))
    raise InputError(str(path), "", f"a NetCDF file of {_KINDS}", f"one with {', '.join(dimensions) or 'nothing'}")
