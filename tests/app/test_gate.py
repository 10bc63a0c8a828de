"""What stands before the pages of the bench, by plain requests: token, cookie, hosts, sizes, and files."""

import pytest

pytest.importorskip("nicegui", reason="the extra app is not installed")

import asyncio
import html
import os
import re
import shlex
import signal
import stat
import subprocess
import sys

import httpx
from fastapi import FastAPI, Request
from processes import capsbayes, wait_until
from starlette.requests import ClientDisconnect

from capsbayes.app import server
from capsbayes.app.desk import Bench
from capsbayes.app.server import AccessControl, make_private
from capsbayes.errors import InputError

PORT = 8123
HOST = f"http://127.0.0.1:{PORT}"
WITHOUT_BROWSER = "import webbrowser; webbrowser.open = lambda address: False\nfrom capsbayes.cli import main\nmain()"
LEADS_TO = re.compile(r'content="0;url=([^"]+)"')


class Browser:
    """Asks the pages behind a gate by their paths below its own, and keeps cookies."""

    def __init__(self, gate):
        self.gate, self.cookies = gate, httpx.Cookies()
        self.place, _, self.token = gate.address.removeprefix(HOST).partition("/?")

    def enter(self, **how):
        return self.get(f"/?{self.token}", **how)

    def get(self, path, **how):
        return self.ask("GET", path, **how)

    def post(self, path, **how):
        return self.ask("POST", path, **how)

    def ask(self, method, path, **how):
        async def asked():
            transport = httpx.ASGITransport(self.gate)
            async with httpx.AsyncClient(transport=transport, base_url=HOST, cookies=self.cookies) as client:
                answer = await client.request(method, self.place + path, **how)
                self.cookies.update(client.cookies)
                return answer

        return asyncio.run(asked())


@pytest.fixture
def client(tmp_path):
    app = FastAPI()
    bench = Bench(tmp_path)
    app.include_router(bench.router())

    @app.get("/")
    def page():
        return "served"

    @app.post("/upload")
    async def upload(request: Request):
        return len(await request.body())

    (tmp_path / "report.html").write_text("<p>kept</p>")
    client = Browser(AccessControl(app, PORT))
    client.offered = bench.offer(tmp_path / "report.html")
    return client


def answer_to_a_socket(client, headers):
    """What is sent to a browser that opens a socket, by an application that accepts all of them."""
    sent = []

    async def accepting(scope, receive, send):
        await send({"type": "websocket.accept"})

    async def send(message):
        sent.append(message["type"])

    scope = {"type": "websocket", "path": f"{client.place}/socket", "query_string": b"", "headers": headers}
    client.gate._app = accepting
    asyncio.run(client.gate(scope, None, send))
    return sent


def test_without_the_token_nothing_is_served(client):
    for asked in ("/", "/?token=", "/?token=other", client.offered):
        refused = client.get(asked)
        assert (refused.status_code, "served" in refused.text) == (403, False)
    assert client.post("/upload", content=b"x").status_code == 403
    host = (b"host", f"127.0.0.1:{PORT}".encode())
    assert answer_to_a_socket(client, [host]) == ["websocket.close"]
    planted = "capsbayes=planted-by-another-port"
    cookie = (b"cookie", f"{client.enter().headers['set-cookie'].partition(';')[0]}; {planted}".encode())
    assert answer_to_a_socket(client, [host, cookie]) == ["websocket.accept"]
    assert answer_to_a_socket(client, [host, cookie, (b"origin", b"http://evil.example")]) == ["websocket.close"]
    assert answer_to_a_socket(client, [host, (b"cookie", planted.encode())]) == ["websocket.close"]


def test_the_token_opens_the_page_once_and_is_not_in_the_cookie_which_goes_to_the_path_of_the_page_alone(client):
    opened = client.enter()
    assert (opened.status_code, html.unescape(LEADS_TO.search(opened.text)[1])) == (200, f"{client.place}/")
    cookie, *about = (part.strip() for part in opened.headers["set-cookie"].split(";"))
    assert sorted(about) == sorted(["HttpOnly", "SameSite=Strict", f"Path={client.place}/"])
    used = client.token.removeprefix("token=")
    assert used not in cookie + opened.text
    assert client.place not in cookie
    assert (client.get("/").json(), client.get(client.offered).text) == ("served", "<p>kept</p>")
    client.cookies.clear()
    assert client.enter().status_code == 403
    assert client.get(client.gate.address.removeprefix(HOST + client.place)).status_code == 200  # the next token
    client.place = ""
    assert [client.get(path, headers={"cookie": cookie}).status_code for path in ("/", client.offered)] == [403, 403]


def test_nothing_may_be_fetched_from_elsewhere(client):
    client.enter()
    headers = client.get("/").headers
    assert "default-src 'self'" in headers["content-security-policy"]
    assert headers["referrer-policy"] == "no-referrer"
    assert "sandbox" not in headers["content-security-policy"]


def test_a_report_which_may_be_of_another_person_reaches_nothing_of_the_bench(client):
    client.enter()
    policies = client.get(client.offered).headers.get_list("content-security-policy")
    assert [policy.partition(" ")[0] for policy in policies] == ["sandbox", "default-src"]


@pytest.mark.parametrize("headers", [{"host": "evil.example:8123"}, {"origin": "http://evil.example"}])
def test_other_hosts_and_foreign_pages_are_refused_even_with_the_token(client, headers):
    assert client.enter(headers=headers).status_code == 403
    assert client.enter().status_code == 200


def test_an_upload_beyond_the_cap_is_refused_whether_or_not_it_says_its_size(client, monkeypatch):
    monkeypatch.setattr(server, "MOST_BYTES", 100)
    client.enter()
    assert client.post("/upload", content=b"x" * 100).json() == 100
    assert client.post("/upload", content=b"x" * 101).status_code == 413

    async def parts():
        for _ in range(2):
            yield b"x" * 60

    with pytest.raises(ClientDisconnect):
        client.post("/upload", content=parts())


def test_files_are_served_by_a_number_drawn_at_random_and_never_by_a_path(client, tmp_path):
    client.enter()
    assert client.get(client.offered).text == "<p>kept</p>"
    _, kept, key, name = client.offered.split("/")
    assert len(key) > 20
    for path in (f"/{kept}/{'0' * len(key)}/{name}", f"/{kept}/{key}/../../etc/passwd", f"/kept/..%2f..%2fetc/{name}"):
        assert client.get(path).status_code == 404


def test_a_browser_that_stays_open_is_led_to_the_page_by_a_file_that_only_the_user_reads(tmp_path, monkeypatch):
    """By the command itself: other users of the machine see the browser's command line, and try folder and port."""
    folder, seen, browser = tmp_path / "bench", tmp_path / "seen", tmp_path / "browser.py"
    browser.write_text(
        f"import pathlib, sys, time\npathlib.Path({str(seen)!r}).write_text(sys.argv[1])\ntime.sleep(900)"
    )
    monkeypatch.setenv("BROWSER", f"{shlex.join([sys.executable, str(browser)])} %s")
    with capsbayes("app", "--folder", folder) as bench:
        try:
            address = re.search(r"http\S+", bench.stdout.readline())[0]
            place, _, token = address.partition("?token=")
            wait_until(lambda: seen.exists() and seen.read_text(), bench)
            file = next(folder.iterdir())
            assert seen.read_text() == file.as_uri()
            assert token not in file.as_uri()
            assert place.split("/")[-2] not in file.as_uri()
            assert [stat.S_IMODE(path.stat().st_mode) for path in (folder, file)] == [0o700, 0o600]
            assert html.unescape(LEADS_TO.search(file.read_text())[1]) == address
            with httpx.Client() as tab:
                assert tab.get(address).status_code == 200
                assert list(folder.iterdir()) == []
                page = tab.get(place)
                script = page.url.join(re.search(r'src="([^"]+/nicegui\.js)"', page.text)[1])
                served = (place, script, f"{place}_nicegui_ws/socket.io/?EIO=4&transport=polling")
                assert [tab.get(path).status_code for path in served] == [200] * 3
            assert [httpx.get(path).status_code for path in (address, *served)] == [403] * 4
            bench.stdout.readline()  # the folder
            assert httpx.get(re.search(r"http\S+", bench.stdout.readline())[0]).status_code == 200
        finally:
            os.killpg(bench.pid, signal.SIGKILL)


def test_the_file_that_leads_to_the_page_is_gone_when_nobody_opened_it(tmp_path):
    with capsbayes("app", "--folder", tmp_path / "bench", program=WITHOUT_BROWSER) as bench:
        wait_until(lambda: list(tmp_path.glob("bench/open-*.html")), bench)
        bench.send_signal(signal.SIGINT)
        bench.communicate()
    assert list((tmp_path / "bench").iterdir()) == []


def test_a_folder_that_others_could_enter_is_closed_to_them_unless_they_need_it(tmp_path):
    tmp_path.chmod(0o775)
    make_private(tmp_path)
    assert stat.S_IMODE(tmp_path.stat().st_mode) == 0o700
    tmp_path.chmod(0o1777)
    with pytest.raises(InputError, match=r"app: --folder: expected a folder that only you can enter, got .*share"):
        make_private(tmp_path)
    assert stat.S_IMODE(tmp_path.stat().st_mode) == 0o1777


IMPORTED = """
import os, signal, sys, time
from pathlib import Path
from capsbayes.app import server

def opened(address):
    while not hasattr(sys.modules.get("capsbayes.infer"), "Prior"):
        time.sleep(0.05)
    print("imported", flush=True)
    os.kill(os.getpid(), signal.SIGINT)

assert "capsbayes.infer" not in sys.modules, "the first page would wait for it"
server.serve(Path(sys.argv[1]), 0, opened)
"""


def test_what_checks_priors_is_imported_before_one_is_typed(tmp_path):
    words = [sys.executable, "-c", IMPORTED, str(tmp_path / "bench")]
    ended = subprocess.run(words, capture_output=True, text=True, timeout=600, check=False)
    assert "imported" in ended.stdout.splitlines(), ended.stderr
