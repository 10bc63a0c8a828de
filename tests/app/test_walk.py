"""The page in a real browser: from a picture to the saved report, by the mouse and by the keyboard alone, and on.

With ``CAPSBAYES_PICTURES=docs/pictures`` in the environment the first test renews the pictures of ``docs/app.md``.
"""

import base64
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import pytest
from browser import needs_browser
from drawn import dirty, drawn, shapes
from processes import members, wait_until
from sessions import EXPERIMENT, drawn_session

from capsbayes.infer import Posterior
from capsbayes.status import Status
from capsbayes.surrogate import Surrogate

pytest.importorskip("nicegui", reason="the extra app is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from walk import FIELDS, WAIT, chromium, dragged, filled, opened, ready, served, sync, with_example

pytestmark = [needs_browser, pytest.mark.slow]

CA, SIZE, VISCOSITY, VELOCITY = 0.08, 1.05, 0.85, 6.2e-3
EXAMPLES = Path(__file__).parents[2] / "examples" / "pictures"
SCRIPT = Path(sys.executable).with_name("capsbayes")
LARGEST, WIDEST, QUALITY = 200_000, 1000, (cv2.IMWRITE_JPEG_QUALITY, 75)  # bytes and px of a picture of the docs


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Folder of a bench that is served, and its address."""
    folder = tmp_path_factory.mktemp("bench") / "capsules"
    with served(folder) as (_, address):
        yield folder, address


@pytest.fixture(scope="module")
def browser():
    with chromium() as opened:
        yield opened


@pytest.fixture
def picture(tmp_path):
    path = tmp_path / "capsule.png"
    cv2.imwrite(str(path), drawn(CA, SIZE, half_width=55.0).picture)
    return path


def test_from_a_picture_to_the_saved_report(bench, browser, picture, tmp_path):
    folder, address = bench
    page, said = opened(browser, address)
    page.locator("input[type=file]").first.set_input_files(picture)
    page.locator(".bench-overlay .edge").wait_for()
    assert page.get_by_role("button", name="Identify").is_disabled()
    kept(page, "bench-picture", tmp_path, ".bench-columns > div >> nth=0")
    filled(page, FIELDS)
    ready(page.get_by_role("button", name="Identify")).click()
    page.locator(".bench-headline").first.wait_for()
    page.locator(".bench-overlay .predicted").wait_for()
    page.locator(".bench-corner img").wait_for()
    assert page.evaluate("document.documentElement.scrollWidth") == 1400
    kept(page, "bench-wide", tmp_path, ".bench-columns")  # before the place of the files is shown
    page.set_viewport_size({"width": 1400, "height": 1180})
    page.evaluate("window.scrollTo(0, 0)")
    kept(page, "bench-top", tmp_path)
    ready(page.get_by_role("button", name="Save the report")).click()
    link = page.get_by_role("link", name="Open the report")
    link.wait_for()
    page.set_viewport_size({"width": 390, "height": 900})
    page.locator(".bench-headline").first.scroll_into_view_if_needed()
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    kept(page, "bench-phone", tmp_path)
    assert said == []
    report = page.context.request.get(link.evaluate("link => link.href"))
    assert "The computation succeeded" in report.text()
    found = Posterior.read(folder / "capsule" / "posterior.nc").marginals["surface_shear_modulus"]
    assert found.lower_95 < true_modulus() < found.upper_95
    page.close()


def test_the_example_leads_to_the_saved_report_by_the_keyboard_alone(bench, browser):
    page, said = opened(browser, bench[1])
    tabbed(page, page.get_by_role("button", name="Try the example"))
    page.keyboard.press("Enter")
    page.get_by_text("The capsule was measured").wait_for()
    help_of = page.get_by_role("button", name="What is this: Half width of the channel")
    tabbed(page, help_of)
    page.keyboard.press("Enter")
    page.get_by_text("25 µm in a channel that is 50 µm wide").wait_for()
    page.keyboard.press("Escape")
    tabbed(page, ready(page.get_by_role("button", name="Identify", exact=True).first))
    page.keyboard.press("Enter")
    page.locator(".bench-headline").first.wait_for()
    sync.expect(page.locator(".bench-densities figure")).to_have_count(2)
    assert "50.1 mN/m" in page.locator(".bench-headline").first.inner_text()
    tabbed(page, ready(page.get_by_role("button", name="Save the report")))
    page.keyboard.press("Enter")
    page.get_by_role("link", name="Open the report").wait_for()
    page.get_by_text("The code that does the same").click()
    script = page.locator(".bench-details .bench-commands").last.inner_text()
    (folder,) = (path for path in bench[0].glob("example*") if path.name in script)
    before = Posterior.read(folder / "posterior.nc")
    (folder / "posterior.nc").unlink()
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0
    after = Posterior.read(folder / "posterior.nc")
    assert after.marginals["surface_shear_modulus"] == before.marginals["surface_shear_modulus"]
    assert said == []
    page.close()


def test_what_was_stated_of_a_capsule_is_there_again_after_a_reload(browser, tmp_path):
    with served(tmp_path / "bench") as (_, address):
        page, said = with_example(browser, address)
        page.get_by_text("Put something right by hand").click()
        page.get_by_label("Error of either wall in px").fill("2")
        page.get_by_label("Rows of the two walls").fill("19.5, 139.5")
        page.locator(".bench-overlay .wall.stated").first.wait_for(state="attached")
        page.get_by_label("Half width of the channel, error", exact=True).fill("0.3")
        ready(page.get_by_role("button", name="Identify", exact=True).first)
        page.reload()
        page.get_by_text("0 capsules in").wait_for()
        page.get_by_text("List of them").click()
        page.get_by_text("example, not saved yet").wait_for()
        page.get_by_role("button", name="Open example again").click()
        page.locator(".bench-overlay .wall.stated").first.wait_for(state="attached")
        for label, text in {"Half width of the channel": "25", "Half width of the channel, error": "0.3"}.items():
            assert page.get_by_label(label, exact=True).input_value() == text
        assert page.get_by_label("Velocity of the capsule", exact=True).input_value() == "4.86"
        assert page.get_by_label("Rows of the two walls").input_value() == "19.5, 139.5"
        ready(page.get_by_role("button", name="Identify", exact=True).first)
        page.get_by_role("button", name="Try the example").click()
        error = page.get_by_label("Half width of the channel, error", exact=True)
        sync.expect(error).to_have_value("0.2", timeout=WAIT)
        page.get_by_role("button", name="Open example again").click()
        page.locator(".bench-overlay .wall.stated").first.wait_for(state="attached")
        sync.expect(error).to_have_value("0.3", timeout=WAIT)
        assert page.get_by_label("Velocity of the capsule", exact=True).input_value() == "4.86"
        assert said == []
        page.close()


def test_a_result_waits_for_a_page_that_was_closed_while_it_was_computed(browser, tmp_path):
    with served(tmp_path / "bench") as (_, address):
        page, said = with_example(browser, address)
        page.get_by_label("Law of the membrane").click()
        page.get_by_role("option", name="unknown").click()
        ready(page.get_by_role("button", name="Identify", exact=True).first).click()
        page.get_by_label("computing").first.wait_for()
        place = page.url
        page.close()
        page, said = opened(browser, place)
        page.get_by_role("button", name="Go on with example").click()
        page.get_by_label("computing").first.wait_for()
        assert page.locator(".bench-headline").count() == 0
        page.locator(".bench-headline").first.wait_for()
        page.locator(".bench-corner img").wait_for()
        found = page.locator(".bench-headline").first.inner_text()
        page.reload()
        page.get_by_text("List of them").click()
        page.get_by_text("example, identified, not saved yet").wait_for()
        page.get_by_role("button", name="Open example again").click()
        sync.expect(page.locator(".bench-headline").first).to_have_text(found, timeout=WAIT)
        page.get_by_text("unknown", exact=True).first.wait_for()
        page.get_by_label("Half width of the channel, error", exact=True).fill("0.3")
        page.locator(".bench-headline").first.wait_for(state="detached")
        page.get_by_label("Half width of the channel, error", exact=True).fill("0.2")
        ready(page.get_by_role("button", name="Save the report")).click()
        page.get_by_role("link", name="Open the report").wait_for()
        assert said == []
        page.close()


def test_a_prior_is_checked_when_it_is_left_and_stands_in_the_code_and_after_a_reload(browser, tmp_path):
    with served(tmp_path / "bench") as (_, address):
        page, said = with_example(browser, address)
        page.get_by_text("More: what is known beforehand").click()
        prior, identify = (
            page.get_by_label("Prior of the shear modulus", exact=True),
            page.get_by_role("button", name="Identify", exact=True),
        )
        ready(identify)
        for wrong, words in {"60 .. 20 mN/m": "Expected low < high", "20 .. 60": "no unit"}.items():
            prior.fill(wrong)
            prior.blur()
            page.get_by_text(words).wait_for()
            sync.expect(identify).to_be_disabled()
        prior.fill("20 .. 49,5 mN/m")
        prior.blur()
        page.get_by_text("no unit").wait_for(state="detached")
        ready(identify).click()
        page.get_by_text("The code that does the same").click()
        lines = page.locator(".bench-details .bench-commands")
        assert "--prior 'surface_shear_modulus=20 .. 49.5 mN/m'" in lines.first.inner_text()
        assert "prior=cb.Prior(surface_shear_modulus='20 .. 49.5 mN/m')" in lines.last.inner_text()
        upper = float(page.locator(".bench-headline").first.inner_text().split()[-2].strip("[],"))
        assert upper <= 49.5
        page.reload()
        page.get_by_role("button", name="Go on with example").click()
        sync.expect(prior).to_have_value("20 .. 49.5 mN/m", timeout=WAIT)
        page.locator(".bench-headline").first.wait_for()
        assert said == []
        page.close()


def test_a_folder_that_is_dropped_becomes_a_population_and_no_file_counts_twice(browser, tmp_path):
    with served(tmp_path / "bench") as (_, address):
        page, said = opened(browser, address)
        filled(page, FIELDS | {"Or flow rate in the channel": ("0.5625", "0.006")})
        picture = cv2.imread(str(EXAMPLES / "capsule.png"), cv2.IMREAD_GRAYSCALE)
        one, other = (base64.b64encode(cv2.imencode(".png", each)[1]).decode() for each in (picture, picture[::-1]))
        page.evaluate(DROPPED, {"one.png": one, "again.png": one, "other.png": other, "notes.txt": one})
        page.get_by_text(re.compile("was given before, as (one|again), and is left out")).wait_for()
        sync.expect(page.locator(".bench-many .bench-file")).to_have_count(2)
        tabbed(page, ready(page.get_by_role("button", name="Measure them all")))
        page.keyboard.press("Enter")
        page.get_by_text("2 capsules in").wait_for()
        tabbed(page, ready(page.get_by_role("button", name="Look at all together")))
        page.keyboard.press("Enter")
        page.get_by_role("link", name="Open population.html").wait_for()
        page.frame_locator("iframe.bench-page").get_by_text("2 capsules").first.wait_for()
        page.get_by_text("List of them").click()
        page.get_by_role("button", name="Remove other from all capsules").click()
        page.get_by_text("1 capsule in").wait_for()
        assert said == []
        page.close()


DROPPED = """(pictures) => {
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const files = Object.entries(pictures).map(([name, text]) => (
    { name, isFile: true, file: (found) => found(new File([bytes(text)], name)) }
  ));
  let some = [files, []];
  const folder = { name: "batch", isFile: false, isDirectory: true };
  folder.createReader = () => ({ readEntries: (found) => found(some.shift()) });
  const event = new Event("drop", { bubbles: true, cancelable: true });
  const [entry, place] = files.length > 1 ? [folder, ".bench-many"] : [files[0], "h1"];
  event.dataTransfer = { types: ["Files"], items: [{ webkitGetAsEntry: () => entry }] };
  document.querySelector(place).dispatchEvent(event);
}"""


def test_all_capsules_are_saved_in_one_file_and_loaded_into_an_empty_bench(browser, tmp_path):
    kept = tmp_path / "kept.zip"
    with served(tmp_path / "one") as (_, address):
        page, said = opened(browser, address)
        save = page.get_by_role("button", name="Save all in one file")
        save.click()
        page.get_by_text("expected capsules that fit into 512 MB, got none").wait_for()
        page.get_by_role("button", name="Try the example").click()
        page.get_by_text("The capsule was measured").wait_for()
        ready(page.get_by_role("button", name="Identify", exact=True).first).click()
        ready(page.get_by_role("button", name="Save the report")).click()
        page.get_by_text("1 capsule in").wait_for()
        with page.expect_download() as download:
            tabbed(page, ready(save))
            page.keyboard.press("Enter")
        assert re.fullmatch(r"capsbayes-bench-\d{4}-\d\d-\d\d\.zip", download.value.suggested_filename)
        download.value.save_as(kept)
        wait_until(lambda: not (tmp_path / "one" / ".bench.zip").exists())
        assert said == []
        page.close()
    with served(tmp_path / "other") as (_, address):
        page, said = opened(browser, address)
        page.get_by_text("0 capsules in").wait_for()
        many = page.locator("input[type=file][multiple]")
        many.set_input_files({"name": "wrong.zip", "mimeType": "", "buffer": b"no archive"})
        page.get_by_text("wrong.zip: expected a file in which step 7 saved all capsules").wait_for()
        page.evaluate(DROPPED, {"kept.zip": base64.b64encode(kept.read_bytes()).decode()})
        page.get_by_text("kept.zip: 1 folder loaded. Step 7 lists the capsules.").wait_for()
        page.get_by_text("1 capsule in").wait_for()
        page.get_by_text("List of them").click()
        with page.context.expect_page() as report:
            page.get_by_role("link", name="report", exact=True).click()
        report.value.get_by_text("The computation succeeded").first.wait_for()
        report.value.close()
        page.get_by_role("button", name="Open example again").click()
        page.get_by_text("The capsule was measured, the flow is to the right").wait_for()
        assert page.get_by_label("Velocity of the capsule", exact=True).input_value() == "4.86"
        ready(page.get_by_role("button", name="Identify", exact=True).first).click()
        ready(page.get_by_role("button", name="Save the report")).click()
        page.get_by_role("link", name="Open the report").wait_for()
        assert [path.name for path in (tmp_path / "other").iterdir()] == ["example"]
        assert said == []
        page.close()


def test_capsules_are_compared_by_the_keyboard_on_a_phone_too_and_in_the_dark(browser, tmp_path):
    with served(tmp_path / "bench") as (_, address):
        page, said = with_example(browser, address)
        for save in (True, False):
            ready(page.get_by_role("button", name="Identify", exact=True).first).click()
            page.locator(".bench-headline").first.wait_for()
            if save:
                ready(page.get_by_role("button", name="Save the report")).click()
                page.get_by_text("1 capsule in").wait_for()
                page.get_by_role("button", name="Try the example").click()
                page.locator(".bench-headline").first.wait_for(state="detached")
                page.get_by_label("Viscosity of the liquid around", exact=True).fill("0.9")
        page.get_by_text("List of them").click()
        page.get_by_text("example-2, identified, not saved yet").wait_for()
        compare = page.get_by_role("button", name="Compare", exact=True)
        sync.expect(compare).to_be_disabled()
        for name in ("example", "example-2"):
            tabbed(page, page.get_by_role("checkbox", name=f"Compare {name}", exact=True))
            page.keyboard.press("Space")
        tabbed(page, ready(compare))
        page.keyboard.press("Enter")
        table = page.get_by_role("region", name="Capsules side by side")
        rows = {row.split("\t")[0]: row.split("\t")[1:] for row in table.inner_text().splitlines() if "\t" in row}
        assert rows[""] == ["example", "example-2"]
        assert rows["≠ µ, viscosity of the suspending liquid"] == ["0.800 ± 0.020 Pa s", "0.900 ± 0.020 Pa s"]
        assert {"a [µm]", "Ca", "a/ℓ", "can be used", "ℓ, half width of the channel"} < set(rows)
        tabbed(page, table)
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            for width in (1400, 390):
                page.set_viewport_size({"width": width, "height": 900})
                assert page.evaluate("document.documentElement.scrollWidth") == width
                page.locator(".bench-few img").wait_for()
            first = table.locator("td").first
            card = page.locator(".bench-step").last.evaluate(GROUND)
            assert table.locator("th").first.evaluate(GROUND) == card, "what scrolls below it is not seen"
        before = first.bounding_box()["x"]
        page.keyboard.press("ArrowRight")
        wait_until(lambda: table.evaluate("one => one.scrollLeft") > 0)
        assert first.bounding_box()["x"] == pytest.approx(before, abs=1.0)
        assert said == []
        page.close()


GROUND = "one => getComputedStyle(one).backgroundColor"


def test_a_field_says_what_is_wrong_with_it_when_it_is_left_and_reads_a_decimal_comma(bench, browser):
    page, _ = opened(browser, bench[1])
    field = page.get_by_label("Viscosity of the liquid around", exact=True)
    field.fill("thick")
    field.blur()
    page.get_by_text("Expected a text in Pa s").first.wait_for()
    for typed in ("0,85", "0.85"):
        field.fill(typed)
        field.blur()
        page.get_by_text("Expected a text in Pa s").wait_for(state="detached")
        page.get_by_text("The half width is missing.").wait_for()
    page.locator("input[type=file]").first.set_input_files(Path(__file__))
    page.get_by_text("test_walk.py is of another kind than .png").wait_for()
    page.close()


def test_a_film_events_and_a_picture_at_once_are_measured_and_added_to_the_population(bench, browser, tmp_path):
    folder, address = bench
    before = len(list(folder.glob("*/**/measurement.toml")))
    page, said = opened(browser, address)
    given = [EXAMPLES / name for name in ("film.avi", "cells.rtdc", "capsule.png")]
    page.locator("input[type=file][multiple]").set_input_files(given)
    rows = page.locator(".bench-many .bench-file")
    sync.expect(rows).to_have_count(3, timeout=WAIT)
    sync.expect(rows.locator("img")).to_have_count(3)
    of_many = {"Frame rate of films": ("400", ""), "Size of a pixel of an .rtdc file": ("0.68", "0.002")}
    filled(page, FIELDS | of_many | {"Or flow rate in the channel": ("0.5625", "0.006")})
    ready(page.get_by_role("button", name="Measure them all")).click()
    page.locator(".bench-progress").get_by_text("frames of film.avi").wait_for()
    sync.expect(rows.locator(".bench-status.good")).to_have_count(3, timeout=WAIT)
    commands = page.locator(".bench-many .bench-commands")
    commands.evaluate("one => { one.parentElement.style.display = 'none'; }")  # it shows the place of the files
    kept(page, "bench-many", tmp_path, ".bench-many")
    commands.evaluate("one => { one.parentElement.style.display = ''; }")
    page.set_viewport_size({"width": 390, "height": 900})
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    found = sorted(folder.glob("*/**/measurement.toml"))
    assert len(found) == before + 5
    page.get_by_text(f"{before + 5} capsules in").wait_for()
    assert said == []
    lines = commands.inner_text().splitlines()
    command = shlex.split(next(line for line in lines if "measure film.avi" in line))
    shutil.copytree(folder / "film", tmp_path / "film")
    shutil.rmtree(folder / "film" / "capsule-1")
    (folder / "film" / "capsules.csv").unlink()
    assert subprocess.run([SCRIPT, *command[1:]], cwd=folder / "film", check=False).returncode == 0
    for path in (tmp_path / "film").rglob("*.*"):
        assert path.read_bytes() == (folder / "film" / path.relative_to(tmp_path / "film")).read_bytes(), path
    page.close()


def test_a_wall_is_moved_by_keys_and_another_tab_knows_nothing_of_it(bench, browser, picture):
    page, said = opened(browser, bench[1])
    other, _ = opened(browser, bench[1])
    page.locator("input[type=file]").first.set_input_files(picture)
    wall = page.get_by_role("slider", name="Upper wall")
    wall.wait_for()
    before = float(wall.get_attribute("aria-valuenow"))
    wall.focus()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Shift+ArrowDown")
    page.locator(".bench-overlay .wall.stated").first.wait_for(state="attached")  # a level line has no height
    assert float(wall.get_attribute("aria-valuenow")) == pytest.approx(before + 5.5, abs=0.11)
    assert other.locator(".bench-overlay image").count() == 1
    assert not other.locator(".bench-overlay").is_visible()
    assert said == []
    page.close()
    other.close()


def test_dirt_on_the_outline_is_erased_by_a_box_that_is_drawn(bench, browser, tmp_path):
    made = drawn(CA, SIZE, half_width=55.0)
    columns = made.picture.shape[1]
    x, y = 0.5 * columns + 20.0, float(made.scene.middle[1]) + 50.0
    cv2.imwrite(str(tmp_path / "dirty.png"), dirty(made, (x, y)))
    page, said = opened(browser, bench[1])
    page.locator("input[type=file]").first.set_input_files(tmp_path / "dirty.png")
    page.get_by_text("The outline is notched").first.wait_for()
    page.get_by_text("Put something right by hand").click()
    page.get_by_text("erase in the picture").click()
    dragged(page, (x - 13.0, y - 13.0), (x + 13.0, y + 13.0))
    page.get_by_text("The capsule was measured").wait_for()
    page.locator(".bench-overlay rect.erased").wait_for()
    left, top, width, height = map(float, page.get_by_label("Wrong outline").input_value().split(","))
    assert (left, top, width, height) == pytest.approx((x - 13.0, y - 13.0, 27.0, 27.0), abs=1.6)
    kept(page, "bench-erased", tmp_path, ".bench-columns > div >> nth=0")
    page.get_by_role("button", name="Find everything again").click()
    page.locator(".bench-overlay rect.erased").wait_for(state="detached")
    assert said == []
    page.close()


def test_a_file_that_is_no_picture_is_refused_in_one_line_and_leaves_nothing(bench, browser, tmp_path):
    broken = tmp_path / "broken.png"
    broken.write_bytes(b"\x89PNG\r\n\x1a\n" + b"x" * 100)
    page, _ = opened(browser, bench[1])
    page.locator("input[type=file]").first.set_input_files(broken)
    page.get_by_text("expected a whole PNG file").wait_for()
    assert not (bench[0] / "broken").exists()
    page.close()


def test_a_wall_is_dragged_a_part_is_drawn_and_the_flow_is_turned_by_the_mouse(bench, browser, picture):
    page, said = opened(browser, bench[1])
    page.locator("input[type=file]").first.set_input_files(picture)
    page.get_by_text("The capsule was measured").wait_for()
    page.get_by_text("Put something right by hand").click()
    turn = page.get_by_role("button", name="Turn the flow round")
    turn.click()
    page.get_by_text(str(Status.WRONG_FLOW)).first.wait_for()
    turn.click()
    page.get_by_text("The capsule was measured, the flow is to the right").wait_for()
    page.get_by_text("draw it in the picture").click()
    dragged(page, (8.0, 20.0), (190.0, 180.0))
    page.locator(".bench-overlay rect.crop").wait_for()
    part = list(map(float, page.get_by_label("Part: left, top, width, height").input_value().split(",")))
    assert part == pytest.approx([8.0, 20.0, 183.0, 161.0], abs=1.6)
    page.get_by_text("The capsule was measured").wait_for()
    wall = page.get_by_role("slider", name="Lower wall")
    before = float(wall.get_attribute("aria-valuenow"))
    dragged(page, (30.0, before), (40.0, before + 3.0))
    page.locator(".bench-overlay .wall.stated").first.wait_for(state="attached")
    assert float(wall.get_attribute("aria-valuenow")) == pytest.approx(before + 3.0, abs=0.6)
    upper, lower = map(float, page.get_by_label("Rows of the two walls").input_value().split(","))
    assert lower == pytest.approx(before + 3.0, abs=0.6)
    assert lower - upper == pytest.approx(113.0, abs=1.0)
    page.get_by_text(re.compile(r"^Walls 11[234]\.\d px apart\.$")).wait_for()
    page.get_by_label("Half width of the channel", exact=True).fill("25")
    page.get_by_text(re.compile(r"^Walls 11[234]\.\d px apart = 50 µm: a pixel is 0\.44\d µm\.$")).wait_for()
    assert said == []
    page.close()


def test_a_picture_that_states_the_size_of_a_pixel_contradicts_a_wrong_half_width(bench, browser, picture, tmp_path):
    """The channel is twice as wide as half its width."""
    path = tmp_path / "capsule.tif"
    with PIL.Image.open(picture) as drawn:
        drawn.save(path, tiffinfo={270: "ImageJ=1.53t\nunit=micron\n", 282: 1.0 / 0.46, 296: 1})
    page, said = opened(browser, bench[1])
    page.locator("input[type=file]").first.set_input_files(path)
    by_file = r"5\d\.?\d* µm by the size of a pixel in the file\."
    page.get_by_text(re.compile(rf"^Walls 11\d\.\d px apart, {by_file}$")).wait_for()
    width = page.get_by_label("Half width of the channel", exact=True)
    width.fill("25.2")
    page.get_by_text(re.compile(rf"px apart = 50\.4 µm: a pixel is 0\.4\d* µm, {by_file}$")).wait_for()
    width.fill("50")
    page.get_by_text(re.compile(rf"{by_file} Check the half width: one of the two is wrong\.$")).wait_for()
    assert said == []
    page.close()


def test_the_whole_way_is_gone_by_the_keyboard_alone(bench, browser, picture):
    page, said = opened(browser, bench[1])
    with page.expect_file_chooser() as chooser:
        tabbed(page, page.locator(".bench-upload").first.locator(".q-uploader__header a, .q-uploader__header button"))
        page.keyboard.press("Enter")
    chooser.value.set_files(picture)
    page.get_by_text("The capsule was measured").wait_for()
    wall = page.get_by_role("slider", name="Upper wall")
    before = float(wall.get_attribute("aria-valuenow"))
    tabbed(page, wall)
    page.keyboard.press("ArrowDown")
    page.locator(".bench-overlay .wall.stated").first.wait_for(state="attached")
    assert float(wall.get_attribute("aria-valuenow")) == pytest.approx(before + 0.5, abs=0.11)
    tabbed(page, page.get_by_role("button", name="Put something right by hand"))
    page.keyboard.press("Enter")
    tabbed(page, page.get_by_role("button", name="Find everything again"))
    page.keyboard.press("Enter")
    page.locator(".bench-overlay .wall.stated").first.wait_for(state="detached")
    for label, texts in FIELDS.items():
        for name, text in zip((label, f"{label}, error"), texts, strict=True):
            tabbed(page, page.get_by_label(name, exact=True))
            page.keyboard.type(text)
    identify = ready(page.get_by_role("button", name="Identify", exact=True).first)
    tabbed(page, identify)
    page.keyboard.press("Enter")
    page.locator(".bench-headline").first.wait_for()
    tabbed(page, ready(page.get_by_role("button", name="Save the report")))
    page.keyboard.press("Enter")
    link = page.get_by_role("link", name="Open the report")
    link.wait_for()
    with page.context.expect_page() as report:
        tabbed(page, link)
        page.keyboard.press("Enter")
    report.value.get_by_text("The computation succeeded").first.wait_for()
    assert said == []
    page.close()


def tabbed(page, target, most=150):
    """Press Tab until the focus is on an element or within it."""
    for _ in range(most):
        page.keyboard.press("Tab")
        if target.evaluate("one => one.contains(document.activeElement)"):
            return
    raise AssertionError(f"not reached by the keyboard: {target}")


def test_a_capsule_of_a_film_is_identified_as_its_commands_say_and_leads_to_the_next_flow_rate_and_the_population(
    browser, tmp_path
):
    with served(tmp_path / "bench") as (_, address):
        page, said = opened(browser, address)
        flow, together = (page.get_by_role("button", name=name) for name in ("At which flow rate", "Look at all"))
        sync.expect(flow).to_be_disabled()
        page.locator("input[type=file][multiple]").set_input_files(EXAMPLES / "film.avi")
        filled(page, FIELDS | {"Frame rate of films": ("400", "")})
        ready(page.get_by_role("button", name="Measure them all")).click()
        ready(page.get_by_label("Identify capsule-1 of film.avi")).click()
        page.get_by_text("capsule-1 of film").first.wait_for()
        ready(page.get_by_role("button", name="Identify", exact=True).first).click()
        ready(page.get_by_role("button", name="Save the report")).click()
        page.get_by_role("link", name="Open the report").wait_for()
        page.get_by_text("The code that does the same").click()
        change, identify, report = page.locator(".bench-details .bench-commands").first.inner_text().splitlines()
        folder = Path(shlex.split(change)[1])
        assert folder == tmp_path / "bench" / "film" / "capsule-1"
        saved = {path: path.read_bytes() for path in folder.iterdir() if not path.name.startswith(".")}
        assert {"measurement.toml", "posterior.nc", "report.html"} <= {path.name for path in saved}
        for line in (identify, report):
            assert subprocess.run([SCRIPT, *shlex.split(line)[1:]], cwd=folder, check=False).returncode == 0
        assert {path: path.read_bytes() for path in saved} == saved
        shutil.copytree(tmp_path / "bench" / "film", tmp_path / "bench" / "another")
        ready(flow).click()
        page.get_by_text("--like film/capsule-1/measurement.toml").wait_for()
        assert page.get_by_text("The expected capsule reaches the limit of existence").is_visible()
        ready(together).click()
        link = page.get_by_role("link", name="Open population.html")
        link.wait_for()
        report = page.context.request.get(link.evaluate("link => link.href"))
        assert report.status == 200
        diagnose = page.get_by_role("button", name="What does the model miss? from 12 capsules on")
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


def kept(page, name, folder: Path, part=None):
    """A picture of what is seen, or of a part of the page, small enough for the docs; put there if that is asked."""
    time.sleep(0.5)  # until what unfolds has done so
    png = page.screenshot() if part is None else page.locator(part).screenshot()
    pixels = cv2.imdecode(np.frombuffer(png, dtype=np.uint8), cv2.IMREAD_COLOR)
    size = min(1.0, WIDEST / pixels.shape[1])
    path = folder / f"{name}.jpg"
    cv2.imwrite(str(path), cv2.resize(pixels, None, fx=size, fy=size, interpolation=cv2.INTER_AREA), QUALITY)
    assert path.stat().st_size < LARGEST
    if (docs := os.environ.get("CAPSBAYES_PICTURES")) is not None:
        shutil.copy(path, docs)


def true_modulus():
    """G_s of the drawn capsule, mu U / Ca [N/m]: that of the case of the database that is drawn."""
    cases = shapes()
    apart = np.abs(np.log(cases["capillary_number"] / CA)) + 10.0 * np.abs(cases["size_ratio"] - SIZE)
    row = int(np.argmin(apart))
    return VISCOSITY * VELOCITY / float(cases["velocity_ratio"][row] * cases["capillary_number"][row])
