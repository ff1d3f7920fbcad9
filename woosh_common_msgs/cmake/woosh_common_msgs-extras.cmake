include("${CMAKE_CURRENT_LIST_DIR}/woosh_interfaces.cmake")
