"""One run writes an output at a time; a lock ends with its owner, and needs no file system that has locks."""

import errno
import signal
import sys

import pytest
from processes import python

from capsbayes.errors import InputError
from capsbayes.run import only_run

if sys.platform != "win32":
    import fcntl
of_unix = pytest.mark.skipif(sys.platform == "win32", reason="flock")

HOLDS = """
import sys, time
from pathlib import Path
from capsbayes.run import only_run
with only_run(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(1000)
"""


@pytest.mark.parametrize("folder", [True, False])
def test_a_second_run_is_refused_until_the_first_is_killed(tmp_path, folder):
    out = tmp_path if folder else tmp_path / "run.nc"
    owner = python("-c", HOLDS, out)
    with owner:
        assert owner.stdout.readline() == "held\n"
        with (
            pytest.raises(InputError, match=rf"no other run that writes it, got process {owner.pid} on .*; let it end"),
            only_run(out),
        ):
            pass
        owner.send_signal(signal.SIGKILL)
    with only_run(out), pytest.raises(InputError), only_run(out):
        pass
    assert not list(tmp_path.iterdir())


def test_a_link_leads_to_the_same_lock(tmp_path):
    (tmp_path / "other.nc").symlink_to(tmp_path / "run.nc")
    with only_run(tmp_path / "run.nc"), pytest.raises(InputError), only_run(tmp_path / "other.nc"):
        pass


@of_unix
def test_a_lock_that_was_removed_while_waited_for_is_taken_anew(tmp_path, monkeypatch):
    locked, seen = fcntl.flock, []

    def removed_first(file, how):
        if not seen:
            (tmp_path / ".run.nc.lock").unlink()
        seen.append(file)
        return locked(file, how)

    monkeypatch.setattr(fcntl, "flock", removed_first)
    with only_run(tmp_path / "run.nc"):
        assert len(seen) == 2


@of_unix
def test_a_file_system_without_locks_is_said_and_one_that_is_read_only_refused(tmp_path, monkeypatch, caplog):
    def unsupported(file, how):
        raise OSError(errno.ENOLCK, "No locks available")

    with monkeypatch.context() as patched:
        patched.setattr(fcntl, "flock", unsupported)
        with only_run(tmp_path / "run.nc"):
            pass
    assert "cannot be locked (No locks available): see that no other run" in caplog.text
    (tmp_path / "file").touch()
    with (
        pytest.raises(InputError, match=r"a place where files can be written, got (File exists|Not a directory)"),
        only_run(tmp_path / "file" / "run.nc"),
    ):
        pass
