"""The one asyncio shell: devices into the inbox, the inbox through kernel and safety, commands out to vehicles.

Every event gets its inbox number, is recorded, then stepped; nothing reaches a vehicle but through safety. The
heartbeat to the vehicles leaves from the steering loop, so that it stops when steering stops. However a mission
ends (finished, Ctrl-C, an error), the vehicles are told to hold and the recording is closed.

The dispatcher acts on the vehicles, the recorder writes down. A robot for which safety calls the
operator is withdrawn: that too goes through the inbox, so that a replay knows it.

Ticks that come while one is still waiting are skipped: a slow moment costs resolution, never a backlog.
"""

import asyncio
import contextlib
import logging
import signal
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from fieldkit.errors import (
    ConfigError,
    DeviceError,
    DeviceTimeout,
    FieldkitError,
    RecordingError,
    ReplayMismatch,
    VehicleRefused,
)
from fieldkit.messages import (
    CallOperator,
    Command,
    EndMission,
    Event,
    Hold,
    Operator,
    Pose,
    ReceiverState,
    RssReading,
    Tick,
    VehicleState,
)
from fieldkit.ports import PositionSource, Receiver, VehicleLink
from fieldkit.recording.reader import Step
from fieldkit.recording.writer import RecordingWriter
from mission.core.kernel import Kernel, Outcome, state_digest
from mission.core.mission_file import Mission
from mission.safety.rules import Safety
from mission.shell.dispatcher import RELEASE, TAKE_OVER, Helm
from mission.shell.preflight import judge_places, refused
from mission.shell.recorder import Follower, Journal
from mission.shell.setups import Rig
from mission.shell.vehicle_fences import VehicleFences, demands_of

logger = logging.getLogger(__name__)

TICK_S = 0.5
DUE_SLACK_S = 0.002
"""Receptions this near to each other are looked at together."""
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
    followers: tuple[Follower, ...] = ()
    """Told everything that is recorded, after it is recorded."""
    override: str = ""
    """Why the mission may start although a vehicle's check is red; typed by the operator."""
    kernel: Kernel = field(init=False)
    safety: Safety = field(init=False)
    end_reason: str = ""

    def __post_init__(self) -> None:
        self.kernel = Kernel(self.mission.kernel)
        self.safety = Safety(self.mission.safety)
        self._inbox: asyncio.Queue[tuple[int, int, Event] | BaseException] = asyncio.Queue()
        self._number = 0
        self._stepped = 0
        self._tick_waits = False
        self._due_s: deque[float] = deque()
        """Event loop's times at which a reception can be looked at, in order."""
        self._due_timer: asyncio.TimerHandle | None = None
        self.journal = Journal(
            self.kernel, self.mission.kernel.engine.grid.cell_m, self.recorder, *self.followers
        )
        self.helm = Helm(self.rig.links, self.rig.clock, self._note)
        self.fences = VehicleFences(self.mission, self.helm.link_of, self._note)
        self._placed = {robot for source in self.rig.positions for robot in source.robots}
        self._doing: dict[str, str] = {}
        self._steered = False
        self._resumed_ns = 0
        """When the last event of an interrupted mission came; 0: this one begins."""

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
            tasks += self.helm.tasks()
            stack.push_async_callback(_cancel, tasks)
            stack.push_async_callback(self._leave)
            if self._resumed_ns:
                self._interrupted()
            tasks.append(asyncio.create_task(self._start(), name="start"))
            for task in tasks:
                task.add_done_callback(partial(self._over, tasks))
            with self._interruptible():
                while not self.end_reason:
                    await self._step(*await self._next(), pool)
            await self._finish(clock.now_ns())
        return self.end_reason

    async def _next(self) -> tuple[int, int, Event]:
        """What comes next out of the inbox. Raises what one of the tasks has raised."""
        came = await self._inbox.get()
        if isinstance(came, BaseException):
            raise came
        return came

    def _over(self, tasks: list[asyncio.Task[Any]], task: asyncio.Task[Any]) -> None:
        """What ended a task goes through the inbox: waiting for all tasks at every event would cost more than it."""
        if not task.cancelled() and (error := task.exception()) is not None:
            tasks.remove(task)  # `_cancel` need not report it once more
            self._inbox.put_nowait(error)

    # -- what comes in ---------------------------------------------------------------------------------------

    def put(self, event: Event) -> None:
        """Into the inbox, stamped with the time it arrives there. A hold by the operator goes out at once."""
        if isinstance(event, Operator) and event.action == "hold":
            self.helm.freeze(self._meant(event), event.t_ns, event.reason or "operator: hold")
        t_ns = self.rig.clock.now_ns()
        self._number += 1
        # At once: what waits here while the kernel is busy must survive a kill as well.
        self.journal.event(self._number, t_ns, event)
        self._inbox.put_nowait((self._number, t_ns, event))
        if isinstance(event, RssReading):
            self._tick_when_due()

    def _tick_when_due(self) -> None:
        """Where receptions are joined quickly, look as soon as this one can be: not at the next regular tick."""
        settings = self.mission.kernel
        wait_s = settings.association_window_s + settings.association_lateness_s
        if wait_s >= TICK_S:
            return
        now_s = asyncio.get_running_loop().time()
        if not self._due_s or now_s + wait_s / self.rig.clock.rate > self._due_s[-1]:
            self._due_s.append(now_s + (wait_s + DUE_SLACK_S) / self.rig.clock.rate)
            self._tick_if_due()

    def _tick_if_due(self) -> None:
        """Look if something can be looked at, and see to it that this is asked again when the next can be.

        Not while a tick waits already: its time may be too early for what came meanwhile.
        """
        if self._due_timer is not None:
            self._due_timer.cancel()
            self._due_timer = None
        if not self._due_s or self._tick_waits:
            return
        loop = asyncio.get_running_loop()
        if self._due_s[0] > loop.time():
            self._due_timer = loop.call_at(self._due_s[0], self._tick_if_due)
        elif self.kernel.started_ns is None:
            self._due_s.clear()
        else:
            self._tick()

    def _tick(self) -> None:
        """A tick into the inbox, unless one waits there."""
        if self._tick_waits:
            return
        self._tick_waits = True
        now_s = asyncio.get_running_loop().time()
        while self._due_s and self._due_s[0] <= now_s:
            self._due_s.popleft()
        self.put(Tick(self.rig.clock.now_ns()))

    def _meant(self, event: Operator) -> list[str]:
        return [robot for robot in self.helm.link_of if event.robot in (None, robot)]

    def _note(self, level: str, text: str) -> None:
        self.journal.note(level, text, self.rig.clock.now_ns())

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
            self._note("warning", f"positions of {', '.join(source.robots)}: {error}")

    async def _start(self) -> None:
        """Vehicles first, then time: the mission's first tick finds every robot ready to be sent somewhere."""
        async with self.helm.beating():
            await self._take_over()
        while True:
            self._tick()
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

    async def _step(self, number: int, t_ns: int, event: Event, pool: ThreadPoolExecutor) -> None:
        self._stepped = number
        if isinstance(event, Tick):
            self._tick_waits = False
            self._tick_if_due()
            self.helm.beat()
            outcome = await self._think(event, pool)
        else:
            outcome = self.kernel.step(event)
        for command in self._judge(number, t_ns, event, outcome):
            self._carry_out(command)
        if isinstance(event, Operator):
            self._obey_operator(event)
        if isinstance(event, Tick) or outcome.notes:
            self._show(t_ns, outcome)

    def _judge(self, number: int, t_ns: int, event: Event, outcome: Outcome) -> list[Command]:
        """What is to be carried out, all of it written down."""
        commands = self.safety.observe(event)
        for command in commands:
            self.journal.command(number, t_ns, command, "safety")
        for asked, allowed in zip(outcome.commands, self.safety.judge(outcome.commands), strict=True):
            self.journal.command(number, t_ns, asked, "kernel")
            self.journal.command(number, t_ns, allowed, "safety")
            commands.append(allowed)
        self.journal.outcome(number, t_ns, outcome)
        if outcome.plan is not None:
            self._doing.update(outcome.plan.purpose)
        return commands

    def relive(self, past: Iterable[Step]) -> None:
        """Go through what an interrupted mission has recorded, into the new recording, without moving anything.

        Raises `ReplayMismatch` where the belief comes out differently, `RecordingError` where events are missing.
        """
        for step in past:
            self._number += 1
            if step.inbox_number != self._number:
                raise RecordingError(
                    f"event {self._number} is missing from the recording (the next is {step.inbox_number}): "
                    "it cannot be resumed; start anew"
                )
            self.journal.event(self._number, step.log_time_ns, step.event)
            outcome = self.kernel.step(step.event)
            self._judge(self._number, step.log_time_ns, step.event, outcome)
            if step.digest and step.digest != self.kernel.digest():
                raise ReplayMismatch(
                    f"after event {self._number} the belief differs from the recorded one; was the recording "
                    "made by another version of fieldkit?"
                )
            self._resumed_ns = step.log_time_ns

    def _interrupted(self) -> None:
        """The time between: nobody listened, and whoever was called for is still needed."""
        now_ns = self.rig.clock.now_ns()
        if self._resumed_ns > now_ns:
            raise ConfigError(
                "this computer's clock is behind the recording's end: set it before resuming the mission"
            )
        self._note("info", f"resumed after {(now_ns - self._resumed_ns) * 1e-9:.1f} s")
        for receiver in self.rig.receivers:
            self.put(ReceiverState(self._resumed_ns, receiver.robot, False, "the mission was interrupted"))
            self.put(ReceiverState(now_ns, receiver.robot, True, "the mission goes on"))
        for name in self.helm.link_of:  # what it was doing then says nothing of now
            self.put(VehicleState(self._resumed_ns, name, "unknown", False, False, None, "not heard since"))
        for name, robot in self.safety.robots.items():
            if robot.called and not robot.ordered:
                self.put(Operator(now_ns, "withdraw", name, "called for before the interruption"))

    async def _think(self, tick: Tick, pool: ThreadPoolExecutor) -> Outcome:
        """Off the loop: a long look at the belief must not delay the drivers. A too long one holds everybody."""
        thinking = asyncio.get_running_loop().run_in_executor(pool, self.kernel.step, tick)
        limit_s = self.mission.safety.overrun_s
        await asyncio.wait({thinking}, timeout=limit_s / self.rig.clock.rate)
        if not thinking.done():
            reason = f"the steering loop is late: one step has taken {limit_s:g} s"
            self._note("warning", f"{reason}; all robots hold")
            with self.helm.frozen(tick.t_ns, reason):
                await asyncio.wait({thinking})
        return await thinking

    def _obey_operator(self, event: Operator) -> None:
        """What the operator's word means for the vehicles beyond the commands it led to."""
        robots = self._meant(event)
        if event.action == "hold":
            self.helm.thaw(robots)
        for robot in robots:
            vehicle = self.safety.robots[robot].vehicle
            if event.action == "resume" and (vehicle is None or vehicle.mode != "guided"):
                # A vehicle that its own failsafe, or somebody else, has had must be taken over anew.
                self.helm.order(robot, TAKE_OVER)
            elif event.action == "release":
                self.helm.order(robot, RELEASE)

    def _carry_out(self, command: Command) -> None:
        if isinstance(command, EndMission):
            self.end_reason = command.reason
            return
        if isinstance(command, CallOperator):
            self._doing[command.robot] = f"needs the operator: {command.reason}"
            self._note("warning", f"{command.robot} needs the operator: {command.reason}")
            self.put(Operator(self.rig.clock.now_ns(), "withdraw", command.robot, command.reason))
        elif isinstance(command, Hold):
            self._doing[command.robot] = f"held: {command.reason}"
        self.helm.order(command.robot, command)

    def _show(self, t_ns: int, outcome: Outcome) -> None:
        self.on_progress(
            Progress(
                self.kernel.elapsed_s(t_ns),
                self.kernel.detections,
                self.kernel,
                dict(self._doing),
                outcome.notes,
                self.journal.left,
            )
        )

    # -- what goes out ---------------------------------------------------------------------------------------

    async def _take_over(self) -> None:
        """Make every vehicle ours once it is heard and its position known."""
        absent = await self._wait_for_all()
        await self._inspect(absent)
        self._steered = True
        if not self._resumed_ns:
            await self.helm.take_over()
            return
        # What was armed is adopted; what is not, or stands under an order, waits for the operator.
        waits = dict.fromkeys(absent, "nothing is heard of it") | {
            name: "it is disarmed"
            for name, robot in self.kernel.robots.items()
            if name not in absent and robot.vehicle is not None and not robot.vehicle.armed
        }
        ordered = {name for name, robot in self.safety.robots.items() if robot.ordered}
        await self.helm.take_over([name for name in self.safety.robots if name not in ordered | waits.keys()])
        for name, why in waits.items():
            self.put(Operator(self.rig.clock.now_ns(), "withdraw", name, why))

    async def _wait_for_all(self) -> set[str]:
        """Robots still not heard when the time to wait is over: none before a start; a resumed mission goes on without.

        Raises `DeviceTimeout` where it cannot.
        """
        deadline_s = self.rig.clock.elapsed_s() + READY_TIMEOUT_S
        while missing := [
            name
            for name, robot in self.kernel.robots.items()
            if robot.pose is None
            or robot.vehicle is None
            or min(robot.pose.t_ns, robot.vehicle.t_ns) <= self._resumed_ns
        ]:
            if self.rig.clock.elapsed_s() > deadline_s:
                text = (
                    f"no telemetry from {', '.join(missing)} in {READY_TIMEOUT_S:.0f} s: is the vehicle on, does it "
                    "send to the address in the mission file, are its system id and signing key right, has it a "
                    "position fix?"
                )
                if not self._resumed_ns or len(missing) == len(self.kernel.robots):
                    raise DeviceTimeout(text)
                self._note("warning", f"{text} The mission goes on without")
                break
            await self.rig.clock.sleep(0.2)
            self.recorder.maybe_flush(self.rig.clock.now_ns())  # silence is no step of the clock
        return set(missing)

    async def _inspect(self, absent: set[str]) -> None:
        """Vehicles that would not stop by themselves, or are unfit otherwise, keep the mission from starting."""
        present = {robot: link for robot, link in self.helm.link_of.items() if robot not in absent}
        checks = await self.fences.put(list(present))
        asked = [link.inspect(robot, demands_of(self.mission)) for robot, link in present.items()]
        checks += [check for found in await asyncio.gather(*asked) for check in found]
        poses = {name: robot.pose for name, robot in self.kernel.robots.items() if robot.pose is not None}
        checks += [check for check in judge_places(self.mission, poses) if check.robot not in absent]
        for check in checks:
            if check.level != "green":
                self._note("warning", f"{check.robot}: {check.name} {check.level}: {check.found}")
        if not (reasons := refused(checks)):
            return
        if not self.override:
            raise VehicleRefused(
                f"the vehicles are not fit to start, nothing has moved:\n{reasons}\n"
                "Mend that, or give a reason to start all the same: --override 'why it is safe'"
            )
        self._note("warning", f"started in spite of red checks: {self.override}")

    async def _leave(self) -> None:
        """However it ends: everybody holds."""
        if self._steered:
            await self.helm.hold_all("the mission is over")
        await self.fences.restore()

    async def _finish(self, t_ns: int) -> None:
        self.journal.end(self._stepped, t_ns)
        self.recorder.result(self._stepped, t_ns, self.result())

    def result(self) -> dict[str, Any]:
        """How it ended, with the digests a replay must reproduce."""
        return {
            "end_reason": self.end_reason,
            "belief_hash": self.kernel.digest(),
            "commands_hash": self.kernel.commands_digest(),
            "state_hash": state_digest(self.kernel),
            "events": self._stepped,
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
