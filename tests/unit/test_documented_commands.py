"""What the pages have readers type exists: each command with its options, each profile with the keys that are set."""

from __future__ import annotations

import re
import shlex
import tomllib
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import typer.main

from agent.options import OptionsError
from agent.options import parse as parse_agent_options
from tests.command_line import xitl_app
from tests.documentation import (
    COMMANDS,
    CONSOLE,
    FILE,
    KINDS,
    NEEDS,
    PAGES,
    ROOT,
    SIGNATURE,
    Command,
    blocks,
    inline_commands,
    is_python,
    profile_header_commands,
    suppose,
)  # fmt: skip
from xitl_cli.commands.init import init
from xitl_cli.errors import UserError
from xitl_cli.plugins.campaign.command import CampaignGroup
from xitl_cli.plugins.campaign.plan import find_plan, read_plan
from xitl_cli.profile import load_profile

TARGETS = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PROFILE_ARGUMENTS = {
    "sim": "profile",
    "wdri": "profile",
    "profiles show": "name",
    "profiles check": "names",
    "vehicle check": "name",
}
SIM_OPTIONS = {"duration": "clock.duration_s", "clock": "clock.mode", "seed": "clock.seed"}
PLACEHOLDER = re.compile(r"[A-Z][A-Z_@]+(\.\.\.|,[A-Z])?|…|.*<.*>.*")
APP: Any = typer.main.get_command(xitl_app())
USAGE_ERROR: Any = typer.BadParameter.__base__  # of the click that typer brings


@pytest.mark.parametrize("page", PAGES)
def test_every_block_of_a_page_is_of_a_known_kind(page: str) -> None:
    found = blocks(page)
    kinds = Counter(block.kind for block in found)  # raises for an unknown one
    assert sum(kinds[kind] for kind in KINDS) == len(found)
    assert {block.about for block in found if block.note == "needs"} <= set(NEEDS)
    text = (ROOT / page).read_text(encoding="utf-8")
    assert text.count("\n```") + text.startswith("```") == 2 * len(found)  # none was missed
    assert len(re.findall(r"<!-- (?:needs|output of|shape of|file|typed|drawing)\b", text)) == sum(
        bool(block.note) for block in found
    )
    for block in found:
        if block.language == "python" and block.kind != SIGNATURE:
            assert is_python(block.text), block


@pytest.mark.parametrize("page", PAGES)
def test_what_a_page_has_typed_exists(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    suppose(tmp_path)
    for block in blocks(page):
        if block.kind == FILE:
            (tmp_path / block.file).write_text(block.text, encoding="utf-8")
            if block.file.startswith("wrong"):
                with pytest.raises(UserError):
                    load_profile(block.file)
            elif block.is_plan:
                read_plan(Path(block.file))
            elif block.language == "yaml":
                load_profile(block.file)
            elif block.language == "ini":
                parse_agent_options(["--config", block.file], "xitl agent")
        elif block.kind in (COMMANDS, CONSOLE):
            for command in block.commands:
                check_command(command, whole=True, profile=block.kind == COMMANDS)  # a console shows errors too
    for command in inline_commands(page):
        check_command(command, whole=False)


def test_what_the_shipped_profiles_have_typed_exists(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    suppose(tmp_path)
    commands = profile_header_commands()
    assert len(commands) > 30
    for command in commands:
        check_command(command, whole=False)


def check_command(command: Command, whole: bool, profile: bool = True) -> None:
    """whole: what it requires is there too. profile: the one that it names is loaded, with what it sets."""
    program, words = command.program, command.words[1:]
    if program == "make":
        missing = {word for word in words if "=" not in word} - TARGETS
        assert not missing, f"{command}: no target {missing}"
    elif program == "pip":
        for extra in re.findall(r"xitl\[([\w,]+)\]", " ".join(words)):
            assert set(extra.split(",")) <= set(PROJECT["optional-dependencies"]), command
    elif program == "python3" and words[:1] == ["xitl-agent.pyz"]:
        if words[1:] != ["doctor"]:
            check_agent(command, words[1:], whole)
    elif program == "xitl" and words[:1] == ["agent"] and words[1:2] not in (["deploy"], ["package"]):
        check_agent(command, words[1:], whole)
    elif program == "xitl" and command.needs != "plug-in":  # typed in tests/e2e/test_plugin_radar.py
        check_xitl(command, words, whole, profile)


def check_agent(command: Command, words: list[str], whole: bool) -> None:
    try:
        parse_agent_options([word for word in words if word not in ("--config", "agent.conf", "--help")], "xitl agent")
    except OptionsError as error:
        if whole or "expected one argument" not in str(error):
            pytest.fail(f"{command}: {error}")


def check_xitl(command: Command, words: list[str], whole: bool, profile: bool) -> None:
    node, path, context = APP, [], None
    while words and hasattr(node, "commands"):
        if words[0].startswith("-"):
            break
        if isinstance(node, CampaignGroup) and words[0] not in node.commands:
            words = [node.default_command, *words]
        assert words[0] in node.commands, f"{command}: no command {words[0]}"
        context = type(node).context_class(node, info_name=node.name, parent=context)
        node, path, words = node.commands[words[0]], [*path, words[0]], words[1:]
    words = [word for word in words if word != "…"]
    context = type(node).context_class(node, info_name=node.name, parent=context, **node.context_settings)
    try:
        given, operands, _ = node.make_parser(context).parse_args(list(words))
    except USAGE_ERROR as error:
        if not whole and str(error).endswith("requires an argument."):
            return
        pytest.fail(f"{command}: {error}")
    if whole and not any(PLACEHOLDER.fullmatch(word) for word in operands):
        required = [param for param in node.params if param.param_type_name == "argument" and param.required]
        assert all(given.get(param.name) not in (None, ()) for param in required), f"{command}: lacks an operand"
    if path == ["board", "enter"] and given["command"]:
        check_command(Command(command.page, command.line, shlex.join(given["command"])), whole, profile)
    if path == ["init"] and whole:
        init(Path(given["path"]))
    if path == ["campaign", "run"] and profile and not PLACEHOLDER.fullmatch(given["plan"]):
        find_plan(given["plan"])
    if (argument := PROFILE_ARGUMENTS.get(" ".join(path))) is None or not profile:
        return
    names = given.get(argument)
    overrides = [*(given.get("overrides") or [])]
    overrides += [f"{key}={given[option]}" for option, key in SIM_OPTIONS.items() if given.get(option) is not None]
    for name in [names] if isinstance(names, str) else names or []:
        if not PLACEHOLDER.fullmatch(name):
            load_profile(name, overrides)
