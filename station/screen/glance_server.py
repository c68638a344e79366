"""The glance page's server, a process of its own: `python -m station.screen.glance_server SOCKET`, read-only.

It reads lines of JSON from its standard input and hands the newest to each page as server-sent events. A page that does
not take it is skipped, and after a while dropped. It ends when the station closes the pipe.
"""

from __future__ import annotations

import asyncio
import hmac
import logging
import os
import resource
import socket
import sys
from http import HTTPStatus
from pathlib import Path
from typing import IO, Any, Final

from tornado import iostream, web
from tornado.httpserver import HTTPServer

MOST_PAGES: Final = 16
STUCK_S: Final = 5.0
"""A page that has not taken a message for so long is dropped; it comes back by itself."""
SILENT_S: Final = 1.0
"""Without news from the station, an empty line tells a page that its connection holds."""
IDLE_S: Final = 10.0
SEND_BUFFER: Final = 32768
"""Bytes: some messages. What waits in it on a slow network grows old there."""
MOST_HEAD: Final = 8192
MOST_FILES: Final = 128
"""Open at once: more connections wait, however many knock."""
LINE_LIMIT: Final = 4 * 2**20
COOKIE_DAYS: Final = 1
FILES: Final = {"": ("index.html", "text/html"), "glance.js": ("glance.js", "text/javascript"),
                "glance.css": ("glance.css", "text/css")}  # fmt: skip
POLICY: Final = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:"
REFUSED: Final = (
    "<!doctype html><meta name=viewport content='width=device-width'><title>station</title>"
    "<h1>Not without the token</h1><p>Open the address that the station printed, with <code>?token=</code> in it."
)


class Newest:
    """The newest message, and who waits for it."""

    def __init__(self) -> None:
        self.line = b""
        self.number = 0
        self.pages = 0
        self.ended = False
        self._taken_s = 0.0
        self._news = asyncio.Event()

    def take(self, line: bytes) -> None:
        self.line, self.number, self._taken_s = line, self.number + 1, asyncio.get_running_loop().time()
        self._wake()

    def end(self) -> None:
        self.ended = True
        self._wake()

    def _wake(self) -> None:
        waiting, self._news = self._news, asyncio.Event()
        waiting.set()

    def message(self) -> bytes:
        """The line, and how long it has been here: none that is old looks new to a page that has just come."""
        held_s = asyncio.get_running_loop().time() - self._taken_s
        return b'data: {"held_s":%.2f,"shown":%s}\n\n' % (held_s, self.line)

    async def after(self, number: int) -> None:
        """Until there is a newer one than that, or the end, or for SILENT_S."""
        if self.number == number and not self.ended:
            try:
                await asyncio.wait_for(self._news.wait(), SILENT_S)
            except TimeoutError:
                return


class Guarded(web.RequestHandler):
    """Only who has the token comes in; on loopback, where there is none, only who asks for loopback by name."""

    def initialize(self, token: str, cookie: str, newest: Newest, files: dict[str, bytes]) -> None:
        self.token, self.cookie, self.newest, self.files = token, cookie, newest, files

    def set_default_headers(self) -> None:
        for name, value in (
            ("Content-Security-Policy", POLICY + "; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"),
            ("Cache-Control", "no-store"),
            ("Referrer-Policy", "no-referrer"),
            ("X-Content-Type-Options", "nosniff"),
        ):
            self.set_header(name, value)
        self.clear_header("Server")

    def prepare(self) -> None:
        if self.request.method != "GET":
            raise web.HTTPError(HTTPStatus.METHOD_NOT_ALLOWED)
        if not self.token:
            # A page of another site can have its own name lead here; it cannot have a browser ask for ours.
            if self.request.host_name not in ("127.0.0.1", "localhost", "[::1]", "::1"):
                raise web.HTTPError(HTTPStatus.FORBIDDEN)
            return
        given = [self.get_query_argument("token", ""), self.get_cookie(self.cookie) or ""]
        given.append(self.request.headers.get("Authorization", "").removeprefix("Bearer "))
        if not any(hmac.compare_digest(one.encode(), self.token.encode()) for one in given):
            raise web.HTTPError(HTTPStatus.FORBIDDEN)

    def write_error(self, status_code: int, **_: Any) -> None:
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.finish(REFUSED if status_code == HTTPStatus.FORBIDDEN and self.token else f"{status_code}")


class PageFile(Guarded):
    def get(self, name: str) -> None:
        if name not in self.files:
            raise web.HTTPError(HTTPStatus.NOT_FOUND)
        if self.token and self.get_query_argument("token", ""):
            # Out of the address bar and the history; the page's own requests bring the cookie.
            self.set_cookie(self.cookie, self.token, httponly=True, samesite="Strict", expires_days=COOKIE_DAYS)
            self.redirect("./")
            return
        self.set_header("Content-Type", f"{FILES[name][1]}; charset=utf-8")
        self.finish(self.files[name])


class Live(Guarded):
    async def get(self) -> None:
        newest = self.newest
        if newest.pages >= MOST_PAGES:
            raise web.HTTPError(HTTPStatus.SERVICE_UNAVAILABLE)
        newest.pages += 1
        try:
            await self._tell(newest)
        except (TimeoutError, iostream.StreamClosedError):
            self._drop()
        finally:
            newest.pages -= 1

    async def _tell(self, newest: Newest) -> None:
        self.set_header("Content-Type", "text/event-stream")
        self.set_header("X-Accel-Buffering", "no")  # nginx, as a reverse proxy
        self.write(b"retry: 1000\n\n")
        told = 0
        while not newest.ended:
            if newest.number != told:
                told = newest.number
                self.write(newest.message())
            else:
                self.write(b":\n\n")
            await asyncio.wait_for(self.flush(), STUCK_S)
            await newest.after(told)
        self.write(b"event: ended\ndata: {}\n\n")
        await asyncio.wait_for(self.flush(), STUCK_S)

    def _drop(self) -> None:
        stream = self.request.connection.stream  # type: ignore[union-attr]
        if not stream.closed():
            stream.close()


async def serve(listener: socket.socket, token: str, pipe: IO[Any]) -> None:
    """Hand out what comes through the pipe until it closes."""
    folder = Path(__file__).with_name("glance")
    files = {name: (folder / file).read_bytes() for name, (file, _) in FILES.items()}
    newest = Newest()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)  # those that it accepts inherit it
    # A browser keeps one set of cookies for all ports of an address.
    more = {"token": token, "cookie": f"station-{listener.getsockname()[1]}", "newest": newest, "files": files}
    application = web.Application([(r"/live", Live, more), (r"/([\w.]*)", PageFile, more)])
    application.settings["log_function"] = lambda _: None
    server = HTTPServer(application, max_header_size=MOST_HEAD, max_body_size=0, idle_connection_timeout=IDLE_S)
    server.add_socket(listener)
    reader = asyncio.StreamReader(limit=LINE_LIMIT)
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), pipe)
    while line := await reader.readline():
        newest.take(line.rstrip())
    newest.end()
    server.stop()
    await asyncio.sleep(0.2)  # for the pages to be told
    await server.close_all_connections()


def main() -> None:
    logging.disable()
    resource.setrlimit(resource.RLIMIT_NOFILE, (MOST_FILES, MOST_FILES))
    asyncio.run(serve(socket.socket(fileno=int(sys.argv[1])), os.environ.pop("STATION_TOKEN", ""), sys.stdin))


if __name__ == "__main__":
    main()
