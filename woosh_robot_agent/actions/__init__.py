"""The actions: goals of ROS clients that the chassis executes and reports on.

`actions` creates the action servers, which `server` implements. `run` runs one goal in the link
thread, as a state machine with the phases of `phase`. It delegates three decisions: `attribution`
decides if a report belongs to the goal, `give_up` when to stop waiting, and `cancellation` when to
send a cancel. `kind` is the protocol that `tasks` and `call_actions` implement.
"""
