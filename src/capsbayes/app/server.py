"""The server of the bench: on this machine alone, for whoever opens its address, with a cap on what is uploaded."""

from __future__ import annotations

import contextlib
import hmac
import html
import os
import secrets
import socket
import stat
import tempfile
import webbrowser
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from threading import Thread
from typing import Any

import uvicorn
from fastapi import FastAPI
from nicegui import app as pages
from nicegui import ui
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.websockets import WebSocketClose

from capsbayes.app.desk import MOST_BYTES, Bench
from capsbayes.app.page import bench_page
from capsbayes.errors import InputError
from capsbayes.interruption import keeping

LOOPBACK = "127.0.0.1"
_HEADERS = {
    "cache-control": "no-store",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
    "x-frame-options": "SAMEORIGIN",
    "content-security-policy": "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; "
    "connect-src 'self' ws:; form-action 'self'",
}


class AccessControl:
    """What stands before the pages: it refuses whoever did not open the address, other hosts, and too large uploads.

    The token in the address opens the page once; then a new one is drawn, and `used` is called. From then on the
    browser is known by another secret, in a cookie for a path that is drawn at random, because browsers send cookies to
    every port of this machine.
    """

    def __init__(self, app: Any, port: int, used: Callable[[], object] = lambda: None) -> None:
        self._app, self._port, self._used = app, port, used
        self._place, self._cookie = f"/{secrets.token_urlsafe(16)}", f"capsbayes={secrets.token_urlsafe(32)}"
        self._token = secrets.token_urlsafe(32)

    @property
    def address(self) -> str:
        """Where the page is opened next."""
        return f"http://{LOOPBACK}:{self._port}{self._place}/?token={self._token}"

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Answer a request, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        asked = HTTPConnection(scope)
        brings = scope.get("method") == "GET" and _same(asked.query_params.get("token", ""), self._token)
        within = scope["path"].startswith(f"{self._place}/")
        known = any(_same(kept.strip(), self._cookie) for kept in asked.headers.get("cookie", "").split(";"))
        if not (within and (brings or known) and self._is_here(asked.headers)):
            answer = PlainTextResponse("This page is opened by the address that capsbayes app printed last.", 403)
            await (WebSocketClose(1008) if scope["type"] == "websocket" else answer)(scope, receive, send)
        elif brings:
            await self._let_in()(scope, receive, send)
        elif int(asked.headers.get("content-length", "0") or 0) > MOST_BYTES:
            await PlainTextResponse(f"At most {MOST_BYTES >> 20} MB.", 413)(scope, receive, send)
        else:
            await self._app({**scope, "root_path": self._place}, _capped(receive), _marked(send))

    def _is_here(self, headers: Headers) -> bool:
        """Refuse the name of another host, by which a foreign page would reach this one, and requests of such pages."""
        here = {f"{name}:{self._port}" for name in (LOOPBACK, "localhost")}
        origin = headers.get("origin", "")
        return headers.get("host", "") in here and (not origin or origin.removeprefix("http://") in here)

    def _let_in(self) -> Response:
        """Give the cookie to a browser, and send it on to the page, whose address holds no token."""
        self._token = secrets.token_urlsafe(32)
        self._used()
        cookie = f"{self._cookie}; HttpOnly; SameSite=Strict; Path={self._place}/"
        # a page of this site, and no redirection: a browser that was sent here by a file would not send the cookie then
        return HTMLResponse(_sent_on(f"{self._place}/"), headers={"set-cookie": cookie, **_HEADERS})


def _same(given: str, secret: str) -> bool:
    return hmac.compare_digest(given.encode(), secret.encode())


def _sent_on(address: str) -> str:
    """Return a page that leads to an address."""
    place = html.escape(address)
    head = f'<link rel="icon" href="data:,"><meta http-equiv="refresh" content="0;url={place}">'
    return f'<!DOCTYPE html><meta charset="utf-8"><title>capsbayes</title>{head}<a href="{place}">capsbayes</a>'


def _marked(send: Any) -> Any:
    """Return the same stream of an answer, with the headers of all pages."""

    async def marked(message: Any) -> None:
        if message["type"] == "http.response.start":
            for header in _HEADERS.items():
                MutableHeaders(scope=message).append(*header)
        await send(message)

    return marked


def _capped(receive: Any) -> Any:
    """Return the same stream of a request's body, which ends where it becomes larger than is allowed."""
    seen = 0

    async def capped() -> Any:
        nonlocal seen
        message = await receive()
        if message["type"] == "http.request":
            seen += len(message.get("body", b""))
            if seen > MOST_BYTES:
                return {"type": "http.disconnect"}
        return message

    return capped


def make_private(folder: Path) -> None:
    """Make a folder private, or refuse it where that cannot be done, or where others need it, as they do ``/tmp``."""
    folder.mkdir(parents=True, exist_ok=True)
    if os.name != "posix":  # folders of a user are private there
        return
    with contextlib.suppress(PermissionError):
        if not folder.stat().st_mode & stat.S_ISVTX:
            folder.chmod(0o700)
    if folder.stat().st_mode & 0o077:
        raise InputError("app", "--folder", "a folder that only you can enter", f"{folder}, which others share")


@contextlib.contextmanager
def _file_that_leads_to(address: str, folder: Path) -> Iterator[Path]:
    """Write a page that only the user can read: other users of this machine see the command line of a browser."""
    handle, name = tempfile.mkstemp(prefix="open-", suffix=".html", dir=folder, text=True)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(_sent_on(address))
        yield Path(name)
    finally:
        Path(name).unlink(missing_ok=True)


def serve(folder: Path, port: int, opened: Callable[[str], object] | None = webbrowser.open) -> None:
    """Serve the bench on this machine until it is interrupted; port 0 is any that is free."""
    # The folder, where capsules are kept, is made private. Once pages are served, `opened` is called in a thread of its
    # own with the address of a file that leads to the page, and is removed once it did.
    with socket.socket() as listening, contextlib.ExitStack() as until_used:
        if os.name == "posix":  # elsewhere it lets another program take the port
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((LOOPBACK, port))
        except OSError as error:
            raise InputError("app", "--port", "a port that is free", f"{port}: {error.strerror}") from None
        listening.listen()  # a browser that is faster than the server waits
        bench = Bench(folder)
        make_private(bench.folder)
        app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
        app.include_router(bench.router())
        pages.on_startup(bench.measuring.start)  # that of posteriors starts with the first picture, and has time
        # priors are checked by it, which takes a second to import: the page would stand still when the first is typed
        pages.on_startup(Thread(target=import_module, args=("capsbayes.infer",), daemon=True).start)
        pages.on_shutdown(bench.stop)
        looks: dict[str, Any] = {"title": "capsbayes", "dark": None, "show_welcome_message": False, "tailwind": False}
        ui.run_with(app, root=lambda: bench_page(bench), reconnect_timeout=30.0, **looks)

        def used() -> None:
            until_used.close()
            print(f"The page was opened. To open it in another browser: {gate.address}", flush=True)

        gate = AccessControl(app, listening.getsockname()[1], used)

        def ready() -> None:
            kept = f"Capsules are kept in {bench.folder}, which only you can enter; Ctrl-C ends it."
            print(f"The bench is open at {gate.address}\n{kept}", flush=True)
            if opened is not None:
                file = until_used.enter_context(_file_that_leads_to(gate.address, bench.folder))
                Thread(target=opened, args=(file.as_uri(),), daemon=True).start()

        pages.on_startup(ready)
        config = uvicorn.Config(
            gate, log_level="error", lifespan="on", timeout_graceful_shutdown=1, server_header=False
        )
        with keeping(bench.folder):
            uvicorn.Server(config).run(sockets=[listening])
