"""`anchorflow token`: what it prints opens what it writes."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest

from anchorflow_cli.main import main
from anchorflow_service.http.tokens import TokenFile


def run(*arguments: str) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["token", *arguments])
    assert caught.value.code == 0


def failure(*arguments: str) -> str:
    with pytest.raises(SystemExit) as caught:
        main(["token", *arguments])
    return str(caught.value.code)


def test_what_is_printed_opens_what_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "tokens"
    run(str(file), "robot-7")
    run(str(file), "chief", "--scopes", "infer,admin")
    robot, chief = capsys.readouterr().out.split()

    tokens = TokenFile(file)
    found = {name: tokens.find(token) for name, token in (("robot", robot), ("chief", chief))}
    assert found["robot"] is not None
    assert found["chief"] is not None
    assert (found["robot"].name, found["robot"].scopes) == ("robot-7", {"infer"})
    assert (found["chief"].name, found["chief"].scopes) == ("chief", {"infer", "admin"})
    assert robot not in file.read_text()
    assert len(robot) >= 40
    assert stat.S_IMODE(file.stat().st_mode) == 0o600


@pytest.mark.parametrize("text", ["", "# NAME SCOPES sha256:DIGEST\n"])
def test_a_file_without_a_token_gets_its_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str
) -> None:
    file = tmp_path / "tokens"
    file.write_text(text)
    run(str(file), "robot-7")

    found = TokenFile(file).find(capsys.readouterr().out.strip())
    assert found is not None
    assert found.name == "robot-7"
    assert file.read_text().startswith(text)


def test_a_last_line_without_an_end_is_not_continued(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "tokens"
    run(str(file), "robot-7")
    file.write_text(file.read_text().rstrip())
    run(str(file), "robot-8")

    tokens = TokenFile(file)
    found = [tokens.find(token) for token in capsys.readouterr().out.split()]
    assert [token and token.name for token in found] == ["robot-7", "robot-8"]
    assert len(file.read_text().splitlines()) == 2


def test_what_cannot_be_is_one_line_and_changes_nothing(tmp_path: Path) -> None:
    file = tmp_path / "tokens"
    run(str(file), "robot-7")
    before = file.read_text()

    assert failure(str(file), "robot-7").endswith("tokens: has a token named robot-7 already")
    assert "expected scopes among infer,admin" in failure(str(file), "a", "--scopes", "root")
    assert "expected a name" in failure(str(file), "a/b")
    assert "NAME SCOPES sha256:DIGEST" in failure(str(file), "a b")
    assert file.read_text() == before
    assert "cannot be written" in failure(str(tmp_path / "no" / "folder"), "a")

    file.write_text("nonsense\n")
    assert "line 1: expected NAME SCOPES" in failure(str(file), "a")
