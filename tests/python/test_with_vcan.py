"""scripts/with_vcan: a command on real vcan interfaces keeps its folder, environment, output and exit status, and leaves
nothing behind, however it ends."""

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
WITH_VCAN = ROOT / "scripts/with_vcan"

# Native inside User Mode Linux: the second way is tested on machines whose own kernel has no vcan.
WAYS = {"first choice": [], "native": ["--interfaces", "1", "--", str(WITH_VCAN), "--how", "native"]}


@pytest.fixture(params=WAYS)
def way(request):
    return WAYS[request.param]


def run(*arguments, **options):
    return subprocess.run([WITH_VCAN, *map(str, arguments)], capture_output=True, text=True, timeout=120, check=False,
                          **options)


def processes_of_kernels():
    """User Mode Linux programs that we may see."""
    found = set()
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and "linux.uml" in (entry / "cmdline").read_text():
                found.add(int(entry.name))
        except OSError:
            pass  # ended meanwhile
    return found


def wait_until(condition, limit_s=10):
    end = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_the_command_has_two_interfaces_and_a_frame_crosses(way):
    r = run(*way, "--", "sh", "-c", "candump -L -n 1 -T 5000 vcan1 & sleep 0.5; cansend vcan1 123#DEADBEEF; wait")
    assert r.returncode == 0, r.stderr
    assert "vcan1 123#DEADBEEF" in r.stdout
    assert "with_vcan: uml" in r.stderr or "with_vcan: native" in r.stderr


def test_fd_frames_only_where_asked_for(way):
    command = ["--", "ip", "link", "show", "vcan0"]
    assert " mtu 72 " in run(*way, *command).stdout
    assert " mtu 16 " in run(*way, "--mtu", "classic", *command).stdout


def test_folder_environment_output_and_status_are_the_commands(way, tmp_path):
    script = 'pwd; printf "%s\\n" "$MRR_TEST_WORD" "$1"; echo aside >&2; echo kept >made; exit 43'
    r = run(*way, "--", "sh", "-c", script, "sh", "a  'b' \"c\" $d", cwd=tmp_path,
            env={**os.environ, "MRR_TEST_WORD": "two words 'and' $more"})
    assert r.returncode == 43
    assert r.stdout.splitlines() == [str(tmp_path), "two words 'and' $more", "a  'b' \"c\" $d"]
    assert "aside" in r.stderr
    assert (tmp_path / "made").read_text() == "kept\n"


def test_stdin_only_on_request(way):
    assert run("--stdin", *way, "--stdin", "--", "cat", input="abc").stdout == "abc"
    assert run(*way, "--", "cat", input="abc").stdout == ""


def test_output_comes_while_the_command_runs():
    with subprocess.Popen([WITH_VCAN, "--", "sh", "-c", "echo first; sleep 60"], stdout=subprocess.PIPE,
                          stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout.readline() == "first\n"
        process.terminate()
        assert process.wait(30) == 128 + signal.SIGTERM


def test_time_limit(way):
    started = time.monotonic()
    r = run(*way, "--time-limit", "1", "--", "sleep", "60")
    assert r.returncode == 124
    assert "time limit of 1 s" in r.stderr
    assert time.monotonic() - started < 30


def test_what_the_command_left_running_ends_with_it(way, tmp_path):
    ticks = tmp_path / "ticks"
    r = run(*way, "--", "sh", "-c", f"(while sleep 0.1; do echo x >>{ticks}; done) & sleep 0.5")
    assert r.returncode == 0
    size = ticks.stat().st_size
    assert size > 0
    time.sleep(0.5)
    assert ticks.stat().st_size == size


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
def test_nothing_is_left_when_it_is_killed(number, tmp_path):
    before = processes_of_kernels()
    mounts = Path("/proc/mounts").read_text()
    with subprocess.Popen([WITH_VCAN, "--how", "uml", "--", "sh", "-c", "echo up; exec sleep 60"],
                          stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
                          env={**os.environ, "TMPDIR": str(tmp_path)}) as process:
        assert process.stdout.readline() == "up\n"
        assert processes_of_kernels() - before
        process.send_signal(number)
        process.wait(30)
    wait_until(lambda: not processes_of_kernels() - before)
    wait_until(lambda: not list(tmp_path.iterdir()))
    assert Path("/proc/mounts").read_text() == mounts


def test_nothing_is_left_after_an_ordinary_end(tmp_path):
    devices = sorted(p.name for p in Path("/dev").iterdir())
    before = processes_of_kernels()
    r = run("--how", "uml", "--tmp", "private", "--", "sh", "-c", "touch /tmp/in_the_guest /dev/in_the_guest /run/in_the_guest", cwd="/")
    assert r.returncode == 0, r.stderr
    assert not processes_of_kernels() - before
    assert sorted(p.name for p in Path("/dev").iterdir()) == devices
    assert not Path("/tmp/in_the_guest").exists() and not Path("/run/in_the_guest").exists()


def test_no_vcan_at_all_is_a_failure_with_both_reasons(tmp_path):
    (tmp_path / "unshare").write_text("#!/bin/sh\n")
    r = run("--how", "uml", "--", "true", env={**os.environ, "MRR_UML_KERNEL": "no_such_kernel"})
    assert r.returncode == 125
    assert "linux.uml is not installed" in r.stderr and "scripts/setup --test" in r.stderr
    r = run("--how", "uml", "--", "true", env={**os.environ, "MRR_UML_MODULES": str(tmp_path)})
    assert r.returncode == 125
    assert f"no vcan module under {tmp_path}" in r.stderr


def test_a_guest_that_dies_is_a_failure_with_its_console(tmp_path):
    kernel = tmp_path / "kernel"
    kernel.write_text('#!/bin/sh\necho "Kernel panic: no luck"\nexit 3\n')
    kernel.chmod(0o755)
    modules = tmp_path / "kernel_modules/kernel/drivers/net/can"
    modules.mkdir(parents=True)
    (modules / "vcan.ko").touch()
    r = run("--how", "uml", "--", "true", env={**os.environ, "MRR_UML_KERNEL": str(kernel),
                                               "MRR_UML_MODULES": str(tmp_path / "kernel_modules")})
    assert r.returncode == 125
    assert "did not come up" in r.stderr and "no luck" in r.stderr


@pytest.mark.parametrize("arguments", [[], ["--"], ["--interfaces", "0", "--", "true"], ["--memory", "1", "--", "true"],
                                       ["--time-limit", "-1", "--", "true"], ["--nonsense", "true"],
                                       ["--cpu", "4096", "true"]])
def test_unusable_options(arguments):
    r = run(*arguments)
    assert r.returncode == 2
    assert r.stderr.strip()


def test_help():
    r = run("--help")
    assert r.returncode == 0
    assert "--time-limit" in r.stdout and "exit status" in r.stdout
