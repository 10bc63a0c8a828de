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
_SCREEN = """<!DOCTYPE html><body><pre id="found"></pre>
<script>
const found = {};
addEventListener("message", (sent) => {
  const frame = [...document.querySelectorAll("iframe")].find((one) => one.contentWindow === sent.source);
  found[frame.width] = JSON.parse(sent.data);
  document.getElementById("found").textContent = JSON.stringify(found);
});
</script>%s</body>"""

_FRAME = '<iframe width="%d" height="900" style="border: 0" srcdoc="%s"></iframe>'

_PROBE = """<script>
addEventListener("load", () => { parent.postMessage(JSON.stringify((() => { %s })()), "*"); });
</script></body>"""


@dataclass
class Seen:
    """What a script returned in the page by the width of the screen, and the lines of the console."""

    found: dict
    console: list


def seen_in_browser(page, script, folder: Path, *, widths=(1200,)):
    """Run the body of a function in a page once it has loaded, on screens of some widths."""
    file = folder / "page.html"
    probed = page.replace("</body>", _PROBE % script)
    assert probed != page, "a page with a body"
    file.write_text(_SCREEN % "".join(_FRAME % (width, escape(probed)) for width in widths), encoding="utf-8")
    options = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--enable-logging=stderr")
    apart = f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=3000"
    command = [CHROMIUM, *options, *apart, "--dump-dom", file.as_uri()]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    probe = re.search(r'<pre id="found">(.+?)</pre>', run.stdout, flags=re.DOTALL)
    assert probe, run.stderr
    console = [line for line in run.stderr.splitlines() if "CONSOLE" in line]
    found = {int(width): one for width, one in json.loads(unescape(probe[1])).items()}
    assert set(found) == set(widths)
    return Seen(found, console)
