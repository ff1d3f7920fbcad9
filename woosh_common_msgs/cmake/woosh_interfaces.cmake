# The build of an interface package, used by all packages of this repository. The generators of rosidl and the
# compiler take several times as long with rosidl_generate_interfaces alone.

# The folder of sitecustomize.py.
set(_woosh_interfaces_folder "${CMAKE_CURRENT_LIST_DIR}")

# woosh_interfaces(): make a package of all .msg, .srv and .action files. The dependencies are listed only in
# package.xml. A macro, because ament_package needs the scope of the package.
#
# With -DWOOSH_WITHOUT_CPP=ON, no C++ code is generated.
macro(woosh_interfaces)
  find_package(ament_cmake REQUIRED)
  find_package(rosidl_default_generators REQUIRED)
  ament_package_xml()
  foreach(dependency IN LISTS ${PROJECT_NAME}_BUILD_DEPENDS)
    find_package(${dependency} REQUIRED)
  endforeach()
  if(WOOSH_WITHOUT_CPP)
    list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "_cpp:")
  endif()

  # Each generator parses every interface file with a slow parser, and its templates again for every interface.
  # sitecustomize.py lets it parse each of them once.
  set(cache "$ENV{WOOSH_IDL_CACHE}")
  if(cache STREQUAL "")
    set(cache "${CMAKE_CURRENT_BINARY_DIR}/idl_cache")
  endif()
  set(path "${_woosh_interfaces_folder}")
  if(NOT "$ENV{PYTHONPATH}" STREQUAL "")
    string(APPEND path ":$ENV{PYTHONPATH}")
  endif()
  set_property(DIRECTORY PROPERTY RULE_LAUNCH_CUSTOM
    "${CMAKE_COMMAND} -E env \"PYTHONPATH=${path}\" \"WOOSH_IDL_CACHE=${cache}\"")

  file(GLOB interfaces CONFIGURE_DEPENDS RELATIVE "${CMAKE_CURRENT_SOURCE_DIR}"
    msg/*.msg srv/*.srv action/*.action)
  rosidl_generate_interfaces(${PROJECT_NAME} ${interfaces}
    DEPENDENCIES ${${PROJECT_NAME}_BUILD_DEPENDS})
  # the generated code of other releases is not known to allow it
  if("$ENV{ROS_DISTRO}" MATCHES "^(humble|jazzy|kilted)$")
    _woosh_unity_build()
  endif()

  ament_export_dependencies(rosidl_default_runtime)
  ament_package(${ARGN})
endmacro()

# These libraries consist of many small files with the same headers: compile many at a time. The other
# libraries define the same names in several files, and so do the descriptions of types.
function(_woosh_unity_build)
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
  if(TARGET ${PROJECT_NAME}__rosidl_typesupport_fastrtps_cpp) # each file declares what it uses of others
    target_compile_options(${PROJECT_NAME}__rosidl_typesupport_fastrtps_cpp PRIVATE -Wno-redundant-decls)
  endif()
  # Nothing imports these modules: rclpy only uses that of rosidl_typesupport_c.
  foreach(kind rosidl_typesupport_fastrtps_c rosidl_typesupport_introspection_c)
    if(TARGET ${PROJECT_NAME}_s__${kind})
      set_property(TARGET ${PROJECT_NAME}_s__${kind} APPEND PROPERTY COMPILE_OPTIONS -O0)
    endif()
  endforeach()
endfunction()
