"""What stands before the pages of the bench, by plain requests: token, hosts, sizes, and what else it serves."""

import pytest

pytest.importorskip("nicegui", reason="the extra app is not installed")

import asyncio

import httpx
from fastapi import FastAPI, Request
from starlette.requests import ClientDisconnect

from capsbayes.app import server
from capsbayes.app.desk import Bench
from capsbayes.app.server import Gate

PORT = 8123
HOST = f"http://127.0.0.1:{PORT}"
TOKEN = "only-for-this-test"


class Browser:
    """Asks the pages behind a gate, and keeps cookies."""

    def __init__(self, gate):
        self.gate, self.cookies = gate, httpx.Cookies()

    def get(self, path, **how):
        return self.ask("GET", path, **how)

    def post(self, path, **how):
        return self.ask("POST", path, **how)

    def ask(self, method, path, **how):
        async def asked():
            transport = httpx.ASGITransport(self.gate)
            async with httpx.AsyncClient(transport=transport, base_url=HOST, cookies=self.cookies) as client:
                answer = await client.request(method, path, **how)
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
    client = Browser(Gate(app, TOKEN, PORT))
    client.offered = bench.offer(tmp_path / "report.html")
    return client


def answer_to_a_socket(headers):
    """What is sent to a browser that opens a socket, by an application that accepts all of them."""
    sent = []

    async def accepting(scope, receive, send):
        await send({"type": "websocket.accept"})

    async def send(message):
        sent.append(message["type"])

    scope = {"type": "websocket", "path": "/socket", "query_string": b"", "headers": headers}
    asyncio.run(Gate(accepting, TOKEN, PORT)(scope, None, send))
    return sent


def test_without_the_token_nothing_is_served(client):
    for asked in ("/", "/?token=", "/?token=other", client.offered):
        refused = client.get(asked)
        assert (refused.status_code, "served" in refused.text) == (403, False)
    assert client.post("/upload", content=b"x").status_code == 403
    host = (b"host", f"127.0.0.1:{PORT}".encode())
    assert answer_to_a_socket([host]) == ["websocket.close"]
    cookie = (b"cookie", f"capsbayes-{PORT}={TOKEN}".encode())
    assert answer_to_a_socket([host, cookie]) == ["websocket.accept"]
    assert answer_to_a_socket([host, cookie, (b"origin", b"http://evil.example")]) == ["websocket.close"]


def test_the_token_opens_the_page_and_its_browser_keeps_it_out_of_the_reach_of_scripts_and_other_sites(client):
    opened = client.get(f"/?token={TOKEN}")
    assert opened.status_code == 200
    cookie = opened.headers["set-cookie"]
    assert {"HttpOnly", "SameSite=Strict"} <= {part.strip() for part in cookie.split(";")}
    assert client.get("/").status_code == 200


def test_nothing_may_be_fetched_from_elsewhere(client):
    headers = client.get(f"/?token={TOKEN}").headers
    assert "default-src 'self'" in headers["content-security-policy"]
    assert headers["referrer-policy"] == "no-referrer"


@pytest.mark.parametrize("headers", [{"host": "evil.example:8123"}, {"origin": "http://evil.example"}])
def test_other_hosts_and_foreign_pages_are_refused_even_with_the_token(client, headers):
    assert client.get(f"/?token={TOKEN}", headers=headers).status_code == 403


def test_an_upload_beyond_the_cap_is_refused_whether_or_not_it_says_its_size(client, monkeypatch):
    monkeypatch.setattr(server, "MOST_BYTES", 100)
    client.get(f"/?token={TOKEN}")
    assert client.post("/upload", content=b"x" * 100).json() == 100
    assert client.post("/upload", content=b"x" * 101).status_code == 413

    async def parts():
        for _ in range(2):
            yield b"x" * 60

    with pytest.raises(ClientDisconnect):
        client.post("/upload", content=parts())


def test_files_are_served_by_a_number_drawn_at_random_and_never_by_a_path(client, tmp_path):
    client.get(f"/?token={TOKEN}")
    assert client.get(client.offered).text == "<p>kept</p>"
    _, kept, key, name = client.offered.split("/")
    assert len(key) > 20
    for path in (f"/{kept}/{'0' * len(key)}/{name}", f"/{kept}/{key}/../../etc/passwd", f"/kept/..%2f..%2fetc/{name}"):
        assert client.get(path).status_code == 404
