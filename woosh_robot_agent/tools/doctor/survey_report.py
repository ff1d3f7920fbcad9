"""The results of a survey, as data for programs and as a report for people."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

from woosh_robot_agent.endpoints import QUERIES
from woosh_robot_agent.link.protos import message_types
from woosh_robot_agent.link.reports import printable
from woosh_robot_agent.pb.robot.robot_pb2 import General
from woosh_robot_agent.robot.clock import describe_offset
from woosh_robot_agent.robot.status_codes import meaning
from woosh_robot_agent.tools.doctor.checks import HttpAnswer
from woosh_robot_agent.tools.doctor.learn import (
    REFERENCE,
    differs,
    known_value,
    learn,
    quantile,
)
from woosh_robot_agent.tools.doctor.observations import Observations, Redactor, Unknown, codes_in

REPORT_FILE = "survey.md"
"""File with the report for people, in the folder of a survey."""

_UNKNOWN_TEXT = re.compile(r"unknown|unsupported|not support|not found|no such|invalid type", re.I)
"""Text of an answer to a request that the robot does not know."""
_NOT_FOUND = 404
"""HTTP status for a request that the robot does not know."""


def results(
    seen: Observations,
    *,
    http: Mapping[str, HttpAnswer | None],
    seconds: float,
    complete: bool,
    lost: int,
    address: str,
    with_names: bool,
) -> dict[str, Any]:
    """Return the results of a survey as JSON.

    Args:
        http: answers over HTTP, by query; None for a query that was not answered.
        complete: False if the survey was stopped early.
        address: address of the robot, left out without `with_names`.
        with_names: True to keep names and numbers that could identify the robot or its site.
    """
    redactor = None if with_names else Redactor(seen.names)
    learned = learn(seen)
    found: dict[str, Any] = {
        "seconds": round(seconds, 1),
        "complete": complete,
        "lost_connections": lost,
        "robot": _robot(seen),
        "requests": list(_requests(seen, http, redactor)),
        "pushes": list(_pushes(seen)),
        "unknown_fields": [
            {"type": name, "field": path, **_unknown(path, each, redactor)}
            for (name, path), each in sorted(seen.unknown_fields.items())
        ],
        "unknown_types": [
            {"type": name, **_unknown("", each, redactor)}
            for name, each in sorted(seen.unknown_types.items())
        ],
        "unreadable": _unreadable(seen.unreadable, without_values=not with_names),
        "status_codes": list(_unknown_codes(seen, redactor)),
        "clock": _series(seen.offsets, digits=3),
        "profile": [
            {
                "field": list(path),
                "value": redactor.text(each.value)
                if redactor and path[0] == "refusals"
                else each.value,
                "samples": each.samples,
                REFERENCE: known_value(path),  # the simulator's value; the key names its profile
                "differs": differs(path, each.value),
            }
            for path, each in learned.items()
        ],
    }
    if with_names:
        found |= {"address": address, "names": sorted(seen.names)}
    return found


def _robot(seen: Observations) -> dict[str, Any]:
    general, _ = seen.latest(General)
    if general is None:
        return {}
    return {
        "model": general.display_model,
        "urdf": general.urdf_name,
        "type": general.type,
        "driver_method": general.driver_method,
        "system": general.version.system,
        "software": general.version.rc,
    }


def _requests(
    seen: Observations, http: Mapping[str, HttpAnswer | None], redactor: Redactor | None
) -> Iterator[dict[str, Any]]:
    """Yield the answers to each type of request, with a verdict.

    The verdict is `answered`, `refused`, `unknown` if the robot does not know the type, or
    `no answer`.
    """
    for name in sorted(seen.asked):
        answers = [each for each in seen.answers if each.request == name]
        accepted = [each for each in answers if each.ok]
        texts = Counter(_redacted(each.text, redactor) for each in answers if not each.ok)
        over_http = http.get(name)
        is_not_found = over_http is not None and over_http.status == _NOT_FOUND
        says_unknown = any(_UNKNOWN_TEXT.search(text) for text in texts)
        if accepted:
            verdict = "answered"
        elif not answers:
            verdict = "no answer"
        else:
            verdict = "unknown" if is_not_found or says_unknown else "refused"
        yield {
            "type": name,
            "verdict": verdict,
            "asked": seen.asked[name],
            "accepted": len(accepted),
            "refused": dict(texts.most_common()),
            "answered_as": sorted({each.type for each in accepted} - {name}),
            "delay": _series([each.delay for each in accepted], digits=4),
            "bytes": _series([each.size for each in accepted], digits=0),
            "http": _http_result(over_http, redactor) if name in http else None,
        }


def _http_result(answer: HttpAnswer | None, redactor: Redactor | None) -> dict[str, Any]:
    if answer is None:  # not answered
        return {"status": 0}
    envelope = answer.envelope
    return {
        "status": answer.status,
        "ok": envelope.ok if envelope else None,
        "text": _redacted(envelope.msg if envelope else "", redactor),
        "delay": round(answer.delay, 4),
    }


def _pushes(seen: Observations) -> Iterator[dict[str, Any]]:
    for name in sorted({*seen.subscribed, *(each.type for each in seen.pushes)}):
        pushes = seen.pushes_of(name)
        yield {
            "type": name,
            "count": len(pushes),
            "subscribed": name in seen.subscribed,
            "in_schema": name in message_types(),
            "period": _series([b.t - a.t for a, b in pairwise(pushes)], digits=4),
            "bytes": _series([each.size for each in pushes], digits=0),
        }


def _series(values: Sequence[float], *, digits: int) -> dict[str, float] | None:
    """Return number, median, 99 % quantile, minimum and maximum of values; None without values."""
    if not values:
        return None
    figures = {
        "median": quantile(values, 0.5),
        "p99": quantile(values, 0.99),
        "least": min(values),
        "most": max(values),
    }
    return {"samples": len(values)} | {key: round(each, digits) for key, each in figures.items()}


def _unknown(path: str, unknown: Unknown, redactor: Redactor | None) -> dict[str, Any]:
    """Return number and examples of an unknown field or type; `path` is empty for a type."""
    key = path.rpartition(".")[2]
    values = [redactor.value(key, each) if redactor else each for each in unknown.values]
    return {"count": unknown.count, "values": values}


def _unreadable(reasons: Counter[str], *, without_values: bool) -> dict[str, int]:
    """Return the reasons of unreadable frames, and how often each occurred."""
    found: Counter[str] = Counter()
    for reason, count in reasons.items():
        if without_values:  # "type: field: value does not fit", or "type: expected ..., got value"
            reason = ": ".join(reason.split(": ")[:2]).partition(", got ")[0]
        found[printable(reason)] += count
    return dict(found)


def _unknown_codes(seen: Observations, redactor: Redactor | None) -> Iterator[dict[str, Any]]:
    """Yield the status codes that the table of known codes lacks."""
    texts: dict[int, str] = {}
    counts: Counter[int] = Counter()
    for body in seen.bodies():
        for code in codes_in(body):
            if code.code and not meaning(code.code):  # an empty answer has the code 0
                counts[code.code] += 1
                texts[code.code] = code.msg
    for number, count in sorted(counts.items()):
        yield {"code": number, "count": count, "text": _redacted(texts[number], redactor)}


def _redacted(text: str, redactor: Redactor | None) -> str:
    return printable(redactor.text(text) if redactor else text)


_QUERIES = {each.request for each in QUERIES}
"""Types of the requests that are queries."""


def markdown(found: Mapping[str, Any]) -> str:
    """Return the report for people on what `results` has returned."""
    robot = found["robot"]
    early = "" if found["complete"] else ", stopped early"
    lines = [
        f"# Survey of a robot: {robot.get('model') or 'unknown model'}",
        "",
        f"- Software: {robot.get('software') or 'unknown'}, "
        f"system {robot.get('system') or 'unknown'}",
        f"- Duration: {found['seconds']:g} s{early}; lost connections: {found['lost_connections']}",
        f"- Clock: {_clock(found['clock'])}",
        "",
        "## Differences from the simulator",
        "",
        f"What the simulator would do differently with the profile {REFERENCE}.",
        "",
        *_differences(found),
        "",
        "## Requests",
        "",
        "Times in ms: median / 99 %. Sizes in bytes: median / largest.",
        "",
        *_table(
            ("Request", "Result", "Asked", "Time", "Size", "HTTP"),
            [_request_row(each) for each in found["requests"]],
        ),
        "",
        "## Pushes",
        "",
        "Times between two pushes in s: median / 99 %. Sizes in bytes: median / largest.",
        "",
        *_table(
            ("Push", "Number", "Period", "Size"),
            [
                (each["type"], each["count"], _times(each["period"]), _sizes(each["bytes"]))
                for each in found["pushes"]
            ],
        ),
        "",
        "## Learned values",
        "",
        *_table(
            ("Field", "Robot", "Samples", REFERENCE),
            [
                (
                    ".".join(each["field"]),
                    _as_code(each["value"]),
                    each["samples"],
                    _as_code(each[REFERENCE]),
                )
                for each in found["profile"]
            ],
        ),
    ]
    return "\n".join(lines) + "\n"


def _differences(found: Mapping[str, Any]) -> list[str]:
    """Return the lines of the section about the differences from the simulator."""
    lines = [
        f"- `{'.'.join(each['field'])}`: {_as_code(each['value'])} instead of "
        f"{_as_code(each[REFERENCE])} ({each['samples']} samples)"
        for each in found["profile"]
        if each["differs"]
    ]
    lines += [
        f"- Unknown field `{each['field']}` of {each['type']}: {_examples(each)}"
        for each in found["unknown_fields"]
    ]
    lines += [
        f"- Unknown type {each['type']}: {_examples(each)}" for each in found["unknown_types"]
    ]
    lines += [
        f"- Query {each['type']}: {each['verdict']}{_refusal_texts(each['refused'])}"
        for each in found["requests"]
        if each["verdict"] != "answered" and each["type"] in _QUERIES
    ]
    lines += [
        f"- Unknown status code {each['code']}: {each['count']} times, {each['text'] or 'no text'}"
        for each in found["status_codes"]
    ]
    lines += [
        f"- Not readable: {reason}: {count} times" for reason, count in found["unreadable"].items()
    ]
    return lines or ["None."]


def _request_row(each: Mapping[str, Any]) -> tuple[object, ...]:
    delay, http = each["delay"], each["http"]
    time = f"{delay['median'] * 1000:.0f} / {delay['p99'] * 1000:.0f}" if delay else ""
    over_http = "" if http is None else "no answer"
    if http and http["status"]:
        over_http = f"{http['status']}, {http['delay'] * 1000:.0f} ms"
    result = f"{each['verdict']}{_refusal_texts(each['refused'])}"
    return each["type"], result, each["asked"], time, _sizes(each["bytes"]), over_http


def _refusal_texts(refused: Mapping[str, int]) -> str:
    texts = "; ".join(f"{text!r} {count} times" for text, count in refused.items())
    return f": {texts}" if texts else ""


def _examples(each: Mapping[str, Any]) -> str:
    return f"{each['count']} times, e.g. {', '.join(map(_as_code, each['values']))}"


def _clock(clock: Mapping[str, float] | None) -> str:
    if clock is None:
        return "frames carry no time"
    return f"{describe_offset(clock['median'])} ({clock['samples']} frames)"


def _times(series: Mapping[str, float] | None) -> str:
    return f"{series['median']:g} / {series['p99']:g}" if series else ""


def _sizes(series: Mapping[str, float] | None) -> str:
    return f"{series['median']:.0f} / {series['most']:.0f}" if series else ""


_MAX_LENGTH = 200
"""Maximum length of a value in the report, in characters."""


def _as_code(value: object) -> str:
    """Return a value as code in Markdown."""
    text = printable(str(value)).replace("`", "'")
    return f"`{text if len(text) <= _MAX_LENGTH else text[: _MAX_LENGTH - 3] + '...'}`"


def _table(heading: Sequence[str], rows: Iterable[Sequence[object]]) -> list[str]:
    lines = [f"| {' | '.join(heading)} |", f"|{' --- |' * len(heading)}"]
    for row in rows:
        cells = (printable(str(each)).replace("|", "\\|") for each in row)
        lines.append(f"| {' | '.join(cells)} |")
    return lines
