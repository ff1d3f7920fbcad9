# scripts/setup includes this file in each project() of the workspace. It speeds up the first build of
# the interface packages several times. A plain `colcon build` works without it.
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)

# PyPI has no rclcpp, so nothing could use the C++ code of the messages. With a sourced ROS, C++ nodes and
# `ros2 bag` do.
if(WOOSH_WITHOUT_CPP)
  list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "_cpp:")
endif()

# The packages may be copied to another checkout; scripts/env tells where the libraries are.
set(CMAKE_SKIP_RPATH ON)

# These libraries consist of many small files with the same headers: compile many at a time. The other
# libraries define the same names in several files, and so do the descriptions of types.
function(woosh_unity_build)
  foreach(kind rosidl_generator_c rosidl_typesupport_c rosidl_typesupport_fastrtps_c
      rosidl_typesupport_introspection_c rosidl_typesupport_cpp rosidl_typesupport_fastrtps_cpp
      rosidl_generator_py)
    if(TARGET ${PROJECT_NAME}__${kind})
      set_target_properties(${PROJECT_NAME}__${kind} PROPERTIES
        UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 40)
      get_target_property(sources ${PROJECT_NAME}__${kind} SOURCES)
      list(FILTER sources INCLUDE REGEX "__description\\.c$")
      foreach(source IN LISTS sources)
        set_source_files_properties("${source}" PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
      endforeach()
    endif()
  endforeach()
  # Nothing imports these modules: rclpy only uses that of rosidl_typesupport_c.
  foreach(kind rosidl_typesupport_fastrtps_c rosidl_typesupport_introspection_c)
    if(TARGET ${PROJECT_NAME}_s__${kind})
      set_property(TARGET ${PROJECT_NAME}_s__${kind} APPEND PROPERTY COMPILE_OPTIONS -O0)
    endif()
  endforeach()
endfunction()
if("$ENV{ROS_DISTRO}" MATCHES "^(humble|jazzy|kilted)$") # their generated code is known to allow it
  cmake_language(DEFER CALL woosh_unity_build)
endif()
