"""Every example in a docstring runs and prints what it says."""

from __future__ import annotations

import doctest
import importlib
import pkgutil

import pytest

import capsbayes
import evidence

MODULES = sorted(
    module.name
    for package in (capsbayes, evidence)
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
    if not module.name.startswith("evidence.benchmarks.")
)


@pytest.mark.parametrize("name", MODULES)
def test_examples_of(name):
    if name.startswith("capsbayes.app."):
        pytest.importorskip("nicegui", reason="the extra app is not installed")
    assert doctest.testmod(importlib.import_module(name)).failed == 0
