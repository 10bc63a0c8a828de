"""The buttons over all capsules in a real browser, and a server that is killed after a capsule was saved."""

import shlex
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from browser import needs_browser
from processes import members, wait_until
from sessions import EXPERIMENT, drawn_session

pytest.importorskip("nicegui", reason="the extra app is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from walk import FIELDS, filled, opened, ready, served, sync

from capsbayes.surrogate import Surrogate

pytestmark = [needs_browser, pytest.mark.slow]

SCRIPT = Path(sys.executable).with_name("capsbayes")
FILM = Path(__file__).parents[2] / "examples" / "pictures" / "film.avi"


def test_a_capsule_of_a_film_is_identified_as_its_commands_say_and_leads_to_the_next_flow_rate_and_the_population(
    browser, tmp_path
):
    with served(tmp_path / "bench") as (_, address):
        page, said = opened(browser, address)
        flow, together = (page.get_by_role("button", name=name) for name in ("At which flow rate", "Look at all"))
        sync.expect(flow).to_be_disabled()
        page.locator("input[type=file][multiple]").set_input_files(FILM)
        filled(page, FIELDS | {"Frame rate of a film": ("400", "")})
        ready(page.get_by_role("button", name="Measure them all")).click()
        ready(page.get_by_label("Identify capsule-1 of film.avi")).click()
        page.get_by_text("capsule-1 of film").first.wait_for()
        ready(page.get_by_role("button", name="Identify", exact=True).first).click()
        ready(page.get_by_role("button", name="Save the report")).click()
        page.get_by_role("link", name="Open the report").wait_for()
        change, identify, report = page.locator(".bench-columns .bench-commands").inner_text().splitlines()
        folder = Path(shlex.split(change)[1])
        assert folder == tmp_path / "bench" / "film" / "capsule-1"
        saved = {path: path.read_bytes() for path in folder.iterdir() if not path.name.startswith(".")}
        assert {"measurement.toml", "posterior.nc", "report.html"} <= {path.name for path in saved}
        for line in (identify, report):
            assert subprocess.run([SCRIPT, *shlex.split(line)[1:]], cwd=folder, check=False).returncode == 0
        assert {path: path.read_bytes() for path in saved} == saved
        ready(flow).click()
        page.get_by_text("--like film/capsule-1/measurement.toml").wait_for()
        assert page.get_by_text("The expected capsule reaches the limit of existence").is_visible()
        ready(together).click()
        link = page.get_by_role("link", name="Open population.html")
        link.wait_for()
        report = page.context.request.get(link.evaluate("link => link.href"))
        assert report.status == 200
        diagnose = page.get_by_role("button", name="What does the model miss? from 10 capsules on")
        sync.expect(diagnose).to_be_disabled()
        assert said == []
        page.close()


def test_twelve_capsules_are_diagnosed_behind_a_bar(browser, tmp_path):
    bench = tmp_path / "bench"
    session, _ = drawn_session(Surrogate.open("square-neo-hookean"), 12, seed=7)
    for number, measurement in enumerate(session.measurements):
        folder = bench / f"capsule-{number}"
        folder.mkdir(parents=True)
        EXPERIMENT.write(folder / "experiment.toml")
        replace(measurement, experiment_file=folder / "experiment.toml").write(folder / "measurement.toml")
    with served(bench) as (_, address):
        page, said = opened(browser, address)
        page.get_by_text("12 capsules in").wait_for()
        ready(page.get_by_role("button", name="What does the model miss?", exact=True)).click()
        link = page.get_by_role("link", name="Open study.html")
        link.wait_for()
        study = page.context.request.get(link.evaluate("link => link.href"))
        assert (study.status, "12 capsules" in study.text()) == (200, True)
        assert said == []
        page.close()


@pytest.mark.parametrize("seconds", [0.0, 0.3, 2.0])
def test_a_server_that_is_killed_while_it_saves_again_loses_nothing_that_was_saved(browser, picture, tmp_path, seconds):
    bench = tmp_path / "bench"
    with served(bench) as (server, address):
        page, _ = opened(browser, address)
        page.locator("input[type=file]").first.set_input_files(picture)
        filled(page, FIELDS)
        ready(page.get_by_role("button", name="Identify", exact=True).first).click()
        save = ready(page.get_by_role("button", name="Save the report"))
        save.click()
        page.get_by_role("link", name="Open the report").wait_for()
        saved = {path: path.read_bytes() for path in (bench / "capsule").iterdir() if not path.name.startswith(".")}
        assert {"report.html", "posterior.nc", "measurement.toml"} <= {path.name for path in saved}
        ready(save).click()
        page.wait_for_timeout(1e3 * seconds)
        server.send_signal(signal.SIGKILL)
        server.wait()
        wait_until(lambda: not members(server.pid))  # what computes ends with the server
        page.close()
    assert {path: path.read_bytes() for path in saved} == saved
    with served(bench) as (_, address):
        page, _ = opened(browser, address)
        page.get_by_text("1 capsule in").wait_for()
        page.close()
