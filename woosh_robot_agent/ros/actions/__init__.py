"""The actions: goals of ROS clients that the chassis executes and reports on.

`actions` creates the action servers, which `server` implements. `goal` says what a goal is, and
`tasks` and `calls` have its kinds. `run` runs one goal in the link thread, as a state machine.
`giving_up` decides when to send a cancel, and when to stop waiting.
"""
