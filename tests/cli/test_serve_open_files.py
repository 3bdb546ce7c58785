"""`anchorflow serve` under limits on open files."""

from __future__ import annotations

import subprocess
import sys
import textwrap

import pytest

from anchorflow_cli.listening import OTHER_FILES
from anchorflow_service.http.connections import RESERVE
from anchorflow_service.http.lifecycle import BACKLOG

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="has no such limits")

BESIDE = RESERVE + BACKLOG + OTHER_FILES
# A separate process, since a hard limit cannot be raised again.
PROGRAM = """
    import logging, resource, sys
    from anchorflow_cli.listening import within_open_files
    from anchorflow_service.http.connections import ConnectionLimits

    logging.basicConfig(format="%(message)s")
    resource.setrlimit(resource.RLIMIT_NOFILE, (int(sys.argv[1]), int(sys.argv[2])))
    limits = within_open_files(ConnectionLimits(max_connections=300))
    print(limits.max_connections, resource.getrlimit(resource.RLIMIT_NOFILE)[0])
"""


@pytest.mark.parametrize(
    ("soft", "hard", "told"),
    [
        (BESIDE + 300, BESIDE + 400, (300, BESIDE + 300)),
        (100, BESIDE + 400, (300, BESIDE + 300)),
        (100, BESIDE + 20, (20, BESIDE + 20)),
    ],
    ids=["enough", "raised", "fewer"],
)
def test_connections_and_open_files_fit(soft: int, hard: int, told: tuple[int, int]) -> None:
    run = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(PROGRAM), str(soft), str(hard)],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )

    assert tuple(map(int, run.stdout.split())) == told
    assert ("--max-connections is 20 in place of 300" in run.stderr) == (told[0] == 20)


def test_too_few_open_files_are_one_line() -> None:
    program = f"""
        import resource
        from anchorflow_cli.main import main

        resource.setrlimit(resource.RLIMIT_NOFILE, ({BESIDE}, {BESIDE}))
        main(["serve", "--port", "0"])
    """
    run = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )

    expected = f"anchorflow serve: open files (ulimit -n): expected more than {BESIDE}"
    assert (run.returncode, run.stdout) == (1, "")
    assert run.stderr.startswith(expected)
    assert len(run.stderr.splitlines()) == 1
