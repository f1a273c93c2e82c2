"""Contents of a board's image. Every change here changes `recipe_version`."""

from __future__ import annotations

import hashlib
import json

LAYOUT = 1
"""Version of the format of the files that `image.py` makes."""

SUITES = ("bookworm", "bullseye")
"""Debian 12 with Python 3.11, and Debian 11 with Python 3.9, the oldest version that the agent supports."""

KERNEL = "linux-image-armmp"
ARCHITECTURE = "armhf"
PACKAGES = (
    "apt",
    "dbus",
    "init",
    "iproute2",
    "kmod",
    "libpam-systemd",
    "openssh-server",
    "procps",
    "python3",
    "stress",
    "systemd",
    "udev",
)
ONLY_IN = {"bookworm": ("usr-is-merged",)}
NUMPY = "python3-numpy"
BUSYBOX = "busybox-static"
"""Runs before the root file system is mounted, and is not installed."""

EARLY_MODULES = ("virtio_mmio", "virtio_pci", "virtio_blk", "ext4", "crc32c_generic")
"""Kernel modules needed to reach the disk."""

MODULES = (
    "arch/*",
    "block/*",
    "crypto/*",
    "drivers/block/*",
    "drivers/char/*",
    "drivers/net/can/*",
    "drivers/net/tun.ko*",
    "drivers/net/virtio_net.ko*",
    "drivers/net/net_failover.ko*",
    "drivers/tty/*",
    "drivers/usb/serial/*",
    "drivers/virtio/*",
    "fs/ext4/*",
    "fs/fuse/*",
    "fs/jbd2/*",
    "fs/mbcache.ko*",
    "fs/overlayfs/*",
    "lib/*",
    "mm/*",
    "net/8021q/*",
    "net/can/*",
    "net/core/*",
    "net/ipv4/*",
    "net/ipv6/*",
    "net/netfilter/*",
    "net/packet/*",
    "net/sched/*",
)
"""Kernel modules for devices of the emulated machine, or of other use there."""

LEFT_OUT = ("usr/share/doc/*", "usr/share/man/*", "usr/share/locale/*", "usr/share/info/*", "usr/share/lintian/*")
KEPT = ("usr/share/doc/*/copyright",)

INTERFACE = "usb0"
"""The board's network interface, as on a board behind USB-Ethernet."""
HOST_ADDRESS, BOARD_ADDRESS, NETWORK = "192.168.7.1", "192.168.7.2", "192.168.7.0/24"
BOARD_PORTS = (14660, 14661)
"""Ports of the agents on the board: the autopilot's, the companion's."""
MAVLINK_PORT = 5762
"""Port of an ArduPilot on the board for ground stations."""
SSH_PORT = 22
SERVICE_PORTS = (SSH_PORT, *BOARD_PORTS, MAVLINK_PORT)
DISK_MIB = 3072
CONSOLE_DEVICE = "ttyAMA0"
SETUP_DONE = "xitl-setup: done"
SETUP_FAILED = "xitl-setup: failed"
READY = "xitl-board: ready"

EARLY_INIT = """\
#!/bin/busybox sh
PATH=/bin
for name in mkdir mount umount insmod sleep cp poweroff switch_root; do busybox ln -s busybox "/bin/$name"; done
mkdir -p /proc /sys /dev /root
mount -t proc proc /proc
mount -t sysfs sysfs /sys
mount -t devtmpfs devtmpfs /dev
while read -r module; do
    insmod "/modules/$module" || echo "xitl-board: the module $module cannot be loaded"
done < /modules/order
tries=0
until [ -b /dev/vda ] || [ $tries -ge 100 ]; do
    tries=$((tries + 1))
    sleep 0.1
done
mount -t ext4 -o rw,noatime,commit=1 /dev/vda /root || {
    echo "xitl-board: the disk cannot be mounted"
    poweroff -f
}
[ ! -d /seed ] || cp -a /seed/. /root/
umount /proc /sys
mount --move /dev /root/dev
init=/sbin/init
for word in "$@"; do
    case "$word" in xitl.init=*) init=${word#xitl.init=} ;; esac
done
exec switch_root /root "$init"
"""

MASKED = (
    "apt-daily-upgrade.timer",
    "apt-daily.timer",
    "dev-hugepages.mount",
    "dev-mqueue.mount",
    "dpkg-db-backup.timer",
    "e2scrub_all.timer",
    "e2scrub_reap.service",
    "fstrim.timer",
    "getty@tty1.service",
    "modprobe@dm_mod.service",
    "modprobe@drm.service",
    "modprobe@efi_pstore.service",
    "modprobe@loop.service",
    "proc-sys-fs-binfmt_misc.automount",
    "sys-kernel-debug.mount",
    "sys-kernel-tracing.mount",
    "systemd-networkd-wait-online.service",
    "systemd-pstore.service",
)
"""Units that only cost time on an emulated board."""

SETUP = f"""\
#!/bin/sh
PATH=/usr/sbin:/usr/bin:/sbin:/bin DEBIAN_FRONTEND=noninteractive DEBCONF_NONINTERACTIVE_SEEN=true LC_ALL=C
export PATH DEBIAN_FRONTEND DEBCONF_NONINTERACTIVE_SEEN LC_ALL
mount -t proc proc /proc
mount -t sysfs sysfs /sys
mount -t tmpfs tmpfs /run
printf '#!/bin/sh\\nexit 101\\n' > /usr/sbin/policy-rc.d
chmod 755 /usr/sbin/policy-rc.d
for kind in rsa ecdsa ed25519; do : > "/etc/ssh/ssh_host_${{kind}}_key"; done # each board gets one of its own
configure() {{ dpkg --force-unsafe-io --configure "$@" 2>&1; }}
configure base-passwd && configure base-files && configure --pending || configure --pending
status=$?
ldconfig
for kernel in /lib/modules/*; do depmod "${{kernel##*/}}"; done
rm -f /usr/sbin/policy-rc.d /xitl-setup /etc/machine-id /var/lib/dbus/machine-id /etc/ssh/ssh_host_*
: > /etc/machine-id
systemctl enable systemd-networkd ssh xitl-board-ready.service
systemctl mask {" ".join(MASKED)}
systemctl set-default multi-user.target
passwd -l root > /dev/null
sync
[ $status -eq 0 ] && echo "{SETUP_DONE}" || echo "{SETUP_FAILED}"
mount -o remount,ro /
echo o > /proc/sysrq-trigger
sleep 60
"""

ROOT_FILES = {
    "etc/dpkg/dpkg.cfg.d/xitl": "".join(
        [f"path-exclude=/{pattern}\n" for pattern in LEFT_OUT] + [f"path-include=/{pattern}\n" for pattern in KEPT]
    ),
    "etc/apt/apt.conf.d/99xitl": 'APT::Install-Recommends "false";\n',
    "etc/fstab": "",
    "etc/hosts": "127.0.0.1 localhost\n",
    "etc/resolv.conf": "",
    "etc/systemd/network/10-xitl.link": (
        f"[Match]\nDriver=virtio_net\n\n[Link]\nName={INTERFACE}\nMACAddressPolicy=none\n"
    ),
    "etc/systemd/network/10-xitl.network": (
        f"[Match]\nName={INTERFACE}\n\n[Network]\nAddress={BOARD_ADDRESS}/24\nGateway={HOST_ADDRESS}\n"
        "LinkLocalAddressing=no\nIPv6AcceptRA=no\nConfigureWithoutCarrier=yes\nIgnoreCarrierLoss=yes\n"
    ),
    "etc/systemd/system/serial-getty@.service.d/xitl.conf": (
        "[Service]\nExecStart=\n"
        "ExecStart=-/sbin/agetty --autologin root --wait-cr --keep-baud 115200,38400,9600 %I $TERM\n"
    ),
    "etc/systemd/system/xitl-board-ready.service": (
        "[Unit]\nDescription=Tell the emulator's console that the board is up\n"
        "After=ssh.service network.target\nRequires=ssh.service\n\n"
        f"[Service]\nType=oneshot\nExecStart=/bin/sh -c 'echo {READY} > /dev/{CONSOLE_DEVICE}'\n\n"
        "[Install]\nWantedBy=multi-user.target\n"
    ),
    "etc/ssh/sshd_config.d/xitl.conf": (
        "HostKey /etc/ssh/ssh_host_ed25519_key\nPasswordAuthentication no\nUseDNS no\nPrintMotd no\n"
    ),
    "etc/systemd/journald.conf.d/xitl.conf": "[Journal]\nStorage=persistent\nSystemMaxUse=64M\n",
    "etc/sysctl.d/xitl.conf": "kernel.printk = 4 4 1 4\n",
}
"""Files of the root file system in addition to those of packages, by path."""


def packages_of(suite: str) -> tuple[str, ...]:
    """Return the packages of an image, in addition to Debian's essential packages and all dependencies."""
    return (*PACKAGES, NUMPY, *ONLY_IN.get(suite, ()))


def recipe_version() -> str:
    """Return a version that changes with every input of an image."""
    said = (LAYOUT, KERNEL, PACKAGES, ONLY_IN, NUMPY, EARLY_MODULES, MODULES, LEFT_OUT, EARLY_INIT, SETUP, ROOT_FILES)
    return hashlib.sha256(json.dumps(said).encode()).hexdigest()[:8]
