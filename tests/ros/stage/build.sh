#!/bin/sh
# Build Stage, stageros and the throttle into a folder: tests/ros/stage/build.sh THIRD_PARTY FOLDER
# Stage and stage_ros are GPL-2+: they are built and run here, and no part of zswarm.
set -eu
sources=$(realpath "$1")
mkdir -p "$2"
folder=$(realpath "$2")
here=$(dirname "$(realpath "$0")")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

tar -xJf "$sources/stage-4.3.tar.xz" -C "$work"
tar -xJf "$sources/stage_ros-1.8.0.tar.xz" -C "$work"
patch --quiet --directory "$work/stage_ros" --strip 1 < "$sources/stageros-reset.patch"
# The library alone: no examples, no worlds.
sed -i -E 's/^ *(ADD_SUBDIRECTORY|add_subdirectory) *\( *(examples|worlds|avonstage) *\)//' "$work/Stage/CMakeLists.txt"
# Each of its some 40 files reads headers of the C++ library, X and OpenGL through this one.
echo 'target_precompile_headers(stage PRIVATE stage.hh)' >> "$work/Stage/libstage/CMakeLists.txt"

build() {  # SOURCE OPTION...: build and install it
    from=$1
    shift
    cmake -S "$from" -B "$work/build-$(basename "$from")" -Wno-dev -DCMAKE_BUILD_TYPE=Release -DCMAKE_CXX_FLAGS_RELEASE=-O1 \
        -DCMAKE_INSTALL_PREFIX="$folder" -DCMAKE_INSTALL_RPATH="$folder/lib" -DCMAKE_POLICY_VERSION_MINIMUM=3.5 "$@"
    cmake --build "$work/build-$(basename "$from")" --parallel "$(nproc)" --target install
}
build "$work/Stage"
build "$work/stage_ros" -DCATKIN_ENABLE_TESTING=OFF -DCMAKE_PREFIX_PATH="$folder" -DPYTHON_EXECUTABLE=/usr/bin/python3
PKG_CONFIG_PATH=$folder/lib/pkgconfig
export PKG_CONFIG_PATH
for controller in throttle lockstep; do
    g++ -O2 -Wall -shared -fPIC $(pkg-config --cflags stage roscpp geometry_msgs std_srvs) \
        -o "$folder/lib/$controller.so" "$here/../../../examples/ros/stage/$controller.cc"
done
touch "$folder/ready"
