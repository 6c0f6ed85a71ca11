"""The parent's end of an emulated field: it asks the child process, and ends it."""

import contextlib
import threading
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, Self

from fieldkit.errors import DeviceError

ASK_TIMEOUT_S = 10.0


class RunningField:
    """The parent's end of an emulated field. Close it, or use it with `with`."""

    def __init__(self, process: Any, connection: Connection, receiver_ports: dict[str, str]) -> None:
        self.receiver_ports = receiver_ports
        """Robot to the port its radio is on, as a receiver's option `port`."""
        self._process = process
        self._connection = connection
        self._lock = threading.Lock()

    def inject(self, fault: str, robot: str, value: Any = None) -> None:
        """Make something go wrong, or right again: a method of `_Faults`, or "reboot"."""
        self._ask("fault", fault, robot, value)

    def unplug(self, robot: str) -> None:
        """Pull the radio's plug."""
        self.inject("unplug", robot)

    def replug(self, robot: str) -> None:
        """Plug the radio back in, under the same port name."""
        self.inject("replug", robot)

    def silence_vehicle(self, robot: str) -> None:
        """Cut the vehicle's link in both directions."""
        self.inject("silence_vehicle", robot)

    def restore_vehicle(self, robot: str) -> None:
        """Mend the vehicle's link."""
        self.inject("restore_vehicle", robot)

    def truth(self) -> dict[str, tuple[float, float, float]]:
        """Robot to where it really is now: east, north (m), heading (deg)."""
        result: dict[str, tuple[float, float, float]] = self._ask("truth")
        return result

    def altitude(self) -> dict[str, float]:
        """Robot to its height above the ground now (m)."""
        result: dict[str, float] = self._ask("altitude")
        return result

    def counts(self) -> dict[str, Any]:
        """Transmissions per source; per robot: frames on its wire, lost ones, bytes from its host, mode."""
        result: dict[str, Any] = self._ask("counts")
        return result

    def _ask(self, *question: Any) -> Any:
        with self._lock:
            try:
                self._connection.send(question)
                if not self._connection.poll(ASK_TIMEOUT_S):
                    raise DeviceError(f"the emulated field does not answer within {ASK_TIMEOUT_S:g} s")
                answer = self._connection.recv()
            except (EOFError, OSError) as error:
                raise DeviceError(f"the emulated field has ended: {error}") from error
        if isinstance(answer, Exception):
            raise answer
        return answer

    def close(self) -> None:
        """End the child process. Closing twice is harmless."""
        with self._lock, contextlib.suppress(OSError):
            self._connection.close()
        self._process.join(5.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join(5.0)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
