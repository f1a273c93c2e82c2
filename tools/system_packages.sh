#!/usr/bin/env bash
# What some tests need beside Python: an ssh server, network namespaces, ARM emulators, systemd-analyze, Lua, a browser, EGL, ROS 1. As root
# on Debian or Ubuntu, install what is missing; elsewhere say so, and those tests skip. No service is started.
set -euo pipefail
declare -A package_of=(
    [ssh]=openssh-client [sshd]=openssh-server [ip]=iproute2 [lua5.3]=lua5.3 [qemu-arm-static]=qemu-user-static
    [systemd-analyze]=systemd [chromium]=chromium [qemu-system-arm]=qemu-system-arm [qemu-img]=qemu-utils
    [mke2fs]=e2fsprogs [fakeroot]=fakeroot
)
PATH=$PATH:/usr/sbin:/sbin
missing=()
for program in "${!package_of[@]}"; do
    command -v "$program" > /dev/null || missing+=("${package_of[$program]}")
done
[ -e /usr/share/glvnd/egl_vendor.d/50_mesa.json ] || missing+=(libegl1 libgl1-mesa-dri)
[ -r /usr/share/keyrings/debian-archive-keyring.gpg ] || missing+=(debian-archive-keyring)
ros1=() # some 80 packages of 15 MB, 170 MB on disk, ten seconds; a distribution may have dropped it
if ! command -v rostopic > /dev/null || [ ! -d /usr/lib/python3/dist-packages/nav_msgs ]; then
    ros1=(ros-core python3-nav-msgs python3-sensor-msgs python3-std-srvs python3-tf2-msgs)
fi
if [ ${#missing[@]} -gt 0 ] || [ ${#ros1[@]} -gt 0 ]; then
    if [ "$(id -u)" -ne 0 ] || ! command -v apt-get > /dev/null; then
        echo "missing, so that some tests skip: ${missing[*]} ${ros1[*]} (names of Debian packages)" >&2
        exit 0
    fi
    policy=/usr/sbin/policy-rc.d # what Debian asks whether a service may start
    if [ ! -e "$policy" ]; then
        trap 'rm -f "$policy"' EXIT
        printf '#!/bin/sh\nexit 101\n' > "$policy"
        chmod 755 "$policy"
    fi
    export DEBIAN_FRONTEND=noninteractive
    wait=(-o DPkg::Lock::Timeout=300) # for another installation that is under way
    apt-get update -qq
    [ ${#missing[@]} -eq 0 ] || apt-get install "${wait[@]}" -qq --yes --no-install-recommends "${missing[@]}" > /dev/null
    [ ${#ros1[@]} -eq 0 ] || apt-get install "${wait[@]}" -qq --yes --no-install-recommends "${ros1[@]}" > /dev/null ||
        echo "no ROS 1 here, so that its tests skip" >&2
fi
[ "$(id -u)" -ne 0 ] || mkdir -p /run/sshd # where a server of root's own separates privileges
