"""The whole way in a real browser: from a drawn picture to the saved report, whose interval of G_s holds the truth.

With ``CAPSBAYES_PICTURES=docs/pictures`` in the environment the same test renews the pictures of ``docs/app.md``.
"""

import os
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from browser import needs_browser
from drawn import dirty, drawn, shapes

from capsbayes.infer import Posterior

pytest.importorskip("nicegui", reason="the extra app is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from walk import FIELDS, WAIT, dragged, filled, opened, ready, sync

pytestmark = [needs_browser, pytest.mark.slow]

CA, SIZE, VISCOSITY, VELOCITY = 0.08, 1.05, 0.85, 6.2e-3
EXAMPLES = Path(__file__).parents[2] / "examples" / "pictures"
SCRIPT = Path(sys.executable).with_name("capsbayes")
LARGEST, WIDEST, QUALITY = 200_000, 1000, (cv2.IMWRITE_JPEG_QUALITY, 75)  # bytes and px of a picture of the docs


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


def test_a_film_events_and_a_picture_at_once_are_measured_and_added_to_the_population(bench, browser, tmp_path):
    folder, address = bench
    before = len(list(folder.glob("*/**/measurement.toml")))
    page, said = opened(browser, address)
    given = [EXAMPLES / name for name in ("film.avi", "cells.rtdc", "capsule.png")]
    page.locator("input[type=file][multiple]").set_input_files(given)
    rows = page.locator(".bench-file")
    sync.expect(rows).to_have_count(3, timeout=WAIT)
    sync.expect(rows.locator("img")).to_have_count(3)
    of_many = {"Frame rate of a film": ("400", ""), "Size of a pixel of an .rtdc file": ("0.68", "0.002")}
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
    command = shlex.split(next(line for line in lines if "film.avi" in line).partition("; ")[2])
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
    page.get_by_text("--erase").first.wait_for()
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
    page.get_by_text("expected a picture (PNG, TIFF or JPEG)").wait_for()
    assert not (bench[0] / "broken").exists()
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
