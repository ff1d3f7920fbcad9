"""A Woosh robot as a VDA 5050 vehicle, without ROS.

The connector talks to the robot over the link and to the master control over MQTT. Its parts, from
the bottom up:

- `model/`: orders, states and factsheets as Python values, the same for all versions.
- `orders/`: acceptance and execution of an order, as a state machine without I/O and clocks.
- `protocol/`: the messages of each version of the standard as JSON, and their validation.
- `robot/`: what the robot reports, as values of the model.
- `actions/`: the actions that the robot can perform.
- `driving`, `leg_task`, `task_orders`, `speed`: driving along the edges of an order by tasks of the
  robot, their pause and cancellation, and their speed limits. `background`: asyncio tasks of these
  parts.
- `mqtt`: the connection to the broker. `other_connector`: detection of a second connector.
- `store`: the state file, which keeps the order and the header ids over a restart.
- `publisher`, `reports`, `schedule`: what is published, and when.
- `parsing`, `order_check`, `intake`: received messages: parsing, check, acceptance or rejection.
- `drive_permission`: permission to start a drive, and the reasons against it.
- `session`: the vehicle under one identity: its connection to the broker, and its state file.
- `vehicle`: one robot with all of these parts.
- `connector`, `program`: the vehicles of one process, and the command line.
"""
