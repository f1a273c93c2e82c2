"""An image of a suite, CACHE/board-images/SUITE-VERSION/: disk, kernel and early user space, made without root.

    packages -> unpacked under fakeroot, with dpkg's database as after `dpkg --unpack` -> ext4 -> configured by
    Debian's own scripts, in the emulator -> image.json

Each step leaves a mark, so that an interrupted build continues at that step.
"""

from __future__ import annotations

import fcntl
import gzip
import json
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from xitl_cli.errors import UserError
from xitl_cli.plugins.board import recipe
from xitl_cli.plugins.board.emulator import ConsoleFile, machine_arguments
from xitl_cli.plugins.board.packages import FetchedPackages, fetch
from xitl_cli.plugins.board.places import images_root, make_folder
from xitl_cli.plugins.board.tools import checked_run, find_program, last_words

Progress = Callable[[str], None]
SETUP_LIMIT_S = 2400.0
"""A machine that is busy with tests takes more than twenty minutes, an idle one less than four."""
LEAST_FREE_MIB = 1200
_DEPENDS = re.compile(rb"\0depends=([^\0]*)\0")


@dataclass(frozen=True, slots=True)
class BoardImage:
    """Image of a suite."""

    folder: Path
    """Folder of its files."""
    suite: str
    version: str
    kernel_release: str
    """Kernel release, as in the board's `uname -r`."""
    packages: int
    """Number of installed packages."""

    @property
    def disk(self) -> Path:
        """The root file system, ext4. Boards write to overlay files."""
        return self.folder / "disk.qcow2"

    @property
    def kernel(self) -> Path:
        """Debian's kernel."""
        return self.folder / "vmlinuz"

    @property
    def early(self) -> Path:
        """The early user space that mounts the disk."""
        return self.folder / "early.cpio.gz"


def find_image(suite: str) -> BoardImage | None:
    """Return the image of this version of xitl, None if it does not exist."""
    folder = images_root() / f"{suite}-{recipe.recipe_version()}"
    try:
        read = json.loads((folder / "image.json").read_text(encoding="utf-8"))
        return BoardImage(folder, read["suite"], read["version"], read["kernel_release"], read["packages"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def make_image(suite: str, mirror: str | None, progress: Progress) -> BoardImage:
    """Return the image of a suite; make it if it does not exist. Raises UserError. Completed steps are kept."""
    make_folder(images_root())
    # Hold the lock of the image. A second process waits and then finds the finished image.
    with (images_root() / f"{suite}.lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            progress("waiting for another xitl that makes this image")
            fcntl.flock(lock, fcntl.LOCK_EX)
        return find_image(suite) or _make_image(suite, mirror, progress)


def _make_image(suite: str, mirror: str | None, progress: Progress) -> BoardImage:
    folder = images_root() / f"{suite}-{recipe.recipe_version()}"
    make_folder(folder)
    free_mib = shutil.disk_usage(folder).free >> 20
    if free_mib < LEAST_FREE_MIB:
        raise UserError(
            f"{folder}: {free_mib} MiB are free, but making an image takes {LEAST_FREE_MIB} MiB; free space, or set "
            "XITL_CACHE to a folder on another disk"
        )
    progress(f"fetching the packages of Debian {suite} for {recipe.ARCHITECTURE}")
    packages = fetch(suite, mirror, images_root() / f"{suite}-packages")
    image = BoardImage(folder, suite, recipe.recipe_version(), "", len(packages.installed))
    unpacked = folder / "unpacked"
    if not unpacked.is_file():
        release = _unpack(image, packages, progress)
        unpacked.write_text(release, encoding="utf-8")
    image = BoardImage(folder, suite, image.version, unpacked.read_text(encoding="utf-8"), image.packages)
    _configure(image, progress)
    words = ["convert", "-O", "qcow2", str(folder / "configuring.qcow2"), str(image.disk)]
    checked_run(["qemu-img", *words], f"{image.disk}: cannot be made", "free space, or try again")
    facts = {key: value for key, value in asdict(image).items() if key != "folder"}
    (folder / "image.json").write_text(json.dumps(facts, indent=2) + "\n", encoding="utf-8")
    for left in ("unpacked", "unpacked.img", "setup.log", "configuring.qcow2"):
        (folder / left).unlink(missing_ok=True)
    return image


def _unpack(image: BoardImage, packages: FetchedPackages, progress: Progress) -> str:
    """Make disk, kernel and early user space. Return the kernel's release."""
    tree = image.folder / "tree"
    shutil.rmtree(tree, ignore_errors=True)
    progress(f"unpacking {len(packages.installed)} packages")
    job = {
        "tree": str(tree),
        "packages": list(map(str, packages.installed)),
        "kernel": str(packages.kernel),
        "disk": str(image.folder / "unpacked.img"),
    }
    words = ["fakeroot", "--", sys.executable, "-m", "xitl_cli.plugins.board.unpack", json.dumps(job)]
    checked_run(words, f"{image.folder}: the packages cannot be unpacked", "free space, or try again")
    (kernel,) = (tree / "boot").glob("vmlinuz-*")
    release = kernel.name.removeprefix("vmlinuz-")
    shutil.copyfile(kernel, image.kernel)
    busybox = image.folder / "busybox"
    checked_run(["dpkg-deb", "-x", str(packages.busybox), str(busybox)], "busybox cannot be unpacked", "try again")
    image.early.write_bytes(early_archive(busybox / "bin/busybox", tree / "lib/modules" / release / "kernel"))
    shutil.rmtree(busybox)
    shutil.rmtree(tree)
    return release


def early_archive(busybox: Path, modules: Path) -> bytes:
    """Return the early user space, compressed. modules: folder of the kernel's modules."""
    loaded = list(_in_order(modules))
    files = {"init": (0o755, recipe.EARLY_INIT.encode()), "bin/busybox": (0o755, busybox.read_bytes())}
    files |= {f"modules/{path.name}": (0o644, path.read_bytes()) for path in loaded}
    files["modules/order"] = (0o644, "".join(f"{path.name}\n" for path in loaded).encode())
    return gzip.compress(cpio_archive(files), 6, mtime=0)


def _in_order(root: Path) -> Iterator[Path]:
    """Return the early modules and all their dependencies, each after the modules it needs."""
    files = {path.name.partition(".")[0].replace("-", "_"): path for path in root.rglob("*.ko")}
    done: set[str] = set()

    def with_needed(name: str) -> Iterator[Path]:
        if name in done or name not in files:  # built-in modules have no file
            return
        done.add(name)
        depends = _DEPENDS.search(files[name].read_bytes())
        for needed in depends[1].decode().split(",") if depends else ():
            yield from with_needed(needed.replace("-", "_"))
        yield files[name]

    for name in recipe.EARLY_MODULES:
        yield from with_needed(name)


def cpio_archive(files: dict[str, tuple[int, bytes]]) -> bytes:
    """Return an archive of files by path, each with mode and content, owned by root, in the format of Linux's initramfs
    (newc).
    """
    folders = sorted({str(parent) for path in files for parent in Path(path).parents if str(parent) != "."})
    entries = [(folder, 0o040755, b"") for folder in folders]
    entries += [(path, 0o100000 | mode, data) for path, (mode, data) in files.items()]
    made = bytearray()
    for number, (path, mode, data) in enumerate([*entries, ("TRAILER!!!", 0, b"")], 1):
        name = path.encode() + b"\0"
        fields = (number, mode, 0, 0, 1, 0, len(data), 0, 0, 0, 0, len(name), 0)
        made += b"070701" + b"".join(b"%08X" % field for field in fields) + name
        made += b"\0" * (-len(made) % 4) + data
        made += b"\0" * (-len(made) % 4)
    return bytes(made)


def make_overlay(disk: Path, base: Path, kind: str) -> None:
    """Make a disk that holds only the differences from `base`, in the format `kind`."""
    disk.unlink(missing_ok=True)
    words = ["qemu-img", "create", "-q", "-f", "qcow2", "-F", kind, "-b", str(base), str(disk)]
    checked_run(words, f"{disk}: cannot be made", "free space, or check the permissions of its folder")


def _configure(image: BoardImage, progress: Progress) -> None:
    """Configure the packages with Debian's scripts, in the emulator."""
    disk, console = image.folder / "configuring.qcow2", image.folder / "setup.log"
    make_overlay(disk, image.folder / "unpacked.img", "raw")
    arguments = machine_arguments(
        1, 512, image.kernel, image.early, f"rw console={recipe.CONSOLE_DEVICE} -- xitl.init=/xitl-setup"
    )
    command = [
        *arguments, "-no-reboot", "-serial", f"file:{console}",
        "-drive", f"if=none,id=disk,format=qcow2,cache=unsafe,file={disk}", "-device", "virtio-blk-device,drive=disk",
    ]  # fmt: skip
    console.write_bytes(b"")
    output = ConsoleFile(console)
    words = [find_program(command[0]) or command[0], *command[1:]]
    with subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=console.open("ab")) as ran:
        try:
            end_s = time.monotonic() + SETUP_LIMIT_S
            while time.monotonic() < end_s and ran.poll() is None:
                count = output.text().count("Setting up ")
                progress(f"configuring package {count} of {image.packages} in the emulator")
                time.sleep(0.5)
        finally:
            ran.kill()
    if recipe.SETUP_DONE not in output.text():
        raise UserError(
            f"{image.folder}: the packages were not configured in the emulator; its console ended with: "
            f"{last_words(output.text())}; try again, or remove the folder if this fails too"
        )
