"""``python -m capsbayes`` is the command line."""

import subprocess
import sys

import pytest

import capsbayes


def said_by(*arguments):
    return subprocess.run([sys.executable, "-m", "capsbayes", *arguments], check=False, capture_output=True, text=True)


def test_the_module_is_run_as_the_command_line():
    done = said_by("--version")
    assert (done.returncode, done.stdout) == (0, f"capsbayes {capsbayes.__version__}\n")


def test_a_mistake_is_one_line_of_the_command():
    done = said_by("identify", "absent.toml")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "capsbayes: absent.toml: expected a file, got nothing there\n"


@pytest.mark.parametrize(
    ("closed", "arguments", "status"),
    [
        (">&-", "--version", 0),
        (">&- 2>&-", "--version", 0),
        ("| exec true", "--help", 1),
        (">&-", "identify absent.toml", 2),
    ],
)
def test_nobody_need_read_what_is_printed(closed, arguments, status):
    command = f"set -o pipefail; (sleep 1; exec {sys.executable} -m capsbayes {arguments}) {closed}"
    done = subprocess.run(["bash", "-c", command], check=False, capture_output=True, text=True)
    assert done.returncode == status
    assert len(done.stderr.splitlines()) == (status == 2)
