#!/usr/bin/env bash
# Unpack Debian's Python and numpy for ARMv7 into a folder, to run the packaged agent with qemu-arm-static (tests/e2e/test_arm.py).
# Nothing is installed: apt works on lists and a package database of its own. Each suite is fetched once.
#
#   tools/armhf_python.sh [SUITE...]        bullseye has Python 3.9, the oldest that the agent runs on; bookworm 3.11
#   XITL_ARMHF_ROOT                         where to (default: ~/.cache/xitl/armhf)
set -euo pipefail
root=${XITL_ARMHF_ROOT:-$HOME/.cache/xitl/armhf}
keyring=/usr/share/keyrings/debian-archive-keyring.gpg
for program in apt-get dpkg-deb; do
    command -v "$program" > /dev/null || { echo "$0: needs $program, which Debian and Ubuntu have" >&2; exit 2; }
done
[ -r "$keyring" ] || { echo "$0: needs Debian's keys: apt install debian-archive-keyring" >&2; exit 2; }
mkdir -p "$root"
work=$(mktemp -d "$root/.work-XXXXXX")
trap 'rm -rf "$work"' EXIT

targets=$(apt-get indextargets --no-release-info --format '$(REPO_URI)' 'Created-By: Packages')
mirror=$(grep --max-count=1 '/debian/\?$' <<< "$targets") ||
    { echo "$0: apt knows no Debian mirror here (an address that ends in /debian); the ARM tests will skip" >&2; exit 0; }

fetch() { # SUITE: its packages from this machine's own mirror to $work/cache/archives
    rm -rf "$work"/*
    mkdir -p "$work"/lists/partial "$work"/cache/archives/partial "$work"/etc/preferences.d
    echo "deb [signed-by=$keyring] $mirror $1 main" > "$work/sources.list"
    : > "$work/status"
    local options=(
        -qq -o Dir::State="$work" -o Dir::State::lists="$work/lists" -o Dir::State::status="$work/status"
        -o Dir::Cache="$work/cache" -o Dir::Etc="$work/etc" -o Dir::Etc::sourcelist="$work/sources.list"
        -o Dir::Etc::sourceparts=- -o APT::Architecture=armhf -o APT::Architectures=armhf
        -o APT::Sandbox::User= -o Acquire::Languages=none -o Acquire::Check-Valid-Until=false -o Acquire::Retries=3
        -o APT::Update::Error-Mode=any
    )
    apt-get "${options[@]}" update &&
        apt-get "${options[@]}" install --yes --download-only --no-install-recommends \
            python3-minimal libpython3-stdlib python3-numpy > /dev/null
}

for suite in "${@:-bullseye}"; do
    if [ -d "$root/$suite/usr/lib/python3/dist-packages/numpy" ]; then
        echo "$root/$suite is there"
        continue
    fi
    fetch "$suite" ||
        { echo "$0: Debian $suite for armhf cannot be fetched; is this machine online?" >&2; exit 1; }
    mkdir "$work/tree"
    for package in "$work"/cache/archives/*.deb; do
        dpkg-deb -x "$package" "$work/tree"
    done
    libraries=$work/tree/usr/lib/arm-linux-gnueabihf
    ln -s blas/libblas.so.3 lapack/liblapack.so.3 "$libraries" # as Debian's alternatives would, were the packages installed
    rm -rf "${root:?}/$suite"
    mv "$work/tree" "$root/$suite"
    echo "$root/$suite is ready"
done
