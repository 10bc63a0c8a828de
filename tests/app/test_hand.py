"""What a hand does on the page in a real browser: walls and boxes by the mouse, and the whole way by the keyboard."""

import pytest
from browser import needs_browser

pytest.importorskip("nicegui", reason="the extra app is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from walk import FIELDS, dragged, opened, ready

from capsbayes.status import Status

pytestmark = [needs_browser, pytest.mark.slow]


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
