"""Acceptance and execution of orders, as a state machine without I/O and clocks.

`OrderMachine` takes events (an order, a new position, the end of a drive or of an action) and
returns commands (drive a leg, perform an action). The caller executes the commands.
"""
