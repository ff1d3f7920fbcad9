"""The actions: goals of ROS clients that the chassis runs and reports on.

`server` is the ROS side of a goal, `run` its life in the link's thread, `doubt` when to give up
waiting, and `tasks` and `call_actions` what is particular to the two kinds of goals.
"""
