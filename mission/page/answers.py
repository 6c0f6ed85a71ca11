"""What the page's server answers besides the page: places in other words, and the present for other maps.

    /where?east_m=..&north_m=..   a place as latitude and longitude, UTM, MGRS
    /sources.geojson              what there is now; /sources.ndjson gives it again and again, a line each
    /network.kml                  a link for Google Earth, which fetches /present.kml
    /background/NAME              pictures under the map
    /report.html                  of a recording: the report

Everything here only looks. Places where robots are and were are as open as the page itself.
"""

import asyncio
import contextlib
import json
import math
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping

from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response, StreamingResponse

from fieldkit.channel.turn import bearing_of
from fieldkit.coordinates import coordinates
from fieldkit.errors import FieldkitError
from fieldkit.geo import FieldFrame
from mission.maps import kml
from mission.maps.background import Background
from mission.maps.geojson import collection
from mission.maps.present import Present
from mission.page.protocol import FittedBearing, Where

EVERY_S = 1.0
"""Between lines of the stream; none is sent while nothing has changed."""
LONGEST_SILENCE_S = 15.0
"""After so long the same is sent once more, so that whoever listens knows that the line is alive."""
MOST_STREAMS = 16
FURTHEST_M = 1e6
MOST_HEARD = 400

Answer = Callable[[Request], Awaitable[Response]]
Report = Callable[[], bytes]


class Answers:
    """For one mission or recording. Asked in the server's loop."""

    def __init__(
        self,
        frame: FieldFrame,
        present: Callable[[], Present],
        background: Background | None = None,
        report: Report | None = None,
    ) -> None:
        """`report` makes the report, an HTML page, when it is asked for; it may take a while."""
        self._frame, self._present = frame, present
        self._report = report
        self._reporting = asyncio.Lock()
        self._pictures = {each.name: each for each in background.pictures} if background else {}
        self._streams = 0
        self._ending, self._ended = asyncio.Event(), asyncio.Event()
        self._ended.set()

    async def end(self) -> None:
        """End the streams, and return when they have ended."""
        self._ending.set()
        await self._ended.wait()

    def routes(self) -> Mapping[str, Answer]:
        """Path to what answers there."""
        return {
            **({} if self._report is None else {"/report.html": self._made_report}),
            "/where": self._where,
            "/bearing": self._bearing,
            "/sources.geojson": self._geojson,
            "/sources.ndjson": self._stream,
            "/present.kml": self._kml,
            "/network.kml": self._link,
            "/background/{name}": self._background,
        }

    def posts(self) -> Mapping[str, Answer]:
        """Nothing: all of it only looks."""
        return {}

    async def _where(self, request: Request) -> Response:
        try:
            east_m, north_m = (float(request.query_params[key]) for key in ("east_m", "north_m"))
        except (KeyError, ValueError):
            return PlainTextResponse("expected ?east_m=..&north_m=.., two numbers", 400)
        if not (abs(east_m) <= FURTHEST_M and abs(north_m) <= FURTHEST_M):
            return PlainTextResponse("too far away", 400)
        lat_deg, lon_deg, _ = self._frame.to_geodetic(east_m, north_m)
        place = coordinates(lat_deg, lon_deg)
        where: Where = {
            "metres": f"{east_m:.1f} m E, {north_m:.1f} m N",
            "lat_lon": place.lat_lon,
            "utm": place.utm,
            "mgrs": place.mgrs,
        }
        return JSONResponse(where)

    async def _bearing(self, request: Request) -> Response:
        """`?heard=HEADING:DBM,...` of one turn round."""
        try:
            pairs = [part.split(":") for part in request.query_params["heard"].split(",")[-MOST_HEARD:]]
            numbers = [(float(heading), float(dbm)) for heading, dbm in pairs]
            if not all(math.isfinite(value) for pair in numbers for value in pair):
                raise ValueError("not finite")
        except (KeyError, ValueError):
            return PlainTextResponse("expected ?heard=HEADING:DBM,HEADING:DBM, numbers", 400)
        found = bearing_of([heading for heading, _ in numbers], [dbm for _, dbm in numbers])
        bearing: FittedBearing = {
            "bearing_deg": _finite(found.bearing_deg),
            "error_90_deg": _finite(found.error_90_deg),
            "swing_db": found.swing_db,
            "why": found.why,
        }
        return JSONResponse(bearing)

    async def _background(self, request: Request) -> Response:
        picture = self._pictures.get(request.path_params["name"])
        if picture is None:
            return PlainTextResponse("there is no such picture", 404)
        return Response(picture.data, media_type=picture.media_type, headers=_KEPT)

    async def _made_report(self, request: Request) -> Response:
        assert self._report is not None
        try:
            async with self._reporting:
                page = await asyncio.to_thread(self._report)
        except (FieldkitError, OSError) as error:
            return PlainTextResponse(f"the report cannot be written: {error}", 500)
        return Response(page, media_type="text/html", headers=_FRESH)

    async def _geojson(self, request: Request) -> Response:
        return Response(_text(self._present()), media_type="application/geo+json", headers=_FRESH)

    async def _stream(self, request: Request) -> Response:
        if self._streams >= MOST_STREAMS:
            return PlainTextResponse("too many listen already", 503)
        return StreamingResponse(self._lines(), media_type="application/x-ndjson", headers=_FRESH)

    async def _lines(self) -> AsyncIterator[str]:
        self._streams += 1
        self._ended.clear()
        last_ns = -1
        silent_s = 0.0
        try:
            while not self._ending.is_set():
                now = self._present()
                if now.t_ns != last_ns or silent_s >= LONGEST_SILENCE_S:
                    last_ns, silent_s = now.t_ns, 0.0
                    yield _text(now) + "\n"
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(EVERY_S):
                        await self._ending.wait()
                silent_s += EVERY_S
        finally:
            self._streams -= 1
            if not self._streams:
                self._ended.set()

    async def _kml(self, request: Request) -> Response:
        return Response(kml.document(self._present()), media_type=kml.MEDIA_TYPE, headers=_FRESH)

    async def _link(self, request: Request) -> Response:
        address = str(request.url_for("page").replace(path="/present.kml", query="", fragment=""))
        link = kml.network_link(self._present().name, address)
        return Response(link, media_type=kml.MEDIA_TYPE, headers=_FRESH)


_KEPT = {"Cache-Control": "max-age=3600", "X-Content-Type-Options": "nosniff"}
_FRESH = {"Cache-Control": "no-store", "X-Content-Type-Options": "nosniff"}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _text(present: Present) -> str:
    return json.dumps(collection(present), separators=(",", ":"), allow_nan=False)
