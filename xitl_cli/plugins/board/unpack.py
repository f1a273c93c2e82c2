"""Program for fakeroot: unpacks packages with root as owner, writes dpkg's database, and makes an ext4 of it."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from fnmatch import fnmatch
from pathlib import Path

from xitl_cli.plugins.board import recipe
from xitl_cli.plugins.board.tools import find_program

MERGED = ("bin", "lib", "sbin")


def main(job: dict[str, object]) -> None:
    tree = Path(str(job["tree"]))
    (tree / "usr").mkdir(parents=True)
    for name in MERGED:
        (tree / "usr" / name).mkdir()
        (tree / name).symlink_to(f"usr/{name}")
    packages = [Path(str(one)) for one in job["packages"]]  # type: ignore[attr-defined]
    excluded = [word for pattern in recipe.LEFT_OUT for word in (f"--exclude=./{pattern}",)]
    for package in packages:
        extract(package, tree, excluded)
    write_database(packages, tree)
    unpack_kernel(Path(str(job["kernel"])), tree)
    prepare(tree)
    disk = Path(str(job["disk"]))
    disk.unlink(missing_ok=True)
    mke2fs = find_program("mke2fs") or "mke2fs"
    options = ["-q", "-t", "ext4", "-L", "xitl-board", "-m", "0", "-E", "lazy_itable_init=0,lazy_journal_init=0"]
    subprocess.run([mke2fs, *options, "-d", str(tree), str(disk), f"{recipe.DISK_MIB}M"], check=True)


def extract(package: Path, tree: Path, options: list[str]) -> None:
    """Extract the package's files into the folder. Existing links in place of folders stay."""
    with subprocess.Popen(["dpkg-deb", "--fsys-tarfile", str(package)], stdout=subprocess.PIPE) as reader:
        words = ["tar", "-x", "-C", str(tree), "--keep-directory-symlink", "--numeric-owner", *options]
        subprocess.run(words, stdin=reader.stdout, check=True)
    if reader.returncode:
        sys.exit(f"{package}: damaged")


def write_database(packages: list[Path], tree: Path) -> None:
    """Write dpkg's database in its state after unpacking and before configuration."""
    root = tree / "var/lib/dpkg"
    info, triggers = root / "info", root / "triggers"
    for folder in (info, triggers, root / "updates", root / "parts", root / "alternatives"):
        folder.mkdir(parents=True, exist_ok=True)
    (info / "format").write_text("1\n")
    stanzas: list[str] = []
    interests: dict[str, list[str]] = {}
    for package in packages:
        control = root / "control"
        subprocess.run(["dpkg-deb", "-e", str(package), str(control)], check=True)
        fields = (control / "control").read_text(encoding="utf-8").rstrip("\n")
        name = _field(fields, "Package")
        same = _field(fields, "Multi-Arch") == "same"
        stem = f"{name}:{_field(fields, 'Architecture')}" if same else name
        for member in control.iterdir():
            if member.name != "control":
                shutil.copy(member, info / f"{stem}.{member.name}")
        listed = subprocess.run(
            ["sh", "-c", 'dpkg-deb --fsys-tarfile "$1" | tar -t', "sh", str(package)],
            check=True, capture_output=True, text=True,
        ).stdout  # fmt: skip
        paths = [line.removeprefix(".").rstrip("/") or "/." for line in listed.splitlines()]
        (info / f"{stem}.list").write_text("".join(f"{path}\n" for path in paths), encoding="utf-8")
        head, _, rest = fields.partition("\n")
        stanzas.append(f"{head}\nStatus: install ok unpacked\n{rest}\n{_conffiles(control / 'conffiles', tree)}")
        if (control / "triggers").is_file():
            for line in (control / "triggers").read_text(encoding="utf-8").splitlines():
                words = line.split("#")[0].split()
                if len(words) == 2 and words[0].startswith("interest"):
                    interests.setdefault(words[1], []).append(stem + ("/noawait" if "noawait" in words[0] else ""))
        shutil.rmtree(control)
    (root / "status").write_text("\n".join(stanzas), encoding="utf-8")
    (root / "available").write_text("")
    in_files = [f"{what} {who}\n" for what, whose in interests.items() if what.startswith("/") for who in whose]
    (triggers / "File").write_text("".join(in_files), encoding="utf-8")
    for what, whose in interests.items():
        if not what.startswith("/"):
            (triggers / what).write_text("".join(f"{who}\n" for who in whose), encoding="utf-8")


def _field(fields: str, name: str) -> str:
    found = re.search(rf"^{name}: *(.*)$", fields, re.MULTILINE)
    return found[1].strip() if found else ""


def _conffiles(listed: Path, tree: Path) -> str:
    if not listed.is_file():
        return ""
    lines = []
    for path in listed.read_text(encoding="utf-8").split("\n"):
        file = tree / path.strip().lstrip("/")
        if path.startswith("/") and file.is_file():
            lines.append(f" {path.strip()} {hashlib.md5(file.read_bytes(), usedforsecurity=False).hexdigest()}\n")
    return "Conffiles:\n" + "".join(lines) if lines else ""


def unpack_kernel(package: Path, tree: Path) -> None:
    """Extract the kernel and the selected modules. The database omits its package, because the emulator loads the
    kernel.
    """
    extract(package, tree, ["--exclude=./usr/share/doc/*", "--exclude=./boot/System.map*"])
    for root in (tree / "lib/modules").glob("*/kernel"):
        for path in list(root.rglob("*.ko*")):
            inside = path.relative_to(root).as_posix()
            if not any(fnmatch(inside, pattern) for pattern in recipe.MODULES):
                path.unlink()


def prepare(tree: Path) -> None:
    """Create the files needed before the first package is configured, and the files of the recipe."""
    for path, text in recipe.ROOT_FILES.items():
        file = tree / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    setup = tree / "xitl-setup"
    setup.write_text(recipe.SETUP, encoding="utf-8")
    setup.chmod(0o755)
    for name in ("passwd", "group"):
        shutil.copy(tree / f"usr/share/base-passwd/{name}.master", tree / "etc" / name)
    for link, target in (("usr/bin/sh", "dash"), ("usr/bin/awk", "mawk")):
        if not os.path.lexists(tree / link):
            (tree / link).symlink_to(target)
    for name in ("proc", "sys", "dev", "run", "tmp"):
        (tree / name).mkdir(exist_ok=True)


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
