"""The one asyncio shell: devices into the inbox, the inbox through kernel and safety, commands out to vehicles.

Every event gets its inbox number, is recorded, then stepped; nothing reaches a vehicle but through safety. The
heartbeat to the vehicles leaves from the steering loop, so that it stops when steering stops. However a mission
ends (finished, Ctrl-C, an error), the vehicles are told to hold and the recording is closed.

Ticks that come while one is still waiting are skipped: a slow moment costs resolution, never a backlog.
"""

import asyncio
import contextlib
import logging
import signal
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

from fieldkit.errors import DeviceError, DeviceTimeout, FieldkitError
from fieldkit.messages import (
    Command,
    EndMission,
    Event,
    GoTo,
    Hold,
    Operator,
    Pose,
    ReceiverState,
    Return,
    Tick,
    VehicleState,
)
from fieldkit.ports import PositionSource, Receiver, VehicleLink
from fieldkit.recording.writer import RecordingWriter
from mission.config import Mission
from mission.kernel import Kernel, Outcome, state_digest
from mission.rigs import Rig
from mission.safety import Safety

logger = logging.getLogger(__name__)

TICK_S = 0.5
BEAT_S = 1.0
BELIEF_EVERY_S = 10.0
READY_TIMEOUT_S = 60.0


@dataclass(frozen=True, slots=True)
class Progress:
    """What there is to show of a running mission."""

    elapsed_s: float
    detections: int
    kernel: Kernel
    doing: dict[str, str]
    """Robot to what it is on: "search", "resolve 3", "held: ..."."""
    notes: tuple[str, ...]
    probability_left: float = 1.0
    """That a source of the reference rate is still not found, as last looked at."""


@dataclass
class Runner:
    """One mission on one rig. `run` once."""

    mission: Mission
    rig: Rig
    recorder: RecordingWriter
    on_progress: Callable[[Progress], None] = lambda _: None
    kernel: Kernel = field(init=False)
    safety: Safety = field(init=False)
    end_reason: str = ""

    def __post_init__(self) -> None:
        self.kernel = Kernel(self.mission.kernel)
        self.safety = Safety(self.mission.safety)
        self._inbox: asyncio.Queue[tuple[int, Event]] = asyncio.Queue()
        self._number = 0
        self._tick_waits = False
        self._links = {robot: link for link in self.rig.links for robot in link.robots}
        self._placed = {robot for source in self.rig.positions for robot in source.robots}
        self._orders: dict[str, Command] = {}
        self._order_ready = {robot: asyncio.Event() for robot in self._links}
        self._doing: dict[str, str] = {}
        self._last_belief_s = -BELIEF_EVERY_S
        self._last_beat_s = -BEAT_S
        self._left = 1.0
        self._steered = False

    async def run(self) -> str:
        """Fly the mission to its end; why it ended. Raises what a device raises before the start."""
        clock = self.rig.clock
        pool = ThreadPoolExecutor(1, thread_name_prefix="kernel")
        async with contextlib.AsyncExitStack() as stack:
            stack.callback(pool.shutdown)
            for device in (*self.rig.receivers, *self.rig.links, *self.rig.positions):
                await stack.enter_async_context(device)
            tasks: list[asyncio.Task[Any]] = [
                asyncio.create_task(self._pump(self._readings(r)), name=f"receiver {r.robot}")
                for r in self.rig.receivers
            ]
            tasks += [
                asyncio.create_task(
                    self._pump(self._vehicle_events(link)), name=f"link {' '.join(link.robots)}"
                )
                for link in self.rig.links
            ]
            tasks += [
                asyncio.create_task(
                    self._pump(self._poses(source)), name=f"positions {' '.join(source.robots)}"
                )
                for source in self.rig.positions
            ]
            tasks += [asyncio.create_task(self._obey(robot), name=f"orders {robot}") for robot in self._links]
            tasks.append(asyncio.create_task(self._ticker(), name="ticker"))
            stack.push_async_callback(_cancel, tasks)
            stack.push_async_callback(self._hold_all, "the mission is over")
            start = asyncio.create_task(self._take_over(), name="start")
            tasks.append(start)
            with self._interruptible():
                while not self.end_reason:
                    get = asyncio.create_task(self._inbox.get())
                    done, _ = await asyncio.wait({get, *tasks}, return_when=asyncio.FIRST_COMPLETED)
                    for task in done - {get}:
                        tasks.remove(task)
                        if not task.cancelled() and (error := task.exception()) is not None:
                            get.cancel()
                            raise error
                    if get not in done:
                        await asyncio.wait({get})
                    t_ns, event = get.result()
                    await self._step(t_ns, event, pool)
            await self._finish(clock.now_ns())
        return self.end_reason

    # -- what comes in ---------------------------------------------------------------------------------------

    def put(self, event: Event) -> None:
        """Into the inbox, stamped with the time it arrives there."""
        self._inbox.put_nowait((self.rig.clock.now_ns(), event))

    async def _pump(self, events: AsyncIterator[Event]) -> None:
        async for event in events:
            self.put(event)

    async def _readings(self, receiver: Receiver) -> AsyncIterator[Event]:
        """A receiver that fails is down, which is a fact for the mission, not its end."""
        try:
            async for reading in receiver.readings():
                yield reading
        except DeviceError as error:
            logger.warning("%s: receiver: %s", receiver.robot, error)
            yield ReceiverState(self.rig.clock.now_ns(), receiver.robot, False, str(error))

    async def _vehicle_events(self, link: VehicleLink) -> AsyncIterator[Event]:
        """A link that fails is down for all its robots; the others go on."""
        try:
            async for event in link.events():
                if not (isinstance(event, Pose) and event.robot in self._placed):
                    yield event
        except DeviceError as error:
            logger.warning("%s: link: %s", ", ".join(link.robots), error)
            for robot in link.robots:
                yield VehicleState(self.rig.clock.now_ns(), robot, "unknown", False, False, None, str(error))

    async def _poses(self, source: PositionSource) -> AsyncIterator[Event]:
        """A source that fails leaves its robots without a position: safety holds them."""
        try:
            async for pose in source.poses():
                yield pose
        except DeviceError as error:
            logger.warning("positions of %s: %s", ", ".join(source.robots), error)
            self.recorder.note(
                "warning", f"positions of {', '.join(source.robots)}: {error}", self.rig.clock.now_ns()
            )

    async def _ticker(self) -> None:
        while True:
            if not self._tick_waits:
                self._tick_waits = True
                self.put(Tick(self.rig.clock.now_ns()))
            await self.rig.clock.sleep(TICK_S)

    @contextlib.contextmanager
    def _interruptible(self) -> Iterator[None]:
        """Ctrl-C and SIGTERM end the mission in order; a second one cancels it."""
        loop = asyncio.get_running_loop()
        this = asyncio.current_task()
        asked = False

        def interrupt() -> None:
            nonlocal asked
            if asked and this is not None:
                this.cancel()
            asked = True
            self.put(Operator(self.rig.clock.now_ns(), "end", None, "interrupted"))

        signals = [signal.SIGINT, signal.SIGTERM]
        installed = []
        for number in signals:
            with contextlib.suppress(NotImplementedError, RuntimeError, ValueError):  # Windows, other threads
                loop.add_signal_handler(number, interrupt)
                installed.append(number)
        try:
            yield
        finally:
            for number in installed:
                loop.remove_signal_handler(number)

    # -- the step --------------------------------------------------------------------------------------------

    async def _step(self, t_ns: int, event: Event, pool: ThreadPoolExecutor) -> None:
        self._number += 1
        number = self._number
        self.recorder.event(number, t_ns, event)
        if isinstance(event, Tick):
            self._tick_waits = False
            self._beat()
            # Off the loop: a long look at the belief must not delay the drivers.
            outcome = await asyncio.get_running_loop().run_in_executor(pool, self.kernel.step, event)
        else:
            outcome = self.kernel.step(event)
        for command in self.safety.observe(event):
            self._carry_out(number, t_ns, command)
        for command in outcome.commands:
            self.recorder.command(number, t_ns, command, "kernel")
            self._carry_out(number, t_ns, self.safety.allow(command))
        self._record(number, t_ns, outcome)
        if isinstance(event, Tick) or outcome.notes:
            self._show(t_ns, outcome)

    def _carry_out(self, number: int, t_ns: int, command: Command) -> None:
        self.recorder.command(number, t_ns, command, "safety")
        if isinstance(command, EndMission):
            self.end_reason = command.reason
            return
        if isinstance(command, Hold):
            self._doing[command.robot] = f"held: {command.reason}"
        self._orders[command.robot] = command
        if command.robot in self._order_ready:
            self._order_ready[command.robot].set()

    def _record(self, number: int, t_ns: int, outcome: Outcome) -> None:
        for note in outcome.notes:
            self.recorder.note("info", note, t_ns)
        for detection in outcome.detections:
            self.recorder.detection(number, t_ns, detection)
        if outcome.plan is not None:
            self.recorder.plan(number, t_ns, outcome.plan)
            self._doing.update(outcome.plan.purpose)
        elapsed_s = self.kernel.elapsed_s(t_ns)
        if outcome.detections:
            self.recorder.sources(number, t_ns, self.kernel.sources())
            self.recorder.belief(number, t_ns, digest=self.kernel.digest())
        if elapsed_s - self._last_belief_s >= BELIEF_EVERY_S:
            self._last_belief_s = elapsed_s
            self._record_belief(number, t_ns)
        if outcome.notes:
            self.recorder.flush()

    def _record_belief(self, number: int, t_ns: int) -> None:
        self._left = self.kernel.belief.probability_left()
        self.recorder.belief(
            number,
            t_ns,
            self.kernel.belief.presence(),
            cell_m=self.mission.kernel.engine.grid.cell_m,
            digest=self.kernel.digest(),
            numbers={"probability_left": self._left},
        )

    def _show(self, t_ns: int, outcome: Outcome) -> None:
        self.on_progress(
            Progress(
                self.kernel.elapsed_s(t_ns),
                self.kernel.detections,
                self.kernel,
                dict(self._doing),
                outcome.notes,
                self._left,
            )
        )

    # -- what goes out ---------------------------------------------------------------------------------------

    def _beat(self) -> None:
        now_s = self.rig.clock.elapsed_s()
        if now_s - self._last_beat_s >= BEAT_S:
            self._last_beat_s = now_s
            for link in self.rig.links:
                link.beat()

    async def _take_over(self) -> None:
        """Make every vehicle ours once it is heard and its position known."""
        deadline_s = self.rig.clock.elapsed_s() + READY_TIMEOUT_S
        while missing := [
            name for name, robot in self.kernel.robots.items() if robot.pose is None or robot.vehicle is None
        ]:
            if self.rig.clock.elapsed_s() > deadline_s:
                raise DeviceTimeout(
                    f"no telemetry from {', '.join(missing)} in {READY_TIMEOUT_S:.0f} s: is the vehicle on, does it "
                    "send to "
                    "the address in the mission file, is its system id right, has it a position fix?"
                )
            await self.rig.clock.sleep(0.2)
        self._steered = True
        async with asyncio.TaskGroup() as group:
            for robot, link in self._links.items():
                group.create_task(link.take_over(robot))

    async def _obey(self, robot: str) -> None:
        """Carry out the newest order for one robot; older ones are forgotten."""
        link, ready = self._links[robot], self._order_ready[robot]
        while True:
            await ready.wait()
            ready.clear()
            order = self._orders[robot]
            try:
                match order:
                    case GoTo(_, _, waypoint):
                        await link.goto(robot, waypoint)
                    case Hold():
                        await link.hold(robot)
                    case Return():
                        await link.return_home(robot)
                    case EndMission():
                        pass
            except DeviceError as error:
                logger.warning("%s: %s", robot, error)
                self.recorder.note(
                    "warning", f"{robot}: {type(order).__name__}: {error}", self.rig.clock.now_ns()
                )

    async def _hold_all(self, reason: str) -> None:
        """Tell every vehicle to hold, all at once; those that do not answer are named."""
        if not self._steered:
            return

        async def hold(robot: str, link: VehicleLink) -> None:
            try:
                await link.hold(robot)
            except DeviceError as error:
                logger.error("%s did not confirm that it holds: %s", robot, error)
                self.recorder.note(
                    "error", f"{robot} did not confirm that it holds: {error}", self.rig.clock.now_ns()
                )

        beating = asyncio.create_task(self._keep_beating())
        await asyncio.gather(*(hold(robot, link) for robot, link in self._links.items()))
        await _cancel([beating])
        self.recorder.note("info", f"all vehicles were told to hold: {reason}", self.rig.clock.now_ns())

    async def _keep_beating(self) -> None:
        while True:
            self._beat()
            await self.rig.clock.sleep(BEAT_S)

    async def _finish(self, t_ns: int) -> None:
        self._record_belief(self._number, t_ns)
        self.recorder.sources(self._number, t_ns, self.kernel.sources())
        self.recorder.result(self._number, t_ns, self.result())

    def result(self) -> dict[str, Any]:
        """How it ended, with the digests a replay must reproduce."""
        return {
            "end_reason": self.end_reason,
            "belief_hash": self.kernel.digest(),
            "commands_hash": self.kernel.commands_digest(),
            "state_hash": state_digest(self.kernel),
            "events": self._number,
            "detections": self.kernel.detections,
            "found_at_s": {str(ident): at_s for ident, at_s in self.kernel.found_at_s.items()},
            "interventions": self.safety.interventions,
        }


async def _cancel(tasks: list[asyncio.Task[Any]]) -> None:
    for task in tasks:
        task.cancel()
    for outcome in await asyncio.gather(*tasks, return_exceptions=True):
        if isinstance(outcome, FieldkitError):
            logger.warning("while closing: %s", outcome)
