"""The server of the bench: on this machine alone, behind a token in the address, with a cap on what is uploaded."""

from __future__ import annotations

import hmac
import secrets
import socket
import webbrowser
from collections.abc import Callable
from http.cookies import CookieError, SimpleCookie
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

import uvicorn
from fastapi import FastAPI
from nicegui import app as pages
from nicegui import ui

from capsbayes.app.desk import MOST_BYTES, Bench
from capsbayes.app.page import bench_page
from capsbayes.errors import InputError
from capsbayes.interruption import keeping

LOOPBACK = "127.0.0.1"
_HEADERS = [
    (b"cache-control", b"no-store"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"SAMEORIGIN"),
    (
        b"content-security-policy",
        b"default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; connect-src 'self' ws:; form-action 'self'",
    ),
]


class Gate:
    """What stands before the pages: it refuses whoever does not know the token, other hosts, and too large uploads.

    Parameters
    ----------
    app : ASGI application
    token : str
    port : int
    """

    def __init__(self, app: Any, token: str, port: int) -> None:
        self._app, self._token, self._port = app, token, port
        self._cookie = f"capsbayes-{port}"  # cookies do not tell ports apart

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Answer a request, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {name.lower(): value.decode("latin-1") for name, value in scope["headers"]}
        asked = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]
        brings = self._same(asked)
        if not (brings or self._same(self._kept(headers))) or not self._is_here(headers):
            await _refuse(scope, send, 403, "This page is opened by the address that capsbayes app printed.")
        elif int(headers.get(b"content-length", "0") or 0) > MOST_BYTES:
            await _refuse(scope, send, 413, f"At most {MOST_BYTES >> 20} MB.")
        else:
            await self._app(scope, _capped(receive), self._marked(send, brings))

    def _same(self, token: str) -> bool:
        return hmac.compare_digest(token.encode(), self._token.encode())

    def _kept(self, headers: dict[bytes, str]) -> str:
        try:
            kept = SimpleCookie(headers.get(b"cookie", "")).get(self._cookie)
        except CookieError:
            return ""
        return "" if kept is None else kept.value

    def _is_here(self, headers: dict[bytes, str]) -> bool:
        """Refuse the name of another host, by which a foreign page would reach this one, and requests of such pages."""
        here = {f"{name}:{self._port}" for name in (LOOPBACK, "localhost")}
        origin = headers.get(b"origin", "")
        return headers.get(b"host", "") in here and (not origin or origin.removeprefix("http://") in here)

    def _marked(self, send: Any, brings: bool) -> Any:
        async def marked(message: Any) -> None:
            if message["type"] == "http.response.start":
                kept = [(name, value) for name, value in message.get("headers", []) if name.lower() != b"cache-control"]
                cookie = f"{self._cookie}={self._token}; HttpOnly; SameSite=Strict; Path=/"
                more = [(b"set-cookie", cookie.encode())] if brings else []
                message = {**message, "headers": [*kept, *_HEADERS, *more]}
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


async def _refuse(scope: Any, send: Any, status: int, reason: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008})
        return
    headers = [(b"content-type", b"text/plain; charset=utf-8")]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": reason.encode()})


def made(bench: Bench, token: str, port: int) -> Gate:
    """Return the application that serves a bench."""
    inner = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    inner.include_router(bench.router())
    pages.on_startup(bench.start)
    pages.on_shutdown(bench.stop)
    ui.run_with(
        inner,
        root=lambda: bench_page(bench),
        title="capsbayes",
        dark=None,
        show_welcome_message=False,
        tailwind=False,
        reconnect_timeout=30.0,
    )
    return Gate(inner, token, port)


def serve(folder: Path, port: int, opened: Callable[[str], object] | None = webbrowser.open) -> None:
    """Serve the bench on this machine until it is interrupted.

    Parameters
    ----------
    folder : Path
        Where capsules are kept.
    port : int
        0 for any that is free.
    opened : function of the address, optional
        Called once pages are served.

    Raises
    ------
    InputError
        If the port is taken.
    """
    with socket.socket() as listening:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((LOOPBACK, port))
        except OSError as error:
            raise InputError("app", "--port", "a port that is free", f"{port}: {error.strerror}") from None
        port, token = listening.getsockname()[1], secrets.token_urlsafe(32)
        address = f"http://{LOOPBACK}:{port}/?token={token}"
        bench = Bench(folder)
        gate = made(bench, token, port)

        def ready() -> None:
            print(f"The bench is open at {address}\nCapsules are kept in {bench.folder}; Ctrl-C ends it.", flush=True)
            if opened is not None:
                opened(address)

        pages.on_startup(ready)
        config = uvicorn.Config(
            gate, log_level="error", lifespan="on", timeout_graceful_shutdown=1, server_header=False
        )
        with keeping(bench.folder):
            uvicorn.Server(config).run(sockets=[listening])
