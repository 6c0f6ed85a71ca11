"""What the editor's page asks for. All of it needs the token: drafts name ports and addresses, and are written.

    GET  /plan/state       the draft, what is wrong with it, what there is to choose from
    POST /plan/change      {form}: the draft with these values
    POST /plan/store       write the file
    GET  /plan/ground      the pictures under the map, and where they lie; /plan/ground/NAME is one of them
    GET  /plan/ports       what is plugged in; nothing is opened
    GET  /plan/heard       ?address=..: vehicles heard on a link; nothing is sent
    POST /plan/preflight   the checks before the start, of the file as stored

Ports, links and preflight are asked by commands in processes of their own: a driver that hangs hangs alone.
"""

import asyncio
import contextlib
import hmac
import json
import sys
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from fieldkit.errors import FieldkitError
from mission.maps.background import BackgroundShown, Picture
from mission.page.posted import posted
from mission.page.protocol import Failed
from mission.plan.desk import Desk
from mission.plan.protocol import Draft

Answer = Callable[[Request], Awaitable[Response]]
LISTEN_S = 3.0
PATIENCE_S = 90.0
LARGEST_FORM = 1_000_000


class PlanAnswers:
    """For one draft. `token` is known once the page is made."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self.token = ""
        self._pictures: dict[str, Picture] = {}

    def routes(self) -> Mapping[str, Answer]:
        """Path to what answers there, asked by GET."""
        return {
            "/plan/state": self._guarded(self._state),
            "/plan/ground": self._guarded(self._ground),
            "/plan/ground/{name}": self._guarded(self._picture),
            "/plan/ports": self._guarded(self._ports),
            "/plan/heard": self._guarded(self._heard),
        }

    def posts(self) -> Mapping[str, Answer]:
        """The same, asked by POST."""
        return {
            "/plan/change": self._guarded(self._change),
            "/plan/store": self._guarded(self._store),
            "/plan/preflight": self._guarded(self._preflight),
        }

    async def end(self) -> None:
        """Nothing is open."""

    def _guarded(self, answer: Answer) -> Answer:
        async def answered(request: Request) -> Response:
            given = request.headers.get("authorization", "").removeprefix("Bearer ")
            if not (self.token and hmac.compare_digest(given.encode(), self.token.encode())):
                return _refused("the token is wrong: open the address that was printed at the start", 403)
            try:
                return await answer(request)
            except (FieldkitError, ValueError, TypeError) as error:
                return _refused(str(error), 400)

        return answered

    async def _state(self, request: Request) -> Response:
        draft: Draft = {**self._desk.state(), "choices": self._desk.choices()}
        return JSONResponse(draft)

    async def _change(self, request: Request) -> Response:
        form = await posted(request, most_bytes=LARGEST_FORM)
        if not isinstance(form, dict):
            raise ValueError("expected a form")
        self._desk.change(form)
        return JSONResponse(self._desk.state())

    async def _store(self, request: Request) -> Response:
        self._desk.store()
        return JSONResponse(self._desk.state())

    async def _ground(self, request: Request) -> Response:
        background = await asyncio.to_thread(self._desk.background)
        self._pictures = {each.name: each for each in background.pictures} if background else {}
        nothing: BackgroundShown = {"credit": "", "pictures": []}
        return JSONResponse(background.described("plan/ground") if background else nothing)

    async def _picture(self, request: Request) -> Response:
        picture = self._pictures.get(request.path_params["name"])
        if picture is None:
            return _refused("there is no such picture", 404)
        return Response(picture.data, media_type=picture.media_type)

    async def _ports(self, request: Request) -> Response:
        return await _asked("devices", "--json")

    async def _heard(self, request: Request) -> Response:
        address = request.query_params.get("address", "")
        if not address or address.startswith("-"):
            raise ValueError("expected the address of a link, as udpin:0.0.0.0:14550")
        found = await _asked("vehicles", "--json", "--seconds", str(LISTEN_S), "--address", address)
        if found.status_code == 200:
            self._desk.hear(json.loads(bytes(found.body)))
        return found

    async def _preflight(self, request: Request) -> Response:
        if not self._desk.state()["stored"]:
            raise ValueError("store the file first: preflight looks at what is stored")
        return await _asked("preflight", str(self._desk.path), "--json")


async def _asked(*words: str) -> Response:
    """A fieldkit command's JSON; or what it says is wrong."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "fieldkit", *words, stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    try:
        async with asyncio.timeout(PATIENCE_S):
            out, said = await process.communicate()
    except TimeoutError:
        return _refused(f"fieldkit {words[0]}: no answer within {PATIENCE_S:g} s", 504)
    finally:
        if process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()
    plain: Any
    try:
        plain = json.loads(out)
    except ValueError:
        lines = said.decode("utf-8", "replace").strip().splitlines()
        return _refused(lines[-1] if lines else f"fieldkit {words[0]} said nothing", 502)
    return JSONResponse(plain)


def _refused(text: str, status: int) -> Response:
    failed: Failed = {"error": text}
    return JSONResponse(failed, status)
