"""The shell every radio driver shares: opens its device in a worker thread, takes it back when lost."""

import asyncio
import contextlib
import logging
import math
import threading
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from types import TracebackType
from typing import Any, Self

from drivers.bounded_queue import BoundedQueue
from drivers.links import ByteLink, WatchedLink
from fieldkit.errors import DeviceError
from fieldkit.messages import ReceiverState, RssReading
from fieldkit.ports import DriverContext

logger = logging.getLogger(__name__)

REOPEN_EVERY_S = 0.5
"""Wall time between attempts to take a lost device back."""


class ReconnectingReceiver(ABC):
    """A `Receiver` around a device that may go away.

    A subclass opens and closes its device, and from its reader thread gives readings to `_give` and calls
    `_on_lost` when the device is gone. `_name` names the device in errors.
    """

    def __init__(self, robot: str, name: str, around: DriverContext) -> None:
        self.robot = robot
        self._name = name
        self._clock = around.clock
        self._tap = None if around.tap is None else partial(around.tap, robot)
        self._listening = False
        self._closed = False
        self._overrun = 0
        self._down = False
        """It counts as down though its device is open."""
        self._watched: WatchedLink | None = None
        self._unseen = 0
        self.unseen_readings = 0
        """Receptions dropped because they had waited while nobody read: nobody knows when they came."""
        self._gate = threading.Lock()
        """Keeps states and readings in order: no reading before its `up`, none after `down`."""

    @abstractmethod
    def _open_device(self, first: bool) -> str:
        """Open; what was opened, in words. In the worker thread. Raises `DeviceError`."""

    @abstractmethod
    def _close_device(self) -> None:
        """Close whatever is open. In the worker thread."""

    def _start(self) -> None:  # noqa: B027 -- most devices need nothing more
        """Called when readings are wanted: the device is open and has been announced."""

    def _watch(self, link: ByteLink) -> WatchedLink:
        """The link that a subclass reads its device by: what waits in it while this computer sleeps has no date."""
        self._watched = WatchedLink(link, self._was_away)
        return self._watched

    async def __aenter__(self) -> Self:
        self._loop = asyncio.get_running_loop()
        self._queue: BoundedQueue[RssReading | ReceiverState] = BoundedQueue()
        self._lost = asyncio.Event()
        self._worker = ThreadPoolExecutor(1, thread_name_prefix=f"receiver-{self.robot}")
        try:
            await self._in_worker(self._open_and_announce, True)
        except BaseException:
            await self._shut()
            raise
        self._reopener = asyncio.create_task(self._keep_open(), name=f"receiver-{self.robot}")
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._closed:
            return
        self._reopener.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await self._reopener
        await self._shut()

    async def readings(self) -> AsyncIterator[RssReading | ReceiverState]:
        """Readings and changes of state, in order; the first is the state after opening. For one consumer."""
        async for item in self._queue.items():
            yield item

    async def _in_worker(self, function: Callable[..., object], *arguments: Any) -> None:
        await self._loop.run_in_executor(self._worker, function, *arguments)

    async def _shut(self) -> None:
        self._closed = True
        self._listening = False
        # Queued behind whatever the worker is at, so a device opened after a cancellation is closed too.
        await asyncio.shield(asyncio.ensure_future(self._in_worker(self._close_device)))
        self._worker.shutdown(wait=True)
        self._queue.close()

    async def _keep_open(self) -> None:
        """Take the device back whenever it is lost."""
        while True:
            await self._lost.wait()
            self._lost.clear()
            logger.warning("%s: lost; trying to take it back", self._name)
            await self._in_worker(self._close_device)
            last = ""
            while not self._listening:
                await asyncio.sleep(REOPEN_EVERY_S)
                try:
                    await self._in_worker(self._open_and_announce, False)
                except Exception as error:  # whatever it answers now, it may be itself again later
                    if str(error) != last:
                        last = str(error)
                        level = logging.INFO if isinstance(error, DeviceError) else logging.WARNING
                        logger.log(level, "%s: %s", self._name, error)

    def _open_and_announce(self, first: bool) -> None:
        words = self._open_device(first)
        if self._closed:
            self._close_device()
            return
        with self._gate:
            self._put(ReceiverState(self._clock.now_ns(), self.robot, True, words))
            self._listening = True
        self._start()

    # What follows runs in the reader thread.

    def _give(self, reading: RssReading) -> None:
        """Hand over a reading; nothing before the device is announced, after it was lost, or of unknown date."""
        with self._gate:
            if not self._listening:
                return
            if self._watched is not None and not self._watched.settled:
                self._unseen += 1
                self.unseen_readings += 1
                return
            if self._unseen:
                text = f"{self._unseen} receptions that had waited unread are left out"
                logger.warning("%s: %s", self._name, text)
                self._put(ReceiverState(self._clock.now_ns(), self.robot, not self._down, text), always=True)
                self._unseen = 0
            self._put(reading)

    def _was_away(self, away_s: float) -> None:
        """Nobody has read for so long, in wall time: the silence of that time means nothing."""
        words = f"nobody read it for {away_s:.1f} s: this computer slept, was stopped, or too busy"
        logger.warning("%s: %s", self._name, words)
        now_ns, rate = self._clock.now_ns(), self._clock.rate
        since_ns = now_ns - round(away_s * rate * 1e9) if math.isfinite(rate) else now_ns
        with self._gate:
            if self._listening and not self._down:
                self._put(ReceiverState(since_ns, self.robot, False, words), always=True)
                self._put(ReceiverState(now_ns, self.robot, True, "it is read again"), always=True)

    def _on_lost(self, reason: str) -> None:
        """The device is gone: its silence means nothing from now on."""
        with self._gate:
            if not self._listening:
                return
            self._listening = False
            self._put(ReceiverState(self._clock.now_ns(), self.robot, False, reason), always=True)
        self._loop.call_soon_threadsafe(self._lost.set)

    def _put(self, item: RssReading | ReceiverState, *, always: bool = False) -> None:
        """Hand over; readings for which there is no room make the receiver count as down until there is."""
        if self._overrun:
            text = f"{self._overrun} readings lost: they came faster than they were taken"
            if self._queue.put(ReceiverState(item.t_ns, self.robot, True, text)):
                self._overrun = 0
        if self._queue.put(item, always=always):
            return
        if not self._overrun:
            text = "readings come faster than they are taken"
            self._queue.put(ReceiverState(item.t_ns, self.robot, False, text), always=True)
        self._overrun += 1
