"""The programs `record` and `replay`, and their MCAP files, which Foxglove and others open.

`layout.py` defines the channels that `replay` needs: `/frames` with every frame byte for byte, and
`/connections` with the begin and end of connections. All other channels are for looking at:
`/chassis/...` and `/client/...` with the protobuf message in each frame, and `/view/...` with the
Foxglove schemas (`views.py`).
"""
