"""Extract observations from a robot's frames, e.g. answers, pushes, clock and unknown fields."""

from __future__ import annotations

import json
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message

from woosh_robot_agent.link.codecs import server_codec
from woosh_robot_agent.link.codecs.json_codec import is_repeated, is_well_known, json_names
from woosh_robot_agent.link.frames import SUBSCRIPTION_TYPES, Envelope, FrameError
from woosh_robot_agent.link.protos import message_types
from woosh_robot_agent.pb.robot.robot_count_pb2 import AbnormalCodes, StatusCode, StatusCodes
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, ScannerData
from woosh_robot_agent.pb.util.commu_pack_pb2 import Subscription

_LARGE = 64 * 1024
"""Size of a frame above which its body is not kept, in bytes."""
_EXAMPLES = 3
"""Maximum number of values that are kept of an unknown field."""
_MAX_NAMES = 20_000
"""Maximum number of names that are kept."""
_HARMLESS_FIELDS = {"action", "adapter", "display_model", "msg", "rc", "system", "urdf_name"}
"""Text fields that reveal nothing about a site."""
_ID_FIELDS = {"robot_id", "serial_number"}
"""Fields with numbers by which a robot can be recognised."""

_M = TypeVar("_M", bound=Message)


class SeenFrame(NamedTuple):
    """A frame between a client and the robot.

    Attributes:
        t: Unix time at which the frame was sent or received, in seconds.
        by_robot: True if the robot sent the frame, False if a client did.
        data: text of a text frame, bytes of a binary frame.
    """

    t: float
    connection: int
    by_robot: bool
    data: str | bytes


class AnsweredRequest(NamedTuple):
    """An answered request.

    Attributes:
        t: Unix time of the answer, in seconds.
        request: type of the request.
        request_body: body of the request; None if unreadable or of an unknown type.
        delay: time from request to answer, in seconds.
        ok: True if the request was accepted.
        type: type of the answer.
        body: body of the answer; None if large, unreadable, a laser scan, of an unknown type, or
            missing in a refusal.
        size: size of the answer's frame, in bytes.
    """

    t: float
    request: str
    request_body: Message | None
    delay: float
    ok: bool
    text: str
    type: str
    body: Message | None
    size: int


class Push(NamedTuple):
    """A push.

    Attributes:
        t: Unix time of its arrival, in seconds.
        body: the message; None if large, unreadable, a laser scan, or of an unknown type.
        size: size of the frame, in bytes.
    """

    t: float
    connection: int
    type: str
    body: Message | None
    size: int


class Scan(NamedTuple):
    """A laser scan.

    Attributes:
        t: Unix time of its arrival, in seconds.
        pushed: True if it was pushed, False if it was requested.
        ranges: hash of the ranges, to tell a new scan from one that was requested again.
    """

    t: float
    connection: int
    pushed: bool
    ranges: int


@dataclass
class Unknown:
    """A field or type that the schema lacks.

    Attributes:
        count: number of occurrences.
        values: the first `_EXAMPLES` different values, as JSON.
    """

    count: int = 0
    values: list[Any] = field(default_factory=list)

    def add(self, value: Any) -> None:
        self.count += 1
        if value not in self.values and len(self.values) < _EXAMPLES:
            self.values.append(value)


class Observations:
    """Everything that was observed in the frames so far.

    Attributes:
        asked: number of requests, by their type.
        subscribed: types that clients have subscribed to.
        unknown_fields: fields that the schema lacks, by message type and path; only from JSON
            frames, which have the names of fields.
        unknown_types: types that the schema lacks, by name, with their bodies as values.
        unreadable: frames and bodies that could not be read, by reason.
        offsets: time by which each timestamp of the robot is ahead of this computer's clock, in
            seconds.
        names: names and numbers by which the site or the robot could be recognised; about
            `_MAX_NAMES` at most.
        frames: number of frames of the robot.
    """

    def __init__(self, frames: Iterable[SeenFrame] = ()) -> None:
        self.asked: Counter[str] = Counter()
        self.answers: list[AnsweredRequest] = []
        self.pushes: list[Push] = []
        self.scans: list[Scan] = []
        self.subscribed: set[str] = set()
        self.unknown_fields: defaultdict[tuple[str, str], Unknown] = defaultdict(Unknown)
        self.unknown_types: defaultdict[str, Unknown] = defaultdict(Unknown)
        self.unreadable: Counter[str] = Counter()
        self.offsets: list[float] = []
        self.names: set[str] = set()
        self.frames = 0
        self._pending: dict[tuple[int, int], tuple[float, str, Message | None]] = {}
        """Time, type and body of requests without an answer, by connection and serial number."""
        self._latest: dict[str, Message] = {}
        """The last message of each type, received by itself or inside a RobotInfo."""
        self._counts: Counter[str] = Counter()
        """Number of messages of each type, those inside a RobotInfo included."""
        for frame in frames:
            self.add(frame)

    def add(self, frame: SeenFrame) -> None:
        """Add a frame."""
        self.frames += frame.by_robot
        try:
            envelope = server_codec(frame.data).decode(frame.data)
        except FrameError as error:
            self.unreadable[f"a frame: {error.kind}"] += 1
        else:
            (self._add_from_robot if frame.by_robot else self._add_from_client)(frame, envelope)

    def latest(self, cls: type[_M]) -> tuple[_M | None, int]:
        """Return the last message of a class, or None, and the number of messages of the class."""
        name = cls.DESCRIPTOR.full_name
        return self._latest.get(name), self._counts[name]  # type: ignore[return-value]

    def bodies(self) -> Iterator[Message | None]:
        """Yield the bodies of all answers, then of all pushes."""
        yield from (each.body for each in self.answers)
        yield from (each.body for each in self.pushes)

    def pushes_of(self, name: str) -> list[Push]:
        """Return the pushes of a type to one client: the client with the most such pushes."""
        return of_busiest_connection([each for each in self.pushes if each.type == name])

    def pushed(self, cls: type[_M]) -> list[tuple[float, _M]]:
        """Return time and body of the pushes of a class to one client."""
        found = self.pushes_of(cls.DESCRIPTOR.full_name)
        return [(each.t, each.body) for each in found if each.body]  # type: ignore[misc]

    def accepted(self, cls: type[Message]) -> list[AnsweredRequest]:
        """Return the accepted requests of a class."""
        name = cls.DESCRIPTOR.full_name
        return [each for each in self.answers if each.request == name and each.ok]

    def _add_from_client(self, frame: SeenFrame, envelope: Envelope) -> None:
        if envelope.type in SUBSCRIPTION_TYPES:  # one of which is not a type of the schema
            body = self._body(frame, Envelope(Subscription.DESCRIPTOR.full_name, envelope.body))
            if isinstance(body, Subscription) and body.sub:
                self.subscribed.update(body.topics)
        else:
            self.asked[envelope.type] += 1
            request = frame.t, envelope.type, self._body(frame, envelope)
            self._pending[frame.connection, envelope.sn] = request

    def _add_from_robot(self, frame: SeenFrame, envelope: Envelope) -> None:
        """Add a push or an answer."""
        if envelope.timestamp:
            self.offsets.append(envelope.timestamp / 1000 - frame.t)
        pending = self._pending.pop((frame.connection, envelope.sn), None) if envelope.sn else None
        if pending and not envelope.type:  # an answer may leave out its type
            envelope.type = pending[1]
        refused = envelope.sn != 0 and envelope.ok is False
        # a refusal without a body tells nothing, not that all values are the default ones
        body = None if refused and not envelope.body else self._body(frame, envelope)
        if body is not None:
            self._add_body(frame, body, pushed=not envelope.sn)
        size = len(frame.data) if isinstance(frame.data, bytes) else len(frame.data.encode())
        kept = None if size > _LARGE or isinstance(body, ScannerData) else body
        if not envelope.sn:  # only answers have a serial number
            self.pushes.append(Push(frame.t, frame.connection, envelope.type, kept, size))
        elif pending:
            sent_at, request, request_body = pending
            answer = AnsweredRequest(
                frame.t,
                request,
                request_body,
                frame.t - sent_at,
                envelope.ok is not False,
                envelope.msg,
                envelope.type,
                kept,
                size,
            )
            self.answers.append(answer)

    def _body(self, frame: SeenFrame, envelope: Envelope) -> Message | None:
        """Return the body of a frame, and note types and fields that the schema lacks.

        None if the body cannot be read, or the schema lacks its type.
        """
        cls = message_types().get(envelope.type)
        if cls is None:
            if frame.by_robot and envelope.type != "error":  # the type of some refusals
                self.unknown_types[envelope.type].add(_as_json(envelope.body))
            return None
        if frame.by_robot and isinstance(envelope.body, dict):
            for path, value in _unknown_fields(envelope.body, cls.DESCRIPTOR, ""):
                self.unknown_fields[envelope.type, path].add(value)
        try:
            return server_codec(frame.data).body(envelope, cls)
        except FrameError as error:
            self.unreadable[str(error)] += 1
            return None

    def _add_body(self, frame: SeenFrame, body: Message, *, pushed: bool) -> None:
        """Note the latest values, the names and the scan in a message of the robot."""
        self._set_latest(body)
        if isinstance(body, RobotInfo):
            for _, part in body.ListFields():
                if isinstance(part, Message):
                    self._set_latest(part)
        if len(self.names) < _MAX_NAMES:
            self.names.update(_names(body))
        if isinstance(body, ScannerData):
            ranges = hash(tuple(body.ranges))
            self.scans.append(Scan(frame.t, frame.connection, pushed, ranges))

    def _set_latest(self, body: Message) -> None:
        name = body.DESCRIPTOR.full_name
        self._counts[name] += 1
        self._latest[name] = body


_Item = TypeVar("_Item", Push, Scan)


def of_busiest_connection(items: list[_Item]) -> list[_Item]:
    """Return the items of the connection with the most items.

    All clients get the same pushes, which must not be counted twice.
    """
    counts = Counter(each.connection for each in items)
    number, _ = counts.most_common(1)[0] if counts else (0, 0)
    return [each for each in items if each.connection == number]


def codes_in(body: object) -> Iterable[StatusCode]:
    """Return the status codes in the body of a frame; none if it is of a type without them."""
    if isinstance(body, StatusCode):
        return [body]
    if isinstance(body, AbnormalCodes | StatusCodes):
        return body.scs
    return body.abnormal_codes.scs if isinstance(body, RobotInfo) else []


def _unknown_fields(body: dict[str, Any], descriptor: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Yield path and value of each field in a JSON body that its message type lacks.

    Args:
        body: the body, or a message within it.
        path: path of a message within the body, e.g. `scene.`; empty for the body itself.
    """
    fields = {name: each for each in descriptor.fields for name in json_names(each)}
    for key, value in body.items():
        known = fields.get(key)
        if known is None:
            yield f"{path}{key}", value
        elif known.message_type is not None and not is_well_known(known):
            items = value if isinstance(value, list) else [value]
            inner = f"{path}{key}[]." if is_repeated(known) else f"{path}{key}."
            for each in items:
                if isinstance(each, dict):
                    yield from _unknown_fields(each, known.message_type, inner)


def _names(message: Any) -> Iterator[str]:
    """Yield the names in a message, and the numbers by which a robot can be recognised."""
    for each, value in message.ListFields():
        items = value if is_repeated(each) else [value]
        if each.message_type is not None:
            for item in items:
                yield from _names(item)
        elif each.name in _ID_FIELDS:
            yield from map(str, items)
        elif each.type == FieldDescriptor.TYPE_STRING and each.name not in _HARMLESS_FIELDS:
            # not a single character, which would be redacted wherever it occurs
            yield from (item for item in items if len(item) > 1)
        elif each.type == FieldDescriptor.TYPE_BYTES:  # e.g. the list of networks, as JSON
            yield from (text for item in items for text in _texts_in_json(item))


def _texts_in_json(data: bytes) -> Iterator[str]:
    """Yield the texts in a JSON object or array, except single characters.

    Yields none if `data` is something else, or larger than `_LARGE`.
    """
    if data[:1] not in (b"{", b"[") or len(data) > _LARGE:
        return
    try:
        yield from (text for text in _texts(json.loads(data)) if len(text) > 1)
    except (ValueError, RecursionError):  # only looks like JSON
        return


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for each in value.values() if isinstance(value, dict) else value:
            yield from _texts(each)


def _as_json(body: object) -> Any:
    """Return the body of an unknown type, for JSON."""
    return f"{len(body)} bytes of protobuf" if isinstance(body, bytes) else body


_ADDRESS = re.compile(
    r"""
    (?<![\w.+-])[\w.+-]+@[\w.-]*\w                         # a mail address
    | \b\d{1,3}(?:\.\d{1,3}){3}\b                          # of IPv4
    | \b(?:[0-9a-f]{2}[:-]){5}[0-9a-f]{2}\b                # of Ethernet
    | (?<![\w:])(?:                                        # of IPv6
        (?:[0-9a-f]{1,4}:){6,7}[0-9a-f]{1,4}
        | (?:[0-9a-f]{1,4}(?::[0-9a-f]{1,4})*)?::(?:[0-9a-f]{1,4}(?::[0-9a-f]{1,4})*)?
      )(?:(?:\.\d{1,3}){3})?(?:%\w+)?(?!\w)
    | (?<![\w.-])(?!woosh\.[\w.]*(?![\w.-]))               # a host, but not a type
      [\w-]+(?:\.[\w-]+)*\.[a-z]{2,}(?![\w-])
    """,
    re.I | re.A | re.X,
)
"""An IP, MAC or mail address, or the name of a host.

Mail addresses and hosts are searched only from the start of a word, because a search from each
character of a long word takes too long.
"""
_IDENTIFYING_KEY = re.compile(
    r"name|serial|sn$|id$|no$|addr|mac|ip$|wifi|ssid|pass|pwd|token|key", re.I
)
"""Keys whose values could identify the robot or its site."""
_PLAIN_KEY = re.compile(r"[a-z]\w{0,40}")
"""A key that looks like the name of a field."""


class Redactor:
    """Redacts addresses, ids and `names` that could identify the robot or its site."""

    def __init__(self, names: Iterable[str]) -> None:
        # the longest first, because the first alternative that matches is taken
        found = "|".join(re.escape(each) for each in sorted(names, key=len, reverse=True))
        # not inside of a type name, e.g. woosh.robot.PoseSpeed
        self._names = re.compile(rf"(?<![\w.])(?:{found})(?!\w|\.\w)", re.A) if found else None

    def text(self, text: str) -> str:
        """Return a text without names and addresses."""
        text = _ADDRESS.sub("<address>", text)
        return self._names.sub("<name>", text) if self._names else text

    def value(self, key: str, value: Any) -> Any:
        """Return the value of a field, as JSON, without texts and numbers that could be ids."""
        if isinstance(value, list):
            return [self.value(key, each) for each in value]
        if isinstance(value, dict):
            return {self._key(name): self.value(name, each) for name, each in value.items()}
        if isinstance(value, str):
            return f"<text of {len(value)} characters>"
        if value is None or isinstance(value, bool) or not _IDENTIFYING_KEY.search(key):
            return value
        return "<number>"

    def _key(self, key: str) -> str:
        """Return a key of an object; `<key>` if it could be a name or an address."""
        return key if _PLAIN_KEY.fullmatch(key) and self.text(key) == key else "<key>"
