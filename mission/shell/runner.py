"""The one asyncio shell: devices into the inbox, the inbox through kernel and safety, commands out to vehicles.

Every event gets its inbox number, is recorded, then stepped; nothing reaches a vehicle but through safety and the
dispatcher. The heartbeat to the vehicles leaves from the steering loop, so that it stops when steering stops. However
a mission ends (finished, a signal, an error), the vehicles are ordered to hold until they show it, those that do not
are named, and the recording is closed.

A robot for which safety calls the operator is withdrawn: that too goes through the inbox, so that a replay knows it.
"""

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from fieldkit.errors import ConfigError, RecordingError, ReplayMismatch
from fieldkit.messages import (
    CallOperator,
    Command,
    EndMission,
    Event,
    Hold,
    Operator,
    ReceiverState,
    RssReading,
    Tick,
    VehicleState,
)
from fieldkit.recording.reader import Step
from fieldkit.recording.writer import RecordingWriter
from fieldkit.settings import TICK_S
from mission.core.fleet import Robot
from mission.core.kernel import NOTHING, Kernel, Outcome, state_digest
from mission.core.mission_file import Mission
from mission.safety.rules import Safety
from mission.shell.alarms import alarms_shown, late_stops
from mission.shell.dispatcher import ACQUIRE, RELEASE, Dispatcher
from mission.shell.intake import end_tasks, streams_of
from mission.shell.landing import Landing
from mission.shell.progress import Progress
from mission.shell.recorder import Follower, Look, MissionRecorder
from mission.shell.setups import Setup
from mission.shell.signals import WHY, StopSignals
from mission.shell.start import Start
from mission.shell.ticks import Ticks
from mission.shell.vehicle_fences import VehicleFences

logger = logging.getLogger(__name__)

SLEPT_S = 1.0
"""So much later than its time a tick may be, in wall time, before this computer is taken to have slept."""
WAKING_S = 0.15
"""Wall time that devices have to say that this computer slept, before the silence of that time is thought about."""


@dataclass
class Runner:
    """One mission on one setup. `run` once."""

    mission: Mission
    setup: Setup
    recorder: RecordingWriter
    on_progress: Callable[[Progress], None] = lambda _: None
    followers: tuple[Follower, ...] = ()
    """Told everything that is recorded, after it is recorded."""
    override: str = ""
    """Why the mission may start although a vehicle's check is red; typed by the operator."""
    kernel: Kernel = field(init=False)
    safety: Safety = field(init=False)
    end_reason: str = ""
    begun: bool = False
    """Whether anything has come in that was not recorded by an earlier mission."""

    def __post_init__(self) -> None:
        self.kernel, self.safety = self.minds()
        self._inbox: asyncio.Queue[tuple[int, int, Event] | BaseException] = asyncio.Queue()
        self._number = 0
        self._stepped = 0
        self._frozen_for: dict[int, list[str]] = {}
        """Numbers of events that stopped robots before they were stepped, and which."""
        kernel = self.mission.kernel
        self._ticks = Ticks(
            put=lambda: self.put(Tick(self.setup.clock.now_ns())),
            has_begun=lambda: self.kernel.started_ns is not None,
            reception_due_s=kernel.association_window_s + kernel.association_lateness_s,
            rate=self.setup.clock.rate,
        )
        self.records = MissionRecorder(self.kernel, kernel.engine.grid.cell_m, self.recorder, *self.followers)
        self.dispatcher = Dispatcher(
            self.setup.links, self.setup.clock, self._note, self.mission.safety.altitude_m
        )
        self.fences = VehicleFences(self.mission, self.dispatcher.link_of, self._note)
        self.signals = StopSignals(
            self._signalled, self._signalled_again, self._signalled_last, self._suspended
        )
        self.unconfirmed: list[str] = []
        """Robots that had not shown that they hold when the mission was left."""
        self._doing: dict[str, str] = {}
        self._steered = False
        self._over_reason = ""
        """Why the mission is over; robots that fly may still be on their way home."""
        self._landing = Landing(self.safety, self.put, self._note, self.dispatcher.link_of)
        self._resumed_ns = 0
        """When the last event of an interrupted mission came; 0: this one begins."""

    def minds(self) -> tuple[Kernel, Safety]:
        """What decides."""
        return Kernel(self.mission.kernel), Safety(self.mission.safety)

    def decide(self, event: Event) -> Outcome:
        """What an event leads to."""
        return self.kernel.step(event)

    @property
    def robots(self) -> Mapping[str, Robot]:
        """Those that must be there before the start."""
        return self.kernel.robots

    async def run(self) -> str:
        """Fly the mission to its end; why it ended. Raises what a device raises before the start."""
        clock = self.setup.clock
        pool = ThreadPoolExecutor(1, thread_name_prefix="kernel")
        # Outermost: a signal that comes while vehicles are being stopped must find somebody who answers it.
        with self.signals.caught():
            async with contextlib.AsyncExitStack() as stack:
                stack.callback(pool.shutdown)
                for device in (*self.setup.receivers, *self.setup.links, *self.setup.positions):
                    await stack.enter_async_context(device)
                stack.push_async_callback(self.dispatcher.close)
                tasks = [
                    asyncio.create_task(self._pump(events), name=name) for name, events in self._streams()
                ]
                stack.push_async_callback(end_tasks, tasks)
                stack.push_async_callback(self._leave)
                if self._resumed_ns:
                    self._interrupted()
                tasks.append(asyncio.create_task(self._start(), name="start"))
                for task in tasks:
                    task.add_done_callback(partial(self._over, tasks))
                while not self.end_reason:
                    await self._step(*await self._next(), pool)
                await self._finish(clock.now_ns())
        return self.end_reason

    def _streams(self) -> list[tuple[str, AsyncIterator[Event]]]:
        """Every device's events, with a name for its task."""
        setup = self.setup
        devices, flying = (setup.receivers, setup.links, setup.positions), self.mission.safety.altitude_m
        lateness_s = self.mission.kernel.association_lateness_s
        return streams_of(*devices, setup.clock, self._note, flying, self._ticks.room, lateness_s)

    async def _next(self) -> tuple[int, int, Event]:
        """What comes next out of the inbox. Raises what one of the tasks has raised."""
        came = await self._inbox.get()
        if isinstance(came, BaseException):
            raise came
        return came

    def _over(self, tasks: list[asyncio.Task[Any]], task: asyncio.Task[Any]) -> None:
        """What ended a task goes through the inbox: waiting for all tasks at every event would cost more than it."""
        if not task.cancelled() and (error := task.exception()) is not None:
            tasks.remove(task)  # `end_tasks` need not report it once more
            self._inbox.put_nowait(error)

    # -- what comes in ---------------------------------------------------------------------------------------

    def put(self, event: Event) -> None:
        """Into the inbox, stamped with the time it arrives there. What stops robots goes out at once."""
        self._number += 1
        self.begun = True
        if isinstance(event, Operator) and (stopped := self._stopped_by(event)):
            self.dispatcher.freeze(stopped, event.t_ns, event.reason or f"operator: {event.action}")
            self._frozen_for[self._number] = stopped
        t_ns = self.setup.clock.now_ns()
        # At once: what waits here while the kernel is busy must survive a kill as well.
        self.records.event(self._number, t_ns, event)
        self._inbox.put_nowait((self._number, t_ns, event))
        if isinstance(event, RssReading):
            self._ticks.heard()

    def _stopped_by(self, event: Operator) -> list[str]:
        """Robots that must not wait for the kernel to have thought."""
        if event.action == "hold":
            return self._meant(event)
        return self.safety.ours() if event.action == "end" and self._steered else []

    def _meant(self, event: Operator) -> list[str]:
        return [robot for robot in self.dispatcher.link_of if event.robot in (None, robot)]

    def _note(self, level: str, text: str) -> None:
        self.records.note(level, text, self.setup.clock.now_ns())

    async def _pump(self, events: AsyncIterator[Event]) -> None:
        async for event in events:
            self.put(event)

    async def _start(self) -> None:
        """Vehicles first, then time: the mission's first tick finds every robot ready to be sent somewhere."""
        clock = self.setup.clock
        start = Start(self.mission, clock, self.dispatcher, self._note, self.fences, self.override)
        async with self.dispatcher.beating(), alarms_shown(self.alarms, self._show_now, clock):
            absent = await start.until_heard(self.robots, self._resumed_ns, self.recorder.maybe_flush)
            resumed = self._resumed_ns > 0
            out = dict.fromkeys(absent, "nothing is heard of it")
            out |= await start.inspect(self.robots, absent, resumed=resumed)
            self._steered = True
            waits = await start.acquire(self.robots, self.safety, out, resumed=resumed)
        for name, why in waits.items():
            self.put(Operator(clock.now_ns(), "withdraw", name, why))
        self._is_ready()
        while True:
            self._ticks.tick()
            slept_s = clock.elapsed_s()
            await clock.sleep(TICK_S)
            if clock.elapsed_s() - slept_s > TICK_S + SLEPT_S * clock.rate:
                await clock.sleep(WAKING_S * clock.rate)  # devices say first that nobody has read them

    def _is_ready(self) -> None:
        """Vehicles are ours; the mission's first tick is next."""

    # -- signals ---------------------------------------------------------------------------------------------

    def _signalled(self, name: str) -> None:
        self.put(Operator(self.setup.clock.now_ns(), "end", None, WHY[name]))

    def _signalled_again(self) -> None:
        people = self.mission.safety.on_foot  # they stop by themselves: nobody waits for them
        waits = [f"{name} to hold" for name in self.dispatcher.unconfirmed() if name not in people]
        waits += [f"{name} to land" for name in (self._landing.aloft() if self._over_reason else ())]
        self._say(
            f"still waiting for {', '.join(waits) or 'the recording to close'}. Once more leaves at once"
        )

    def _signalled_last(self) -> None:
        """Whoever is not home or has not shown that it holds is named, and left."""
        self.dispatcher.lose_patience()
        self.put(Operator(self.setup.clock.now_ns(), "end", None, "left at once"))

    def _suspended(self) -> None:
        self.put(Operator(self.setup.clock.now_ns(), "hold", None, "Ctrl-Z"))
        self._say("Ctrl-Z does not suspend a mission: all robots hold; r: resume   Ctrl-C: end")

    def _say(self, text: str) -> None:
        logger.warning(text)
        self._note("warning", text)

    # -- the step --------------------------------------------------------------------------------------------

    async def _step(self, number: int, t_ns: int, event: Event, pool: ThreadPoolExecutor) -> None:
        self._stepped = number
        look: Look | None = None
        if isinstance(event, Tick):
            self._ticks.taken()
            self.dispatcher.beat()
            outcome, look = await self._think(event, pool)
        else:
            outcome = self.decide(event)
        for command in self._judge(number, t_ns, event, outcome):
            self._carry_out(command)
        if look is not None:
            self.records.belief(number, t_ns, look)
        if isinstance(event, Operator):
            self._obey_operator(event)
        if self._over_reason:
            self._end_when_down(t_ns, event)
        if isinstance(event, Tick) or outcome.notes:
            self._show(t_ns, outcome)

    def _judge(self, number: int, t_ns: int, event: Event, outcome: Outcome) -> list[Command]:
        """What is to be carried out, all of it written down."""
        commands = self.safety.observe(event)
        for command in commands:
            self.records.command(number, t_ns, command, "safety")
        for asked, allowed in zip(outcome.commands, self.safety.judge(outcome.commands), strict=True):
            self.records.command(number, t_ns, asked, "kernel")
            self.records.command(number, t_ns, allowed, "safety")
            commands.append(allowed)
        self.records.outcome(number, t_ns, outcome)
        if outcome.plan is not None:
            self._doing.update(outcome.plan.purpose)
        return commands

    def rebuild(self, past: Iterable[Step]) -> None:
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
            self.records.event(self._number, step.log_time_ns, step.event)
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
        now_ns = self.setup.clock.now_ns()
        if self._resumed_ns > now_ns:
            raise ConfigError(
                "this computer's clock is behind the recording's end: set it before resuming the mission"
            )
        self._note("info", f"resumed after {(now_ns - self._resumed_ns) * 1e-9:.1f} s")
        for receiver in self.setup.receivers:
            self.put(ReceiverState(self._resumed_ns, receiver.robot, False, "the mission was interrupted"))
            self.put(ReceiverState(now_ns, receiver.robot, True, "the mission goes on"))
        for name in self.dispatcher.link_of:  # what it was doing then says nothing of now
            self.put(VehicleState(self._resumed_ns, name, "unknown", False, False, None, "not heard since"))
        for name, robot in self.safety.robots.items():
            if robot.called and not robot.ordered:
                self.put(Operator(now_ns, "withdraw", name, "called for before the interruption"))

    async def _think(self, tick: Tick, pool: ThreadPoolExecutor) -> tuple[Outcome, Look | None]:
        """Off the loop: a long look at the belief must not delay the drivers. A too long one holds everybody."""

        def think() -> tuple[Outcome, Look | None]:
            return self.decide(tick), self.records.look_if_due(tick.t_ns)

        thinking = asyncio.get_running_loop().run_in_executor(pool, think)
        limit_s = self.mission.safety.overrun_s
        await asyncio.wait({thinking}, timeout=limit_s / self.setup.clock.rate)
        if not thinking.done():
            reason = f"the steering loop is late: one step has taken {limit_s:g} s"
            self._note("warning", f"{reason}; all robots hold")
            with self.dispatcher.frozen(self.safety.ours(), tick.t_ns, reason):
                await asyncio.wait({thinking})
        return await thinking

    def _obey_operator(self, event: Operator) -> None:
        """What the operator's word means for the vehicles beyond the commands it led to."""
        self.dispatcher.thaw(self._frozen_for.pop(self._stepped, ()))
        for robot in self._meant(event):
            watched = self.safety.robots[robot]
            vehicle = watched.vehicle
            if watched.ordered == "release" and event.action != "release":
                continue
            if event.action == "resume" and (vehicle is None or vehicle.mode != "guided"):
                # A vehicle that its own failsafe, or somebody else, has had needs its control acquired anew.
                self.dispatcher.order(robot, ACQUIRE)
            elif event.action == "release":
                self.dispatcher.order(robot, RELEASE)

    def _end_when_down(self, now_ns: int, event: Event) -> None:
        """End once nothing of ours is waited for in the air; who is left there is named."""
        over, aloft = self._landing.is_over(now_ns, event)
        if not over:
            return
        if aloft:
            self._say(f"STILL IN THE AIR: {', '.join(aloft)}: they hold where they are; land them by hand")
        if others := self._landing.not_ours():
            self._say(f"IN THE AIR, AND NOT OURS TO LAND: {', '.join(others)}: see to them by hand")
        self.end_reason = self._over_reason

    def _carry_out(self, command: Command) -> None:
        if isinstance(command, EndMission):
            self._over_reason = command.reason
            self._landing.begin(command.t_ns, self.setup.clock.now_ns(), command.reason)
            return
        if isinstance(command, CallOperator):
            self._doing[command.robot] = f"needs the operator: {command.reason}"
            self._note("warning", f"{command.robot} needs the operator: {command.reason}")
            self.put(Operator(self.setup.clock.now_ns(), "withdraw", command.robot, command.reason))
        elif isinstance(command, Hold):
            self._doing[command.robot] = f"held: {command.reason}"
        self.dispatcher.order(command.robot, command)

    def alarms(self) -> list[str]:
        """Stops that vehicles have not shown, and a recording that has stopped."""
        return late_stops(self.dispatcher.unconfirmed()) + (
            [f"NOTHING IS RECORDED: {self.recorder.failure}"] if self.recorder.failure else []
        )

    def doing(self) -> dict[str, str]:
        """What each robot does, in words."""
        return dict(self._doing)

    def _show_now(self) -> None:
        """Without a tick, on every surface."""
        self._show(self.setup.clock.now_ns(), NOTHING)
        self.records.flush()

    def _show(self, t_ns: int, outcome: Outcome) -> None:
        progress = Progress(
            self.kernel.elapsed_s(t_ns),
            self.kernel.detections,
            self.kernel,
            self.doing(),
            outcome.notes,
            self.records.left,
            tuple(self.alarms()),
        )
        try:
            self.on_progress(progress)
        except Exception:  # a terminal that has gone, or a mistake in what shows: neither is the mission
            self.on_progress = lambda _: None
            logger.exception("progress is no longer shown; the mission goes on")

    # -- what goes out ---------------------------------------------------------------------------------------

    async def _leave(self) -> None:
        """However it ends: everybody that is ours holds, and shows it. Nothing cancels that."""
        if not self._steered:
            await self.fences.restore()
            return
        stopping = asyncio.create_task(
            self.dispatcher.stop(self.safety.ours(), self.setup.clock.now_ns(), "the mission is over")
        )
        cancelled: asyncio.CancelledError | None = None
        while not stopping.done():
            try:
                await asyncio.wait({stopping})
            except asyncio.CancelledError as error:
                cancelled = error
        self.unconfirmed = stopping.result()
        await self.fences.restore()
        if cancelled is not None:
            raise cancelled

    async def _finish(self, t_ns: int) -> None:
        self.records.end(self._stepped, t_ns)
        self._show_now()  # with the last look at the belief, and that nobody is steered any more
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
