"""Which node is the rig's: that of the rig file, that of the log, or the first one that is received.

Of several nodes the first one that sends samples is chosen. If another one sends samples too, the choice is doubtful
unless the rig file states the node.
"""

from __future__ import annotations

from daq.drivers.rotorlink.wire import EncoderBlock, NodeFrame, Skipped
from daq.drivers.sparing import Foreign
from daq.items import DeviceEvent

_ASSUMED = 1  # by the locks, until an event names another number


class NodeChoice:
    """The node whose frames are decoded.

    Attributes:
        node: its number; None before its first frame.
        complaint: why it cannot be known which node is the rig's; empty if it can.

    Args:
        device: name in the events.
        stated: number in the rig file; None if it states none.
        learned: number in the identity; None if it has none.
    """

    def __init__(self, device: str, stated: int | None, learned: int | None) -> None:
        self.node: int | None = learned if stated is None else stated
        self.complaint: str = ""
        self._device, self._stated = device, stated is not None
        self._sends_samples = self.node is not None
        self._foreign_nodes = Foreign(device)

    def feed(self, frame: NodeFrame | Skipped) -> list[DeviceEvent]:
        """Take note of a frame's node; return an event for a choice, and one for each other node."""
        block = isinstance(frame, EncoderBlock)
        if self.node is None:
            self.node, self._sends_samples = frame.node, block
            return self._chosen(_ASSUMED)
        if frame.node == self.node:
            self._sends_samples |= block
            return []
        if block and not self._sends_samples:
            before, self.node, self._sends_samples = self.node, frame.node, True
            return [*self._chosen(before), *self._foreign(before)]
        if block and not self._stated and not self.complaint:
            numbers = sorted((self.node, frame.node))
            self.complaint = (
                f"nodes {numbers[0]} and {numbers[1]} both send samples, and the rig file does not state the rig's: "
                f"node {self.node} is decoded. State its number, for example node = {self.node}"
            )
            facts = {"node": frame.node}
            return [*self._foreign(frame.node), DeviceEvent("doubt", self._device, self.complaint, facts)]
        return self._foreign(frame.node)

    def _chosen(self, before: int) -> list[DeviceEvent]:
        if self.node == before:
            return []
        text = f"the node's number is {self.node}"
        return [DeviceEvent("acknowledge", self._device, text, {"node": self.node})]

    def _foreign(self, node: int) -> list[DeviceEvent]:
        text = f"frames of node {node} ignored: this rig's is node {self.node}"
        return self._foreign_nodes.event(text, {"node": node})
