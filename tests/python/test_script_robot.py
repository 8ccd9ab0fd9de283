"""scripts/robot keeps out of a runtime folder that others can get at: it would start programs from pid files and sockets
that are theirs."""

import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def robot(command, folder):
    environment = dict(os.environ, MRR_RUNTIME_DIR=str(folder), MRR_BUILD_DIR="/nonexistent")
    return subprocess.run([ROOT / "scripts/robot", command], capture_output=True, text=True, timeout=30, check=False,
                          env=environment)


def spoilt(tmp_path, how):
    folder = tmp_path / "run"
    if how == "a file":
        folder.write_text("")
    elif how == "a link":
        (tmp_path / "elsewhere").mkdir(mode=0o700)
        folder.symlink_to(tmp_path / "elsewhere")
    else:
        folder.mkdir(mode=0o700)
        if how == "open to others":
            folder.chmod(0o750)
        else:
            os.chown(folder, 65534, 65534)
    return folder


@pytest.mark.parametrize("how, reason", [("a file", "is not a folder"), ("a link", "is not a folder"),
                                         ("open to others", "chmod 0700"), ("another user's", "belongs to user 65534")])
@pytest.mark.parametrize("command", ["down", "status"])
def test_a_runtime_folder_others_can_get_at_is_refused(tmp_path, command, how, reason):
    if how == "another user's" and os.geteuid() != 0:
        pytest.skip("only root can make a folder for another user")
    r = robot(command, spoilt(tmp_path, how))
    assert r.returncode == 1
    assert reason in r.stderr


def test_without_a_folder_nothing_is_up(tmp_path):
    r = robot("status", tmp_path / "none")
    assert r.returncode == 1
    assert "nothing is up" in r.stderr
    assert not (tmp_path / "none").exists()
