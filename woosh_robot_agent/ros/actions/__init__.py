"""The actions: goals of ROS clients that the chassis executes and reports on.

`actions` creates the action servers, which `server` implements. `goal` has the phases and events of
a goal; `tasks` and `calls` have the kinds of goals. `run` runs one goal in the link thread, as a
state machine. `giving_up` decides when to send a cancel, and when to stop waiting.
"""
