"""The commands ``identify``, ``report`` and ``app``."""

import importlib.util
import json
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command_line import written
from results import population

from capsbayes import Posterior, Surrogate
from capsbayes.prediction import NUMBERS
from capsbayes.resimulation import ShapeSource, SimulatedShapes

EXAMPLE = Path(__file__).parents[2] / "examples" / "ovalbumin" / "capsule.toml"
RESULTS = {"posterior.nc", "summary.json", "corner.png", "outline.png"}
QUICK = ("capsule.toml", "--database", "manufactured.nc", "--engine", "quadrature")


@pytest.fixture
def identify(here, capsbayes):
    """A function that identifies; exit status and what is printed in one line."""

    def identify(*words):
        status, out, err = capsbayes("identify", *words)
        return status, " ".join((out + err).split())

    return identify


def test_one_capsule_end_to_end(here, identify):
    size = ("--walkers", 32, "--steps", 600, "--ensembles", 5)
    status, printed = identify(*QUICK[:-2], *size, "--out", "result")
    assert status == 0, printed
    out = here / "result"
    assert len(Posterior.read(out / "posterior.nc").ensemble) == 5 * 32
    for words in ("G_s [mN/m]", "a [µm]", "U [mm/s]", "68 %", "95 %", "quadrature", "published", "The engines agree"):
        assert words in printed
    for words in ("share of the variance of ln G_s", "Status: The computation succeeded (13 of 13 checks)"):
        assert words in printed
    assert written(out) == RESULTS
    summary = json.loads((out / "summary.json").read_text())
    ca = summary["quantities"]["capillary_number"]
    assert ca["lower_68"] < 0.06 < ca["upper_68"]
    assert summary["deterministic"]["size_ratio"] == pytest.approx(0.9, abs=0.01)
    assert set(summary["inputs"]["files"]) == {"capsule.toml", "channel.toml"}
    for name in ("corner.png", "outline.png"):
        assert (out / name).read_bytes().startswith(b"\x89PNG")


def test_an_answer_is_checked_by_the_simulator(here, identify, monkeypatch):
    """The model itself in the place of the simulator: nothing moves."""
    model = Surrogate.open("manufactured.nc")

    class Agreeing:
        refinement = 12

        def shapes(self, theta, near, folder):
            assert folder == Path("result", "shapes")
            seen = model(theta, outline=True)
            return SimulatedShapes(theta, np.column_stack([getattr(seen, name) for name in NUMBERS]), seen.outline)

    monkeypatch.setattr(ShapeSource, "of", lambda model: Agreeing())
    status, printed = identify(*QUICK, "--resimulate", 6, "--out", "result")
    assert status == 0, printed
    assert "Checked by the simulator: 6 shapes at refinement 12; the model's error moved G_s by" in printed
    assert written(here / "result") == RESULTS | {"simulator.png"}
    summary = json.loads((here / "result" / "summary.json").read_text())
    assert abs(summary["resimulation"]["surface_shear_modulus_moved"]) < 0.02
    assert summary["resimulation"]["simulated_minus_predicted"]["outline"]["largest"] == 0.0


def test_the_papers_capsule_with_the_database_that_comes_with_the_library(identify):
    """The paper: Ca = 0.082, a/l = 0.96, v_o/U = 1.29 from L_z = 2.14 l and L_a = 1.81 l."""
    status, printed = identify(EXAMPLE, "--engine", "quadrature", "--seed", "7", "--json")
    summary = json.loads(printed)
    assert (status, summary["engine"], summary["seed"], summary["status"]) == (0, "quadrature", 7, "DONE")
    assert summary["agreement"] is None
    for name, value in (("capillary_number", 0.082), ("size_ratio", 0.96), ("velocity_ratio", 1.29)):
        interval = summary["quantities"][name]
        assert interval["lower_68"] < value < interval["upper_68"], name
        assert summary["deterministic"][name] == pytest.approx(value, rel=0.05), name
    assert sum(summary["variance_of_log_surface_shear_modulus"].values()) == pytest.approx(1.0)
    low, high = summary["surface_shear_modulus_over_laws"]  # one law is one of several
    assert low < summary["quantities"]["surface_shear_modulus"]["median"] < high


def test_a_posterior_on_the_border_ends_with_status_one(here, identify):
    text = (here / "capsule.toml").read_text()
    (here / "capsule.toml").write_text("\n".join(line for line in text.splitlines() if "axial_length" not in line))
    status, printed = identify(*QUICK)
    assert status == 1
    assert "leans on the border" in printed
    assert "next to the border of the database" in printed


def test_an_error_while_writing_leaves_nothing_behind(here, identify, monkeypatch):
    from capsbayes.report import posterior_figures

    def broken(posterior, names):
        raise RuntimeError("no ink")

    monkeypatch.setattr(posterior_figures, "corner_plot", broken)
    with pytest.raises(RuntimeError, match="no ink"):
        identify(*QUICK, "--out", "result")
    assert not (here / "result").exists()


@pytest.mark.slow
def test_a_picture_is_measured_and_identified_in_one_go(here, identify):
    options = ("--experiment", "experiment.toml", "--velocity", "6.20 +/- 0.06 mm/s", "--background", "empty.png")
    status, printed = identify("picture.png", *options, "--engine", "quadrature", "--out", "result")
    assert status == 0, printed
    measured = {"measurement.toml", "measurement.outline.csv", "outline.csv", "silhouette.csv", "overlay.png"}
    assert written(here / "result") == RESULTS | measured
    summary = json.loads((here / "result" / "summary.json").read_text())
    ca = summary["quantities"]["capillary_number"]
    assert ca["lower_95"] < 0.08 < ca["upper_95"]
    assert summary["quantities"]["size_ratio"]["sd"] < 0.003
    assert {"outline", "axial_length"} < set(summary["variance_of_log_surface_shear_modulus"])
    assert "(silhouettes)" in printed
    again = json.loads(identify("result/measurement.toml", "--engine", "quadrature", "--json")[1])
    assert again["quantities"]["size_ratio"] == pytest.approx(summary["quantities"]["size_ratio"])


def test_what_is_known_of_the_membrane_is_stated_in_the_file_and_changed_by_options(here, identify):
    with (here / "capsule.toml").open("a") as file:
        file.write('[membrane]\nlaw = "Skalak"\nhardening = 0.5\npre_inflation = 0.03\nbending = 2e-4\n')

    def stated(*options):
        name = json.loads(identify("capsule.toml", "--engine", "quadrature", "--json", *options)[1])["model"]["name"]
        return set(name.split(" at ")[1].split(", "))

    always = {"pre_inflation = 0.03", "bending = 0.0002"}
    assert {"strain_hardening = 1", "area_dilation_modulus = 2", *always} == stated()
    other = stated("--membrane", "neo-hookean", "--membrane", "hardening=unknown")
    assert {"strain_hardening = 0", "area_dilation_modulus = 3", *always} == other


def test_the_folder_of_identify_becomes_a_page(here, capsbayes):
    for place in (here / "result", here / "new"):
        place.mkdir()
    (here / "posterior.nc").rename(here / "result" / "posterior.nc")
    status, printed, _ = capsbayes("report", "result", "--out", "new/capsule.html")
    assert (status, "capsule.html, 0." in printed) == (0, True)
    assert "Capsule capsule.toml" in (here / "new" / "capsule.html").read_text(encoding="utf-8")
    assert written(here / "new") == {"capsule.html"}


def test_a_population_becomes_a_page_of_at_most_so_many_rows(here, capsbayes):
    population().write(here / "run.nc")
    assert capsbayes("report", "run.nc", "--rows", 3)[0] == 0
    assert "The 3 worst of 8 are shown; the others are in run.nc." in (here / "report.html").read_text(encoding="utf-8")


def test_without_the_extra_one_line_says_how_to_install_the_bench(monkeypatch, mistaken, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert 'pip install "capsbayes[app]"' in mistaken("app")
    assert list(tmp_path.iterdir()) == []


def test_a_port_that_is_taken_is_one_line(mistaken, tmp_path):
    pytest.importorskip("nicegui", reason="the extra app is not installed")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        line = mistaken("app", "--folder", tmp_path / "bench", "--port", port)
    assert f"--port: expected a port that is free, got {port}" in line


def test_neither_the_package_nor_the_command_line_nor_identification_imports_what_serves_the_page():
    code = (
        "import sys, capsbayes, capsbayes.cli, capsbayes.infer.identify\n"
        "sys.exit(any(name in sys.modules for name in ('nicegui', 'fastapi', 'uvicorn', 'starlette')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
