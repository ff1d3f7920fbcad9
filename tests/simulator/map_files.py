"""Files of a small nav2 map."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from woosh_robot_agent.simulator.scenes.files import load_scene

NAV2 = """
image: {image}
mode: {mode}
resolution: 0.1
origin: [-1.0, -2.0, 0.0]
negate: {negate}
occupied_thresh: 0.65
free_thresh: 0.196
"""


def room_picture() -> Image.Image:
    """A white room with black walls around it and a black block in the upper left corner."""
    greys = np.full((40, 60), 254, np.uint8)
    greys[0, :] = greys[-1, :] = greys[:, 0] = greys[:, -1] = 0
    greys[5:10, 5:15] = 0
    return Image.fromarray(greys)


def write_map(
    folder: Path,
    image: Image.Image | bytes,
    suffix: str = ".png",
    mode: str = "trinary",
    negate: str = "0",
) -> Path:
    if isinstance(image, Image.Image):
        image.save(folder / f"room{suffix}")
    else:
        (folder / f"room{suffix}").write_bytes(image)
    file = folder / "room.yaml"
    file.write_text(NAV2.format(image=f"room{suffix}", mode=mode, negate=negate))
    return file


def cells(file: Path) -> list[list[int]]:
    grid = load_scene(file).maps[0].grid
    assert grid
    found: list[list[int]] = grid.cells.tolist()
    return found
