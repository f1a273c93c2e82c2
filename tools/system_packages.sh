#!/usr/bin/env bash
# What some tests need beside Python: an ssh server, network namespaces, an ARM emulator, systemd-analyze, Lua, a browser. As root on Debian
# or Ubuntu, install what is missing; elsewhere say so, and those tests skip. No service is started.
set -euo pipefail
declare -A package_of=(
    [ssh]=openssh-client [sshd]=openssh-server [ip]=iproute2 [lua5.3]=lua5.3 [qemu-arm-static]=qemu-user-static
    [systemd-analyze]=systemd [chromium]=chromium
)
PATH=$PATH:/usr/sbin:/sbin
missing=()
for program in "${!package_of[@]}"; do
    command -v "$program" > /dev/null || missing+=("${package_of[$program]}")
done
[ -r /usr/share/keyrings/debian-archive-keyring.gpg ] || missing+=(debian-archive-keyring)
if [ ${#missing[@]} -gt 0 ]; then
    if [ "$(id -u)" -ne 0 ] || ! command -v apt-get > /dev/null; then
        echo "missing, so that some tests skip: ${missing[*]} (names of Debian packages)" >&2
        exit 0
    fi
    policy=/usr/sbin/policy-rc.d # what Debian asks whether a service may start
    if [ ! -e "$policy" ]; then
        trap 'rm -f "$policy"' EXIT
        printf '#!/bin/sh\nexit 101\n' > "$policy"
        chmod 755 "$policy"
    fi
    export DEBIAN_FRONTEND=noninteractive
    apt-get update -qq
    apt-get install -qq --yes --no-install-recommends "${missing[@]}" > /dev/null
fi
[ "$(id -u)" -ne 0 ] || mkdir -p /run/sshd # where a server of root's own separates privileges
