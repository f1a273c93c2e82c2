"""YAML text -> entries: scalars by YAML 1.2, origins, and everything that is refused."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.golden import Golden
from xitl_cli.errors import UserError
from xitl_cli.profile.files.entry import Entry, ProfileError
from xitl_cli.profile.files.yaml_file import parse_yaml, read_yaml


def _parsed(text: str) -> Entry:
    entry = parse_yaml(text, "boat.yaml")
    assert entry is not None
    return entry


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("8", 8),
        ("-8", -8),
        ("0x1f", 31),
        ("0o17", 15),
        ("010", 10),
        ("8.5", 8.5),
        ("1e-3", 1e-3),
        ("8.73e-4", 8.73e-4),
        (".5", 0.5),
        ("5.", 5.0),
        ("-.inf", -math.inf),
        ("true", True),
        ("False", False),
        ("yes", "yes"),
        ("off", "off"),
        ("none", "none"),
        ("null", None),
        ("~", None),
        ("1:30", "1:30"),
        ("2024-01-01", "2024-01-01"),
        ("8 m/s", "8 m/s"),
        ("1_000", "1_000"),
        ("'8'", "8"),
        ('"true"', "true"),
        ("[1, [2, a]]", (1, (2, "a"))),
        ("{a: {b: 1}}", {"a": {"b": 1}}),
    ],
)
def test_scalars_follow_the_yaml_1_2_core_schema(text: str, value: object) -> None:
    plain = _parsed(text).plain()
    assert plain == value
    assert type(plain) is type(value)


def test_every_value_knows_its_line() -> None:
    entry = _parsed("a:\n  b: 1\n\n  c:\n    - x\n    - y: 2\nd: {e: 3,\n  f: 4}\n")
    lines = {
        path: entry.nearest(path)[0].origin.line
        for path in [("a",), ("a", "b"), ("a", "c"), ("a", "c", 0), ("a", "c", 1), ("a", "c", 1, "y"), ("d", "f")]
    }
    assert lines == {
        ("a",): 1,
        ("a", "b"): 2,
        ("a", "c"): 4,
        ("a", "c", 0): 5,
        ("a", "c", 1): 6,
        ("a", "c", 1, "y"): 6,
        ("d", "f"): 8,
    }


@pytest.mark.parametrize(
    "text",
    [
        "a: 1\nb: 2\na: 3\n",
        "a:\n  b: [1, 2\nc: 3\n",
        "a: 1\n\tb: 2\n",
        "1: a\n",
        "[a, b]: 1\n",
        "a: &x {b: 1}\nc:\n  <<: *x\n",
        "a: !!python/name:os.system x\n",
        "a: !secret {}\n",
        "a: 1\n---\nb: 2\n",
        "a: *nowhere\n",
        "a: 1\nb: \x07\n",
        "a: " + "[" * 80 + "]" * 80,
        "a: " + "[" * 5000 + "]" * 5000,
        "a: &a [*a]\n",
    ],
)
def test_refused_with_file_and_line(text: str, golden: Golden) -> None:
    with pytest.raises(ProfileError) as caught:
        parse_yaml(text, "boat.yaml")
    golden("error", caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("opener", ["[", "{a: ", "- ", "[\n"])
def test_a_text_that_would_exhaust_the_stack_is_refused(opener: str) -> None:
    with pytest.raises(ProfileError, match=r"boat\.yaml:\d+: is nested too deeply; flatten it"):
        parse_yaml("a:\n " + 100_000 * opener, "boat.yaml")


def test_long_lists_are_not_deep() -> None:
    pairs = _parsed(f"a: [{'[1, 2], ' * 2000}]").plain()
    assert pairs == {"a": ((1, 2),) * 2000}


@pytest.mark.medium
def test_an_alias_bomb_is_refused() -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 9)]
    with pytest.raises(ProfileError, match="expands to more than 100000 values"):
        parse_yaml("\n".join(lines), "boat.yaml")


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"", "boat.yaml:1: is empty"),
        (b"# nothing but a comment\n", "boat.yaml:1: is empty"),
        (b"- a\n- b\n", "boat.yaml:1: is a list of 2; a profile is a mapping of keys"),
        (b"hello", "boat.yaml:1: is 'hello'; a profile is a mapping of keys"),
        (b"a: \xff\xfe\n", "boat.yaml:1: is not UTF-8 text (byte 3)"),
    ],
)
def test_files_that_hold_no_profile(tmp_path: Path, content: bytes, sentence: str) -> None:
    path = tmp_path / "boat.yaml"
    path.write_bytes(content)
    with pytest.raises(ProfileError) as caught:
        read_yaml(path, "boat.yaml")
    assert str(caught.value).startswith(sentence)


def test_a_folder_is_not_read(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"boat\.yaml: cannot be read: is a directory"):
        read_yaml(tmp_path, "boat.yaml")


@pytest.mark.medium
@given(st.text(alphabet=st.sampled_from("ab:-[]{}&*!|>'\"#%@`,? \n\t0.1\x00é"), max_size=40))
def test_any_text_parses_or_is_refused_on_one_line_with_its_place(text: str) -> None:
    message = ""
    try:
        parse_yaml(text, "boat.yaml")
    except ProfileError as error:
        message = str(error)
    assert message == "" or message.startswith("boat.yaml:")
    assert "\n" not in message
