# Included at each project() of the workspace by scripts/setup: makes the first build of the
# interface packages several times as fast. A plain `colcon build` does without.
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)

# There is no rclcpp on PyPI: nobody could use the C++ side of the messages there.
if(WOOSH_WITHOUT_CPP)
  list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "_cpp:")
endif()

# Each of these is many small files that include the same headers: compile them a dozen at a time.
# (The other libraries repeat names from file to file.)
function(woosh_unity_build)
  foreach(kind rosidl_typesupport_c rosidl_typesupport_fastrtps_c rosidl_typesupport_introspection_c
      rosidl_typesupport_cpp rosidl_typesupport_fastrtps_cpp rosidl_generator_py)
    if(TARGET ${PROJECT_NAME}__${kind})
      set_target_properties(${PROJECT_NAME}__${kind} PROPERTIES
        UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 12)
    endif()
  endforeach()
endfunction()
if("$ENV{ROS_DISTRO}" STREQUAL "jazzy") # the one whose generated code is known to allow it
  cmake_language(DEFER CALL woosh_unity_build)
endif()
