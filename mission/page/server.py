"""Serves the page from a thread and an event loop of its own: no browser, slow or dead, ever delays the mission.

What the mission publishes is put into a small mailbox per browser: of the present only the newest is kept, of the
news the oldest are dropped. Commands need the token that was printed at the start, over a websocket whose origin
is this page; everybody else may look. Hosts are checked by name, so that no foreign page can reach a loopback
address by a name of its own.
"""

import asyncio
import contextlib
import errno
import hmac
import ipaddress
import logging
import os
import secrets
import socket
import threading
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self
from urllib.parse import urlsplit

import uvicorn
from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from fieldkit import settings as given
from fieldkit.errors import ConfigError
from fieldkit.look import TYPEFACES
from mission.page.commands import Question, checked_command, message_of, number_of, question_of, token_of
from mission.page.protocol import Answer, Rights, text_of

logger = logging.getLogger(__name__)

STATIC = Path(__file__).parent / "static"
FILES = TYPEFACES | {
    path.name: path for path in STATIC.iterdir() if path.suffix in (".html", ".js", ".css", ".svg")
}
NEWS_WAITING = 200
"""News kept for a browser that does not take them."""
LONGEST_MESSAGE = 16_384
MOST_VIEWERS = 64
"""Browsers at a time; of more, the one that has looked for longest without the token makes room."""
SEND_TIMEOUT_S = 10.0
"""A browser that takes nothing for this long is let go."""
LAST_WORDS_S = 2.0
"""So long the end of a mission waits for browsers to take how it ended."""
ENDING_S = 3.0
"""Streams that have not ended by then are cut off."""
UNKNOWN_HOST = "unknown host name: use the address that was printed"
HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'",
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}


class Show(Protocol):
    """What there is to see: a mission under way, or a recording."""

    def open(self, mailbox: "Mailbox") -> None:
        """A browser has come; `mailbox` takes what it is to get. In the server's loop."""
        ...

    def close(self, mailbox: "Mailbox") -> None: ...

    def asked(self, mailbox: "Mailbox", question: Question) -> None:
        """It asks for something else to see."""
        ...


class NothingLive:
    """A `Show` of nothing: what has no present."""

    def open(self, mailbox: "Mailbox") -> None:
        """Nothing is sent."""

    def close(self, mailbox: "Mailbox") -> None:
        """Nothing is kept."""

    def asked(self, mailbox: "Mailbox", question: Question) -> None:
        """Nothing is answered."""


class Answers(Protocol):
    """What is served besides the page."""

    def routes(self) -> Mapping[str, Callable[[Request], Awaitable[Response]]]:
        """Paths, and what answers there, in the server's loop."""
        ...

    def posts(self) -> Mapping[str, Callable[[Request], Awaitable[Response]]]:
        """The same for what is posted."""
        ...

    async def end(self) -> None:
        """Whatever still goes out ends."""
        ...


class Mailbox:
    """What one browser has still to get. Filled and emptied in the server's loop."""

    def __init__(self) -> None:
        self._newest: dict[str, str] = {}
        self._news: deque[str] = deque(maxlen=NEWS_WAITING)
        self._more = asyncio.Event()
        self._taken = asyncio.Event()
        self._taken.set()
        self.dropped = 0
        self.may_command = False
        """Its browser has shown the token."""
        self.let_go = False

    def put(self, slot: str, text: str) -> None:
        """Something of which only the newest counts."""
        self.dropped += slot in self._newest
        self._newest.pop(slot, None)
        self._newest[slot] = text
        self._fill()

    def add(self, text: str) -> None:
        """News, in order; the oldest are dropped."""
        self.dropped += len(self._news) == self._news.maxlen
        self._news.append(text)
        self._fill()

    async def taken(self) -> None:
        """Everything has been taken, and the last of it sent."""
        await self._taken.wait()

    async def items(self) -> AsyncIterator[str]:
        """What is there, as it comes."""
        while True:
            if not self._more.is_set():
                self._taken.set()
            await self._more.wait()
            self._more.clear()
            waiting, self._newest = self._newest, {}
            for text in waiting.values():
                yield text
            while self._news:
                yield self._news.popleft()

    def _fill(self) -> None:
        self._more.set()
        self._taken.clear()


class Page:
    """The page on a port, while used as a context manager. Raises `ConfigError` where the port is taken."""

    def __init__(
        self,
        show: Show,
        on_command: Callable[[dict[str, Any]], str] | None = None,
        *,
        host: str = given.PAGE_HOST,
        port: int = 0,
        answers: Answers | None = None,
        front: str = "page.html",
    ) -> None:
        """`on_command` is called in the server's thread with a checked command and says why it is refused, or nothing.

        None: nobody may command. `answers` serves other paths than the page's own; `front` is the file at its root.
        """
        self.token = secrets.token_urlsafe(16)
        self._show = show
        self._on_command = on_command
        self._answers, self._front = answers, front
        self._socket = _bound(host, port)
        self.host, self.port = host, int(self._socket.getsockname()[1])
        self.loop: asyncio.AbstractEventLoop | None = None
        """The server's event loop, while it runs."""
        self.clients = 0
        self._mailboxes: dict[Mailbox, WebSocket] = {}
        """The viewers, in the order in which they came."""
        self._leaving: set[asyncio.Task[None]] = set()
        self._ready = threading.Event()
        app = Starlette(
            routes=[
                WebSocketRoute("/live", self._live),
                *(
                    Route(path, self._guarded(answer))
                    for path, answer in (answers.routes() if answers else {}).items()
                ),
                *(
                    Route(path, self._guarded(answer, posted=True), methods=["POST"])
                    for path, answer in (answers.posts() if answers else {}).items()
                ),
                Route("/", self._file, name="page"),
                Route("/{name}", self._file),
            ]
        )
        config = uvicorn.Config(
            app, log_level="warning", access_log=False, lifespan="off", ws_max_size=LONGEST_MESSAGE
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)

    @property
    def commanders(self) -> int:
        """Browsers that have shown the token."""
        return sum(mailbox.may_command for mailbox in tuple(self._mailboxes))

    @property
    def is_reached_by_others(self) -> bool:
        """Whether other devices in the network reach it."""
        return self.host not in ("localhost", "::1") and not self.host.startswith("127.")

    @property
    def address(self) -> str:
        """Where to look; without the right to command."""
        shown = own_address() if self.host in ("0.0.0.0", "::") else self.host
        return f"http://{f'[{shown}]' if ':' in shown else shown}:{self.port}/"

    @property
    def command_address(self) -> str:
        """Where to look and command. The token is behind the #: browsers keep it to themselves."""
        return f"{self.address}#{self.token}"

    def __enter__(self) -> Self:
        self._thread.start()
        self._ready.wait(10.0)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.loop is not None and self._thread.is_alive():
            with contextlib.suppress(TimeoutError, RuntimeError):
                asyncio.run_coroutine_threadsafe(self._last_words(), self.loop).result(LAST_WORDS_S)
        if self._answers is not None and self.loop is not None and self._thread.is_alive():
            with contextlib.suppress(TimeoutError, RuntimeError):
                asyncio.run_coroutine_threadsafe(self._answers.end(), self.loop).result(ENDING_S)
        self._server.should_exit = True
        self._server.force_exit = True
        self._thread.join(5.0)
        self._socket.close()

    def call(self, action: Callable[[], None]) -> None:
        """Have something done in the server's loop; from any thread, without waiting."""
        if self.loop is not None:
            with contextlib.suppress(RuntimeError):  # it has just ended
                self.loop.call_soon_threadsafe(action)

    async def _last_words(self) -> None:
        await asyncio.sleep(0)  # what was handed over before is in the mailboxes then
        await asyncio.gather(*(mailbox.taken() for mailbox in self._mailboxes))

    def _run(self) -> None:
        async def serve() -> None:
            self.loop = asyncio.get_running_loop()
            self._ready.set()
            await self._server.serve(sockets=[self._socket])
            if tasks := self._server.server_state.tasks:  # told that it ends, they need a moment to do so
                await asyncio.wait(tasks, timeout=ENDING_S)

        try:
            asyncio.run(serve())
        except Exception:  # the page is not the mission: it may fail, and says so
            logger.exception("the page has stopped; the mission goes on")
        finally:
            self._ready.set()

    # -- what browsers ask for -------------------------------------------------------------------------------

    def _guarded(self, answer: Callable[[Request], Awaitable[Response]], *, posted: bool = False) -> Any:
        async def answered(request: Request) -> Response:
            host = request.headers.get("host", "")
            if not is_known_host(host, self.host):
                return PlainTextResponse(UNKNOWN_HOST, 421)
            if posted and not is_own_origin(request.headers.get("origin"), host):
                return PlainTextResponse("another page may not do this", 403)
            try:
                return await answer(request)
            except ClientDisconnect:  # whoever asked has gone in the middle of it
                return PlainTextResponse("", 400)
            except Exception as error:  # anybody may ask: not each of them may fill the terminal
                words = f"{request.url.path} could not be answered: {type(error).__name__}: {error}"
                logger.error(words, exc_info=logger.isEnabledFor(logging.INFO))
                return PlainTextResponse(words, 500)

        return answered

    async def _file(self, request: Request) -> Response:
        if not is_known_host(request.headers.get("host", ""), self.host):
            return PlainTextResponse(UNKNOWN_HOST, 421)
        path = FILES.get(request.path_params.get("name", self._front))
        if path is None:
            return PlainTextResponse("there is no such file", 404)
        return FileResponse(path, headers=HEADERS)

    async def _live(self, websocket: WebSocket) -> None:
        host = websocket.headers.get("host", "")
        if not is_known_host(host, self.host) or not is_own_origin(websocket.headers.get("origin"), host):
            await websocket.close(4403)
            return
        await websocket.accept()
        mailbox = Mailbox()
        self.clients += 1
        self._mailboxes[mailbox] = websocket
        self._make_room()
        self._show.open(mailbox)
        sending = asyncio.create_task(_send(websocket, mailbox))
        try:
            await self._receive(websocket, mailbox)
        except (WebSocketDisconnect, RuntimeError):
            pass
        finally:
            self.clients -= 1
            self._mailboxes.pop(mailbox, None)
            self._show.close(mailbox)
            sending.cancel()
            await asyncio.wait({sending})

    def _make_room(self) -> None:
        """Idle viewers never lock the operator out."""
        stay = [each for each in self._mailboxes if not each.let_go]
        looking = [each for each in stay if not each.may_command]
        if len(stay) <= MOST_VIEWERS or len(looking) < 2:  # the newest may be about to show the token
            return
        looking[0].let_go = True
        leaving = asyncio.create_task(_close(self._mailboxes[looking[0]]))
        self._leaving.add(leaving)
        leaving.add_done_callback(self._leaving.discard)

    async def _receive(self, websocket: WebSocket, mailbox: Mailbox) -> None:
        may_command = False
        while True:
            frame = await websocket.receive()
            if frame["type"] == "websocket.disconnect":
                return
            message = message_of(frame.get("text") or frame.get("bytes") or b"")
            if message.get("kind") == "token":
                mailbox.may_command = may_command = self._is_token(token_of(message))
                said: Rights = {"kind": "rights", "may_command": may_command, "wrong_token": not may_command}
                mailbox.put("rights", text_of(said))
            elif message.get("kind") == "command":
                self._command(message, may_command, mailbox)
            elif (question := question_of(message)) is not None:
                self._show.asked(mailbox, question)

    def _is_token(self, given: str) -> bool:
        if self._on_command is None:
            return False
        return hmac.compare_digest(given.encode("utf-8", "replace"), self.token.encode())

    def _command(self, message: dict[str, Any], may_command: bool, mailbox: Mailbox) -> None:
        answer: Answer = {
            "kind": "answer",
            "number": number_of(message),
            "ok": False,
            "text": "",
        }
        command = checked_command(message)
        if not may_command or self._on_command is None:
            answer["text"] = "not allowed: open the address with the token that was printed at the start"
        elif isinstance(command, str):
            answer["text"] = command
        else:
            answer["text"] = self._on_command(command)
            answer["ok"] = not answer["text"]
        mailbox.add(text_of(answer))


async def _send(websocket: WebSocket, mailbox: Mailbox) -> None:
    try:
        async for text in mailbox.items():
            # Not wait_for: before Python 3.12 it loses a cancellation that comes as it ends.
            async with asyncio.timeout(SEND_TIMEOUT_S):
                await websocket.send_text(text)
    except (WebSocketDisconnect, RuntimeError, TimeoutError, OSError):
        with contextlib.suppress(Exception):
            await websocket.close(1008)


async def _close(websocket: WebSocket) -> None:
    with contextlib.suppress(Exception):  # however it goes, it goes
        async with asyncio.timeout(SEND_TIMEOUT_S):
            await websocket.close(1013, "too many look")


def own_address() -> str:
    """An IPv4 address at which others in the network reach this machine; its own for itself where there is none."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError):
        # Nothing is sent: this asks by which interface a packet would leave.
        probe.connect(("192.0.2.1", 9))
        return str(probe.getsockname()[0])
    with contextlib.suppress(OSError):  # a network without a way out of it, as in the field
        for address in socket.gethostbyname_ex(socket.gethostname())[2]:
            if not address.startswith("127."):
                return address
    return "127.0.0.1"


def is_known_host(header: str, served: str) -> bool:
    """Whether a Host header is an address or a name of this machine: foreign names that point here are not."""
    name = urlsplit(f"//{header}").hostname or ""
    own = socket.gethostname().lower()
    if name in ("localhost", served, own, f"{own.removesuffix('.local')}.local"):
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def is_own_origin(origin: str | None, host: str) -> bool:
    """Whether a websocket was opened by this page, or by no page at all (then there is no Origin)."""
    return origin is None or origin in (f"http://{host}", f"https://{host}")


def may_be_served(host: str, port: int) -> None:
    """Raises `ConfigError` where no page can be served by now."""
    _bound(host, port).close()


def _bound(host: str, port: int) -> socket.socket:
    try:
        return socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        number = error.errno or 0  # of a name that nobody knows it is none of the system's
        why = os.strerror(number) if number in errno.errorcode else "nobody knows this name"
        remedy = {
            errno.EADDRINUSE: "is another mission running? choose another --page-port",
            errno.EACCES: "choose a --page-port above 1023",
        }.get(number, "expected an address of this computer, or 0.0.0.0 for all that it has")
        raise ConfigError(f"the page cannot be served on {host}:{port}: {why}; {remedy}") from error
