"""The actions: goals of ROS clients that the chassis executes and reports on.

`actions` puts all of them together, and `server` is the ROS side of a goal. `run` is the life of a
goal in the link's thread, in the phases of `phase`. It leaves three decisions to objects of their
own: `attribution` (is a report on this goal?), `give_up` (when to stop waiting) and `cancellation`.
`kind` is the protocol of what differs between goals; `tasks` and `call_actions` implement it.
"""
