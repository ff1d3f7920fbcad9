"""The programs `record` and `replay`, and their MCAP files, which Foxglove and others open.

`layout.py` defines the channels that `replay` needs: `/frames` with every frame byte for byte, and
`/connections` with the start and end of connections. All other channels are only for display:
`/chassis/...` and `/client/...` have the protobuf message in each frame, and `/view/...` has views:
messages with Foxglove's schemas, e.g. the laser scan (`views.py`).
"""
