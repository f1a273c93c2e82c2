"""Plug-ins of other packages: made as installed packages in a folder, found by entry points."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from tests.command_line import xitl_app
from tests.installed_packages import Install
from xitl_cli import registry
from xitl_cli.errors import UserError
from xitl_cli.main import CORE_COMMANDS
from xitl_cli.plugin import Command
from xitl_cli.profile.files.catalogue import find_profile, profile_name

HELLO = '''
from xitl_cli.plugin import Command

def _add(app, name):
    @app.command(name)
    def hello():
        """Say hello."""
        print("hello from", __name__)

COMMAND = Command("Say hello.", _add)
'''


def error_of(name: str) -> str:
    (row,) = [row for row in registry.plugins() if row.package == name]
    return row.error


def test_a_command_of_another_package_is_one_of_xitl(install: Install) -> None:
    install("xitl-hello", HELLO, commands="hello = xitl_hello:COMMAND")
    done = CliRunner().invoke(xitl_app(["hello"]), ["hello"])
    assert (done.exit_code, done.output) == (0, "hello from xitl_hello\n")
    assert "Say hello." in CliRunner().invoke(xitl_app([]), ["--help"]).output
    assert error_of("xitl-hello") == ""


@pytest.mark.parametrize(
    ("code", "entry", "said"),
    [
        ("import no_such_module", "hello = xitl_hello:COMMAND", "No module named 'no_such_module'"),
        ("raise RuntimeError('two\\nlines')", "hello = xitl_hello:COMMAND", "RuntimeError: two lines"),
        ("import sys; sys.exit(3)", "hello = xitl_hello:COMMAND", "SystemExit: 3"),
        (HELLO, "hello = xitl_hello:OTHER", "has no attribute 'OTHER'"),
        (HELLO, "hello = xitl_hello_elsewhere:COMMAND", "No module named 'xitl_hello_elsewhere'"),
        (HELLO + "XITL_INTERFACE = 2\n", "hello = xitl_hello:COMMAND", "made for interface 2"),
    ],
)
def test_a_broken_plug_in_breaks_nothing_and_is_named(install: Install, code: str, entry: str, said: str) -> None:
    install("xitl-hello", code, commands=entry)
    assert CliRunner().invoke(xitl_app([]), ["--help"]).exit_code == 0
    listed = CliRunner().invoke(xitl_app(["plugins"]), ["plugins"])
    assert listed.exit_code == 1
    error = error_of("xitl-hello")
    assert said in error
    assert "\n" not in error
    with pytest.raises(UserError, match=r"hello: the plug-in of xitl-hello 1\.2"):
        CliRunner().invoke(xitl_app(["hello"]), ["hello"], catch_exceptions=False)


def test_xitl_keeps_a_name_that_another_package_registers_too(install: Install) -> None:
    install("xitl-hello", HELLO, commands="logs = xitl_hello:COMMAND")
    assert "taken by xitl" in error_of("xitl-hello")
    assert registry.load(registry.COMMANDS, "logs").group


def test_the_first_package_has_a_name_that_two_register(install: Install) -> None:
    install("xitl-b", HELLO, commands="hello = xitl_b:COMMAND")
    install("xitl-a", HELLO, commands="hello = xitl_a:COMMAND")
    assert (error_of("xitl-a"), "taken by xitl-a" in error_of("xitl-b")) == ("", True)
    assert CliRunner().invoke(xitl_app(["hello"]), ["hello"]).output == "hello from xitl_a\n"


def test_a_command_that_nobody_registers_is_named_with_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_first_of_each_name", lambda group: {})
    with pytest.raises(UserError, match=r"xitl campaign: .* 'xitl\[campaign\]'"):
        CliRunner().invoke(xitl_app(["campaign"]), ["campaign"], catch_exceptions=False)
    assert CliRunner().invoke(xitl_app(["nonsense"]), ["nonsense"]).exit_code == 2


def test_profiles_of_another_package_are_found_by_name(install: Install, tmp_path: Path) -> None:
    folder = tmp_path / "profiles"
    folder.mkdir()
    (folder / "fjord.yaml").write_text("extends: sitl\n", encoding="utf-8")
    (folder / "sitl.yaml").write_text("extends: mitl\n", encoding="utf-8")
    code = f"from pathlib import Path\nPROFILES = Path({str(folder)!r})\n"
    install("xitl-fjord", code, profiles="fjord = xitl_fjord:PROFILES")
    assert find_profile("fjord") == folder / "fjord.yaml"
    assert profile_name(folder / "fjord.yaml") == "fjord"
    assert find_profile("sitl") != folder / "sitl.yaml"


def declared() -> dict[str, Command]:
    return {**CORE_COMMANDS, **dict(registry.load_all(registry.COMMANDS))}


@pytest.mark.medium
def test_the_declared_sentence_is_that_of_the_command() -> None:
    whole = typer.main.get_command(xitl_app())
    for name, command in declared().items():
        shown = whole.commands[name].get_short_help_str(limit=1000)  # type: ignore[attr-defined]
        assert shown.rstrip(".") == command.help.rstrip("."), name


def test_commands_of_xitls_own_plug_ins_are_known_where_one_is_missing() -> None:
    from xitl_cli.main import OWN_PLUGIN_COMMANDS

    assert set(OWN_PLUGIN_COMMANDS) == set(registry.names(registry.COMMANDS))


@pytest.mark.medium
def test_help_loads_no_command() -> None:
    program = (
        "import sys; from xitl_cli.main import _app; _app(['--help']); "
        "print([name for name in sys.modules if name.endswith('command') and name.startswith('xitl_cli.')])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
