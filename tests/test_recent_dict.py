"""The dictionary that holds only the entries that were set last."""

from __future__ import annotations

from woosh_robot_agent.link.reports import RecentDict


def test_the_oldest_entry_is_removed() -> None:
    recent: RecentDict[int, str] = RecentDict(2)
    for number in range(5):
        recent[number] = str(number)
    assert recent == {3: "3", 4: "4"}


def test_an_entry_that_is_set_again_becomes_the_latest() -> None:
    recent: RecentDict[str, int] = RecentDict(2)
    recent["a"], recent["b"], recent["a"], recent["c"] = 1, 2, 3, 4
    assert list(recent.items()) == [("a", 3), ("c", 4)]


def test_reading_an_entry_does_not_make_it_younger() -> None:
    recent: RecentDict[str, int] = RecentDict(2)
    recent["a"], recent["b"] = 1, 2
    assert recent["a"] == recent.get("a") == 1
    recent["c"] = 3
    assert "a" not in recent
