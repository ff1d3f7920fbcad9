"""The interface packages serve C++ programs, where the build makes their C++ code."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix

CMAKE = """\
cmake_minimum_required(VERSION 3.16)
project(user CXX)
set(CMAKE_CXX_STANDARD 17)
find_package(woosh_robot_msgs REQUIRED)
find_package(rosidl_typesupport_cpp REQUIRED)
add_executable(user user.cpp)
if(TARGET woosh_robot_msgs::woosh_robot_msgs__rosidl_typesupport_cpp)
  target_link_libraries(user woosh_robot_msgs::woosh_robot_msgs__rosidl_typesupport_cpp)
endif()
foreach(kind fastrtps introspection)
  target_link_libraries(user woosh_robot_msgs::woosh_robot_msgs__rosidl_typesupport_${kind}_cpp)
endforeach()
"""
PROGRAM = """\
#include <iostream>
#include "rosidl_typesupport_cpp/message_type_support.hpp"
#include "rosidl_typesupport_cpp/service_type_support.hpp"
#include "rosidl_typesupport_introspection_cpp/message_introspection.hpp"
#include "rosidl_typesupport_introspection_cpp/message_type_support_decl.hpp"
#include "woosh_robot_msgs/action/exec_task.hpp"
#include "woosh_robot_msgs/msg/pose_speed.hpp"
#include "woosh_robot_msgs/srv/robot_info.hpp"

int main() {
  woosh_robot_msgs::msg::PoseSpeed pose;
  pose.pose.x = 1.5;
  using Members = rosidl_typesupport_introspection_cpp::MessageMembers;
  auto introspected = rosidl_typesupport_introspection_cpp::get_message_type_support_handle<
    woosh_robot_msgs::msg::PoseSpeed>();
  auto members = static_cast<const Members *>(introspected->data);
  auto inner = static_cast<const Members *>(members->members_[1].members_->data);
  bool found = rosidl_typesupport_cpp::get_message_type_support_handle<
                 woosh_robot_msgs::msg::PoseSpeed>() != nullptr &&
               rosidl_typesupport_cpp::get_service_type_support_handle<
                 woosh_robot_msgs::srv::RobotInfo>() != nullptr;
  std::cout << pose.pose.x << " " << members->message_name_ << " " << inner->message_namespace_
            << " " << found << std::endl;
}
"""


def test_a_cpp_program_uses_messages_services_and_their_introspection(tmp_path: Path) -> None:
    prefix = Path(get_package_prefix("woosh_robot_msgs"))
    if not list(prefix.rglob("pose_speed.hpp")):
        pytest.skip("no C++ code is built for ROS from PyPI, which has no rclcpp")
    (tmp_path / "CMakeLists.txt").write_text(CMAKE)
    (tmp_path / "user.cpp").write_text(PROGRAM)
    environment = {key: value for key, value in os.environ.items() if key != "WOOSH_IDL_CACHE"}
    for command in (["cmake", "-B", "build"], ["cmake", "--build", "build"], ["build/user"]):
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.split() == ["1.5", "PoseSpeed", "woosh_common_msgs::msg", "1"]
