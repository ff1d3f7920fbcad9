"""The programs `record` and `replay`, and their MCAP files, which Foxglove and others open.

`layout.py` defines the channels that `replay` needs: `/frames` with every frame byte for byte, and
`/connections` with the events of connections. All other channels are only for display.
`/chassis/...` and `/client/...` have the decoded protobuf messages of the frames. `/view/...` has
views, i.e. messages with Foxglove's schemas, such as the laser scan (`views.py`).
"""
