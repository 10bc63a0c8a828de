"""Groups of datasets as an `arviz.InferenceData`, in SI or in display units."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from capsbayes.parameters import PARAMETERS

if TYPE_CHECKING:
    import xarray as xr


def inference_data(groups: Mapping[str, xr.Dataset]) -> Any:
    """Return the groups as an `arviz.InferenceData`."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # of ArviZ itself, once a day
        import arviz  # a second to import
    return arviz.InferenceData(**groups, warn_on_custom_groups=False)


def shown(groups: Mapping[str, xr.Dataset]) -> dict[str, xr.Dataset]:
    """Return groups with all quantities in display units, named as ``G_s [mN/m]``."""
    return {group: _shown(dataset) if group != "log_likelihood" else dataset for group, dataset in groups.items()}


def _shown(dataset: xr.Dataset) -> xr.Dataset:
    made = {}
    for name, variable in dataset.data_vars.items():
        parameter = PARAMETERS.get(str(name).removesuffix("_error"))
        if parameter is None:
            made[str(name)] = variable
            continue
        metres = variable.attrs.get("units") == "m" and parameter.unit == "l"
        scale, unit = (1e6, "µm") if metres else (parameter.scale, parameter.shown_unit)
        error = "error of " if str(name).endswith("_error") else ""
        label = f"{error}{parameter.symbol} [{unit}]" if unit not in ("", "-") else f"{error}{parameter.symbol}"
        made[label] = (scale * variable).assign_attrs({**variable.attrs, "units": unit})
    return dataset.drop_vars(list(dataset.data_vars)).assign(made)
