"""What is published beside the wheel states the same version and the same requirements."""

import re
import tomllib
from pathlib import Path

import yaml
from packaging.requirements import Requirement
from packaging.version import Version

import capsbayes

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
CONDA = {"matplotlib": "matplotlib-base", "opencv-python-headless": "py-opencv"}
LOCKED = dict(re.findall(r"^([a-z0-9-]+)==([^ ;]+)", (ROOT / "requirements.lock").read_text(), re.MULTILINE))


def needed(*extras):
    """Requirements of the package, and those of some extras that are not extras again."""
    lines = [*PROJECT["dependencies"], *(line for extra in extras for line in PROJECT["optional-dependencies"][extra])]
    return [one for one in map(Requirement, lines) if one.name != "capsbayes"]


def test_the_version_is_one():
    recipe = yaml.safe_load((ROOT / "conda" / "recipe.yaml").read_text())
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert recipe["context"]["version"] == str(citation["version"]) == capsbayes.__version__
    assert f"## {capsbayes.__version__}\n" in (ROOT / "CHANGELOG.md").read_text()


def test_the_recipe_of_conda_needs_what_the_wheel_needs():
    recipe = yaml.safe_load((ROOT / "conda" / "recipe.yaml").read_text())
    stated = {line.split()[0]: line.partition(" ")[2] for line in recipe["requirements"]["run"]}
    assert stated.pop("python") == PROJECT["requires-python"]
    due = {CONDA.get(one.name, one.name): one.specifier for one in needed()}
    assert stated.keys() == due.keys()
    for name, limits in due.items():
        parts = set(stated[name].split(","))
        lowest = {f">={part.version.removesuffix('.84')}" for part in limits if part.operator == ">="}  # of the wheel
        assert parts & lowest
        assert {str(part) for part in limits if part.operator == "<"} <= parts


def test_the_lock_holds_versions_that_are_allowed():
    for one in needed("rtdc", "cluster", "xlsx", "test"):
        assert Version(LOCKED[one.name]) in one.specifier, one.name


def test_the_bench_brings_what_the_files_that_it_takes_need():
    pulled_in = {extra for line in PROJECT["optional-dependencies"]["app"] for extra in Requirement(line).extras}
    assert pulled_in == {"rtdc"}


def test_the_lock_names_no_place_and_a_hash_of_each_file():
    text = (ROOT / "requirements.lock").read_text()
    assert "://" not in text
    assert len(re.findall(r"^[a-z0-9-]+==[^\\]*\\\n    --hash=sha256:", text, re.MULTILINE)) == len(
        re.findall(r"^[a-z0-9-]+==", text, re.MULTILINE)
    )
