"""The base class of the parts of the standard layer."""

from __future__ import annotations


class Part:
    """One part of the standard layer: usually one topic or service."""

    async def run(self) -> None:
        """Do the periodic work of the part in the link thread, until cancelled.

        By default there is none: the part only reacts to messages and requests.
        """

    def close(self) -> None:
        """Remove what `Node.destroy_node` leaves in the graph, in the executor thread."""
