"""What a public project has beside its code: citation, hooks, a workflow, templates. They name what is there."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

from agent import __version__

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
TARGETS = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
FORMS = sorted((ROOT / ".github/ISSUE_TEMPLATE").glob("[!c]*.yml"))


def read(name: str) -> Any:
    return yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))


def steps(job: dict[str, Any]) -> list[str]:
    return [step["run"] for step in job["steps"] if "run" in step]


def test_the_citation_is_of_this_version_and_of_the_paper() -> None:
    citation = read("CITATION.cff")
    assert citation["cff-version"] == "1.2.0"
    assert citation["version"] == __version__
    assert citation["license"] == PROJECT["license"]
    paper = citation["preferred-citation"]
    assert (paper["authors"][0]["family-names"], paper["journal"], paper["year"]) == ("Ribeiro", "Robotica", 2024)
    assert len(paper["authors"]) == 9


def test_the_changelog_keeps_its_form_and_has_upgrade_notes() -> None:
    """Keep a Changelog 1.1.0: versions newest first with ISO dates, and six kinds of changes."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    first, *versions, last = re.findall(r"^## (.+)$", text, re.MULTILINE)
    assert (first, last) == ("Unreleased", "Upgrade notes")
    dated = [re.fullmatch(r"(\d+)\.(\d+)\.(\d+) - (\d{4}-\d{2}-\d{2})", version) for version in versions]
    assert all(dated)
    numbers = [tuple(int(match[part]) for part in (1, 2, 3)) for match in dated if match]
    assert numbers == sorted(set(numbers), reverse=True)
    assert [int(part) for part in __version__.split(".")[:3]] == list(numbers[0])
    changes, _, notes = text.partition("## Upgrade notes")
    kinds = set(re.findall(r"^### (.+)$", changes, re.MULTILINE))
    assert kinds <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    upgrades = re.findall(r"^### To (.+)$", notes, re.MULTILINE)
    assert set(upgrades) <= {"the next version", *(version.partition(" ")[0] for version in versions)}


def test_the_security_policy_names_what_is_there() -> None:
    text = (ROOT / "SECURITY.md").read_text(encoding="utf-8")
    assert set(re.findall(r"`make ([a-z-]+)`", text)) <= TARGETS
    for place in re.findall(r"\]\(([^)#]+)", text):
        assert (ROOT / place).is_file()
    assert "Report a vulnerability" in text


def test_the_recipe_of_the_images_agrees_with_the_tree() -> None:
    recipe = (ROOT / "Containerfile").read_text(encoding="utf-8")
    stages = re.findall(r"^FROM .* AS (\w+)$", recipe, re.MULTILINE)
    assert stages == ["package", "agent", "run"]
    for target in re.findall(r"\bmake ([.\w/-]+)", re.sub(r"#.*|apt-get install[^&]*", "", recipe)):
        assert target in TARGETS or target == ".venv/.run"
    assert 'CMD ["make", "run"]' in recipe
    assert all(stage in stages for stage in re.findall(r"--from=(\w+)", recipe))
    left_out = set((ROOT / ".dockerignore").read_text(encoding="utf-8").split())
    needed = {
        "agent",
        "profiles",
        "campaigns",
        "firmware_params",
        "examples",
        "constraints.txt",
        "LICENSE",
        "README.md",
    }
    assert all((ROOT / name).exists() for name in needed)
    assert not left_out & needed
    for script in ("try_containers.sh", "try_system.sh", "check_wheel.sh"):
        assert os.access(ROOT / "tools" / script, os.X_OK)


def test_the_workflow_tries_the_other_systems() -> None:
    jobs = read(".github/workflows/tests.yml")["jobs"]
    assert jobs["systems"]["strategy"]["matrix"]["system"] == ["macos-latest", "windows-latest"]
    tried = (ROOT / "tools/try_system.sh").read_text(encoding="utf-8")
    assert re.findall(r'^"\$bin/xitl" (\w+)', tried, re.MULTILINE)[:5] == ["sim", "logs", "wdri", "view", "campaign"]


def test_the_workflow_runs_every_python_that_is_promised() -> None:
    jobs = read(".github/workflows/tests.yml")["jobs"]
    least = PROJECT["requires-python"].removeprefix(">=")
    pythons = jobs["host"]["strategy"]["matrix"]["python"]
    assert (pythons[0], pythons[-1]) == (least, "3.14")
    named = [entry.rpartition(" ")[2] for entry in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", entry)]
    assert pythons == named
    assert {step["with"]["python-version"] for step in jobs["agent"]["steps"] if "with" in step} == {"3.9"}
    for job in jobs.values():
        for command in steps(job):
            if command.startswith("make "):
                assert set(command.split()[1:]) <= TARGETS
            else:
                assert (ROOT / command.split()[-1]).is_file()


def test_what_has_to_pass_is_what_the_workflow_runs() -> None:
    jobs = read(".github/workflows/tests.yml")["jobs"]
    assert ".ci/run" in steps(jobs["all"])
    asked = re.findall(r"\bmake ([a-z-]+)\b", (ROOT / ".ci/run").read_text(encoding="utf-8"))
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    tests = re.search(r"^test: .*\n((?:\t.*\n)+)", makefile, re.MULTILINE)
    checks = re.search(r"^checks: ([^#\n]*)", makefile, re.MULTILINE)
    assert tests is not None
    assert sorted(asked) == sorted([*re.findall(r"\(MAKE\) ([a-z-]+)", tests[1]), "checks"])
    assert set(asked) <= TARGETS
    assert checks is not None
    assert set(checks[1].split()) == {"lint", "types", "check-dialect", "docs", "wheel"} <= TARGETS


@pytest.mark.medium
def test_every_hook_is_local_and_starts_what_is_there() -> None:
    repositories = read(".pre-commit-config.yaml")["repos"]
    assert [repository["repo"] for repository in repositories] == ["local"]
    for hook in repositories[0]["hooks"]:
        assert hook["language"] == "system"
        program, *words = hook["entry"].split()
        if program == "make":
            assert set(words) <= TARGETS
        else:
            assert program in (".venv/bin/ruff", ".venv/bin/mypy", ".venv/bin/python")
        if program == ".venv/bin/python":
            assert (ROOT / words[0]).is_file()
        if "files" in hook:
            paths = [str(file.relative_to(ROOT)) for folder in ("agent", "docs", "xitl_cli", "xitl", "sim_core")
                     for file in (ROOT / folder).rglob("*.*")]  # fmt: skip
            assert any(re.search(hook["files"], path) for path in paths), hook["id"]


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.stem)
def test_a_form_asks_for_what_is_needed(form: Path) -> None:
    content = yaml.safe_load(form.read_text(encoding="utf-8"))
    assert content["name"]
    assert content["description"]
    fields = content["body"]
    assert len({field["id"] for field in fields}) == len(fields)
    assert any(field.get("validations", {}).get("required") for field in fields)
    assert {field["type"] for field in fields} <= {"textarea", "input", "checkboxes", "dropdown", "markdown"}


def test_the_template_of_a_change_names_targets_that_are_there() -> None:
    text = (ROOT / ".github/pull_request_template.md").read_text(encoding="utf-8")
    asked = [word for words in re.findall(r"`make ([^`]+)`", text) for word in words.split()]
    assert "test" in asked
    assert set(asked) <= TARGETS


def test_no_output_of_a_run_lies_at_the_top_of_the_tree() -> None:
    named = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    outputs = (".png", ".html", ".mcap", ".bin", ".pdf", ".svg", ".csv")
    assert [name for name in named if "/" not in name and name.endswith(outputs)] == []


STUB = """#!/bin/sh
echo "$(basename $0) $*" >> "$CALLS"
wait_for() { until [ -e "$1" ]; do sleep 0.01; done; }
case "$1" in
    checks) [ -z "$LATE" ] || wait_for "$CALLS.last" ;;
    test-fast) [ -n "$LATE" ] || wait_for build/checks.code ;;
    test-realtime) touch "$CALLS.last" ;;
esac
if [ "$1" = "${FAILING:-none}" ]; then
    seq -f "line %g of $1" 100
    exit 1
fi
"""
"""Stands for each program. The checks end before the fast tests, or if LATE is set, after the last tests."""


def ci_run(folder: Path, failing: str = "", late: str = "") -> tuple[int, str, list[str]]:
    """Run `.ci/run` with stubs of all programs. Return exit code, output and the targets of make."""
    programs = ["bin/make", "bin/apt-get", ".venv/bin/python", ".venv/bin/xitl"]
    programs += [f"tools/{name}.sh" for name in ("system_packages", "armhf_python", "ros_python")]
    for name in programs:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(STUB, encoding="utf-8")
        (folder / name).chmod(0o755)
    (folder / ".ci").mkdir()
    shutil.copy(ROOT / ".ci/run", folder / ".ci/run")
    variables = {"CALLS": str(folder / "calls"), "FAILING": failing, "LATE": late}
    done = subprocess.run(
        [folder / ".ci/run"],
        env={"PATH": f"{folder / 'bin'}:{os.environ['PATH']}", **variables},
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=60, check=False,
    )  # fmt: skip
    calls = (folder / "calls").read_text(encoding="utf-8").splitlines()
    return done.returncode, done.stdout, [call.removeprefix("make ") for call in calls if call.startswith("make ")]


def test_ci_runs_all_stages_and_passes(tmp_path: Path) -> None:
    code, output, targets = ci_run(tmp_path)
    assert (code, "failed" in output) == (0, False)
    assert sorted(targets) == [".venv/.dev", "checks", "test-fast", "test-medium", "test-realtime", "test-slow"]
    tests = [target for target in targets if "test" in target]
    assert tests == ["test-fast", "test-medium", "test-slow", "test-realtime"]


def test_ci_stops_after_the_stage_in_which_checks_fail(tmp_path: Path) -> None:
    code, output, targets = ci_run(tmp_path, failing="checks")
    assert code == 1
    assert [target for target in targets if "test" in target] == ["test-fast"]
    end = output.splitlines()[-50:]
    assert "line 100 of checks" in end
    assert "checks failed; the end of build/checks.log:" in end
    assert any(line.endswith("checks, beside the tests: failed") for line in end)


def test_ci_reports_checks_that_fail_after_the_last_stage(tmp_path: Path) -> None:
    code, output, targets = ci_run(tmp_path, failing="checks", late="yes")
    assert code == 1
    assert "test-realtime" in targets
    assert "line 100 of checks" in output.splitlines()[-50:]


@pytest.mark.parametrize("failing", ["test-fast", "test-medium", "test-slow", "test-realtime"])
def test_ci_stops_at_tests_that_fail(tmp_path: Path, failing: str) -> None:
    code, output, targets = ci_run(tmp_path, failing=failing)
    tests = [target for target in targets if "test" in target]  # the checks begin beside the fast tests
    assert (code, tests[-1]) == (1, failing)
    assert re.search(r"^(fast tests|medium tests|slow tests|tests of real time) failed$", output, re.MULTILINE)
    assert "checks failed" not in output
