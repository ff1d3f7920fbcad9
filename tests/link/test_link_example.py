"""The documented example runs, with its address replaced."""

from __future__ import annotations

import asyncio
import re
from pathlib import Path

import pytest

from tests.link.link_peer import Frame, Peer, Wire

PAGE = Path(__file__).parents[2] / "docs/link_protocol.md"


@pytest.mark.skipif(not PAGE.exists(), reason="a copy of the code without its documentation")
async def test_the_example_of_the_documentation_runs(capsys: pytest.CaptureFixture[str]) -> None:
    async def script(wire: Wire, frame: Frame) -> bool:
        if frame["type"] == "woosh.robot.Speak":
            await wire.push("woosh.robot.PoseSpeed", {"pose": {"x": 1.5, "y": 2}})
            await wire.answer(frame, msg=frame["body"]["text"])
            return True
        return False

    found = re.search(r"```python\n(.*)```", PAGE.read_text(), re.DOTALL)
    assert found
    async with Peer(script=script) as peer:
        code = found[1].replace('ip="169.254.128.2"', f'ip="127.0.0.1", port={peer.port}')
        assert code != found[1]
        await asyncio.to_thread(exec, code, {})
    assert sorted(capsys.readouterr().out.splitlines()) == ["1.5 2.0", "True hello"]
