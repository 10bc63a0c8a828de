"""The package is light to import, and its public names are where they should be."""

from __future__ import annotations

import subprocess
import sys

import pytest

import capsbayes

HEAVY = {"arviz", "cv2", "dask", "distributed", "emcee", "matplotlib", "numba", "scipy", "xarray"}


def modules_after(statement):
    code = f"import sys; {statement}; print(*{{name.split('.')[0] for name in sys.modules}})"
    return set(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split())


def test_importing_the_package_or_the_command_line_loads_nothing_heavy():
    assert not modules_after("import capsbayes") & HEAVY
    assert not modules_after("import capsbayes.cli") & HEAVY


def test_importing_inference_loads_no_cluster_no_figures_no_pictures():
    assert not modules_after("import capsbayes.infer") & {"cv2", "dask", "distributed", "matplotlib"}


@pytest.mark.parametrize("name", capsbayes.__all__)
def test_every_public_name_can_be_had(name):
    assert getattr(capsbayes, name) is not None
    assert name in dir(capsbayes)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'capsbayes' has no attribute 'capsule'"):
        _ = capsbayes.capsule
