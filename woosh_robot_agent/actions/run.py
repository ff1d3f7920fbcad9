"""The life of a goal in the link's thread: send, follow the chassis's reports, end."""

from __future__ import annotations

import asyncio
import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Coroutine
from dataclasses import dataclass
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.actions.doubt import Doubt
from woosh_robot_agent.actions.events import (
    Answered,
    Asked,
    CancelAsked,
    End,
    Event,
    LinkChanged,
    Replaced,
    Report,
    Tick,
)
from woosh_robot_agent.actions.server import Goal, Outcome
from woosh_robot_agent.convert import BadFieldError
from woosh_robot_agent.link import (
    Answer,
    ChassisClient,
    ConnectionLostError,
    LinkError,
    LinkState,
    RequestTimeoutError,
)
from woosh_robot_agent.motion.gate import MotionGate

_LOG = logging.getLogger(__name__)

_HASTE = 0.2
"""Share of the usual pause between two questions while a goal's state is in doubt."""
REPLACED = "replaced by a newer goal, which the chassis took"
STOPPING = "the agent is stopping; the robot may go on with it"
NO_REASON = "the chassis refused without a reason"


class Runs:
    """The goals of one action that are under way, oldest first."""

    def __init__(self) -> None:
        self.open: list[GoalRun] = []

    def post(self, event: Event) -> None:
        """Tell every open goal."""
        for run in self.open:
            run.post(event)

    @property
    def moving(self) -> int:
        """For how many of them the chassis may be at work, or about to be."""
        return sum(not run.took.done() or run.took.result() for run in self.open)

    def took(self, run: GoalRun) -> None:
        """The chassis took this goal: the one that it ran before is replaced."""
        for older in self.open[: self.open.index(run)]:
            older.post(Replaced())

    async def newer_taken(self, run: GoalRun) -> bool:
        """Whether the chassis takes a goal that came after this one; waits until that is known."""
        while True:
            newer = [other.took for other in self.open[self.open.index(run) + 1 :]]
            if any(took.done() and took.result() for took in newer):
                return True
            unknown = [took for took in newer if not took.done()]
            if not unknown:
                return False
            await asyncio.wait(unknown, return_when=asyncio.FIRST_COMPLETED)


@dataclass(frozen=True)
class Context:
    """What all goals of one action have in common.

    Attributes:
        chassis: the link, in whose thread all of this runs.
        gate: passes commands on.
        runs: the action's open goals.
        link_timeout: gives the s for which a goal stays open without a link.
        to_proto: makes the chassis's message of the goal's `arg`.
        query: makes a request that only names its type.
        to_ros: makes the ROS message of a report.
    """

    chassis: ChassisClient
    gate: MotionGate
    runs: Runs
    link_timeout: Callable[[], float]
    to_proto: Callable[[Any], Message]
    query: Callable[[type[Message]], Message]
    to_ros: Callable[[Message], Any]


class GoalRun(ABC):
    """One goal. What is particular to a kind of goal is in the subclasses.

    Attributes:
        cancel_wanted: whether its client asked to cancel it.
        took: whether the chassis took it, once that is known: by its answer, or by its reports.
        inherited: ends that, as the first report, are those of an earlier goal that went under the
            same name; none for a name that is new.
        predecessors: how many earlier goals of that name may still be under way.
        was_heard: whether there was a report on it.
    """

    poll_period = 5.0
    """s without a report after which the chassis is asked, in case that a push was lost."""

    def __init__(self, goal: Goal, context: Context) -> None:
        self.goal = goal
        self.chassis = context.chassis
        self.gate = context.gate
        self.runs = context.runs
        self.link_timeout = context.link_timeout()
        self.to_proto = context.to_proto
        self.query = context.query
        self.to_ros = context.to_ros
        self.cancel_wanted = False
        self.took: asyncio.Future[bool] = asyncio.get_running_loop().create_future()
        self.inherited: Collection[Outcome] = ()
        self.predecessors = 0
        self.was_heard = False
        self._answered = False
        self._events: asyncio.Queue[Event] = asyncio.Queue()
        self._deadline: float | None = None
        self._deadline_reason = ""
        self._silent = False
        """Whether the deadline is there because the chassis answers nothing."""
        self._doubt = Doubt(self.link_timeout)
        self._next_poll = 0.0
        self._cancel_due = False
        self._work: dict[str, asyncio.Task[None]] = {}

    # What a kind of goal has to say

    @abstractmethod
    def make_request(self) -> Message:
        """The request that starts the goal; BadFieldError if the robot must not get it."""

    @abstractmethod
    def make_cancel(self) -> Message:
        """The request that cancels the goal."""

    @abstractmethod
    def failed(self, reason: str) -> Message:
        """What the goal returns when it fails for `reason`."""

    @abstractmethod
    def read(self, report: Message) -> End | None:
        """Pass a report on as feedback if it is on this goal; the end if it says so."""

    @abstractmethod
    async def recover(self) -> End | None:
        """Ask the chassis how the goal stands, for want of reports.

        Returns:
            The end, if the chassis does not know the goal. What it does know is posted.

        Raises:
            LinkError: it cannot be asked.
        """

    # The life

    def post(self, event: Event) -> None:
        """Tell the goal what happened; in the link's thread."""
        if isinstance(event, CancelAsked):
            self.cancel_wanted = True
        self._events.put_nowait(event)

    async def run(self) -> None:
        """Live; the goal has ended when this returns."""
        self.runs.open.append(self)
        try:
            end = await self.live()
        except BadFieldError as error:
            end = self.aborted(f"{error.below('arg')}; nothing was sent")
        except asyncio.CancelledError:
            self.finish(self.aborted(STOPPING))
            raise
        except Exception as error:
            _LOG.exception("a goal failed")
            end = self.aborted(f"the agent failed: {error!r}; please report this")
        finally:
            if not self.took.done():
                self.took.set_result(False)
            self.runs.open.remove(self)
            for task in self._work.values():
                task.cancel()
        self.finish(end)

    def aborted(self, reason: str) -> End:
        """The end of a goal that failed for `reason`."""
        return End(Outcome.ABORTED, self.failed(reason))

    def finish(self, end: End) -> None:
        """Tell the client."""
        self.goal.finish(end.outcome, self.to_ros(end.ret))

    async def live(self) -> End:
        """Send the goal, and follow it until it ends."""
        loop = asyncio.get_running_loop()
        self._spawn("start", self._start(self.make_request()))
        self._next_poll = self._now() + self.poll_period
        while True:
            due = self._doubt.cancel_due if self._deadline is None else self._deadline
            timer = loop.call_at(min(due, self._next_poll), self.post, Tick())
            try:
                event = await self._events.get()
            finally:
                timer.cancel()
            end = self._take(event)
            if end is not None:
                return await self._judge(end)

    def _take(self, event: Event) -> End | None:
        match event:
            case Report(message):
                return self.read(message)
            case Answered(answer):
                self._answered = True
                return self._started(answer)
            case Replaced():
                return self.aborted(REPLACED)
            case CancelAsked():
                self._cancel_due = True
                self._cancel_soon()
            case LinkChanged(ready=False):
                self._limit(f"the link was lost ({self.chassis.last_error or 'it was closed'})")
            case LinkChanged():
                self._limit("the link was lost")
                self._ask()
            case Asked():
                return self._learn(event)
            case Tick():
                return self._look_at_the_time()
        return None

    def _started(self, answer: Answer | Exception) -> End | None:
        if isinstance(answer, Answer):
            if not answer.ok:
                return self.aborted(answer.msg or NO_REASON)
            self._taken()
        elif not isinstance(answer, LinkError):
            raise answer
        elif not isinstance(answer, RequestTimeoutError | ConnectionLostError):
            return self.aborted(str(answer))
        else:
            _LOG.warning("a goal has no answer: %s; asking how it stands", answer)
            if not self.was_heard:
                self._limit(f"no answer to the goal: {answer}")
            self._ask()
        return None

    def _learn(self, asked: Asked) -> End | None:
        """What comes of a question, besides the reports that it brought."""
        if asked.silent:
            if self._deadline is None:
                self._limit(f"the chassis does not answer ({asked.error})")
                self._silent = True
            return None
        if asked.error is None:
            if asked.end is not None and self.took.done():  # else it may still be on its way
                return asked.end
            if self._silent:
                self._silent, self._deadline = False, None
        if self._deadline is not None:  # that will tell
            return None
        reason = None
        if isinstance(asked.error, RequestTimeoutError):
            reason = self._doubt.in_vain(self._now(), str(asked.error))
        elif asked.error is None and self.was_heard:  # long steps report seldom
            self._doubt.answered()
        elif asked.error is None:
            reason = self._doubt.in_vain(self._now(), "its answers tell nothing of it")
        return None if reason is None else self.aborted(reason)

    def _look_at_the_time(self) -> End | None:
        now = self._now()
        if self._deadline is None:
            reason = self._doubt.uncancelled(now)
            if reason is not None:
                return self.aborted(reason)
        elif now >= self._deadline:
            return self.aborted(
                f"{self._deadline_reason}, and nothing was heard of the goal for "
                f"{self.link_timeout:g} s; the robot may go on with it"
            )
        if now >= self._next_poll:
            self._ask()
        return None

    def is_mine(self, outcome: Outcome | None) -> bool:
        """Whether a report under the goal's name is on this goal, not on one before it.

        Args:
            outcome: the end that it reports, if any.
        """
        took = self.took.done()
        if outcome is None:
            if not self._answered:
                return took or not self.predecessors
            if self.predecessors and not took:
                return False
            # the earlier one is over; only its cancel may still be on the way
            self.inherited = (Outcome.CANCELED,) if self.predecessors else ()
            return True
        inherited = self.inherited
        if self._answered or self.predecessors < 2:
            self.inherited, self.predecessors = (), 0
        else:  # each of the earlier goals has an end of its own
            self.predecessors -= 1
        if took and outcome is Outcome.CANCELED and self.cancel_wanted:
            return True
        # an end before the answer is that of an earlier one; if not, asking will tell
        return outcome not in inherited if took and self._answered else not inherited

    def heard(self) -> None:
        """The chassis reports on the goal: whatever limited the wait for that is over."""
        self.was_heard = True
        self._deadline = None
        self._doubt.heard(self._now())
        self._next_poll = self._now() + self.poll_period
        self._taken()  # if the answer was lost, but not the goal
        if self.chassis.state is LinkState.READY:
            self._cancel_soon()  # a wish that did not get through still stands

    def _taken(self) -> None:
        if not self.took.done():
            self.took.set_result(True)
            self.runs.took(self)
            self._cancel_soon()

    async def _judge(self, end: End) -> End:
        """A goal that was cancelled, but not by its client: perhaps a newer one replaced it."""
        if end.outcome is not Outcome.CANCELED or self.cancel_wanted:
            return end
        if await self.runs.newer_taken(self):
            return self.aborted(REPLACED)
        return End(Outcome.ABORTED, end.ret)

    def _limit(self, reason: str) -> None:
        self._silent = False
        self._deadline_reason = reason
        self._deadline = self._now() + self.link_timeout

    @staticmethod
    def _now() -> float:
        return asyncio.get_running_loop().time()

    # Requests, each beside the life so that nothing waits for their answers

    def _spawn(self, name: str, work: Coroutine[Any, Any, None]) -> None:
        self._work[name] = asyncio.get_running_loop().create_task(work, name=f"goal: {name}")

    def _busy(self, name: str) -> bool:
        return name in self._work and not self._work[name].done()

    async def _start(self, request: Message) -> None:
        try:  # the answer comes by the tap, in its place among the reports
            await self.gate.request(request, tap=lambda answer: self.post(Answered(answer)))
        except Exception as error:
            self.post(Answered(error))

    def _ask(self) -> None:
        in_doubt = self._deadline is not None or self._cancel_due
        haste = _HASTE if in_doubt else 1.0
        self._next_poll = self._now() + self.poll_period * haste
        # before the answer to the start, what the chassis tells may be of an earlier goal
        ready = self._answered and self.chassis.state is LinkState.READY
        if ready and not self._busy("ask"):
            self._spawn("ask", self._recover())

    async def _recover(self) -> None:
        before = self.chassis.stats.rx
        try:
            asked = Asked(await self.recover())
        except LinkError as error:
            _LOG.debug("cannot ask how a goal stands: %s", error)
            timed_out = isinstance(error, RequestTimeoutError)
            asked = Asked(None, error, silent=timed_out and self.chassis.stats.rx == before)
        self.post(asked)

    def _cancel_soon(self) -> None:
        """Pass the wish to cancel on: once the chassis has the goal, and not twice at a time."""
        known = self.took.done() and self.took.result()
        if self._cancel_due and known and not self._busy("cancel"):
            self._spawn("cancel", self._cancel())

    async def _cancel(self) -> None:
        if await self.runs.newer_taken(self):
            return  # it would hit the newer goal, and this one is over
        while self._cancel_due:  # again, if the client asked again meanwhile
            self._cancel_due = False
            try:
                answer = await self.gate.request(self.make_cancel())
            except LinkError as error:
                self._cancel_due = True
                _LOG.warning(
                    "the cancel did not get through, the goal goes on; it is sent again once the "
                    "chassis reports on the goal: %s",
                    error,
                )
                return
            if answer.ok:
                self._doubt.cancel_taken(self._now())
            else:
                _LOG.warning("the chassis refused to cancel, the goal goes on: %s", answer.msg)
