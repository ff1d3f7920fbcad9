# shellcheck shell=sh
# Set up this shell for the ROS 2 of woosh_robot_agent. ../setup.bash and ../setup.sh source this file.
_woosh_prepend() {
  eval "_woosh_value=\${$1-}"
  case ":$_woosh_value:" in
    *":$2:"*) ;;
    *) export "$1=$2${_woosh_value:+:$_woosh_value}" ;;
  esac
  unset _woosh_value
}
export ROS_DISTRO=@ros_distro@ ROS_VERSION=2 ROS_PYTHON_VERSION=3
# Otherwise the wheels restart each Python process to set LD_LIBRARY_PATH.
export _ROS_WHEELS_BOOTSTRAP_COMPLETE=1
_woosh_prepend PATH @prefix@/venv/bin
_woosh_prepend AMENT_PREFIX_PATH @prefix@/venv
_woosh_prepend CMAKE_PREFIX_PATH @prefix@/venv
for _woosh_folder in @prefix@/venv/lib/python3.*/site-packages/ros_*.libs @prefix@/venv/lib; do
  [ ! -d "$_woosh_folder" ] || _woosh_prepend LD_LIBRARY_PATH "$_woosh_folder"
done
unset _woosh_folder
unset -f _woosh_prepend
