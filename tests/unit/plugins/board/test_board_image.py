"""Making an image: what apt is asked for, what is unpacked, and the steps. Nothing is fetched and no emulator runs."""

from __future__ import annotations

import gzip
import hashlib
import json
import os
import shutil
import stat
import subprocess
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from xitl_cli.errors import UserError
from xitl_cli.plugins.board import image, recipe, tools, unpack
from xitl_cli.plugins.board.image import BoardImage, FetchedPackages, find_image, images_root, make_image

RELEASE = "6.1.0-9-armmp"


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XITL_CACHE", str(tmp_path))
    return tmp_path


# -- packages


class Apt:
    """Stands in for apt. packages: what it would install. asked: commands without the options of its configuration."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
        self.asked: list[list[str]] = []
        self.options: dict[str, str] = {}
        self.mirrors = "http://a.example/ubuntu\nhttp://deb.example/debian/\nhttp://b.example/debian\n"
        self.kernel = f"linux-image-armmp\n  Depends: linux-image-{RELEASE}\n  Depends: other\n"
        self.known = {f"linux-image-{RELEASE}", "busybox-static"}
        keyring = tmp_path / "keyring.gpg"
        keyring.write_bytes(b"")
        monkeypatch.setattr(image, "KEYRING", keyring)
        monkeypatch.setattr(image, "checked_run", self._run)

    def _run(
        self, words: Sequence[str], failure: str, todo: str, cwd: Path | None = None, timeout_s: float | None = None
    ) -> str:
        given = list(words)
        for number in [number for number, word in enumerate(given) if word == "-o"]:
            name, _, value = given[number + 1].partition("=")
            self.options[name] = value
        plain = [word for n, word in enumerate(given) if word not in ("-q", "-o") and given[n - 1] != "-o"]
        self.asked.append(plain)
        if plain[1] == "indextargets":
            return self.mirrors
        if plain[1] == "depends":
            return self.kernel
        if plain[1] == "download" and "--print-uris" not in plain:
            assert cwd is not None
            (cwd / f"{plain[2]}_1_armhf.deb").write_bytes(b"")
        elif plain[1] == "download":
            name = plain[3]
            return f"'http://x/{name}.deb' {name}_1_armhf.deb 3 SHA256:0\n" if name in self.known else ""
        elif "--print-uris" in plain:
            assert not Path(self.options["Dir::Cache::archives"], "lock").exists()
            return "NOTE\n'http://x/b.deb' b_2_armhf.deb 3 SHA256:0\n'http://x/a.deb' a_1%3a1_armhf.deb 3 SHA256:0\n"
        return ""


@pytest.fixture
def apt(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Apt:
    return Apt(monkeypatch, tmp_path)


def test_the_packages_of_a_suite_are_fetched_from_the_mirror_of_this_machine(apt: Apt, tmp_path: Path) -> None:
    work = tmp_path / "work"
    fetched = image.fetch("bullseye", None, work)
    archives = work / "archives"
    assert fetched == FetchedPackages(
        (archives / "a_1%3a1_armhf.deb", archives / "b_2_armhf.deb"),
        archives / f"linux-image-{RELEASE}_1_armhf.deb",
        archives / "busybox-static_1_armhf.deb",
    )
    assert (work / "sources.list").read_text() == (
        f"deb [signed-by={image.KEYRING}] http://deb.example/debian/ bullseye main\n"
    )
    wanted = ["apt-get", "install", "--yes", "--download-only", "?essential", *recipe.packages_of("bullseye")]
    assert apt.asked == [
        ["apt-get", "indextargets", "--no-release-info", "--format", "$(REPO_URI)", "Created-By: Packages"],
        ["apt-get", "update"],
        wanted,
        [*wanted, "--print-uris"],
        ["apt-cache", "depends", "linux-image-armmp"],
        ["apt-get", "download", "--print-uris", f"linux-image-{RELEASE}"],
        ["apt-get", "download", f"linux-image-{RELEASE}"],
        ["apt-get", "download", "--print-uris", "busybox-static"],
        ["apt-get", "download", "busybox-static"],
    ]
    assert apt.options["APT::Architecture"] == apt.options["APT::Architectures"] == "armhf"
    assert apt.options["Dir::State::status"] == str(work / "status")
    assert (work / "status").read_text() == ""
    assert (work / "lists/partial").is_dir()
    assert (work / "archives/partial").is_dir()


def test_a_package_that_is_there_is_not_fetched_again(apt: Apt, tmp_path: Path) -> None:
    image.fetch("bookworm", "http://mine.example/debian", tmp_path / "work")
    assert not any("indextargets" in words for words in apt.asked)
    assert "http://mine.example/debian bookworm" in (tmp_path / "work/sources.list").read_text()
    apt.asked.clear()
    image.fetch("bookworm", "http://mine.example/debian", tmp_path / "work")
    assert not any(words[1] == "download" and "--print-uris" not in words for words in apt.asked)


def test_a_suite_without_the_kernel_or_a_package(apt: Apt, tmp_path: Path) -> None:
    apt.known.remove("busybox-static")
    with pytest.raises(UserError, match="Debian bookworm: has no package busybox-static for armhf at this mirror"):
        image.fetch("bookworm", "http://a", tmp_path)
    apt.kernel = "linux-image-armmp\n"
    with pytest.raises(UserError, match="Debian bookworm: has no linux-image-armmp at this mirror; use another mirror"):
        image.fetch("bookworm", "http://a", tmp_path)


def test_a_program_that_takes_too_long_is_ended() -> None:
    with pytest.raises(UserError, match=r"^it broke: sleep did not end within 0 s; mend it$"):
        tools.checked_run(["sleep", "10"], "it broke", "mend it", timeout_s=0.05)
    with pytest.raises(UserError, match=r"^it broke \(exit code 3\); mend it$"):
        tools.checked_run(["sh", "-c", "exit 3"], "it broke", "mend it")
    assert tools.checked_run(["pwd"], "it broke", "mend it", cwd=Path("/")) == "/\n"


def test_one_missing_program_is_named_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tools, "find_program", lambda name: None if name == "ssh" else "/bin/x")
    with pytest.raises(UserError, match=r"a board needs ssh, which this machine does not have; .*apt install openssh-"):
        tools.require(tools.FOR_RUNNING, "a board")
    monkeypatch.setattr(tools, "find_program", lambda name: "/bin/x")
    tools.require(tools.FOR_MAKING)


def test_programs_of_roots_path_are_there_too(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[str, str | None]] = []

    def which(name: str, path: str | None = None) -> str | None:
        seen.append((name, path))
        return "/usr/sbin/x" if path else None

    monkeypatch.setattr(shutil, "which", which)
    assert tools.find_program("x") == "/usr/sbin/x"
    assert seen == [("x", None), ("x", "/usr/sbin:/sbin")]


# -- an image


class Steps:
    """Stands in for what makes an image. done: steps in order."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.done: list[str] = []
        self.fails_at = ""
        packages = FetchedPackages((Path("a.deb"), Path("b.deb")), Path("k.deb"), Path("bb.deb"))
        monkeypatch.setattr(image, "fetch", lambda *given: (self._do(f"fetch {given[:2]}"), packages)[1])
        monkeypatch.setattr(image, "_unpack", lambda *given: (self._do("unpack"), RELEASE)[1])
        monkeypatch.setattr(image, "_configure", lambda made, progress: self._do(f"configure {made.kernel_release}"))
        monkeypatch.setattr(image, "checked_run", lambda words, *given: self._do(" ".join(words[:2])))

    def _do(self, step: str) -> None:
        self.done.append(step)
        if self.fails_at and step.startswith(self.fails_at):
            raise UserError("interrupted")


def test_an_image_is_made_once_and_found_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    steps = Steps(monkeypatch)
    told: list[str] = []
    assert find_image("bookworm") is None
    made = make_image("bookworm", "http://a", told.append)
    folder = images_root() / f"bookworm-{recipe.recipe_version()}"
    assert made == BoardImage(folder, "bookworm", recipe.recipe_version(), RELEASE, 2)
    assert (made.disk.name, made.kernel.name, made.early.name) == ("disk.qcow2", "vmlinuz", "early.cpio.gz")
    assert steps.done == [
        "fetch ('bookworm', 'http://a')",
        "unpack",
        f"configure {RELEASE}",
        "qemu-img convert",
    ]
    assert told == ["fetching the packages of Debian bookworm for armhf"]
    assert [path.name for path in folder.iterdir()] == ["image.json"]
    assert find_image("bookworm") == make_image("bookworm", None, told.append) == made
    assert len(steps.done) == 4
    (folder / "image.json").write_text("{}")
    assert find_image("bookworm") is None


def test_an_interrupted_image_continues_at_its_step(monkeypatch: pytest.MonkeyPatch) -> None:
    steps = Steps(monkeypatch)
    steps.fails_at = "configure"
    with pytest.raises(UserError, match="interrupted"):
        make_image("bookworm", None, lambda doing: None)
    steps.fails_at = ""
    steps.done.clear()
    assert make_image("bookworm", None, lambda doing: None).kernel_release == RELEASE
    assert steps.done == ["fetch ('bookworm', None)", f"configure {RELEASE}", "qemu-img convert"]


@pytest.mark.parametrize(("free_mib", "enough"), [(1199, False), (1200, True)])
def test_an_image_needs_its_space(monkeypatch: pytest.MonkeyPatch, free_mib: int, enough: bool) -> None:
    Steps(monkeypatch)
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=(free_mib << 20) + 1000))
    if enough:
        make_image("bookworm", None, lambda doing: None)
    else:
        with pytest.raises(UserError, match="1199 MiB are free, but making an image takes 1200 MiB"):
            make_image("bookworm", None, lambda doing: None)


def test_a_second_xitl_waits_for_the_image_of_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    Steps(monkeypatch)
    locks = []

    def lock(file: Any, how: int) -> None:
        locks.append(how)
        if len(locks) == 1:
            raise BlockingIOError

    monkeypatch.setattr(image.fcntl, "flock", lock)
    told: list[str] = []
    make_image("bookworm", None, told.append)
    assert locks == [image.fcntl.LOCK_EX | image.fcntl.LOCK_NB, image.fcntl.LOCK_EX]
    assert told[0] == "waiting for another xitl that makes this image"


def module(path: Path, needs: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"\x7fELF\0depends=" + needs.encode() + b"\0")


def test_kernel_and_early_user_space_come_from_the_unpacked_tree(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = BoardImage(tmp_path / "image", "bookworm", "1", "", 2)
    tree = made.folder / "tree"
    tree.mkdir(parents=True)
    (tree / "left over").write_bytes(b"")
    ran: list[Sequence[str]] = []

    def run(words: Sequence[str], *given: object) -> str:
        ran.append(words)
        if words[0] == "fakeroot":
            job = json.loads(words[-1])
            assert not tree.exists()  # what an interrupted step left is removed
            assert job == {
                "tree": str(tree),
                "packages": ["a.deb", "b.deb"],
                "kernel": "k.deb",
                "disk": str(made.folder / "unpacked.img"),
            }
            (tree / "boot").mkdir(parents=True)
            (tree / f"boot/vmlinuz-{RELEASE}").write_bytes(b"kernel")
            module(tree / "lib/modules" / RELEASE / "kernel/fs/ext4/ext4.ko", "")
        else:
            assert words[:2] == ["dpkg-deb", "-x"]
            assert words[2] == "bb.deb"
            (Path(words[3]) / "bin").mkdir(parents=True)
            (Path(words[3]) / "bin/busybox").write_bytes(b"busybox")
        return ""

    monkeypatch.setattr(image, "checked_run", run)
    told: list[str] = []
    packages = FetchedPackages((Path("a.deb"), Path("b.deb")), Path("k.deb"), Path("bb.deb"))
    assert image._unpack(made, packages, told.append) == RELEASE
    assert told == ["unpacking 2 packages"]
    assert made.kernel.read_bytes() == b"kernel"
    early = gzip.decompress(made.early.read_bytes())
    assert b"busybox" in early
    assert recipe.EARLY_INIT.encode() in early
    assert b"modules/order" in early
    assert sorted(path.name for path in made.folder.iterdir()) == ["early.cpio.gz", "vmlinuz"]


class Emulator:
    """Stands in for the emulator that configures the packages. It writes lines until it ends."""

    words: list[str]
    lines: Sequence[str] = ()
    console: Path

    def __init__(self, words: list[str], **keys: Any) -> None:
        Emulator.words, self.killed = words, False
        self._lines = iter(Emulator.lines)
        keys["stderr"].close()

    def poll(self) -> int | None:
        line = next(self._lines, None)
        if line is None:
            return 0
        with Emulator.console.open("a") as file:
            file.write(line)
        return None

    def kill(self) -> None:
        self.killed = True

    def __enter__(self) -> Emulator:
        return self

    def __exit__(self, *_: object) -> None:
        assert self.killed


@pytest.fixture
def unconfigured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> BoardImage:
    made = BoardImage(tmp_path, "bookworm", "1", RELEASE, 3)
    monkeypatch.setattr(image, "subprocess", SimpleNamespace(Popen=Emulator, DEVNULL=subprocess.DEVNULL))
    monkeypatch.setattr(image, "find_program", lambda name: None)
    monkeypatch.setattr(image, "make_overlay", lambda disk, base, kind: None)
    Emulator.console = tmp_path / "setup.log"
    return made


def configure(made: BoardImage, monkeypatch: pytest.MonkeyPatch, *lines: str) -> list[str]:
    """What is told, half a second after the other."""
    told: list[str] = []
    now_s = [0.0]
    monkeypatch.setattr(
        image,
        "time",
        SimpleNamespace(monotonic=lambda: now_s[0], sleep=lambda pause_s: now_s.append(now_s.pop() + pause_s)),
    )
    Emulator.lines = lines
    image._configure(made, told.append)
    return told


def test_packages_are_configured_in_the_emulator_until_it_says_that_they_are(
    unconfigured: BoardImage, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = ("", "Setting up a (1) ...\n", "Setting up b (2) ...\n", f"{recipe.SETUP_DONE}\n")
    told = configure(unconfigured, monkeypatch, *lines)
    assert told == [f"configuring package {count} of 3 in the emulator" for count in (0, 1, 2, 2)]
    words = Emulator.words
    assert words[words.index("-append") + 1] == "rw console=ttyAMA0 -- xitl.init=/xitl-setup"
    assert words[words.index("-serial") + 1] == f"file:{unconfigured.folder}/setup.log"
    assert words[words.index("-smp") + 1] == "1"
    assert words[words.index("-m") + 1] == "512"


def test_packages_that_are_not_configured_are_told_with_the_last_lines(
    unconfigured: BoardImage, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(UserError, match="its console ended with: one / two; try again, or remove the folder"):
        configure(unconfigured, monkeypatch, "one\n", "two\n")
    monkeypatch.setattr(image, "SETUP_LIMIT_S", 1.0)
    with pytest.raises(UserError, match="its console ended with: 0 / 1;"):
        configure(unconfigured, monkeypatch, *(f"{number}\n" for number in range(9)))


def test_an_overlay_replaces_the_one_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[Sequence[str]] = []
    monkeypatch.setattr(image, "checked_run", lambda words, *given: ran.append(words))
    disk = tmp_path / "disk.qcow2"
    disk.write_bytes(b"")
    image.make_overlay(disk, tmp_path / "base", "raw")
    assert not disk.exists()
    assert ran == [["qemu-img", "create", "-q", "-f", "qcow2", "-F", "raw", "-b", str(tmp_path / "base"), str(disk)]]


# -- unpacking


DPKG_DEB = """\
#!/bin/sh
case "$1" in
    --fsys-tarfile) [ -d "$2/data" ] || exit 2; exec tar -c -C "$2/data" . ;;
    -e) exec cp -r "$2/control" "$3" ;;
esac
"""


@pytest.fixture
def dpkg(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A dpkg-deb whose packages are folders with `data` and `control`."""
    program = tmp_path / "programs/dpkg-deb"
    program.parent.mkdir()
    program.write_text(DPKG_DEB)
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")


def package(folder: Path, control: str, files: dict[str, str], members: dict[str, str] | None = None) -> Path:
    for root, named in (("data", files), ("control", {"control": control, **(members or {})})):
        for path, text in named.items():
            (folder / root / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / root / path).write_text(text)
    return folder


@pytest.mark.medium
def test_a_disk_is_made_of_packages_kernel_and_recipe(
    tmp_path: Path, dpkg: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    base = package(
        tmp_path / "base.deb",
        "Package: base-passwd\nArchitecture: armhf\nMulti-Arch: foreign\nVersion: 1\n",
        {
            "usr/share/base-passwd/passwd.master": "root:*:0:0\n",
            "usr/share/base-passwd/group.master": "root:*:0:\n",
            "usr/share/doc/base-passwd/README": "left out",
            "usr/lib/base.conf": "merged",
            "etc/base.conf": "setting",
        },
        {"conffiles": "/etc/base.conf\n/etc/missing.conf\nremove-on-upgrade /etc/old\n", "postinst": "#!/bin/sh\n"},
    )
    library = package(
        tmp_path / "libc.deb",
        "Package: libc6\nArchitecture: armhf\nMulti-Arch: same\n",
        {"lib/libc.so": "c", "bin/sh": "shell"},
        {"triggers": "# why\ninterest-noawait ldconfig\ninterest /usr/lib # now\nactivate other\ninterest\n"},
    )
    kernel = package(
        tmp_path / "kernel.deb",
        "Package: linux-image\n",
        {
            f"boot/vmlinuz-{RELEASE}": "kernel",
            f"boot/System.map-{RELEASE}": "left out",
            f"lib/modules/{RELEASE}/kernel/fs/ext4/ext4.ko": "kept",
            f"lib/modules/{RELEASE}/kernel/fs/nfs/nfs.ko.xz": "left out",
            f"lib/modules/{RELEASE}/kernel/drivers/net/virtio_net.ko.xz": "kept",
        },
    )
    made: list[list[str]] = []
    run = subprocess.run

    def without_disk(words: list[str], **keys: Any) -> Any:
        if "mke2fs" not in words[0]:
            return run(words, **keys)
        made.append(words)
        return None

    monkeypatch.setattr(subprocess, "run", without_disk)
    tree, disk = tmp_path / "tree", tmp_path / "disk.img"
    disk.write_bytes(b"of an interrupted step")
    unpack.main({"tree": str(tree), "packages": [str(base), str(library)], "kernel": str(kernel), "disk": str(disk)})

    assert not disk.exists()
    assert made[0][-4:] == ["-d", str(tree), str(disk), f"{recipe.DISK_MIB}M"]
    # Files are in /usr, their documentation is left out
    assert {name: (tree / name).readlink() for name in ("bin", "lib", "sbin")} == {
        name: Path(f"usr/{name}") for name in ("bin", "lib", "sbin")
    }
    assert (tree / "usr/lib/libc.so").read_text() == "c"
    assert (tree / "usr/bin/sh").read_text() == "shell"
    assert not (tree / "usr/share/doc/base-passwd").exists()
    # The database says what was unpacked
    root = tree / "var/lib/dpkg"
    digest = hashlib.md5(b"setting", usedforsecurity=False).hexdigest()
    assert (root / "status").read_text() == (
        "Package: base-passwd\nStatus: install ok unpacked\nArchitecture: armhf\nMulti-Arch: foreign\nVersion: 1\n"
        f"Conffiles:\n /etc/base.conf {digest}\n"
        "\nPackage: libc6\nStatus: install ok unpacked\nArchitecture: armhf\nMulti-Arch: same\n"
    )
    assert sorted(path.name for path in (root / "info").iterdir()) == [
        "base-passwd.conffiles",
        "base-passwd.list",
        "base-passwd.postinst",
        "format",
        "libc6:armhf.list",
        "libc6:armhf.triggers",
    ]
    listed = (root / "info/libc6:armhf.list").read_text().splitlines()
    assert listed[0] == "/."
    assert set(listed[1:]) == {"/lib", "/lib/libc.so", "/bin", "/bin/sh"}
    assert (root / "triggers/File").read_text() == "/usr/lib libc6:armhf\n"
    assert (root / "triggers/ldconfig").read_text() == "libc6:armhf/noawait\n"
    assert not (root / "control").exists()
    # Of the kernel, the modules of the recipe
    assert (tree / f"boot/vmlinuz-{RELEASE}").is_file()
    assert not (tree / f"boot/System.map-{RELEASE}").exists()
    modules = tree / "lib/modules" / RELEASE / "kernel"
    assert sorted(path.name for path in modules.rglob("*.ko*")) == ["ext4.ko", "virtio_net.ko.xz"]
    # What the first package needs to be configured
    assert (tree / "etc/passwd").read_text() == "root:*:0:0\n"
    assert (tree / "etc/group").read_text() == "root:*:0:\n"
    assert stat.S_IMODE((tree / "xitl-setup").stat().st_mode) == 0o755
    assert (tree / "usr/bin/awk").readlink() == Path("mawk")
    assert not (tree / "usr/bin/sh").is_symlink()  # a package brought one
    for path, text in recipe.ROOT_FILES.items():
        assert (tree / path).read_text() == text
    assert all((tree / name).is_dir() for name in ("proc", "sys", "dev", "run", "tmp"))


def test_a_damaged_package_ends_the_program(tmp_path: Path, dpkg: None) -> None:
    with pytest.raises((SystemExit, subprocess.CalledProcessError)):
        unpack.extract(tmp_path / "none.deb", tmp_path, [])
