"""The open ROS 2 agent of Woosh mobile robots.

Layers, each importing only those below it: `agent`, the ROS side (`services`, `topics`,
`actions`), the table of `endpoints`, `convert`, and `link`, which knows nothing of ROS.
"""
