"""An event loop whose time jumps: whatever waits for time does not wait, whatever waits for a socket does.

The real asyncio code (drivers on real loopback sockets, the mission's shell) runs as fast as the processor can, and
a mission of minutes comes out the same each time. `clock` is the mission clock that goes with it.
"""

import asyncio
import selectors
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

Result = TypeVar("Result")
PATIENCE_S = 0.05
"""Wall seconds to wait for a socket where no time is waited for at all."""


class _Jumping(selectors.BaseSelector):
    """A selector that moves its loop's time on instead of sleeping."""

    def __init__(self) -> None:
        self._real = selectors.DefaultSelector()
        self.now_s = 0.0

    def select(self, timeout: float | None = None) -> list[Any]:
        ready = self._real.select(0)
        if ready or (timeout is not None and timeout <= 0):
            return ready
        if timeout is None:
            return self._real.select(PATIENCE_S)
        self.now_s += timeout
        return []

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        return self._real.register(fileobj, events, data)

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:
        return self._real.unregister(fileobj)

    def modify(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        return self._real.modify(fileobj, events, data)

    def get_map(self) -> Any:
        return self._real.get_map()

    def close(self) -> None:
        self._real.close()


class JumpLoop(asyncio.SelectorEventLoop):
    """See the module. Work for threads is done at once, in this thread: it takes no time."""

    def __init__(self) -> None:
        self._jumping = _Jumping()
        super().__init__(self._jumping)

    def time(self) -> float:
        return self._jumping.now_s

    def run_in_executor(self, executor: Any, func: Callable[..., Any], *args: Any) -> "asyncio.Future[Any]":  # type: ignore[override]
        done = self.create_future()
        try:
            done.set_result(func(*args))
        except Exception as error:
            done.set_exception(error)
        return done


class LoopClock:
    """Mission time by the running loop's time, from `start_ns` (UTC) on."""

    rate = 1.0

    def __init__(self, start_ns: int) -> None:
        self.start_ns = start_ns

    def now_ns(self) -> int:
        return self.start_ns + round(self.elapsed_s() * 1e9)

    def elapsed_s(self) -> float:
        return asyncio.get_running_loop().time()

    async def sleep(self, duration_s: float) -> None:
        await asyncio.sleep(max(0.0, duration_s))


def run(main: Coroutine[Any, Any, Result]) -> Result:
    """`asyncio.run` on a loop whose time jumps."""
    with asyncio.Runner(loop_factory=JumpLoop) as runner:
        return runner.run(main)
