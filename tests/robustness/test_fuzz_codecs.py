"""Codecs and client survive malformed input; `scripts/bench --fuzz` sends much more."""

from __future__ import annotations

import random

import pytest

from tests.robustness.fuzz import fuzz
from tests.robustness.fuzz_inputs import blob, text
from tests.robustness.fuzz_targets import ACCEPTED, TARGETS, Target, batches

SEED = 1


@pytest.mark.parametrize(
    ("key", "count"),
    [
        ("json", 4000),
        ("protobuf", 4000),
        ("framing", 2000),
        ("json-client", 1000),
        ("tcp-client", 1000),
    ],
)
def test_no_input_breaks_the_target(key: str, count: int) -> None:
    result = fuzz(key, count, SEED)
    assert not result.crashes, result.crashes[0]
    assert result.inputs == count
    assert result.kinds[ACCEPTED] > count / 10, "most inputs are noise"
    assert result.kinds.total() - result.kinds[ACCEPTED] > count / 20


def test_input_depends_on_its_seed_and_number_alone() -> None:
    for target in (TARGETS["json"](), TARGETS["protobuf"](), TARGETS["framing"]()):
        ((_, first),) = batches(target, SEED, 1, first=37)
        inputs = [each for _, batch in batches(target, SEED, 40) for each in batch]
        assert inputs[37] == first[0]
        assert len(set(inputs)) > 30


def test_crash_is_reported_with_the_command_that_repeats_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    feed = TARGETS["json"].feed

    def broken(target: Target, batch: list[object]) -> object:
        if len(batch[0]) % 7 == 0:  # type: ignore[arg-type]
            raise ZeroDivisionError
        return feed(target, batch)

    monkeypatch.setattr(TARGETS["json"], "feed", broken)
    result = fuzz("json", 100, SEED)
    assert 0 < len(result.crashes) < 100
    assert "ZeroDivisionError" in result.crashes[0]
    assert f"--target json --seed {SEED} --first " in result.crashes[0]
    assert "input " in result.crashes[0]


def test_inputs_include_the_extremes() -> None:
    texts = [text(random.Random(f"x{n}")) for n in range(20_000)]
    for odd in ("[" * 1000, "1e999", "\\ud800", "9" * 500, "null", "\\u0000", "kNoSuchName"):
        assert any(odd in each for each in texts), odd
    blobs = [blob(random.Random(f"x{n}")) for n in range(20_000)]
    for odd in (b"\x0b" * 1000, b"\xff" * 10):
        assert any(odd in each for each in blobs), odd
