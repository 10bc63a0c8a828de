"""A bench that is served, and its page in a browser, for the tests that walk through it."""

import contextlib
import re

import pytest
from browser import CHROMIUM
from processes import capsbayes

sync = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

WAIT = 240_000  # ms: as long as the slowest machine may take
OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage",
)  # fmt: skip
FIELDS = {
    "Half width of the channel": ("25.0", "0.2"),
    "Viscosity of the liquid around": ("0.85", "0.02"),
    "Velocity of the capsule": ("6.20", "0.06"),
}


@contextlib.contextmanager
def served(folder):
    """Serve a bench as leader of a group of processes; its process, and its address."""
    with capsbayes("app", "--no-browser", "--folder", folder) as server:
        try:
            yield server, re.search(r"http\S+", server.stdout.readline())[0]
        finally:
            server.terminate()


@contextlib.contextmanager
def chromium():
    """A browser without a window; its tabs share their cookies, as the address of a bench opens it once."""
    with sync.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=OPTIONS)
        yield opened.new_context(viewport={"width": 1400, "height": 900})
        opened.close()


def opened(browser, address):
    """A tab with the page in it, and the list of what its console says."""
    page = browser.new_page()
    page.set_default_timeout(WAIT)
    said = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("requestfailed", lambda request: said.append(request.url))
    page.goto(address)
    page.get_by_text("1. The picture").wait_for()
    return page, said


def with_example(browser, address):
    """The same with the capsule of the example, which is measured."""
    page, said = opened(browser, address)
    page.get_by_role("button", name="Try the example").click()
    page.get_by_text("The capsule was measured").wait_for()
    return page, said


def filled(page, fields):
    """Fill numbers and their errors into the form."""
    for label, texts in fields.items():
        for name, text in zip((label, f"{label}, error"), texts, strict=True):
            page.get_by_label(name, exact=True).fill(text)


def ready(button):
    """A button once it can be pressed."""
    sync.expect(button).to_be_enabled(timeout=WAIT)
    return button


def dragged(page, begin, end):
    """Drag the mouse from a place of the picture to another, each as column and row in pixels."""
    shown = page.locator(".bench-overlay")
    shown.scroll_into_view_if_needed()
    place = shown.bounding_box()
    scale = place["width"] / float(shown.locator("image").get_attribute("width"))
    page.mouse.move(*(place[edge] + scale * (at + 0.5) for edge, at in zip("xy", begin, strict=True)))
    page.mouse.down()
    page.mouse.move(*(place[edge] + scale * (at + 0.5) for edge, at in zip("xy", end, strict=True)), steps=5)
    page.mouse.up()
