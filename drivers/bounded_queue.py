"""From a driver's thread to the event loop: bounded, in order, and honest about what did not fit."""

import asyncio
import threading
from collections import deque
from collections.abc import AsyncIterator
from typing import Generic, TypeVar

Item = TypeVar("Item")


class BoundedQueue(Generic[Item]):
    """A queue with one consumer in the loop and producers in any thread.

    `put` never blocks: a reader thread that waits loses bytes in the kernel, where nobody counts them. What
    does not fit is refused, and the producer says so. Items are never None.
    """

    def __init__(self, limit: int = 50_000) -> None:
        self._limit = limit
        self._items: deque[Item] = deque()
        self._lock = threading.Lock()
        self._loop = asyncio.get_running_loop()
        self._wake = asyncio.Event()
        self._wake_pending = False
        self._closed = False

    def put(self, item: Item, *, always: bool = False) -> bool:
        """Add an item; False if there was no room for it. `always` is for the few that must not be lost."""
        with self._lock:
            if self._closed or (len(self._items) >= self._limit and not always):
                return False
            self._items.append(item)
            if self._wake_pending:
                return True
            self._wake_pending = True
        self._loop.call_soon_threadsafe(self._wake.set)
        return True

    def close(self) -> None:
        """End the consumer's iteration after what is there. From the loop's thread; twice is harmless."""
        with self._lock:
            self._closed = True
        self._wake.set()

    def close_soon(self) -> None:
        """As `close`, from any thread."""
        with self._lock:
            self._closed = True
        self._loop.call_soon_threadsafe(self._wake.set)

    async def items(self) -> AsyncIterator[Item]:
        """Items in the order they were put, until closed."""
        while True:
            with self._lock:
                item = self._items.popleft() if self._items else None
                self._wake_pending = item is not None
                closed = self._closed
                if item is None and not closed:
                    self._wake.clear()
            if item is not None:
                yield item
            elif closed:
                return
            else:
                await self._wake.wait()
