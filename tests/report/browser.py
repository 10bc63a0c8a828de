"""A page in headless Chromium: what its scripts find, and what its console says."""

import json
import re
import shutil
import subprocess
from dataclasses import dataclass
from html import escape, unescape
from pathlib import Path

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)

needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no chromium or chrome is installed")

# the page lies in a frame of its own width, since the window of a headless browser is never below 500 pixels
_FRAME = """<!DOCTYPE html><body style="margin: 0"><pre id="found"></pre>
<script>addEventListener("message", (sent) => { document.getElementById("found").textContent = sent.data; });</script>
<iframe style="width: %dpx; height: 900px; border: 0" srcdoc="%s"></iframe></body>"""

_PROBE = """<script>
addEventListener("load", () => { parent.postMessage(JSON.stringify((() => { %s })()), "*"); });
</script></body>"""


@dataclass
class Seen:
    """What a script returned in the page, and the lines of the console."""

    found: object
    console: list


def seen_in_browser(page, script, folder: Path, *, width=1200):
    """Run the body of a function in a page once it has loaded, on a screen of a width."""
    file = folder / "page.html"
    probed = page.replace("</body>", _PROBE % script)
    assert probed != page, "a page with a body"
    file.write_text(_FRAME % (width, escape(probed)), encoding="utf-8")
    options = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--enable-logging=stderr")
    apart = f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=3000"
    command = [CHROMIUM, *options, *apart, "--dump-dom", file.as_uri()]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    probe = re.search(r'<pre id="found">(.+?)</pre>', run.stdout, flags=re.DOTALL)
    assert probe, run.stderr
    console = [line for line in run.stderr.splitlines() if "CONSOLE" in line]
    return Seen(json.loads(unescape(probe[1])), console)
