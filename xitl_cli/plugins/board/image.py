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
from dataclasses import asdict
from pathlib import Path

from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.plugins.board import recipe
from xitl_cli.plugins.board.emulator import ConsoleFile, machine_arguments
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


KEYRING = Path("/usr/share/keyrings/debian-archive-keyring.gpg")
LONGEST_S = 900.0
_OTHER = "set a Debian mirror with --mirror URL"
_KERNEL = re.compile(r"Depends: (linux-image-\S+)")


@dataclass(frozen=True, slots=True)
class FetchedPackages:
    """Archives on this machine: packages to install, the kernel's, and the shell for the time before the disk is
    mounted.
    """

    installed: tuple[Path, ...]
    kernel: Path
    busybox: Path


def fetch(suite: str, mirror: str | None, work: Path) -> FetchedPackages:
    """Fetch the packages of an image of `suite` to the folder `work`, from `mirror` or from apt's mirror. Raises
    UserError.
    """
    if not KEYRING.is_file():
        raise UserError(f"{KEYRING}: missing, with Debian's keys; install it: apt install debian-archive-keyring")
    if mirror is None:
        targets = ["indextargets", "--no-release-info", "--format", "$(REPO_URI)", "Created-By: Packages"]
        lines = checked_run(["apt-get", *targets], "apt does not list its mirrors", _OTHER).splitlines()
        mirror = next((line.strip() for line in lines if line.rstrip("/").endswith("/debian")), None)
        if mirror is None:
            raise UserError(f"apt has no Debian mirror here (an address that ends in /debian); {_OTHER}")
    apt = _Apt(work, suite, mirror)
    apt.update()
    return FetchedPackages(apt.fetch_all(recipe.packages_of(suite)), apt.fetch_kernel(), apt.fetch_one(recipe.BUSYBOX))


class _Apt:
    """apt-get with a private configuration under a folder."""

    def __init__(self, work: Path, suite: str, mirror: str) -> None:
        for folder in ("lists/partial", "archives/partial", "etc/preferences.d"):
            (work / folder).mkdir(parents=True, exist_ok=True)
        self._sources = work / "sources.list"
        self._sources.write_text(f"deb [signed-by={KEYRING}] {mirror} {suite} main\n", encoding="utf-8")
        (work / "status").write_text("", encoding="utf-8")
        self._archives = work / "archives"
        self._suite = suite
        self._empty = work / "empty" / "partial"
        settings = {
            "Dir::State": work,
            "Dir::State::lists": work / "lists",
            "Dir::State::status": work / "status",
            "Dir::Cache": work,
            "Dir::Cache::archives": self._archives,
            "Dir::Etc": work / "etc",
            "Dir::Etc::sourcelist": self._sources,
            "Dir::Etc::sourceparts": "-",
            "APT::Architecture": recipe.ARCHITECTURE,
            "APT::Architectures": recipe.ARCHITECTURE,
            "APT::Sandbox::User": "",
            "APT::Install-Recommends": "false",
            "APT::Update::Error-Mode": "any",
            "Acquire::Languages": "none",
            "Acquire::Check-Valid-Until": "false",
            "Acquire::Retries": "3",
        }
        self._options = [word for name, value in settings.items() for word in ("-o", f"{name}={value}")]

    def update(self) -> None:
        self._get(["update"], "the list of its packages cannot be fetched")

    def fetch_all(self, packages: tuple[str, ...]) -> tuple[Path, ...]:
        """Fetch the essential packages, these, and all their dependencies."""
        wanted = ["install", "--yes", "--download-only", "?essential", *packages]
        self._get(wanted, "its packages cannot be fetched")
        self._empty.mkdir(parents=True, exist_ok=True)
        output = self._get(
            [*wanted, "--print-uris", "-o", f"Dir::Cache::archives={self._empty.parent}"], "cannot be listed"
        )
        names = re.findall(r"^'[^']*' (\S+\.deb) ", output, re.MULTILINE)
        return tuple(sorted(self._archives / name for name in names))

    def fetch_kernel(self) -> Path:
        output = checked_run(
            ["apt-cache", *self._options, "depends", recipe.KERNEL], "the kernel's package does not exist", _OTHER
        )
        named = _KERNEL.search(output)
        if named is None:
            raise UserError(
                f"Debian {self._suite}: has no {recipe.KERNEL} at this mirror; use another mirror with --mirror URL"
            )
        return self.fetch_one(named[1])

    def fetch_one(self, package: str) -> Path:
        """Fetch one package without its dependencies."""
        output = self._get(["download", "--print-uris", package], "does not exist")
        named = re.search(r"^'[^']*' (\S+\.deb) ", output, re.MULTILINE)
        if named is None:
            raise UserError(f"Debian {self._suite}: has no package {package} for {recipe.ARCHITECTURE} at this mirror")
        file = self._archives / named[1]
        if not file.is_file():
            self._get(["download", package], "cannot be fetched", cwd=self._archives)
        return file

    def _get(self, arguments: list[str], failure: str, cwd: Path | None = None) -> str:
        return checked_run(
            ["apt-get", "-q", *self._options, *arguments],
            f"Debian {self._suite}: {failure}",
            "check the network, or use another mirror with --mirror URL; completed downloads are kept",
            cwd=cwd,
            timeout_s=LONGEST_S,
        )
