"""Floor of map transfers: a node with two services, of which one answers with a large map.

    python -m benchmarks.floors.maps BYTES

The answer to a download is made once: a file of the given size. An upload is accepted and dropped.
The program prints `true` when its services exist.
"""

from __future__ import annotations

import os
import sys
from array import array
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

from woosh_common_msgs.msg import FileData
from woosh_map_msgs.srv import Download, Upload


def main(size: int) -> None:
    rclpy.init()
    node = rclpy.create_node("floor", namespace="/woosh_robot")
    files = [FileData(name="map.png", data=array("B", os.urandom(size)))]

    def download(_request: Any, response: Any) -> Any:
        response.ok = True
        response.ret.file_datas = files
        return response

    def upload(_request: Any, response: Any) -> Any:
        response.ok = True
        return response

    node.create_service(Download, "map/Download", download)
    node.create_service(Upload, "map/Upload", upload)
    print("true", flush=True)
    rclpy.spin(node, SingleThreadedExecutor())


if __name__ == "__main__":
    try:
        main(int(sys.argv[1]))
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
