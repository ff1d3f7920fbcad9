"""A Woosh robot as a VDA 5050 vehicle, without ROS.

This program, the connector, talks to the robot over the link and to the master control over MQTT.
Its parts, from the bottom up:

- `messages/`: orders, states and factsheets as Python values, and how each version of the standard
  writes them as JSON.
- `orders/`: acceptance and execution of orders and instant actions, as state machines without I/O
  or clocks.
- `robot/`: reports of the robot, and commands to it: tasks, actions of its own, speed limits.
- `execution`: the state machines and the robot together.
- `mqtt`, `store`, `reports`: the connection to the broker, the state file, the published messages.
- `session`: a vehicle at the broker, which combines these three.
- `actions/`: the actions that the robot can perform.
- `intake`: acceptance or rejection of messages.
- `vehicle`: one robot with all of these parts.
- `program`, `robots_file`: the vehicles of one process, and the command line.

docs/vda5050_reference.md follows an order, an instant action and a state message through the code.
"""
