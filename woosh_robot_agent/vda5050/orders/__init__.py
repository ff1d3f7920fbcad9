"""Acceptance and execution of orders and instant actions: state machines without I/O or clocks.

`OrderMachine` and `InstantActions` take events (an order, a new position, the end of a drive or of
an action) and return commands (drive a leg, perform an action). The caller executes the commands.
"""
