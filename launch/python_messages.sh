# Source this file (bash or zsh) if you build without catkin: rostopic, rosbag and rqt then know this package's messages.
#   . launch/python_messages.sh
# It generates their Python types in the user's cache, and sets PYTHONPATH and ROS_PACKAGE_PATH.
_source="${BASH_SOURCE[0]:-$0}"
_package="$(cd "$(dirname "$_source")/.." && pwd)"
_types="${XDG_CACHE_HOME:-$HOME/.cache}/anytime_scan_matcher/python"
_generator="$(command -v genmsg_py.py || ls /usr/lib/genpy/genmsg_py.py /opt/ros/*/lib/genpy/genmsg_py.py 2>/dev/null | head -n 1)"
_python=/usr/bin/python3
if mkdir -p "$_types/anytime_scan_matcher/msg" &&
  : >"$_types/anytime_scan_matcher/__init__.py" &&
  "$_python" "$_generator" -p anytime_scan_matcher -I "std_msgs:$_package/definitions/std_msgs/msg" \
    -I "anytime_scan_matcher:$_package/msg" -o "$_types/anytime_scan_matcher/msg" \
    "$_package"/msg/*.msg &&
  "$_python" "$_generator" --initpy -p anytime_scan_matcher -o "$_types/anytime_scan_matcher/msg"; then
  export PYTHONPATH="$_types${PYTHONPATH:+:$PYTHONPATH}"
  case ":${ROS_PACKAGE_PATH:-}:" in
    *":$_package:"* | *":$(dirname "$_package"):"*) ;;
    *) export ROS_PACKAGE_PATH="$_package:${ROS_PACKAGE_PATH:-/usr/share}" ;;
  esac
  echo "the types are in $_types"
else
  echo "cannot make the Python types of the messages: is genpy installed (Debian: python3-genpy)?" >&2
fi
unset _source _package _types _generator _python
