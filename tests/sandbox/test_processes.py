"""Processes of sandboxes end when they are to, and their hosts go on."""

import os
import random
import resource
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from contextlib import suppress
from pathlib import Path

import pytest

from ssduck.errors import LimitError, SandboxError
from ssduck.interpreter.stopping import StopRequest
from ssduck.lazy import ONE_THREAD
from ssduck.limits import Limits
from ssduck.sandbox import SandboxedInterpreter
from ssduck.sandbox.processes import Zygote, shared_zygote
from tests.support.triggering import until

PAST_HANGING = 60.0


def is_running(pid):
    """Whether there is a process of a number that is no zombie."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return False
    return text.rpartition(")")[2].split()[0] not in "ZX"


def wait_for_end(pids):
    until(lambda: not any(map(is_running, pids)))


def children_of(pid):
    """The numbers of a process's children."""
    return [int(n) for n in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


# How many processes are killed: for each change, and in the night.
MANY = pytest.param(500, marks=pytest.mark.long)


@pytest.mark.slow
@pytest.mark.parametrize("count", [25, MANY])
def test_killed_workers_leave_nothing_and_no_question_hangs(zygote, count):
    """They are killed at random moments: while one starts, computes, answers or waits."""
    generator = random.Random(43)  # noqa: S311
    pids, answers = set(), 0
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    folder = Path(zygote._folder)
    with SandboxedInterpreter(limits=Limits.strict(seconds=20), zygote=zygote) as ss:
        ss["mine"] = 7
        for _ in range(count):
            process = ss._worker
            pids.add(process._pid)
            killer = threading.Timer(generator.random() * 0.02, os.kill, (process._pid, 9))
            killer.start()
            try:
                while process.is_alive:
                    assert ss.eval("sum(SELECT a.this FROM a=[1, 2, 3, mine] AS list);") == 13
                    answers += 1
            except (LimitError, UserWarning) as error:
                assert "process of the" in str(error)
            killer.join()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                assert ss.eval("1;") == 1
            assert ss.eval("mine;") == 7
        pids.add(ss._worker._pid)
    assert len(pids) >= count
    assert answers > count // 5
    wait_for_end(pids)
    assert not any(folder.glob("worker*/scratch/*"))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000


# Forks a host for each line that it reads, which asks a sandbox until it is killed.
HOSTS = """
import os, sys
from ssduck.sandbox import SandboxedInterpreter, processes, worker
for line in sys.stdin:
    if (pid := os.fork()) == 0:
        if line == "forked\\n":
            processes.fork_zygote()
        with SandboxedInterpreter() as ss:
            while ss.eval("1 + 1;") == 2:
                pass
    print(pid, flush=True)
    os.waitpid(pid, 0)
"""


def running_with(text):
    """The numbers of the processes whose commands have a text."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            if text.encode() in path.read_bytes() and is_running(int(path.parent.name)):
                found.append(int(path.parent.name))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("count", [5, MANY])
def test_killed_hosts_leave_nothing(count, tmp_path):
    """They are killed at random moments, one of ten with a zygote that was executed."""
    generator = random.Random(44)  # noqa: S311
    command = [sys.executable, "-c", HOSTS, str(tmp_path)]
    environment = {**os.environ, **ONE_THREAD, "TMPDIR": str(tmp_path)}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    most = 0
    with subprocess.Popen(command, env=environment, text=True, **pipes) as hosts:
        for number in range(count):
            kind, seconds = ("executed", 6.0) if number % 10 == 4 else ("forked", 0.6)
            hosts.stdin.write(f"{kind}\n")
            hosts.stdin.flush()
            pid = int(hosts.stdout.readline())
            time.sleep(generator.random() * seconds)
            most = max(most, len(running_with(str(tmp_path))))
            os.kill(pid, signal.SIGKILL)
            until(
                lambda: running_with(str(tmp_path)) == [hosts.pid] and not any(tmp_path.iterdir())
            )
        hosts.stdin.close()
    assert most == 4  # where hosts were started from, a host, its zygote, and a worker


HOST = """
import sys, time
from ssduck.limits import Limits
from ssduck.sandbox import SandboxedInterpreter
from ssduck.sandbox.processes import shared_zygote
ss = SandboxedInterpreter(limits=Limits.strict(seconds=100))
print(shared_zygote().pid, ss._worker._pid, shared_zygote()._folder, flush=True)
{}
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "work"),
    [
        (signal.SIGKILL, "time.sleep(100)"),
        (signal.SIGKILL, "ss.sql('SELECT sleep_ms(90000)')"),
        (signal.SIGINT, "ss.sql('SELECT sleep_ms(90000)')"),
    ],
)
def test_all_processes_end_with_their_host(number, work):
    code = HOST.format(work)
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as host:
        zygote, worker, folder = host.stdout.readline().split()
        assert is_running(worker)
        host.send_signal(number)
        host.wait(PAST_HANGING)
    wait_for_end([zygote, worker])
    until(lambda: not Path(folder).exists())


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_command_forks_its_zygote_which_ends_with_it(number, tmp_path):
    command = [*(sys.executable, "-m", "ssduck", "query", "kitchen", "--strict", "--sql")]
    command.append("SELECT sleep_ms(90000)")
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    with subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL) as host:
        until(lambda: any(map(children_of, children_of(host.pid))))
        (zygote,) = children_of(host.pid)
        (worker,) = children_of(zygote)
        asked = [Path(f"/proc/{pid}/cmdline").read_bytes() for pid in (host.pid, zygote, worker)]
        assert len(set(asked)) == 1  # no program was executed
        assert os.getsid(zygote) == zygote
        host.send_signal(number)
        assert host.wait(PAST_HANGING) == (-9 if number == signal.SIGKILL else 130)
    wait_for_end([zygote, worker])
    until(lambda: not any(tmp_path.iterdir()))


@pytest.mark.slow
def test_a_host_that_ends_before_its_zygote_is_ready_leaves_nothing():
    code = """
from ssduck.sandbox.processes import shared_zygote
print(shared_zygote().pid, shared_zygote()._folder, flush=True)
import time; time.sleep(100)
"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as host:
        zygote, folder = host.stdout.readline().split()
        host.kill()
    wait_for_end([zygote])
    assert not Path(folder).exists()


@pytest.mark.slow
def test_a_host_without_standard_streams_has_sandboxes():
    code = """
import os, sys
os.close(0); os.close(1)
sys.stdin = sys.stdout = None
import ssduck
with ssduck.Interpreter(limits=ssduck.Limits.strict()) as ss:
    sys.stderr.write(repr(ss.eval("print('x'); 1 + 1;")))
"""
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert told.stderr == "2"


@pytest.mark.slow
def test_a_host_that_ends_normally_leaves_nothing():
    told = subprocess.run(
        [sys.executable, "-c", HOST.format("")], capture_output=True, text=True, check=True
    )
    zygote, worker, folder = told.stdout.split()
    wait_for_end([zygote, worker])
    assert not Path(folder).exists()
    assert told.stderr == ""


@pytest.mark.slow
def test_workers_end_with_their_zygote_and_the_next_question_has_another():
    zygote = Zygote()
    with SandboxedInterpreter(zygote=zygote) as ss:
        worker = ss._worker._pid
        os.kill(zygote.pid, signal.SIGKILL)
        wait_for_end([worker])
        until(lambda: not ss._worker.is_alive)
        with pytest.warns(UserWarning, match="has ended"), pytest.raises(SandboxError):
            ss.eval("1;")
    zygote.close()
    first = shared_zygote()
    with SandboxedInterpreter() as ss:
        os.kill(first.pid, signal.SIGKILL)
        until(lambda: not ss._worker.is_alive)
        with pytest.warns(UserWarning, match="process of the sandbox has ended"):
            assert ss.eval("1 + 1;") == 2
    shared_zygote().close()


@pytest.mark.slow
def test_time_is_ended_by_the_host(zygote):
    with SandboxedInterpreter(limits=Limits.strict(seconds=0.3), zygote=zygote) as ss:
        pid = ss._worker._pid
        with pytest.raises(LimitError, match=r"took more than 0\.3 s, and its process was ended"):
            ss.ask("worker.python", "__import__('time').sleep(100)")
        wait_for_end([pid])
        with pytest.raises(LimitError, match=r"took more than 0\.3 s"):
            ss.ask(
                "worker.python",
                "__import__('signal').pthread_sigmask(0, range(1, 64)) is None or [0 for _ in iter(int, 1)]",
            )
        assert ss.eval("1;") == 1


@pytest.mark.slow
def test_ctrl_c_ends_the_program_and_keeps_its_variables(zygote):
    with SandboxedInterpreter(limits=Limits.strict(seconds=60), zygote=zygote) as ss:
        ss.eval("low = 0.5;")
        ss["m"] = list(range(100_000))
        worker = ss._worker
        for ask in (
            lambda: ss.eval("sum(SELECT a.this * b.this FROM a=m, b=m AS list);"),
            lambda: ss.ask("worker.python", "__import__('time').sleep(60)"),
            lambda: ss.sql("SELECT sum(a.range * b.range) FROM range(1000000) a, range(1000000) b"),
        ):
            threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
            with pytest.raises(KeyboardInterrupt):
                ask()
            assert ss.eval("low;") == 0.5
        assert ss._worker is worker


@pytest.mark.slow
def test_ctrl_c_ends_a_process_that_ignores_it(zygote):
    with SandboxedInterpreter(limits=Limits.strict(seconds=60), zygote=zygote) as ss:
        threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
        ignoring = "__import__('signal').signal(2, __import__('signal').SIG_IGN) and __import__('time').sleep(60)"
        with pytest.raises(KeyboardInterrupt):
            ss.ask("worker.python", ignoring)
        with pytest.warns(UserWarning, match="has ended"):
            assert ss.eval("1;") == 1


@pytest.mark.slow
def test_a_program_is_stopped_by_another_thread(zygote):
    with SandboxedInterpreter(limits=Limits.strict(seconds=60), zygote=zygote) as ss:
        ss.eval("low = 0.5;")
        ss["m"] = list(range(100_000))
        stop = StopRequest()
        stopper = threading.Timer(0.3, stop.make)
        stopper.start()
        with stop.applies_to(ss):
            for _ in range(2):  # the second does not begin
                with pytest.raises(LimitError, match="stopped"):
                    ss.eval("sum(SELECT a.this * b.this FROM a=m, b=m AS list);")
        stopper.join()
        assert ss.eval("low;") == 0.5


@pytest.mark.slow
def test_threads_of_the_host_take_turns(zygote):
    with SandboxedInterpreter(zygote=zygote) as ss:
        found = []

        def ask(number):
            found.extend(ss.eval(f"{number} * {i};") == number * i for i in range(20))

        threads = [threading.Thread(target=ask, args=(n,)) for n in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert found == [True] * 80


@pytest.mark.slow
def test_sandboxes_share_no_variables(zygote):
    with SandboxedInterpreter(zygote=zygote) as one, SandboxedInterpreter(zygote=zygote) as other:
        one["x"] = 1
        other["x"] = 2
        assert (one.eval("x;"), other.eval("x;")) == (1, 2)
        folders = [ss.ask("worker.python", "__import__('os').getcwd()") for ss in (one, other)]
        with pytest.raises(SandboxError, match="Permission denied"):
            one.ask("worker.python", f"__import__('os').listdir({folders[1]!r})")


@pytest.mark.slow
def test_one_that_nothing_refers_to_ends(zygote):
    ss = SandboxedInterpreter(zygote=zygote)
    worker, folder = ss._worker._pid, ss._worker._scratch
    del ss
    wait_for_end([worker])
    assert not folder.exists()


def test_the_zygote_has_one_thread_and_nothing_of_the_host(zygote):
    pid = zygote.pid
    assert len(list(Path(f"/proc/{pid}/task").iterdir())) == 1
    assert os.getsid(pid) == pid
    assert Path(f"/proc/{pid}/cwd").resolve() == Path("/")
    opened = {str(path.readlink()) for path in Path(f"/proc/{pid}/fd").iterdir()}
    assert not any(path.startswith(tempfile.gettempdir()) for path in opened)


@pytest.mark.slow
def test_what_cannot_start_says_why(tmp_path, monkeypatch):
    (tmp_path / "broken_zygote.py").write_text(
        "import threading\n"
        "def main():\n"
        "    from ssduck.sandbox import zygote\n"
        "    threading.Thread(target=threading.Event().wait, daemon=True).start()\n"
        "    zygote.run(None, zygote.json.loads(zygote.sys.argv[1]))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    zygote = Zygote("broken_zygote")
    with pytest.raises(SandboxError, match="has started threads"):
        SandboxedInterpreter(zygote=zygote)
    with pytest.raises(SandboxError, match="cannot start"):
        SandboxedInterpreter(zygote=Zygote("no_such_module"))


@pytest.mark.slow
def test_a_forked_child_leaves_the_process_to_its_parent(zygote):
    with SandboxedInterpreter(zygote=zygote) as ss:
        reading, writing = os.pipe()
        if (child := os.fork()) == 0:
            try:
                ss.close()
            finally:
                os.write(writing, b"x")
                os._exit(0)
        os.waitpid(child, 0)
        assert select.select([reading], [], [], 0)[0]
        assert ss.eval("1 + 1;") == 2
        os.close(reading)
        os.close(writing)
