r"""The file format of a recording: JSON lines, a header first, then frames and events in order.

    {"format": "woosh_robot_agent recording", "version": 1, "started": 1700000000.0, "address": ...}
    {"t": 0.01, "connection": 1, "event": "open", "by": "client", "text": "127.0.0.1:41234"}
    {"t": 0.02, "connection": 1, "from": "client", "text": "{\"type\":\"woosh.robot.Mode\", ...}"}
    {"t": 0.03, "connection": 1, "from": "chassis", "base64": "CgRieXRl"}

`t` is in seconds since `started`, which is Unix time. A text frame is in `text`, a binary frame in
`base64`. A text frame that is not valid UTF-8 is in `base64` too, with `"invalid": true`.
"""
